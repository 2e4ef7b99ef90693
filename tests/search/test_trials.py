"""The loop of a search: laws of its trials, which hold whatever a run is worth."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import optuna
import pytest

from pneuma.engines import loop
from pneuma.engines.loop import evaluation_updates
from pneuma.search import values
from pneuma.search.samplers import CmaEs
from pneuma.search.spec import OVER_SEEDS
from pneuma.search.trials import rounds
from pneuma.search.values import Outcomes, over_seeds
from pneuma.store.store import Status, Store
from pneuma.study.plan import Cell

from .conftest import Formula, MakeTask, height, solve


@pytest.fixture(autouse=True)
def twenty_evaluations(monkeypatch: pytest.MonkeyPatch) -> None:
    """Evaluate these short runs as often as long ones."""
    monkeypatch.setattr(loop, "SHORT_STEPS", 0)


@pytest.mark.parametrize("sampler", ["tpe", "random", "nsga-ii", "cmaes", "optuna.samplers:GPSampler"])
@pytest.mark.filterwarnings("error")
def test_a_search_is_the_same_however_often_it_is_begun_again(make_task: MakeTask, sampler: str) -> None:
    more = f'[space.gamma]\nlow = 0.8\nhigh = 1.0\n[sampler]\nname = "{sampler}"'
    once, again = solve(make_task(12, more)), solve(make_task(12, more))
    assert once == again
    assert [told.number for told in once] == list(range(12))
    assert len({told.params["learning_rate"] for told in once}) == 12  # nothing is suggested twice
    assert solve(make_task(5, more)) == once[:5]  # fewer trials are the first of more


def test_cmaes_suggests_what_optunas_own_does_whose_state_is_a_pickle_in_the_log() -> None:
    def searched(sampler: type[optuna.samplers.CmaEsSampler]) -> list[dict[str, Any]]:
        study = optuna.create_study(direction="maximize")
        for number in range(16):
            study.sampler = sampler(popsize=5, seed=number)
            trial = study.ask()
            study.tell(trial, -(trial.suggest_float("x", -1, 1) ** 2) - trial.suggest_int("y", 0, 9))
        return [trial.params for trial in study.trials]

    assert searched(CmaEs) == searched(optuna.samplers.CmaEsSampler)


def test_the_first_trials_are_those_that_it_starts_with(make_task: MakeTask) -> None:
    told = solve(make_task(4, start='start = ["table-6-1", "table-6-2"]'))
    assert told[0].params == {"learning_rate": 3e-4, "activation": "relu"}
    assert told[1].params == {"learning_rate": 3e-4, "activation": "tanh"}
    assert told[1].values[0] == pytest.approx(1 - 0.2 * abs(np.log10(3e-4) + 3) + 0.005)


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


@pytest.mark.parametrize(
    ("pruner", "pauses"),
    [  # by hand, from Optuna's definitions; a run has 20 evaluations
        ('name = "median"', [5, 10, 15]),
        ('name = "optuna.pruners:PercentilePruner"\npercentile = 10.0', [*range(1, 20)]),
        ('name = "hyperband"', [2, 6, 18]),
    ],
)
def test_training_pauses_where_the_pruner_decides(
    make_task: MakeTask, pruner: str, pauses: list[int]
) -> None:
    task = make_task(4, f"[run]\nhorizon = 64\n[pruner]\n{pruner}")
    asked: list[Mapping[str, int]] = []
    (trial, *_) = solve(task, asked=asked)
    assert [part.pause for part in rounds(task)] == [*pauses, 20]
    steps = [until[trial.run_ids[0]] for until in asked]
    run = task.search.make_run(trial.params, steps=2048)
    evaluated = sorted(evaluation_updates(run))  # 32 updates of 64 steps
    assert steps == [64 * evaluated[pause - 1] for pause in pauses] + [0]


def test_a_median_stops_what_is_below_it(make_task: MakeTask) -> None:
    """By hand: those below the median of the complete trials of earlier generations, of 4 each."""
    more = '[sampler]\nname = "random"\n[pruner]\nname = "median"\nn_warmup_steps = 10\ninterval_steps = 10'
    more = f"[run]\nhorizon = 64\n{more}"  # 32 updates
    told = solve(make_task(24, more + "\nn_startup_trials = 4"))
    assert all(trial.state == "complete" and [*trial.reports] == [*range(1, 21)] for trial in told[:4])
    for place, trial in enumerate(told[4:], 4):
        before = [each for each in told[: place // 4 * 4] if each.state == "complete"]
        best = max(trial.reports[step] for step in range(1, 11))
        median = np.median([each.reports[10] for each in before])
        assert (trial.state == "pruned") == bool(best < median)
        if trial.state == "pruned":
            assert [*trial.reports] == [*range(1, 11)] and trial.values == (trial.reports[10],)


@pytest.mark.parametrize(
    ("step", "paused", "reports"),
    [  # by hand: 4 updates are 5, 10, 15 and 20 twentieths; the first from 6 on is 10, and from 16 on 20
        (6, 1024, [5, 10]),
        (16, 0, [5, 10, 15, 20]),
    ],
)
def test_each_evaluation_is_reported_once_and_no_trial_is_stopped_at_its_end(
    make_task: MakeTask, step: int, paused: int, reports: list[int]
) -> None:
    more = f'name = "median"\nn_startup_trials = 1\nn_warmup_steps = {step}\ninterval_steps = 20'
    asked: list[Mapping[str, int]] = []
    told = solve(make_task(24, f"[run]\nhorizon = 512\n[pruner]\n{more}"), asked=asked)
    assert {*asked[0].values()} == {paused}
    assert {trial.state for trial in told} == {"complete", "pruned"} - ({"pruned"} if paused == 0 else set())
    for trial in told:
        assert [*trial.reports] == ([5, 10, 15, 20] if trial.state == "complete" else reports)


def test_wilcoxon_compares_seed_by_seed(make_task: MakeTask) -> None:
    """Of 8 seeds: a trial that is worse than the best on each of the first few is not trained on the rest."""
    asked: list[Mapping[str, int]] = []
    task = make_task(12, '[pruner]\nname = "wilcoxon"')
    task = replace(task, budget=task.budget.model_copy(update={"seeds": tuple(range(1000, 1008))}))
    told = solve(task, asked=asked)
    pruned = [trial for trial in told if trial.state == "pruned"]
    assert pruned and all(2 <= len(trial.reports) < 8 for trial in pruned)
    trained = {name for until in asked for name in until}
    for trial in pruned:
        assert sum(name in trained for name in trial.run_ids) == len(trial.reports)


def test_over_seeds_by_hand() -> None:
    found = {name: over_seeds(name, np.array([1.0, 2, 3, 8])) for name in OVER_SEEDS}
    assert found == pytest.approx({"mean": 3.5, "median": 2.5, "iqm": 2.5, "deviation": math.sqrt(29 / 3)})


@dataclass(frozen=True)
class _Row:
    """What a search reads of a row."""

    status: str = "done"
    end: int = 0


def test_a_run_that_diverges_after_a_pause_had_its_values_there(
    make_task: MakeTask, store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """So that what a pruner decided at the pause is decided again once the run's end is known."""
    task = make_task()
    run = task.search.make_run({"learning_rate": 1e-3, "activation": "tanh"}, steps=2048)
    cell = Cell("trial-000", 1000, run)
    monkeypatch.setattr(Store, "status", lambda *_: Status("diverged", 250))
    monkeypatch.setattr(values, "stored_row", lambda *_: _Row("diverged"))
    monkeypatch.setattr(values, "row_until", lambda *asked: _Row(end=asked[-1]))
    monkeypatch.setattr(values, "outcome", lambda run, name: run.end)
    early = Outcomes(task.search, store).read_early(cell, "final-share-killed", [100, 200, 300])
    assert early == [100, 200, 0.0]  # the worst share from where it diverged on
