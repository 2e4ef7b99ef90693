"""How much each hyperparameter matters, and its values taken one at a time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pneuma.search.importance import importances
from pneuma.search.sensitivity import points
from pneuma.search.trials import Task

from .conftest import MakeTask


def record(task: Task, values: list[float], direction: str = "maximize") -> dict[str, Any]:
    """Return a search's record of trials whose learning rates rise and whose activations alternate."""
    rates = np.geomspace(1e-5, 1e-2, len(values))
    trials = [
        {
            "number": n,
            "params": {"learning_rate": float(rate), "activation": ("tanh", "relu")[n % 2]},
            "value": value,
            "state": "complete",
        }
        for n, (rate, value) in enumerate(zip(rates, values, strict=True))
    ]
    return {"trials": trials, "identity": {"objectives": [{"direction": direction}]}}


@pytest.mark.parametrize(("sign", "direction"), [(1, "maximize"), (-1, "minimize")])
def test_what_alone_decides_is_most_important(make_task: MakeTask, sign: int, direction: str) -> None:
    task = make_task()
    found = importances(record(task, [sign * n / 24 for n in range(24)], direction), task.search.space)
    assert sum(found.values()) == pytest.approx(1)
    assert found["learning_rate"] > 0.8 > found["activation"]


def test_where_too_few_are_better_than_the_worst_nothing_is_known(make_task: MakeTask) -> None:
    """The best five of 12 would be all of them; Optuna calls every parameter as important, and warns."""
    task = make_task()
    assert importances(record(task, [0.0] * 8 + [0.1, 0.2, 0.3, 0.4]), task.search.space) == {}
    assert importances(record(task, [0.0] * 7 + [0.1, 0.2, 0.3, 0.4, 0.5]), task.search.space) != {}
    assert importances(record(task, [0.1, 0.2, 0.3]), task.search.space) == {}


def test_the_values_of_a_range_are_spread_evenly_with_the_bases_own(make_task: MakeTask) -> None:
    """By hand: three decades in four steps are a factor of 10^0.75 each; Table 6.2 has 3e-4, and tanh."""
    found = points(make_task())
    rates = [point for point in found if point.parameter == "learning_rate"]
    spread = [1e-5 * 10 ** (0.75 * step) for step in range(5)]
    assert [point.value for point in rates] == pytest.approx(sorted([*spread, 3e-4]), rel=1e-5)
    assert [point.value for point in rates if point.is_base] == [3e-4]
    kinds = [(point.value, point.is_base) for point in found if point.parameter == "activation"]
    assert sorted(kinds) == [("relu", False), ("tanh", True)]
