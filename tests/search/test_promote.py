"""Promoting a trial: its study trains just what the trial trained, on other seeds."""

from __future__ import annotations

from pathlib import Path

import pytest
from optuna.trial import FrozenTrial

from pneuma.errors import UserError
from pneuma.presets import WORLDS
from pneuma.search.log import Record
from pneuma.search.promote import find_trial, promotion_study
from pneuma.search.spec import Budget, load_search
from pneuma.study.plan import Plan, Query, make_plan
from pneuma.study.shipped import shipped_names, studies_folder
from pneuma.study.spec import load_study

from .conftest import Formula, MakeTask, Task

OPTIMIZERS = """
[space.optimizer]
choices = ["adam", "sgd"]

[space.gradient_limit]
choices = [0.5, "none"]

[space.betas]
choices = [[0.9, 0.999], [0.9, 0.9]]
when = { optimizer = "adam" }
"""


def plan(record: Record, trial: FrozenTrial, folder: Path) -> Plan:
    """Plan a promotion on the search's own seeds, which only a test may use."""
    path = folder / "promoted.toml"
    text = promotion_study(record, trial, range(5), None)
    path.write_text(text.replace("seeds = [0, 1, 2, 3, 4]", "seeds = [1000, 1001]"))
    return make_plan(load_study(str(path)), Query())


def ids(planned: Plan, condition: str) -> list[str]:
    return [cell.run_id for cell in planned.cells if cell.condition == condition]


def test_the_promoted_condition_is_the_trial(make_task: MakeTask, tmp_path: Path) -> None:
    """On the search's own seeds its run ids are the trial's: it is the very same training."""
    record = make_task(8, OPTIMIZERS).record()
    for trial in record.ended:
        planned = plan(record, trial, tmp_path)
        assert ids(planned, "tuned") == trial.user_attrs["run_ids"]
        base = [cell.run for cell in planned.cells if cell.condition == "base"]
        assert {(run.learning_rate, run.optimizer, run.steps) for run in base} == {(3e-4, "adam", 2048)}
        assert planned.study.outcomes == ("final-share-killed",)


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped_names(studies_folder() / "search"))
def test_whatever_a_shipped_search_finds_can_be_promoted(name: str, tmp_path: Path, formula: Formula) -> None:
    for world in WORLDS if load_search(name).has_worlds else [None]:
        budget = Budget(trials=2, seeds=(1000, 1001), steps=2048)
        record = Task(load_search(name, world), budget).record()
        for trial in record.ended:
            if record.search.make_run(trial.params) != record.search.make_run({}):
                assert ids(plan(record, trial, tmp_path), "tuned") == trial.user_attrs["run_ids"]


def test_the_base_itself_is_not_promoted(make_task: MakeTask) -> None:
    record = make_task(1, start='start = ["table-6-2"]').record()
    with pytest.raises(UserError, match=r"no trial is better than the base \(trial 0\)"):
        promotion_study(record, find_trial(record, None), range(5), None)


def test_the_best_trial_is_promoted_unless_told_and_on_seeds_that_are_fresh(make_task: MakeTask) -> None:
    record = make_task(8).record()
    best = find_trial(record, None)
    assert best.values[0] == max(trial.values[0] for trial in record.ended)
    assert find_trial(record, 3).number == 3
    with pytest.raises(UserError, match="no such complete trial"):
        find_trial(record, 99)
    with pytest.raises(UserError, match="the search already used the seeds 1001; choose others"):
        promotion_study(record, best, (0, 1, 2, 3, 1001), None)
    with pytest.raises(UserError, match="seeds: 4 seeds cannot tell gain from luck; give at least 5"):
        promotion_study(record, best, range(4), None)
    more = '[objectives.low]\noutcome = "final-share-killed"\ndirection = "minimize"'
    with pytest.raises(UserError, match="has no single best trial but a Pareto front; choose one of the"):
        find_trial(make_task(4, more).record(), None)
