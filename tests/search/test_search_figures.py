"""What figures of searches show: numbers worked out from the formula that the trials are of."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure

from pneuma.figures import search as figures
from pneuma.figures.style import save_figure
from pneuma.search.record import read_record, save_record
from pneuma.study.plan import Cell
from pneuma.study.store import Store

from .conftest import MakeTask, Solve

MOMENTUM = """
[space.gamma]
low = 0.8
high = 1.0
"""
SPREAD = """
[objectives.spread]
outcome = "final-return"
over_seeds = "mean"
direction = "minimize"
"""


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures of searches that were about to be saved; they are saved all the same."""
    made: list[Figure] = []

    def save(figure: Figure, *arguments: Any) -> list[Path]:
        made.append(figure)
        return save_figure(figure, *arguments)

    monkeypatch.setattr(figures, "save_figure", save)
    return made


def _record(folder: Path, make_task: MakeTask, solve: Solve, read: Any = None, **more: Any) -> dict[str, Any]:
    task = make_task(**more)
    told = [
        trial for generation in (solve(task, None, read) if read else solve(task)) for trial in generation
    ]
    save_record(Store(folder), task, told, "", "")
    return read_record(Store(folder), "formula")


def test_dots_of_a_contour_are_the_trials_between_the_ends_of_both_ranges(
    make_task: MakeTask, solve: Solve, tmp_path: Path, drawn: list[Figure]
) -> None:
    """A rate of 1e-5 × 1000^x lies at x of its range, which is logarithmic; a gamma of 0.8 + 0.2 y at y."""
    record = _record(tmp_path, make_task, solve, more=MOMENTUM)
    figures.draw_search(record, tmp_path, ["contour"], ("svg",))
    axes = drawn[0].axes[0]
    across, up = axes.get_xlabel(), axes.get_ylabel()
    assert {across, up} == {"learning_rate", "gamma"}
    (dots,) = [own for own in axes.collections if isinstance(own, PathCollection)]
    rates = [trial["params"]["learning_rate"] for trial in record["trials"]]
    gammas = [trial["params"]["gamma"] for trial in record["trials"]]
    places = {
        "learning_rate": [math.log10(rate / 1e-5) / 3 for rate in rates],
        "gamma": [(gamma - 0.8) / 0.2 for gamma in gammas],
    }
    expected = np.array([places[across], places[up]]).T
    np.testing.assert_allclose(np.asarray(dots.get_offsets()), expected, atol=1e-9)
    np.testing.assert_allclose(np.asarray(dots.get_array()), [trial["value"] for trial in record["trials"]])


def test_a_contours_surface_is_a_mean_weighted_by_nearness() -> None:
    """By hand: halfway between two trials it is their mean; on one of them nearly its value."""
    x, y, values = np.array([0.0, 1.0]), np.array([0.5, 0.5]), np.array([2.0, 4.0])
    surface = figures._smooth(x, y, values, np.array([0.0, 0.5, 1.0]))
    assert surface[:, 1] == pytest.approx([3.0, 3.0, 3.0])  # rows are of y, columns of x
    near, far = 1 / 0.001, 1 / 1.001
    assert surface[1, 0] == pytest.approx((2 * near + 4 * far) / (near + far))
    assert surface[1, 2] == pytest.approx((4 * near + 2 * far) / (near + far))


def test_a_front_is_of_the_trials_that_none_other_beats_in_both(
    make_task: MakeTask, solve: Solve, tmp_path: Path, drawn: list[Figure]
) -> None:
    def read(cell: Cell, outcome: str) -> float:
        """Return kills that are worth it with tanh alone; of returns, less is sought here."""
        rate = math.log10(cell.run.learning_rate)
        return rate - (cell.run.activation == "relu") if outcome == "final-share-killed" else rate

    record = _record(tmp_path, make_task, solve, read, second=SPREAD)
    figures.draw_search(record, tmp_path, ["front"], ("svg",))
    (front,) = [line for line in drawn[0].axes[0].get_lines() if line.get_label() == "Pareto front"]
    every = [tuple(trial["values"]) for trial in record["trials"]]
    unbeaten = [
        own for own in every if not any(o != own and o[0] >= own[0] and o[1] <= own[1] for o in every)
    ]
    assert sorted(map(tuple, np.asarray(front.get_data()).T.tolist())) == sorted(unbeaten)
    assert 1 < len(unbeaten) < len(every)


def test_a_history_has_the_best_so_far_as_its_steps(
    make_task: MakeTask, solve: Solve, tmp_path: Path, drawn: list[Figure]
) -> None:
    record = _record(tmp_path, make_task, solve)
    figures.draw_search(record, tmp_path, ["history"], ("svg",))
    values = [trial["value"] for trial in record["trials"]]
    lines = {line.get_label(): line for line in drawn[0].axes[0].get_lines()}
    assert np.asarray(lines["trial"].get_ydata()).tolist() == values
    assert np.asarray(lines["best so far"].get_ydata()).tolist() == [
        max(values[: n + 1]) for n in range(len(values))
    ]
