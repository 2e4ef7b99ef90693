"""The detector of collapse, on records whose onset is known."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.analysis.collapse import (
    Diagnosis,
    diagnose,
    diagnoses,
    incidence,
    intersection,
    joined,
    share_with_sign,
)
from pneuma.analysis.outcomes import outcome_values
from pneuma.analysis.runs import open_study
from pneuma.analysis.study_data import StudyData
from pneuma.imports.tensorboard import import_tensorboard
from pneuma.store import series
from pneuma.store.index import RunIndex
from pneuma.store.store import Store
from pneuma.study.plan import Query

from ..hand_made import (
    BUDGET,
    COLLAPSED,
    healthy,
    learning,
    one_action,
    save_collapse,
    study_of,
    write_events,
)


def diagnosed(folder: Path, updates: np.ndarray, shares: np.ndarray, **more: Any) -> Diagnosis:
    """Return the diagnosis of a run; `more` as `save_collapse` takes it."""
    store = Store(folder / "results")
    save_collapse(store, "a0" * 8, updates, shares, **more)
    data = study_of(store, {("a", 0): "a0" * 8})
    return diagnose(data.rows[0])


def after(shares: np.ndarray, first: int, value: float, last: int = 20) -> np.ndarray:
    """Return evaluations with a value from one of them to another, both counted."""
    shares = shares.copy()
    shares[first - 1 : last] = value
    return shares


# --- Onset ---------------------------------------------------------------------------


def apart(second: int) -> np.ndarray:
    """Return updates with a policy of one action from 61 to 64, and from another one on as long."""
    updates = one_action(61, second + 3)
    updates[64 : second - 1] = healthy()[: second - 65]
    return updates


def repeated(*places: int) -> np.ndarray:
    """Return updates with a policy of one action in some places of each three, from 61 to 92."""
    updates = healthy()
    for place in places:
        updates[60 + place : 92 : 3] = COLLAPSED
    return updates


SEEN: dict[str, tuple[np.ndarray, np.ndarray, dict[str, Any], dict[str, Any]]] = {
    # name: (updates, evaluations, more about the run, its diagnosis)
    "one action to the end": (
        one_action(61), after(learning(), 13, 0.05), {},
        {
            "collapsed": True, "onset_step": 6100, "onset_update": 61,
            "signs": ("no entropy", "one action", "dead units", "fall"),
        },
    ),
    "a fall for good, without any loss of entropy": (
        healthy(), after(learning(), 15, 0.1), {},
        {"collapsed": True, "signs": ("fall",), "onset_step": 7500},
    ),
    # Of a budget twice as long three updates may lie between, and it must last for ten.
    "in two of three updates": (
        repeated(0, 1), learning(), {"steps": 2 * BUDGET},
        {"collapsed": True, "onset_step": 6100},
    ),
    "in one of three updates": (repeated(0), learning(), {"steps": 2 * BUDGET}, {"collapsed": False}),
    "diverged": (
        one_action(61), learning(), {"end": 8000},
        {"collapsed": True, "onset_update": 61},
    ),
    # From update 61 at step 6,100 on, a twentieth of the budget, 500 steps, is over at update 66.
    "shorter than a twentieth": (one_action(61, 65), learning(), {}, {"collapsed": False}),
    "as long as a twentieth": (one_action(61, 66), learning(), {}, {"collapsed": True}),
    # Each half is 300 steps long, and 200 apart: a hundredth of the budget, and an update.
    "interrupted for a hundredth": (apart(66), learning(), {}, {"collapsed": True, "onset_step": 6100}),
    "interrupted for longer": (apart(67), learning(), {}, {"collapsed": False}),
    # From 0.2, half of it is a tenth less; from 0.19, half of it is less of a fall.
    "a fall by a tenth": (
        healthy(), after(np.full(20, 0.2), 15, 0.1), {},
        {"collapsed": True, "signs": ("fall",), "onset_step": 7500},
    ),
    "a fall to more than half": (healthy(), after(np.full(20, 0.4), 15, 0.22), {}, {"collapsed": False}),
    "a fall by less": (healthy(), after(np.full(20, 0.19), 15, 0.095), {}, {"collapsed": False}),
    "healthy": (healthy(), learning(), {}, {"collapsed": False, "onset_step": None, "signs": ()}),
    "certain of several actions": (healthy() * (0, 1, 1), learning(), {}, {"collapsed": False}),
    "dead units alone": (healthy() * (1, 1, 9), learning(), {}, {"collapsed": False}),
    "one bad evaluation": (healthy(), after(learning(), 15, 0.1, 15), {}, {"collapsed": False}),
    "never learned": (healthy(), np.where(np.arange(20) < 10, 0.1, 0.0), {}, {"collapsed": False}),
    "a single action, as the world has": (one_action(1) * (0, 1, 0), learning(), {}, {"collapsed": False}),
}  # fmt: skip


@pytest.mark.parametrize("case", SEEN)
def test_what_is_found_of_a_run(case: str, tmp_path: Path) -> None:
    updates, shares, more, expected = SEEN[case]
    diagnosis = vars(diagnosed(tmp_path, updates, shares, **more))
    assert {key: diagnosis[key] for key in expected} == expected


def test_a_return_that_sinks_below_zero_from_above_is_a_collapse_where_xp_is_never_reset(
    tmp_path: Path,
) -> None:
    """It crosses zero at update 60; a point averages five episodes, so that the one of update 62 is 0."""
    sinking = np.interp(np.arange(1, 101), [1, 40, 100], [0.0, 20.0, -40.0])

    def of_returns(returns: np.ndarray, **fields: Any) -> Diagnosis:
        return diagnosed(tmp_path, healthy(), np.full(20, 0.1), returns=returns, **fields)

    forever = {"xp_scope": "forever"}
    diagnosis = of_returns(sinking, **forever)
    assert (diagnosis.collapsed, diagnosis.signs) == (True, ("return below zero",))
    assert diagnosis.onset_step == 6300
    assert of_returns(np.abs(sinking), **forever) == Diagnosis(False)  # it has risen
    late = of_returns(sinking + 36, **forever)  # from update 96 on
    never_above = of_returns(sinking - 20, **forever)
    reset = of_returns(sinking, xp_scope="episode")
    elsewhere = of_returns(sinking, env="Pendulum-v1")  # which has no XP: returns may change sign
    assert not (late.collapsed or never_above.collapsed or reset.collapsed or elsewhere.collapsed)


# --- Studies --------------------------------------------------------------------------------------


@pytest.fixture
def data(tmp_path: Path) -> StudyData:
    """Of `relu` two runs of three collapse, the second for a while; of `tanh` none of two does."""
    store = Store(tmp_path / "results")
    cells = {("relu", 0): "a0" * 8, ("relu", 1): "a1" * 8, ("relu", 2): "a2" * 8}
    cells |= {("tanh", 0): "b0" * 8, ("tanh", 1): "b1" * 8}
    for run_id in cells.values():
        save_collapse(store, run_id, healthy(), learning())
    save_collapse(store, "a0" * 8, one_action(61), after(learning(), 13, 0.05))
    save_collapse(store, "a1" * 8, one_action(31, 50), after(learning(), 7, 0.05, 10))
    return study_of(store, cells)


def test_incidence_counts_runs_with_an_exact_interval(data: StudyData) -> None:
    """Clopper and Pearson's bounds of 2 of 3 and of 0 of 2, from their binomial equations."""
    relu, tanh = incidence(data, diagnoses(data)).to_dict("records")
    assert [relu[key] for key in ("runs", "collapsed")] == [3, 2]
    assert 3 * relu["low"] ** 2 * (1 - relu["low"]) + relu["low"] ** 3 == pytest.approx(0.025)
    assert 1 - relu["high"] ** 3 == pytest.approx(0.025)
    assert (tanh["collapsed"], tanh["share"], tanh["low"]) == (0, 0, 0)
    assert (1 - tanh["high"]) ** 2 == pytest.approx(0.025)
    assert outcome_values(data, "relu", "collapsed").tolist() == [1, 1, 0]
    np.testing.assert_array_equal(outcome_values(data, "relu", "collapse-step"), [6100, 3100, np.nan])


def imported(folder: Path, tag: str, values: list[float]) -> StudyData:
    """Import a log of one run with a hundred points."""
    store = Store(folder / "results")
    points = [(tag, 100 * k, value) for k, value in enumerate(values, start=1)]
    write_events(folder / "logs" / "a_1" / "events.out.tfevents.1.host", points)
    import_tensorboard([folder / "logs"], store)
    return open_study(RunIndex(store), Query(study="logs"))


def test_logs_are_judged_by_their_entropy(tmp_path: Path) -> None:
    data = imported(tmp_path, "train/entropy_loss", [-1.0 if k < 60 else -0.001 for k in range(1, 101)])
    diagnosis = diagnose(data.rows[0])
    assert (diagnosis.collapsed, diagnosis.onset_step, diagnosis.onset_update) == (True, 6000, None)
    assert data.budget == BUDGET


def test_logs_are_judged_by_returns_below_zero(tmp_path: Path) -> None:
    """Of their world nothing is known."""
    data = imported(tmp_path, "rollout/ep_rew_mean", [1.0 if k < 60 else -1.0 for k in range(1, 101)])
    diagnosis = diagnose(data.rows[0])
    assert (diagnosis.collapsed, diagnosis.onset_step) == (True, 6000)
    assert diagnosis.signs == ("return below zero",)


def test_a_run_of_which_actions_alone_are_known_is_no_healthy_one(tmp_path: Path) -> None:
    store, updates = Store(tmp_path / "results"), one_action(61)
    updates[:, 0] = np.nan  # its entropy
    save_collapse(store, "a0" * 8, updates, np.empty(0), xp_scope="episode")
    data = study_of(store, {("a", 0): "a0" * 8})
    (row,) = incidence(data, diagnoses(data)).to_dict("records")
    assert (row["runs"], row["collapsed"], row["unknown"]) == (0, 0, 1)


def test_stretches_by_hand() -> None:
    step = np.array([10, 20, 30, 40, 50])
    assert series.stretches(step, np.array([True, True, False, True, False])) == [(10, 20), (40, 40)]
    assert intersection([(10, 30)], [(0, 10), (20, 40)]) == [(10, 10), (20, 30)]
    assert joined([(40, 50), (10, 20), (25, 30)], gap=5) == [(10, 30), (40, 50)]
    assert share_with_sign([(10, 20)], (10, 40), distance=10) == 0.5


def test_stuck_updates_have_no_entropy_and_one_action() -> None:
    """Of six updates two are stuck, one has entropy left, one two actions, one is stuck, one unknown."""
    step = np.arange(1.0, 7.0)
    entropy = np.array([0.05, 0.05, 0.5, 0.05, 0.0, np.nan])
    greatest = np.array([1.0, 0.995, 1.0, 0.97, 1.0, 1.0])
    columns = {f"action_{i}": np.zeros(6) for i in range(5)}
    columns |= {"action_2": greatest, "action_3": 1 - greatest}
    assert series.update_signs(step, {**columns, "entropy": entropy})[1] == (3, 6, 2)
    spells = {f"action_{i}": np.zeros(6) for i in range(5)}  # all actions are of the two without a column
    assert series.update_signs(step, {**spells, "entropy": entropy})[1] == (4, 6, 2)
    assert series.update_signs(step, columns)[1] == (0, 0, 0)
    assert series.update_signs(step, {**columns, "entropy": np.full(6, np.nan)})[1] == (0, 0, 0)
