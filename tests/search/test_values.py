"""The value of a trial, by hand."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from pneuma.search import values
from pneuma.search.spec import OVER_SEEDS, Objective
from pneuma.search.values import combine, read_rows, trial_value
from pneuma.store.store import Status, Store
from pneuma.study.plan import Cell

from .conftest import MakeTask


@dataclass(frozen=True)
class _Row:
    """What a search reads of a row."""

    value: float = 0.0
    status: str = "done"


def test_over_seeds_by_hand() -> None:
    found = {name: combine(name, np.array([1.0, 2, 3, 8])) for name in OVER_SEEDS}
    assert found == pytest.approx({"mean": 3.5, "median": 2.5, "iqm": 2.5, "deviation": math.sqrt(29 / 3)})


@pytest.mark.parametrize(
    ("outcome", "over_seeds", "direction", "value"),
    [  # by hand, of 0.5 and of 0.7 that diverged; a share lies between 0 and 1, a return has no bounds
        ("final-share-killed", "mean", "maximize", 0.25),
        ("final-share-killed", "mean", "minimize", 0.75),
        ("final-share-killed", "deviation", "minimize", math.sqrt(0.5)),  # of 0 and 1
        ("final-return", "mean", "maximize", 0.6),
        ("final-return", "deviation", "minimize", math.sqrt(0.02)),
    ],
)
def test_a_diverged_run_counts_with_the_worst_that_can_be(
    monkeypatch: pytest.MonkeyPatch, outcome: str, over_seeds: str, direction: str, value: float
) -> None:
    monkeypatch.setattr(values, "outcome", lambda row, name: row.value)
    objective = Objective(outcome=outcome, over_seeds=over_seeds, direction=direction)
    rows = [_Row(0.5), _Row(0.7, "diverged")]
    assert trial_value(objective, rows) == pytest.approx(value)  # type: ignore[arg-type]


def test_a_run_that_diverges_after_a_pause_has_its_values_from_before(
    make_task: MakeTask, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So that what a pruner decided at the pause is decided again once the run's end is known."""
    run = make_task().search.make_run({"learning_rate": 1e-3, "activation": "tanh"}, steps=2048)
    cell = Cell("trial-000", 1000, run)
    monkeypatch.setattr(Store, "status", lambda *_: Status("diverged", 250))
    monkeypatch.setattr(values, "stored_row", lambda *_: "end")
    monkeypatch.setattr(values, "row_until", lambda *args: args[-1])
    rows = [read_rows(store, [cell], step)[0] for step in (100, 200, 250, 300, None)]
    assert rows == [100, 200, "end", "end", "end"]
