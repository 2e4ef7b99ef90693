"""Curves against examples worked out by hand."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
import pytest

from pneuma.analysis.curves import Curve, random_levels, random_returns, study_curves
from pneuma.analysis.runs import open_study
from pneuma.analysis.study_data import StudyData
from pneuma.errors import UserError
from pneuma.store.index import RunIndex
from pneuma.store.quantities import WINDOWS
from pneuma.store.series import make_grid, peak_curve, update_curve
from pneuma.store.store import Store
from pneuma.study.plan import Query

from ..hand_made import make_id, save_run, study_of

NAN = float("nan")
TRAILING = WINDOWS[1]

Episode = tuple[int, float]  # step at which it ended, and its return
Runs = Mapping[tuple[str, int], Mapping[int, Sequence[Episode]]]
"""The episodes of each slot, by condition and seed."""


def _study(store: Store, runs: Runs, evaluated: Mapping[tuple[str, int], Any] | None = None) -> StudyData:
    """Store runs of 200 steps as a study; `evaluated` has steps and shares killed of each."""
    cells = {cell: make_id(*cell) for cell in runs}
    for cell, slots in runs.items():
        episodes = [
            {"slot": slot, "step": step, "return": value}
            for slot, ended in slots.items()
            for step, value in ended
        ]
        shares = [{"step": step, "share_killed": share} for step, share in (evaluated or {}).get(cell, ())]
        fields = {"steps": 200, "slots": max(len(slots), 1)}
        save_run(store, cells[cell], episodes, [], shares, 200, fields=fields)
    return study_of(store, cells)


def _one_run(
    store: Store, slots: Mapping[int, Sequence[Episode]], window: str = WINDOWS[0]
) -> dict[float, float]:
    """Return the curve of a single run as {t: value}."""
    (curve,) = study_curves(_study(store, {("a", 0): slots}), ["return"], window)["return"]
    assert curve.runs.shape == (200, 1)
    return dict(zip(curve.runs.index, curve.runs[0], strict=True))


# --- One run -------------------------------------------------------------------------------------

# A budget of 200 steps: the grid is 1, 2, … 200, and 5 % are the last 10 steps.
EXAMPLE: list[Episode] = [(12, 3.0), (17, 5.0), (22, 10.0), (60, 1.0)]


VALUES = {
    11: NAN,  # nothing has ended yet
    12: 3.0,  # (2, 12] is closed on the right
    17: 4.0,  # (3 + 5) / 2
    21: 4.0,  # (11, 21]
    22: 7.5,  # (12, 22] is open on the left: (5 + 10) / 2
    27: 10.0,  # (17, 27]
    32: NAN,  # (22, 32] holds no end of an episode
    60: 1.0,
    69: 1.0,
    70: NAN,
}


def test_a_point_is_the_mean_of_what_ended_in_the_last_twentieth(store: Store) -> None:
    curve = _one_run(store, {0: EXAMPLE})
    assert {at: curve[at] for at in VALUES} == pytest.approx(VALUES, nan_ok=True)


def test_a_curve_is_blank_until_every_slot_has_finished_an_episode(store: Store) -> None:
    curve = _one_run(store, {0: [(12, 4.0), (25, 6.0)], 1: [(30, 8.0)]})
    assert all(np.isnan(curve[t]) for t in range(1, 30))
    assert curve[30] == 7.0  # (20, 30]: 6 and 8
    assert curve[35] == 8.0  # (25, 35]


def test_trailing_100_is_the_mean_of_the_last_hundred_episodes_once_there_are_as_many(store: Store) -> None:
    """Episode k ends at step k and returns k."""
    curve = _one_run(store, {0: [(k, float(k)) for k in range(1, 151)]}, TRAILING)
    assert all(np.isnan(curve[t]) for t in range(1, 100))
    assert curve[100] == 50.5  # 1 … 100
    assert curve[101] == 51.5  # 2 … 101
    assert curve[150] == 100.5  # 51 … 150
    assert curve[200] == 100.5  # still the last hundred


def test_a_quantity_without_a_curve_in_a_window_is_refused() -> None:
    study_data = open_study(RunIndex(Store("none")), Query("activation", "arena", conditions=("tanh",)))
    with pytest.raises(
        UserError, match="table holds no hp in the window trailing-100; its curves are: return"
    ):
        study_curves(study_data, ["hp"], TRAILING)


# --- Several runs --------------------------------------------------------------------------------


def test_runs_of_different_ends_are_averaged_where_they_are(store: Store) -> None:
    long, short = {0: [(40, 2.0), (80, 4.0)]}, {0: [(40, 6.0)]}
    (curve,) = study_curves(_study(store, {("a", 0): long, ("a", 1): short}), ["return"])["return"]
    frame = curve.frame().set_index("x")
    assert frame["runs"][[39, 40, 49, 50, 80, 90]].tolist() == [0, 2, 2, 0, 1, 0]
    assert frame["mean"][[40, 80]].tolist() == [4, 4]  # of 2 and 6; of the long one alone
    assert np.isnan(frame["mean"][50])


# --- Mean, bands ---------------------------------------------------------------------------------

# Points of five runs, four, none and one.
POINTS = [[1, 2, NAN, NAN], [3, 4, NAN, 4], [8, 2, NAN, NAN], [4, 4, NAN, NAN], [4, NAN, NAN, NAN]]
CURVE = Curve("a", pd.DataFrame(np.transpose(POINTS), [1.0, 2.0, 3.0, 4.0]))
# means 20 / 5 = 4, 12 / 4 = 3; squares about them 9 + 1 + 16 = 26 over 4, 4 over 3
ROOT_6_5, ROOT_4_3, ROOT_1_3 = 2.5495097567963922, 1.1547005383792515, 1.140175425099138
T_4 = 2.7764451051977987  # of a table: 97.5 % of Student's t, 4 degrees


@pytest.mark.parametrize(
    ("band", "low", "high"),
    [
        ("sd", [4 - ROOT_6_5, 3 - ROOT_4_3], [4 + ROOT_6_5, 3 + ROOT_4_3]),
        ("variance", [4 - ROOT_6_5, 3 - ROOT_4_3], [4 + ROOT_6_5, 3 + ROOT_4_3]),  # another name
        ("ci", [4 - T_4 * ROOT_1_3, NAN], [4 + T_4 * ROOT_1_3, NAN]),  # sqrt(6.5 / 5); four are too few
        ("minmax", [1, 2], [8, 4]),
        ("runs", [NAN, NAN], [NAN, NAN]),
    ],
)
def test_a_band_has_its_edges_and_none_for_too_few_runs(
    band: str, low: list[float], high: list[float]
) -> None:
    frame = CURVE.frame(band)
    np.testing.assert_allclose(frame["mean"], [4, 3, NAN, 4])
    np.testing.assert_allclose(frame["low"], [*low, NAN, NAN])
    np.testing.assert_allclose(frame["high"], [*high, NAN, NAN])


# --- Evaluations, and the table of curves --------------------------------------------------------


def _evaluated(store: Store, shares: Mapping[tuple[str, int], Any]) -> list[Curve]:
    """Return the curves of runs that were evaluated at some steps: (step, share killed) of each."""
    return study_curves(_study(store, dict.fromkeys(shares, {}), shares), ["share_killed"])["share_killed"]


def test_evaluation_curves_stand_at_the_evaluations_own_steps(store: Store) -> None:
    shares = {("b", 0): [(64, 0.25), (128, 0.5)], ("a", 0): [(64, 0.0), (128, 1.0)]}
    shares["b", 1] = [(64, 0.75)]  # and then it diverged
    first, second = _evaluated(store, shares)
    assert (first.condition, second.condition) == ("b", "a")
    np.testing.assert_array_equal(first.runs.T, [[0.25, 0.5], [0.75, NAN]])
    assert first.frame()[["x", "mean", "runs"]].to_numpy().tolist() == [[64, 0.5, 2], [128, 0.5, 1]]
    np.testing.assert_array_equal(second.runs.T, [[0, 1]])


def test_of_several_evaluations_at_one_step_the_last_counts(store: Store) -> None:
    (curve,) = _evaluated(store, {("a", 0): [(64, 0.25), (64, 0.75), (128, 0.5), (128, 1.0)]})
    assert curve.runs[0].to_dict() == {64: 0.75, 128: 1.0}


def test_runs_that_were_evaluated_at_unlike_steps_share_those_of_the_fewest(store: Store) -> None:
    """Between its evaluations the other is on a straight line, and before and after them it has no value."""
    shares = {("a", 0): [(20, 0.2), (120, 0.6)], ("a", 1): [(50, 0.0), (100, 0.5), (150, 1.0)]}
    (curve,) = _evaluated(store, shares)
    assert curve.runs.index.tolist() == [20, 120]
    np.testing.assert_allclose(curve.runs.T, [[0.2, 0.6], [NAN, 0.7]], atol=1e-12)


def test_curves_lie_over_episodes_and_over_time_too(store: Store) -> None:
    """Episodes of 50 steps (as `save_run` has them) in one slot: four of 200; 8 seconds, as it took."""
    runs = {("a", 0): {0: [(50, 1.0), (100, 2.0), (150, 3.0), (200, 4.0)]}}
    data = _study(store, runs)
    for x, end in (("episodes", 4.0), ("wall-clock", 8.0)):
        (curve,) = study_curves(data, ["return"], x=x)["return"]
        assert curve.runs.index.max() == pytest.approx(end)
        assert curve.runs[0].loc[curve.runs.index >= end / 4].dropna().iloc[[0, -1]].tolist() == [1, 4]


def test_episodes_are_counted_by_their_length_up_to_each_point(store: Store) -> None:
    """Ten episodes of ten steps and a return of 1, then two of fifty and 5: step 100 lies at 10 episodes.

    A window holds an end up to step 110, at 11 episodes. By the mean length of all, 17 steps, it lies at 7.
    """
    ends = [*range(10, 101, 10), 150, 200]
    episodes = [
        {"step": end, "length": 10 if end <= 100 else 50, "return": 1.0 if end <= 100 else 5.0}
        for end in ends
    ]
    save_run(store, make_id("a", 0), episodes, [], [], 200, fields={"steps": 200, "slots": 1})
    (curve,) = study_curves(study_of(store, {("a", 0): make_id("a", 0)}), ["return"], x="episodes")["return"]
    values = curve.runs[0]
    assert values.loc[1.1:10.9].unique().tolist() == [1]
    assert values.loc[11.2:12.0].between(1, 5, inclusive="neither").all() and values.iloc[-1] == 5


def test_on_a_logarithmic_axis_means_and_intervals_are_of_logarithms() -> None:
    """Of 1, 10 and 100 the mean is 10, and its interval reaches as many times above as below it."""
    runs = pd.DataFrame([[1, 10, 100, 1, 100], [5, 0, 5, 0, 5]])  # what is 0 has no logarithm
    curve = Curve("mine", runs, log=True)
    half = T_4 / np.sqrt(5)  # of logarithms 0, 1, 2, 0 and 2, whose deviation is 1
    for band, ends in (("ci", (10 ** (1 - half), 10 ** (1 + half))), ("minmax", (1, 100))):
        frame = curve.frame(band)
        assert frame["runs"].tolist() == [5, 3]
        assert frame["mean"].tolist() == pytest.approx([10, 5])
        assert (frame["low"][0], frame["high"][0]) == pytest.approx(ends)


# --- One run's series -----------------------------------------------------------------------------

GRID = make_grid(200)  # 1, 2, … 200; a twentieth is 10


def _at(curve: np.ndarray, *steps: int) -> list[float]:
    return [float(curve[step - 1]) for step in steps]


@pytest.mark.parametrize(
    ("updates", "end", "points"),
    [
        # they are averaged over the last twentieth: (4, 14] has two
        ({4: 1, 8: 2, 12: 6}, 200, {3: NAN, 4: 1, 8: 1.5, 12: 3, 14: 4, 18: 6}),
        # one stands for all until the next
        ({50: 1, 100: 3}, 150, {49: NAN, 50: 1, 99: 1, 100: 3, 150: 3, 151: NAN}),
        # one that is not finite, as a diverged run's last loss may be, counts as none: (10, 20] has 20 alone
        ({10: 1, 15: NAN, 20: 5, 60: np.inf}, 200, {15: 1, 19: 1, 20: 5, 60: 5, 200: 5}),
    ],
)
def test_updates_make_a_curve(updates: dict[int, float], end: int, points: dict[int, float]) -> None:
    curve = update_curve(np.array([*updates], float), np.array([*updates.values()], float), GRID, end)
    np.testing.assert_equal(_at(curve, *points), [*points.values()])


def test_a_peak_is_of_the_updates_since_the_point_before_up_to_its_own_step() -> None:
    step, values = np.array([3.0, 3.5, 4.0, 4.5, 300.0]), np.array([1.0, 7.0, 5.0, 2.0, 9.0])
    curve = peak_curve(step, values, GRID, np.fmax)
    np.testing.assert_equal(_at(curve, 2, 3, 4, 5, 6, 200), [NAN, 1, 7, 2, NAN, 9])


@pytest.mark.parametrize("huge", [1e17, -1e30])
def test_a_huge_value_is_forgotten_with_its_window(huge: float) -> None:
    """It is not kept in a running total, in which all later values would be lost."""
    step = np.arange(1.0, 201.0)
    values = np.where(step == 3, huge, 0.5)
    curve = update_curve(step, values, GRID, 200)
    assert curve[20:].tolist() == [0.5] * 180
    assert abs(curve[5]) > 1e15


# --- The random player -----------------------------------------------------------------------------


def test_a_random_players_return_rises_where_xp_is_never_reset() -> None:
    """In four environments; a plain loop over 80 worlds with other actions gave 176 and 564."""
    index = RunIndex(Store("none"))
    own_game = random_returns(
        open_study(index, Query(study="own-game", conditions=("relu",))), last_step=1_000_448
    )
    assert own_game is not None
    assert own_game.loc[95_000:101_000].mean() == pytest.approx(176, rel=0.1)
    assert own_game.loc[295_000:301_000].mean() == pytest.approx(564, rel=0.1)
    assert 1750 < own_game.iloc[-1] < 1990
    arena = random_returns(open_study(index, Query(study="activation", world="arena")), last_step=5_000_000)
    assert arena is not None and [*arena.index] == [0, 5_000_000]
    assert [*arena] == [pytest.approx(1.49, abs=0.01)] * 2


def test_no_random_player_is_drawn_for_rewards_and_environments_in_which_it_was_not_measured() -> None:
    """A hundredth of the reward, and where XP is never reset other numbers of environments."""
    index = RunIndex(Store("none"))
    for study in ("betas-and-units", "cartpole"):
        assert random_returns(open_study(index, Query(study=study)), last_step=1_000_448) is None


@pytest.mark.parametrize(
    ("world", "studies", "share"),
    [
        ("arena", ["optimizer", "algorithms", "perception"], 0.175),
        ("godot", ["optimizer", "own-game"], 0.204),
    ],
)
def test_the_random_players_share_is_one_number_in_all_figures_of_a_world(
    world: str, studies: list[str], share: float
) -> None:
    """Their runs recorded 17.6 to 19.2 % in the arena, by their seeds; 20,000 episodes have the number."""
    index, shares = RunIndex(Store("none")), set[float]()
    for study in studies:
        shares.update(random_levels(open_study(index, Query(study, world)), "share_killed").values())
    assert [*shares] == [pytest.approx(share, abs=0.001)]
