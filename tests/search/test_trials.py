"""The loop of a search: laws of its trials, which hold whatever a run is worth."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from pneuma.search.spec import Budget
from pneuma.search.trials import Told, best_number, conduct, over_seeds, stages
from pneuma.study.plan import Cell, Plan

from .conftest import MakeTask, Solve, flat, height

SAMPLERS = ("tpe", "random", "gp", "nsga-ii")


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_a_search_is_the_same_however_often_it_is_begun_again(
    make_task: MakeTask, solve: Solve, sampler: str
) -> None:
    task = make_task(12, more=f'[sampler]\nname = "{sampler}"')
    once, again = flat(solve(task)), flat(solve(task))
    assert once == again
    assert [told.number for told in once] == list(range(12))
    assert len({told.params["learning_rate"] for told in once}) == 12  # nothing is suggested twice


@pytest.mark.parametrize("count", [1, 5, 8])
def test_fewer_trials_are_the_first_of_more(make_task: MakeTask, solve: Solve, count: int) -> None:
    assert flat(solve(make_task(count))) == flat(solve(make_task(12)))[:count]


def test_a_generation_is_asked_for_before_any_of_it_is_told(make_task: MakeTask, solve: Solve) -> None:
    def upside_down(cell: Cell, outcome: str) -> float:
        return -height(cell, outcome)

    more = "[sampler]\nstartup_trials = 4"
    one, other = flat(solve(make_task(8, more))), flat(solve(make_task(8, more), read=upside_down))
    assert [told.params for told in one[:4]] == [told.params for told in other[:4]]
    assert [told.params for told in one[4:]] != [told.params for told in other[4:]]


def test_the_first_trials_are_those_that_it_starts_with(make_task: MakeTask, solve: Solve) -> None:
    told = flat(solve(make_task(4, start='start = ["table-6-1", "table-6-2"]')))
    assert told[0].params == {"learning_rate": 3e-4, "activation": "relu"}
    assert told[1].params == {"learning_rate": 3e-4, "activation": "tanh"}
    assert told[1].values[0] == pytest.approx(1 - 0.2 * abs(np.log10(3e-4) + 3) + 0.005)


def test_a_trial_is_one_run_for_each_seed(make_task: MakeTask, solve: Solve) -> None:
    plans: list[Plan] = []
    told = flat(solve(make_task(4), plans))
    cells = {cell.run_id: cell for cell in plans[-1].cells}
    for trial in told:
        runs = [cells[name].run for name in trial.run_ids]
        assert [run.seed for run in runs] == [1000, 1001]
        assert {run.learning_rate for run in runs} == {trial.params["learning_rate"]}
        assert {run.steps for run in runs} == {2048}


def test_a_run_without_a_number_fails_its_trial_alone(make_task: MakeTask, solve: Solve) -> None:
    def blank_for_relu(cell: Cell, outcome: str) -> float:
        return float("nan") if cell.run.activation == "relu" else height(cell, outcome)

    told = flat(solve(make_task(8), read=blank_for_relu))
    assert {(t.state, t.params["activation"]) for t in told} == {("failed", "relu"), ("complete", "tanh")}
    why = "a run has no final-share-killed, or none that is finite"
    assert {t.state: t.note for t in told} == {"failed": why, "complete": ""}


def test_runs_that_diverge_alike_have_the_greatest_spread(make_task: MakeTask) -> None:
    """By hand: of two shares, 0 and 1 lie the furthest apart; their deviation is √(2 · 0.5²)."""
    more = '[objectives.spread]\noutcome = "final-share-killed"\nover_seeds = "deviation"'
    task = make_task(4, more)
    diverged = conduct(task, lambda plan: None, lambda cell, name: 0.0, lambda cell: True)
    assert [t.values for t in flat(diverged)] == [pytest.approx((0.0, math.sqrt(0.5)))] * 4


def test_two_rungs_that_round_to_one_budget_are_one_training(make_task: MakeTask, solve: Solve) -> None:
    """At a horizon of 256, both 100 and 200 steps are 256."""
    more = '[run]\nhorizon = 256\n[pruner]\nname = "median"\nrungs = 2\nstartup_trials = 8'
    task = replace(make_task(4, more), budget=Budget(4, (1000, 1001), 200))
    told = flat(solve(task))
    assert all(len(t.run_ids) == len({*t.run_ids}) == 2 for t in told)


def test_rungs_of_the_budget() -> None:
    budget = Budget(8, (0, 1, 2), 9000)
    assert [s.steps for s in stages({"name": "median", "rungs": 3}, budget)] == [3000, 6000, 9000]
    assert [s.seeds for s in stages({"name": "wilcoxon"}, budget)] == [(0,), (1,), (2,)]
    assert [(s.seeds, s.steps) for s in stages({"name": ""}, budget)] == [((0, 1, 2), 9000)]


@pytest.mark.parametrize(
    ("pruner", "seeds"),
    [
        ('name = "median"\nrungs = 2\nstartup_trials = 1', 2),
        ('name = "wilcoxon"', 6),
    ],
)
def test_a_pruned_trial_is_trained_no_further(
    make_task: MakeTask, solve: Solve, pruner: str, seeds: int
) -> None:
    plans: list[Plan] = []
    task = make_task(24, f"[pruner]\n{pruner}")
    task = replace(task, budget=replace(task.budget, seeds=tuple(range(seeds))))
    told = flat(solve(task, plans))
    assert told == flat(solve(task))
    trained = {cell.run_id for cell in plans[-1].cells}
    assert trained == {name for trial in told for name in trial.run_ids}
    whole = max(len(trial.run_ids) for trial in told)
    pruned = [trial for trial in told if trial.state == "pruned"]
    assert pruned
    assert all(len(trial.run_ids) < whole for trial in pruned)
    best = max((trial for trial in told if trial.state == "complete"), key=lambda trial: trial.values)
    assert best_number(told, task.search) == best.number
    assert best.values[0] > max(trial.values[0] for trial in pruned)


def test_median_gives_up_what_is_below_the_median_at_its_rung(make_task: MakeTask, solve: Solve) -> None:
    """By hand: of 4 + 4 trials, those of the second generation below the median of the first go."""
    task = make_task(
        8, '[sampler]\nname = "random"\n[pruner]\nname = "median"\nrungs = 2\nstartup_trials = 4'
    )
    told = flat(solve(task))
    first = [trial.rungs[1] for trial in told[:4]]
    assert all(trial.state == "complete" for trial in told[:4])  # nothing to compare with yet
    for trial in told[4:]:
        assert (trial.state == "pruned") == (trial.rungs[1] < np.median(first))


def test_the_pareto_front_by_hand(make_task: MakeTask) -> None:
    second = '[objectives.spread]\noutcome = "final-share-killed"\ndirection = "minimize"'
    search = make_task(second=second).search
    values = [(0.5, 0.2), (0.6, 0.3), (0.4, 0.3), (0.6, 0.1), (0.1, 0.05)]
    told = [Told(n, {}, {}, "complete", own, (), {}) for n, own in enumerate(values)]
    assert best_number(told, search) == [3, 4]
    assert best_number([], search) == []


def test_the_first_of_equals_is_best(make_task: MakeTask) -> None:
    search = make_task().search
    told = [Told(n, {}, {}, state, (own,), (), {}) for n, (state, own) in enumerate(
        [("complete", 0.2), ("pruned", 0.9), ("complete", 0.4), ("complete", 0.4)]
    )]  # fmt: skip
    assert best_number(told, search) == 2
    assert best_number([], search) is None


@pytest.mark.parametrize(
    ("name", "expected"),
    [("mean", 3.0), ("median", 2.5), ("least", 1.0), ("iqm", 2.5), ("deviation", np.sqrt(10 / 3))],
)
def test_over_seeds_by_hand(name: str, expected: float) -> None:
    values = np.array([1.0, 2.0, 3.0, 5.0]) if name != "mean" else np.array([1.0, 2.0, 3.0, 6.0])
    if name == "deviation":
        values = np.array([1.0, 2.0, 4.0, 5.0])
    assert over_seeds(name, values) == pytest.approx(expected)
    assert np.isnan(over_seeds(name, np.array([1.0, np.nan])))
