"""Promoting winners: their study trains just what their trials trained, on other seeds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from optuna.trial import FrozenTrial

from pneuma.errors import UserError
from pneuma.figures.search import winners_page
from pneuma.presets import WORLDS
from pneuma.search.promote import Winner, find_winners, gains, winners_study
from pneuma.search.record import Record, Task
from pneuma.search.spec import Budget, load_search
from pneuma.store.store import Store
from pneuma.study.plan import Plan, Query, make_plan
from pneuma.study.shipped import shipped_names, studies_folder
from pneuma.study.spec import load_study

from ..hand_made import make_id, save_run, study_of
from .conftest import MakeTask, record

OPTIMIZERS = """
[space.optimizer]
choices = ["adam", "sgd"]

[space.gradient_limit]
choices = [0.5, "none"]

[space.betas]
choices = [[0.9, 0.999], [0.9, 0.9]]
when = { optimizer = "adam" }
"""
TUNED_ALIKE = {
    "tune-adam": '[run]\noptimizer = "adam"',
    "tune-sgd": '[run]\noptimizer = "sgd"\nhorizon = 512',
}


def plan(winners: list[Winner], folder: Path, seeds: tuple[int, ...] = (1000, 1001)) -> Plan:
    path = folder / "promoted.toml"
    path.write_text(winners_study(winners, seeds, winners[0].searched.budget.steps))
    return make_plan(load_study(str(path)), Query())


def ids(planned: Plan, condition: str) -> tuple[str, ...]:
    return tuple(cell.run_id for cell in planned.cells if cell.condition == condition)


def ids_of(trial: FrozenTrial) -> tuple[str, ...]:
    return tuple(trial.user_attrs["run_ids"])


@pytest.fixture
def alike(make_task: MakeTask) -> list[Record]:
    """Return two searches that were tuned alike: of Adam, and of SGD with another horizon."""
    tasks = {name: make_task(8, more=fixed) for name, fixed in TUNED_ALIKE.items()}
    return [
        record(replace(own, search=own.search.model_copy(update={"name": name})))
        for name, own in tasks.items()
    ]


def test_the_promoted_condition_is_the_trial(make_task: MakeTask, tmp_path: Path) -> None:
    """On the search's own seeds its run ids are the trial's: it is the very same training."""
    own = record(make_task(8, OPTIMIZERS))
    for trial in own.trials:
        planned = plan([Winner(own, trial, "formula")], tmp_path)
        assert ids(planned, "formula-tuned") == ids_of(trial)
        assert {c.run.learning_rate for c in planned.cells if c.condition == "formula"} == {3e-4}


def test_a_trial_of_the_bases_own_values_is_its_base(make_task: MakeTask) -> None:
    first, *others = (own := record(make_task(4, OPTIMIZERS, start='start = ["table-6-2"]'))).trials
    assert Winner(own, first, "formula").is_base
    assert not any(Winner(own, trial, "formula").is_base for trial in others)


@pytest.mark.slow
@pytest.mark.parametrize("name", shipped_names(studies_folder() / "search"))
def test_whatever_a_shipped_search_finds_can_be_promoted(name: str, tmp_path: Path) -> None:
    for world in WORLDS if load_search(name).has_worlds else [None]:
        own = record(Task(load_search(name, world), Budget(trials=2, seeds=(1000, 1001), steps=2048)))
        for trial in own.trials:
            assert ids(plan([Winner(own, trial, "x")], tmp_path), "x-tuned") == ids_of(trial)[-2:]


def test_winners_stand_beside_what_each_was_tuned_from(alike: list[Record], tmp_path: Path) -> None:
    winners = find_winners(alike, None, (0, 1))
    planned = plan(winners, tmp_path)
    assert list(planned.conditions) == ["adam", "adam-tuned", "sgd", "sgd-tuned"]
    assert all(ids(planned, own.tuned) == ids_of(own.trial) for own in winners)
    runs = {cell.condition: cell.run for cell in planned.cells}
    assert (runs["sgd"].optimizer, runs["sgd"].horizon) == ("sgd", 512)


def test_a_gain_is_over_the_base_and_luck_what_the_search_saw_beyond_it(
    alike: list[Record], tmp_path: Path
) -> None:
    """A run that diverged counts as one that killed nothing."""
    (winner,) = find_winners(alike[:1], None, (0, 1))
    store, cells = Store(tmp_path), {}
    for condition, shares in ((winner.name, (0.2, 0.25, 0.3)), (winner.tuned, (0.6, 0.9))):
        for seed, share in enumerate(shares):
            cells[condition, seed] = run_id = make_id(condition, seed)
            status = "diverged" if share == 0.9 else "done"
            ends = [{"step": 2048, "share_killed": share}]
            save_run(store, run_id, [], [], ends, 2048, status, {"steps": 2048})
    data = study_of(store, cells)
    (found,) = gains([winner], data).itertuples()
    assert (found.fresh, found.base) == pytest.approx((0.3, 0.25))
    assert (found.diverged, found.base_diverged) == (1, 0)
    assert found.difference == pytest.approx(0.05)
    assert found.luck == pytest.approx(winner.trial.values[0] - 0.3)

    page = winners_page("won", [winner], data)
    panel, beside = page.grid[0]
    assert panel and beside and panel.rows == [winner.name]
    panel.draw(axes := Figure().add_subplot())
    marks = {line.get_label(): line for line in axes.get_lines()}
    assert {"untuned", "tuned", "tuned, as its search saw it"} <= {*marks}
    drawn = [np.asarray(line.get_xdata()) for line in axes.get_lines()]
    assert [list(each) for each in drawn if len(each) > 1] == [[0.6, 0.0], [0.2, 0.25, 0.3]]
    assert [each[0] for each in drawn if len(each) == 1] == pytest.approx([0.25, 0.3, winner.trial.values[0]])
    beside.draw(axes := Figure().add_subplot())
    bars = [list(np.asarray(line.get_xdata())) for line in axes.get_lines()]
    assert pytest.approx([found.low, found.high]) in bars and [found.difference] in bars


def test_the_best_trial_is_promoted_unless_told_and_on_seeds_that_are_fresh(alike: list[Record]) -> None:
    (best,) = find_winners(alike[:1], None, (0,))
    assert best.trial.values[0] == max(trial.values[0] for trial in alike[0].trials)
    assert find_winners(alike[:1], 3, (0,))[0].trial.number == 3
    with pytest.raises(UserError, match="--trial 99: no complete trial"):
        find_winners(alike[:1], 99, (0,))
    with pytest.raises(UserError, match="the search was run on 1001"):
        find_winners(alike, None, (0, 1001))
