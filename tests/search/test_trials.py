"""The loop of a search: laws of its trials, which hold whatever a run is worth."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from pneuma.search.spec import Budget, Median, NoPruner
from pneuma.search.trials import EndedTrial, best_number, over_seeds, rung_steps
from pneuma.study.plan import Cell, Plan

from .conftest import Formula, MakeTask, height, solve


@pytest.mark.parametrize("sampler", ["tpe", "random", "nsga-ii"])
def test_a_search_is_the_same_however_often_it_is_begun_again(make_task: MakeTask, sampler: str) -> None:
    more = f'[sampler]\nname = "{sampler}"'
    once, again = solve(make_task(12, more)), solve(make_task(12, more))
    assert once == again
    assert [told.number for told in once] == list(range(12))
    assert len({told.params["learning_rate"] for told in once}) == 12  # nothing is suggested twice
    assert solve(make_task(5, more)) == once[:5]  # fewer trials are the first of more


def test_the_first_trials_are_those_that_it_starts_with(make_task: MakeTask) -> None:
    told = solve(make_task(4, start='start = ["table-6-1", "table-6-2"]'))
    assert told[0].params == {"learning_rate": 3e-4, "activation": "relu"}
    assert told[1].params == {"learning_rate": 3e-4, "activation": "tanh"}
    assert told[1].values[0] == pytest.approx(1 - 0.2 * abs(np.log10(3e-4) + 3) + 0.005)


def test_a_trial_is_one_run_for_each_seed(make_task: MakeTask) -> None:
    plans: list[Plan] = []
    told = solve(make_task(4), plans)
    cells = {cell.run_id: cell for cell in plans[-1].cells}
    for trial in told:
        runs = [cells[name].run for name in trial.run_ids]
        assert [(run.seed, run.steps) for run in runs] == [(1000, 2048), (1001, 2048)]
        assert {run.learning_rate for run in runs} == {trial.params["learning_rate"]}


def test_a_run_without_a_number_fails_its_trial_alone(make_task: MakeTask) -> None:
    def blank_for_relu(cell: Cell, outcome: str) -> float:
        return float("nan") if cell.run.activation == "relu" else height(cell, outcome)

    told = solve(make_task(8), outcomes=Formula(blank_for_relu))
    assert {(t.state, t.params["activation"]) for t in told} == {("failed", "relu"), ("complete", "tanh")}
    assert all(("final-share-killed" in t.note) == (t.state == "failed") for t in told)


def test_runs_that_diverge_alike_have_the_greatest_spread(make_task: MakeTask) -> None:
    """By hand: of two shares, 0 and 1 lie the furthest apart; their deviation is √(2 · 0.5²)."""
    more = '[objectives.spread]\noutcome = "final-share-killed"\nover_seeds = "deviation"'
    told = solve(make_task(4, more), outcomes=Formula(lambda cell, name: 0.0, diverged=True))
    assert [t.values for t in told] == [pytest.approx((0.0, math.sqrt(0.5)))] * 4


def test_rungs_of_the_budget(make_task: MakeTask) -> None:
    budget = Budget(trials=8, seeds=(0, 1, 2), steps=9000)
    assert rung_steps(Median(name="median"), budget) == {1: 1000, 2: 3000, 3: 9000}
    assert rung_steps(Median(name="median", rungs=2), budget) == {1: 3000, 2: 9000}
    assert rung_steps(NoPruner(), budget) == {1: 9000}
    # at a horizon of 256, rungs of 67 and 200 steps both are 256: one training
    more = '[run]\nhorizon = 256\n[pruner]\nname = "median"\nrungs = 2\nstartup_trials = 8'
    task = replace(make_task(4, more), budget=Budget(trials=4, seeds=(1000, 1001), steps=200))
    assert all(len(t.run_ids) == len({*t.run_ids}) == 2 for t in solve(task))


def test_a_pruned_trial_is_trained_no_further(make_task: MakeTask) -> None:
    plans: list[Plan] = []
    task = make_task(24, '[pruner]\nname = "median"\nrungs = 2\nstartup_trials = 1')
    told = solve(task, plans)
    assert {cell.run_id for cell in plans[-1].cells} == {name for trial in told for name in trial.run_ids}
    whole = max(len(trial.run_ids) for trial in told)
    pruned = [trial for trial in told if trial.state == "pruned"]
    assert pruned and all(len(trial.run_ids) < whole for trial in pruned)
    best = best_number(told, task.search)
    assert isinstance(best, int) and told[best].values[0] > max(trial.values[0] for trial in pruned)


def test_median_gives_up_what_is_below_the_median_at_its_rung(make_task: MakeTask) -> None:
    """By hand: of generations of 4, those below the median of all trials of earlier generations go."""
    more = '[sampler]\nname = "random"\n[pruner]\nname = "median"\nrungs = 2\nstartup_trials = 4'
    told = solve(make_task(16, more))
    values = [trial.rungs[1] for trial in told]
    assert all(trial.state == "complete" for trial in told[:4])  # nothing to compare with yet
    for place, trial in enumerate(told[4:], 4):
        assert (trial.state == "pruned") == (values[place] < np.median(values[: place // 4 * 4]))


def test_the_best_trials_by_hand(make_task: MakeTask) -> None:
    search = make_task().search
    states = [("complete", 0.2), ("pruned", 0.9), ("complete", 0.4), ("complete", 0.4)]
    told = [EndedTrial(n, {}, state, (own,), (), {}) for n, (state, own) in enumerate(states)]
    assert best_number(told, search) == 2  # the first of equals
    assert best_number([], search) is None
    front = make_task(second='[objectives.spread]\noutcome = "final-return"\ndirection = "minimize"').search
    values = [(0.5, 0.2), (0.6, 0.3), (0.4, 0.3), (0.6, 0.1), (0.1, 0.05)]
    told = [EndedTrial(n, {}, "complete", own, (), {}) for n, own in enumerate(values)]
    assert best_number(told, front) == [3, 4]


@pytest.mark.parametrize(
    ("name", "values", "expected"),
    [
        ("mean", (1, 2, 3, 6), 3.0),
        ("median", (1, 2, 3, 5), 2.5),
        ("iqm", (1, 2, 3, 5), 2.5),
        ("deviation", (1, 2, 4, 5), math.sqrt(10 / 3)),
    ],
)
def test_over_seeds_by_hand(name: str, values: tuple[int, ...], expected: float) -> None:
    assert over_seeds(name, np.array(values, float)) == pytest.approx(expected)
    assert np.isnan(over_seeds(name, np.array([1.0, np.nan])))
