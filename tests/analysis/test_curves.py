"""Curves against examples worked out by hand (design section 7)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
import pytest
from pneuma.analysis.records import Records
from pneuma.analysis.series import held_curve, make_grid, update_curve
from scipy import stats

from pneuma.analysis import WINDOWS
from pneuma.analysis.curves import (
    Curve,
    curves_table,
    evaluation_curves,
    training_curves,
)
from pneuma.analysis.frames import StudyData
from pneuma.study.store import Status, Store

NAN = float("nan")
TRAILING = "trailing-100"

Episode = tuple[int, float]  # step at which it ended, and its return


class _Records(Records):
    """Tables given by hand, of all runs together."""

    def __init__(self, run_id: str, end: int, tables: dict[str, pd.DataFrame]) -> None:
        super().__init__(Store("nowhere"), run_id, Status("done", end))
        self._tables = tables

    def table(self, name: str) -> pd.DataFrame:
        table = self._tables[name]
        return table[table["run_id"] == self.run_id].drop(columns=["condition", "run_id"])


def _data(runs: Sequence[tuple[str, str, int, int]], **tables: pd.DataFrame) -> StudyData:
    """Return finished runs given by hand, as (condition, id, budget, slots), and their tables."""
    rows = [
        {
            "condition": condition,
            "seed": seed,
            "run_id": name,
            "run": {"env": "any", "slots": slots, "steps": budget},
        }
        for seed, (condition, name, budget, slots) in enumerate(runs)
    ]
    record = {"study": "mine", "title": "Mine", "figure": "fig-mine", "same": [], "runs": rows}
    return StudyData({name: _Records(name, budget, tables) for _, name, budget, _ in runs}, record)


def _episodes(condition: str, name: str, slots: dict[int, list[Episode]]) -> pd.DataFrame:
    rows = [
        {"condition": condition, "run_id": name, "slot": slot, "step": step, "return": value}
        for slot, episodes in slots.items()
        for step, value in episodes
    ]
    return pd.DataFrame(rows)


def _one_run(
    slots: dict[int, list[Episode]], slot_count: int = 1, window: str = WINDOWS[0]
) -> dict[float, float]:
    """Return the curve of a single run of 200 steps as {t: value}."""
    table = _episodes("a", "r", slots)
    (curve,) = training_curves(_data([("a", "r", 200, slot_count)], episodes=table), "return", window)
    assert curve.runs.shape == (1, 200)
    return dict(zip(curve.step.tolist(), curve.runs[0].tolist(), strict=True))


# --- One run -------------------------------------------------------------------------------------

# A budget of 200 steps: the grid is 1, 2, … 200, and 5 % are the last 10 steps.
EXAMPLE: list[Episode] = [(12, 3.0), (17, 5.0), (22, 10.0), (60, 1.0)]


@pytest.mark.parametrize(
    ("at", "value"),
    [
        (11, NAN),  # nothing has ended yet
        (12, 3.0),  # (2, 12] is closed on the right
        (17, 4.0),  # (3 + 5) / 2
        (21, 4.0),  # (11, 21]
        (22, 7.5),  # (12, 22] is open on the left: (5 + 10) / 2
        (27, 10.0),  # (17, 27]
        (32, NAN),  # (22, 32] holds no end of an episode
        (60, 1.0),
        (69, 1.0),
        (70, NAN),
    ],
)
def test_a_point_is_the_mean_of_what_ended_in_the_last_twentieth(at: float, value: float) -> None:
    assert _one_run({0: EXAMPLE})[at] == pytest.approx(value, nan_ok=True)


def test_a_curve_is_blank_until_every_slot_has_finished_an_episode() -> None:
    curve = _one_run({0: [(12, 4.0), (25, 6.0)], 1: [(30, 8.0)]}, slot_count=2)
    assert all(np.isnan(curve[t]) for t in range(1, 30))
    assert curve[30] == 7.0  # (20, 30]: 6 and 8
    assert curve[35] == 8.0  # (25, 35]


def test_trailing_100_is_the_mean_of_the_last_hundred_episodes() -> None:
    """Episode k ends at step k and returns k."""
    curve = _one_run({0: [(k, float(k)) for k in range(1, 151)]}, window=TRAILING)
    assert curve[1] == 1.0
    assert curve[50] == 25.5  # 1 … 50
    assert curve[100] == 50.5  # 1 … 100
    assert curve[101] == 51.5  # 2 … 101
    assert curve[150] == 100.5  # 51 … 150
    assert curve[200] == 100.5  # still the last hundred


# --- Several runs --------------------------------------------------------------------------------


def test_runs_of_different_ends_are_averaged_where_they_are() -> None:
    table = pd.concat(
        [_episodes("a", "long", {0: [(40, 2.0), (80, 4.0)]}), _episodes("a", "short", {0: [(40, 6.0)]})]
    )
    runs = [("a", "long", 200, 1), ("a", "short", 200, 1)]
    (curve,) = training_curves(_data(runs, episodes=table), "return")
    at = {int(t): i for i, t in enumerate(curve.step)}
    assert [curve.count[at[t]] for t in (39, 40, 49, 50, 80, 90)] == [0, 2, 2, 0, 1, 0]
    assert curve.mean[at[40]] == 4.0  # of 2 and 6
    assert curve.mean[at[80]] == 4.0  # of the long one alone
    assert np.isnan(curve.mean[at[50]])


# --- Mean, bands ---------------------------------------------------------------------------------

# Points of three runs, two, none and one.
CURVE = Curve(
    "a",
    np.array([1.0, 2.0, 3.0, 4.0]),
    np.array([[1.0, 2.0, NAN, NAN], [3.0, NAN, NAN, 4.0], [8.0, 4.0, NAN, NAN]]),
)
# means (1 + 3 + 8) / 3 = 4, (2 + 4) / 2 = 3; squares about them 9 + 1 + 16 = 26 over 2, 1 + 1 = 2 over 1
ROOT_13, ROOT_2 = 3.605551275463989, 1.4142135623730951
T_2, T_1 = 4.302652729911275, 12.706204736432095  # of a table: 97.5 % of Student's t, 2 and 1 degrees


@pytest.mark.parametrize(
    ("band", "low", "high"),
    [
        ("std", [4 - ROOT_13, 3 - ROOT_2], [4 + ROOT_13, 3 + ROOT_2]),
        ("se", [4 - 2.0816659994661326, 2], [4 + 2.0816659994661326, 4]),  # sqrt(13 / 3), sqrt(2 / 2)
        ("ci", [4 - T_2 * 2.0816659994661326, 3 - T_1], [4 + T_2 * 2.0816659994661326, 3 + T_1]),
        ("minmax", [1, 2], [8, 4]),
        ("runs", [NAN, NAN], [NAN, NAN]),
    ],
)
def test_a_band_has_its_edges_and_none_for_a_single_run(
    band: str, low: list[float], high: list[float]
) -> None:
    edges = CURVE.band(band)
    np.testing.assert_allclose(edges[0], [*low, NAN, NAN])
    np.testing.assert_allclose(edges[1], [*high, NAN, NAN])


# --- Evaluations, and the table of curves --------------------------------------------------------


def test_evaluation_curves_stand_at_the_evaluations_own_steps() -> None:
    rows = [
        ("b", "r1", 64, 0.25),
        ("b", "r1", 128, 0.5),
        ("b", "r2", 64, 0.75),  # and then it diverged
        ("a", "r3", 64, 0.0),
        ("a", "r3", 128, 1.0),
    ]
    table = pd.DataFrame(rows, columns=["condition", "run_id", "step", "share_killed"])
    runs = [("b", "r1", 128, 1), ("b", "r2", 128, 1), ("a", "r3", 128, 1)]
    first, second = evaluation_curves(_data(runs, evaluations=table))
    assert (first.condition, second.condition) == ("b", "a")
    np.testing.assert_array_equal(first.step, [64, 128])
    np.testing.assert_array_equal(first.runs, [[0.25, 0.5], [0.75, NAN]])
    np.testing.assert_array_equal(first.mean, [0.5, 0.5])
    np.testing.assert_array_equal(first.count, [2, 1])
    np.testing.assert_array_equal(second.runs, [[0, 1]])


def test_the_table_of_curves_has_a_row_for_each_point() -> None:
    table = curves_table({"return": [CURVE], "kills": [CURVE]}, "minmax")
    assert list(table.columns) == ["condition", "quantity", "step", "mean", "low", "high", "band", "runs"]
    assert len(table) == 8
    assert table.iloc[1].to_list() == ["a", "return", 2.0, 3.0, 2.0, 4.0, "minmax", 2]
    assert table["quantity"].to_list() == ["return"] * 4 + ["kills"] * 4


def test_on_a_logarithmic_axis_means_and_intervals_are_of_logarithms() -> None:
    """Of 1, 10 and 100 the mean is 10, and its interval reaches as many times above as below it."""
    runs = np.array([[1.0, 5.0], [10.0, 0.0], [100.0, 5.0]])  # what is 0 has no logarithm
    curve = Curve("mine", np.array([1.0, 2.0]), runs, log=True)
    assert curve.count.tolist() == [3, 2]
    assert curve.mean == pytest.approx([10.0, 5.0])
    low, high = curve.band("ci")
    half = stats.t.ppf(0.975, 2) / np.sqrt(3)  # of logarithms 0, 1 and 2, whose deviation is 1
    assert (low[0], high[0]) == (pytest.approx(10 ** (1 - half)), pytest.approx(10 ** (1 + half)))
    low, high = curve.band("minmax")
    assert (low[0], high[0]) == (pytest.approx(1.0), pytest.approx(100.0))


# --- One run's series -----------------------------------------------------------------------------

GRID = make_grid(200)  # 1, 2, … 200; a twentieth is 10


def _at(curve: np.ndarray, *steps: int) -> list[float]:
    return [float(curve[step - 1]) for step in steps]


def test_updates_are_averaged_over_the_last_twentieth() -> None:
    curve = update_curve(np.array([4.0, 8.0, 12.0]), np.array([1.0, 2.0, 6.0]), GRID, 200)
    np.testing.assert_equal(_at(curve, 3, 4, 8, 12, 14, 18), [NAN, 1, 1.5, 3, 4, 6])  # (4, 14] has two


def test_an_update_stands_for_all_until_the_next() -> None:
    curve = update_curve(np.array([50.0, 100.0]), np.array([1.0, 3.0]), GRID, 150)
    np.testing.assert_equal(_at(curve, 49, 50, 99, 100, 150, 151), [NAN, 1, 1, 3, 3, NAN])


def test_an_update_that_is_not_finite_counts_as_none() -> None:
    """The explained variance of constant returns is NaN, and a diverged run's last loss may be."""
    step, values = np.array([10.0, 15.0, 20.0, 60.0]), np.array([1.0, NAN, 5.0, np.inf])
    curve = update_curve(step, values, GRID, 200)
    np.testing.assert_equal(_at(curve, 15, 19, 20, 60, 200), [1, 1, 5, 5, 5])  # 20: (10, 20] has 20 alone


@pytest.mark.parametrize("huge", [1e17, -1e30])
def test_a_huge_value_is_forgotten_with_its_window(huge: float) -> None:
    """Not kept in a running total, beside which all later values would be nothing."""
    step = np.arange(1.0, 201.0)
    values = np.where(step == 3, huge, 0.5)
    curve = update_curve(step, values, GRID, 200)
    assert curve[20:].tolist() == [0.5] * 180
    assert abs(curve[5]) > 1e15


def test_a_logged_nan_is_a_blank_until_the_next_entry() -> None:
    curve = held_curve(np.array([10.0, 20.0, 30.0]), np.array([1.0, NAN, 2.0]), GRID, 200)
    np.testing.assert_equal(_at(curve, 19, 20, 29, 30), [1, NAN, NAN, 2])
