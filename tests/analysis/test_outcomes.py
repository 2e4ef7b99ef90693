"""Outcomes by hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.analysis.notes import notes_on_ends
from pneuma.analysis.outcomes import OUTCOMES, find_outcome, outcome, outcome_values
from pneuma.analysis.runs import open_study
from pneuma.analysis.study_data import StudyData
from pneuma.engines.records import METRIC_COLUMNS
from pneuma.imports.tensorboard import import_tensorboard
from pneuma.store.index import RunIndex
from pneuma.store.row_builder import stored_row
from pneuma.store.store import Store
from pneuma.study.plan import Query

from .. import hand_made
from ..hand_made import healthy, learning, one_action, save_collapse, study_of, write_events

BUDGET = 1000
SHARES = (0.2, 0.6, 0.4, 0.5)
"""Share killed at the evaluations at steps 250, 500, 750 and 1,000."""


def episode(k: int) -> dict[str, Any]:
    """An episode that ended at step 50 k, returned k / 3 and left its player with k HP."""
    return {"episode": k, "step": 50 * k, "return": k / 3, "kills": k, "hp": float(k)}


def update(k: int) -> dict[str, Any]:
    """Update k of ten: entropy falls and norms rise, except for one peak at the second."""
    row = {**dict.fromkeys(METRIC_COLUMNS, 1 / 7), "step": 100 * k, "entropy": 1.6 - k / 10}
    actions = {"action_0": 0.25, "action_1": 0.2, "action_2": 0.15, "action_3": 0.05, "action_4": 0.24}
    own = {**actions, "approx_kl": k / 100, "explained_variance": k / 20}
    return {**row, **own, "grad_norm": 50.0 if k == 2 else float(k)}


def evaluation(k: int, share: float) -> dict[str, Any]:
    """Evaluation k of four."""
    own = {"share_killed": share, "argmax_share_killed": share / 2, "score": share * 2, "died": 0.3}
    own |= {"commonest_action": 0.2 * k, "success": k / 8, "q_estimate": k + 9.5, "q_true": 2 * k}
    own |= {"steps_to_clear": 100 / k, "hp_lost": 2**k, "kill_evenness": 0.1 if k % 2 else np.nan}
    return {**own, "step": 250 * k, "return": 10 * share, "argmax_return": 11 * share}


def save(
    store: Store,
    run_id: str,
    shares: Sequence[float] = SHARES,
    end: int = BUDGET,
    fields: dict[str, Any] | None = None,
    **more: Sequence[float],
) -> None:
    """Store a run that ended at `end`; `more` are further columns of its evaluations."""
    rows = [
        {**evaluation(k, share), **{name: values[k - 1] for name, values in more.items()}}
        for k, share in enumerate(shares, start=1)
    ]
    episodes, updates = [episode(k) for k in range(1, 21)], [update(k) for k in range(1, 11)]
    status = "done" if end >= BUDGET else "diverged"
    hand_made.save_run(store, run_id, episodes, updates, rows, end, status, fields)


CELLS = {("a", 0): "a0" * 8, ("a", 1): "a1" * 8, ("b", 0): "b0" * 8}


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> StudyData:
    """Of seed 0 a run of `a` and one of `b` that learns steadily; of seed 1 one of `a` diverged at 600."""
    store = Store(tmp_path_factory.mktemp("outcomes") / "results")
    save(store, "a0" * 8)
    save(store, "a1" * 8, (0.2, 0.6), end=600)
    save(store, "b0" * 8, (0.1, 0.2, 0.3, 0.4))
    return study_of(store, CELLS)


# --- Values by hand -------------------------------------------------------------------------------


BY_HAND: dict[str, float] = {
    "final-share-killed": 0.5,
    "auc-share-killed": (0.4 + 0.5 + 0.45) / 3,  # trapezoids between 0.2, 0.6, 0.4, 0.5
    "greedy-share-killed": 0.25,
    "normalised-score": 1.0,
    "evaluated-return": 5.0,
    "greedy-return": 5.5,
    "final-success": 0.5,
    "q-overestimation": 13.5 - 8,
    "time-to-clear": (100 + 50 + 100 / 3 + 25) / 4,
    "hp-lost": (2 + 4 + 8 + 16) / 4,
    "kill-evenness": 0.1,  # of the evaluations that have one
    "final-return": 20 / 3,  # (950, 1000] holds the twentieth episode alone
    "best-return": 20 / 3,
    "auc-return": 3182.5 / 950,  # 45 steps at each k / 3 from 50 on, and 5 on the way to the next
    "final-length": 50,
    "final-hp": 20,
    "final-died": 0.3,
    "least-entropy": 0.6,
    "final-entropy": 0.6,
    "max-grad-norm": 50,
    "median-grad-norm": 6,  # of 1, 50, 3, 4, 5, 6, 7, 8 and 9, twenty points each, and one of 10
    "mean-kl": (20 * 0.45 + 0.1) / 181,  # 0.01 to 0.09, twenty points each, and one of 0.1
    "early-explained-variance": 0.05,  # of the first update, at a tenth of the budget
    "one-action": 0.25,
    "final-dead-units": 1 / 7,
    "final-action-0": 0.25,
    "final-action-1": 0.2,
    "final-action-2": 0.15,
    "final-action-3": 0.05,
    "final-action-4": 0.24,
    "collapsed": 0,
    "best-score": 1.2,  # twice the share of 0.6
    "fall-from-best": 0.1,
    "late-fall": 0.0,  # of four evaluations the best five are the last five
    "shuffled-fall": 0.0,
    "late-one-action-time": 0.0,
    "lasting-one-action-step": np.inf,
    "final-kills": 20,  # of the last episode alone
    "curve-roughness": (0.4 + 0.2 + 0.1 - 0.3) / 3,
    "late-share-killed": 0.425,  # of all four evaluations, as there are no five
    "late-greedy-share-killed": 0.2125,
    "late-slope": 3 * 0.07,  # (-0.3 - 0.3 + 0.2 + 0.75) / 5 from one evaluation to the next
    "log-max-grad-norm": np.log(50),
    "log-max-kl": np.log(0.1),  # of the last update
    "final-commonest-action": 0.8,
    "grad-norm-growth": (17 * np.log(9) + np.log(10)) / 18,  # of 181 points, from 1 in the first tenth
    "stuck-share": 0.0,
    "steps-to:0.5": 250 + 250 * 0.3 / 0.4,  # on the way from 0.2 to 0.6
    "steps-to:0.9": np.inf,
    "wall-seconds": 8,
    "steps-per-second": 125,
}
OF_UPDATES = {"low-entropy-share", "late-one-action-updates", "lasting-one-action-spell"}
IN_TESTS_OF_THEIR_OWN = {"collapse-step", *OF_UPDATES}
"""Of runs that collapse: in `test_collapse.py`, and below."""


@pytest.mark.parametrize(("name", "expected"), BY_HAND.items())
def test_a_done_runs_outcome(data: StudyData, name: str, expected: float) -> None:
    assert outcome(data.rows[0], name) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(
    ("in_one_action", "time", "step"),
    [
        ("0000011111", 1.0, 600),
        ("0111110000", 0.2, 200),  # it leaves the state again
        ("1111011110", 0.8, np.inf),
    ],
)
def test_time_in_one_action_and_when_it_lasts(
    store: Store, in_one_action: str, time: float, step: float
) -> None:
    """Of ten evaluations, whose commonest action takes 95 or exactly 90 % of the steps."""
    rows = [
        {"step": 100 * k, "commonest_action": 0.95 if state == "1" else 0.9, "share_killed": k / 10}
        for k, state in enumerate(in_one_action, start=1)
    ]
    hand_made.save_run(store, "a0" * 8, [], [], rows, 1000)
    run = stored_row(store, "a0" * 8)
    assert outcome(run, "late-one-action-time") == pytest.approx(time)
    assert outcome(run, "lasting-one-action-step") == step
    assert outcome(run, "late-fall") == pytest.approx(0)  # the best five, 0.6 to 1, are the last
    assert outcome(run, "shuffled-fall") == pytest.approx(0.8 - 0.55)


def test_late_outcomes_are_of_five_evaluations(store: Store) -> None:
    """The best five of ten are 0.6, 0.5, 0.5, 0.4 and 0.4, mean 0.48; the last ones fall from 0.6 to 0.2."""
    shares = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.5, 0.4, 0.3, 0.2)
    rows = [{"step": 100 * k, "share_killed": share} for k, share in enumerate(shares, start=1)]
    hand_made.save_run(store, "a0" * 8, [], [], rows, BUDGET)
    (run,) = study_of(store, {("a", 0): "a0" * 8}).rows
    names = ("late-share-killed", "late-fall", "shuffled-fall", "late-slope")
    assert [outcome(run, name) for name in names] == pytest.approx([0.4, 0.08, 0.13, -0.4])


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("final-share-killed", 0.6),  # its last evaluation
        ("auc-share-killed", (0.4 * 250 + 0.6 * 500) / 750),  # which is carried on to the budget
        ("final-return", 12 / 3),
        ("auc-return", (3327.5 / 3 + 400 * 4) / 950),  # 400 steps more at its last
        ("final-entropy", np.float32(1.0)),
        ("final-hp", 12),
        ("steps-per-second", 75),
    ],
)
def test_a_diverged_run_counts_with_its_last_recorded_values(
    data: StudyData, name: str, expected: float
) -> None:
    assert outcome(data.rows[2], name) == pytest.approx(expected)


def test_the_share_of_training_with_a_low_entropy_is_of_updates(tmp_path: Path) -> None:
    """Of 100 updates none; 21 to 30 and 61 to 100; these, diverged at the 70th."""
    store, gaps = Store(tmp_path / "results"), one_action(21, 30)
    gaps[60:] = one_action(61)[60:]
    ids = {("a", seed): f"a{seed}" * 8 for seed in range(3)}
    save_collapse(store, ids["a", 0], healthy(), learning())
    save_collapse(store, ids["a", 1], gaps, learning())
    save_collapse(store, ids["a", 2], gaps, learning(), 7_000)
    data = study_of(store, ids)
    shares = [outcome(run, "low-entropy-share") for run in data.rows]
    assert shares == pytest.approx([0, 0.5, 20 / 70])
    assert outcome(data.rows[2], "steps-per-second") == pytest.approx(7_000 / 8)


def test_steps_to_a_value_are_read_off_the_line_between_evaluations(data: StudyData) -> None:
    """Of evaluations of 0.2, 0.6, 0.4 and 0.5 at every 250 steps."""
    run = data.rows[0]
    steps = {share: outcome(run, f"steps-to:{share}") for share in (0.1, 0.2, 0.3, 0.6)}
    assert steps == pytest.approx({0.1: 250, 0.2: 250, 0.3: 312.5, 0.6: 500})  # none before the first
    assert outcome(run, "steps-to-return:4") == pytest.approx(375)


def test_late_updates_in_one_action_are_of_the_last_quarter_of_the_budget(tmp_path: Path) -> None:
    """Of 100 updates, the last 25: none; 81 to 100; 61 to 70, diverged at the 70th; 21 to 30 alone."""
    store = Store(tmp_path / "results")
    ids = {("a", seed): f"a{seed}" * 8 for seed in range(4)}
    save_collapse(store, ids["a", 0], healthy(), learning())
    save_collapse(store, ids["a", 1], one_action(81), learning())
    save_collapse(store, ids["a", 2], one_action(61), learning(), 7_000)
    save_collapse(store, ids["a", 3], one_action(21, 30), learning())
    shares = [outcome(run, "late-one-action-updates") for run in study_of(store, ids).rows]
    assert shares == pytest.approx([0, 20 / 25, 10 / 25, 0])


@pytest.mark.parametrize(
    ("spells", "step"),
    [
        ([], np.inf),
        ([(11, 14), (16, 19)], np.inf),  # of 100 updates, four in a row each time
        ([(11, 14), (16, 20), (41, 100)], 1_600),  # five: a twentieth
    ],
)
def test_a_spell_of_updates_in_one_action_lasts_a_twentieth_of_the_budget_unbroken(
    tmp_path: Path, spells: list[tuple[int, int]], step: float
) -> None:
    store, updates = Store(tmp_path / "results"), healthy()
    for first, last in spells:
        updates[first - 1 : last] = one_action(first, last)[first - 1 : last]
    save_collapse(store, "a0" * 8, updates, learning())
    (run,) = study_of(store, {("a", 0): "a0" * 8}).rows
    assert outcome(run, "lasting-one-action-spell") == step


# --- What there is not ----------------------------------------------------------------------------


def test_runs_that_end_at_unlike_steps_count_at_their_own_ends_and_that_is_said(tmp_path: Path) -> None:
    store = Store(tmp_path / "results")
    for seed, end in enumerate((1000, 1000, 980, 400)):
        points = [("rollout/ep_rew_mean", step, float(step + seed)) for step in (10, end)]
        write_events(tmp_path / "logs" / f"a_{seed}" / "events.out.tfevents.1.host", points)
    import_tensorboard([tmp_path / "logs"], store)
    data = open_study(RunIndex(store), Query(study="logs"))
    found = outcome_values(data, "a", "final-return")
    np.testing.assert_allclose(found, [1000, 1001, 982, 403], atol=1)  # in steps of 2
    assert notes_on_ends(data) == ["Runs end at 400 to 1,000 steps, and each counts at its own end."]
    assert notes_on_ends(replace(data, runs=data.runs[:3])) == []


# --- Laws -----------------------------------------------------------------------------------------


def test_every_outcome_has_a_value_by_hand() -> None:
    assert OUTCOMES.keys() - BY_HAND.keys() == IN_TESTS_OF_THEIR_OWN


def test_outcomes_lie_within_their_bounds(data: StudyData) -> None:
    none_has = {"collapse-step"}  # of healthy runs
    # of runs whose fields do not contain the steps of an update
    none_has |= OF_UPDATES
    for name in (*OUTCOMES, "steps-to:0.5"):
        low, high = find_outcome(name).bounds
        values = [outcome(run, name) for run in data.rows]
        assert all(np.isnan(value) or low <= value <= high for value in values), name
        assert np.isnan(values).all() == (name in none_has), name


def test_returns_are_the_outcomes_that_have_the_unit_of_the_reward(store: Store) -> None:
    """Of two runs that differ only in a reward of twice as much."""
    for run_id, unit in (("a0" * 8, 1), ("a1" * 8, 2)):
        episodes = [{**episode(k), "return": unit * k} for k in range(1, 21)]
        evaluations = [
            {**evaluation(k, share), "return": unit * share, "argmax_return": unit * share}
            for k, share in enumerate(SHARES, start=1)
        ]
        hand_made.save_run(store, run_id, episodes, [update(k) for k in range(1, 11)], evaluations, BUDGET)
    once, twice = stored_row(store, "a0" * 8), stored_row(store, "a1" * 8)
    values = {name: (outcome(once, name), outcome(twice, name)) for name in OUTCOMES}
    doubled = {name for name, (low, high) in values.items() if low < high == 2 * low}
    assert doubled == {name for name, declared in OUTCOMES.items() if declared.is_return}
    assert find_outcome("steps-to-return:0.5").is_return and not find_outcome("steps-to:0.5").is_return
