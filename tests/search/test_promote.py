"""Promoting a winner: its study trains just what the trial trained, on other seeds."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.errors import UserError
from pneuma.search import promote
from pneuma.search.promote import (
    BASELINE,
    WINNER,
    _unlike_estimates,
    gain,
    promoted_study,
    refuse_seen_seeds,
    winner,
)
from pneuma.search.record import read_record, save_record
from pneuma.search.spec import Budget, list_searches, load_search
from pneuma.search.trials import Task, Told
from pneuma.study.plan import Cell, Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Store
from pneuma.worlds import WORLDS

from .conftest import MakeTask, Solve, flat

Searched = tuple[Task, list[Told], dict[str, Any]]

OPTIMIZERS = """
[space.optimizer]
choices = ["adam", "sgd"]

[space.gradient_limit]
choices = [0.5, "none"]

[space.betas]
choices = [[0.9, 0.999], [0.9, 0.9]]
when = { optimizer = "adam" }
"""


@pytest.fixture
def searched(make_task: MakeTask, solve: Solve, tmp_path: Path) -> Searched:
    """Return a task, what was told, and the record of it."""
    task = make_task(8, OPTIMIZERS)
    told = flat(solve(task))
    store = Store(tmp_path / "results")
    save_record(store, task, told, "sqlite:///x.db", "x")
    return task, told, read_record(store, "formula")


def test_the_promoted_condition_is_the_trial(searched: Searched, tmp_path: Path) -> None:
    """On the search's own seeds its run ids are the trial's: it is the very same training."""
    task, told, record = searched
    for trial in told:
        path = tmp_path / "promoted.toml"
        path.write_text(promoted_study(task.search, record, winner(record, trial.number)))
        plan = make_plan(load_study(str(path)), Selection(seeds=(1000, 1001), steps=2048))
        ids = [cell.run_id for cell in plan.cells if cell.condition == WINNER]
        assert ids == list(trial.run_ids)
        assert {cell.run.learning_rate for cell in plan.cells if cell.condition == BASELINE} == {3e-4}


def test_what_is_promoted_is_run_where_it_was_searched_alone(searched: Searched, tmp_path: Path) -> None:
    """In the other world a learner of tables, for one, would be no study at all."""
    task, _, record = searched
    path = tmp_path / "promoted.toml"
    path.write_text(promoted_study(task.search, record, winner(record, None)))
    with pytest.raises(UserError, match="is not run in the world godot"):
        load_study(str(path), "godot")


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("name", list_searches())
def test_whatever_a_shipped_search_finds_can_be_promoted(
    name: str, world: str, solve: Solve, tmp_path: Path
) -> None:
    task = Task(load_search(name, world), Budget(4, (1000, 1001), 2048))
    told = flat(solve(task))
    store = Store(tmp_path / "results")
    save_record(store, task, told, "sqlite:///x.db", "x")
    record = read_record(store, task.search.name)
    for trial in told:
        path = tmp_path / "promoted.toml"
        path.write_text(promoted_study(task.search, record, winner(record, trial.number)))
        plan = make_plan(load_study(str(path)), Selection(seeds=(1000, 1001), steps=2048))
        ids = [cell.run_id for cell in plan.cells if cell.condition == WINNER]
        assert ids == list(trial.run_ids[-2:])


def test_what_a_trials_optimizer_does_not_read_is_left_out(
    make_task: MakeTask, solve: Solve, tmp_path: Path
) -> None:
    space = '[space.optimizer]\nchoices = ["adam", "sgd"]\n[space.momentum]\nlow = 0.1\nhigh = 0.9\n'
    task = make_task(8, space)
    told = flat(solve(task))
    save_record(Store(tmp_path / "results"), task, told, "sqlite:///x.db", "x")
    record = read_record(Store(tmp_path / "results"), "formula")
    written = {}
    for trial in told:
        path = tmp_path / "promoted.toml"
        path.write_text(promoted_study(task.search, record, winner(record, trial.number)))
        load_study(str(path))
        written[trial.params["optimizer"]] = "momentum" in path.read_text()
    assert written == {"adam": False, "sgd": True}


def test_the_best_trial_is_promoted_unless_told(searched: Searched) -> None:
    _, told, record = searched
    assert winner(record, None)["value"] == max(trial.values[0] for trial in told)
    assert winner(record, 3)["number"] == 3
    with pytest.raises(UserError, match="--trial 99: no complete trial"):
        winner(record, 99)


def test_seeds_of_the_search_are_refused(searched: Searched) -> None:
    refuse_seen_seeds((0, 1, 2), searched[2])
    with pytest.raises(UserError, match="the search was run on 1001"):
        refuse_seen_seeds((0, 1001), searched[2])


def test_gain_and_luck_by_hand() -> None:
    won, base = np.array([0.5, 0.7]), np.array([0.4, 0.4])
    found = gain((0.9, math.nan), (0.6, 0.4), won, base)
    assert (found.fresh, found.fresh_baseline, found.difference) == pytest.approx((0.6, 0.4, 0.2))
    assert found.luck == pytest.approx(0.3)
    assert math.isnan(gain((0.9, math.nan), (0.6, 0.4), won, base, "other steps").luck)


@pytest.mark.parametrize(
    ("over_seeds", "seen", "fresh", "told"),
    [
        ("mean", 2, 10, ""),
        ("least", 10, 10, ""),
        ("least", 2, 10, "a least over 2 seeds and one over 10 differ by themselves"),
        ("deviation", 3, 10, "a deviation over 3 seeds and one over 10 differ by themselves"),
    ],
)
def test_luck_is_not_told_of_what_hangs_on_the_number_of_seeds(
    over_seeds: str, seen: int, fresh: int, told: str
) -> None:
    """The least of ten is below that of two on average, though nobody was lucky."""
    assert _unlike_estimates(over_seeds, seen, fresh) == told


class Played:
    """Stands in for stored runs: every winner's run is worth 0.5, every other 0.25."""

    def read(self, cell: Cell, outcome: str) -> float:
        return 0.5 if cell.condition == WINNER else 0.25

    def diverged(self, cell: Cell) -> bool:
        return False


@pytest.mark.parametrize(
    ("over_seeds", "fresh", "known"), [("mean", 3, True), ("least", 3, False), ("least", 2, True)]
)
def test_gains_say_where_luck_cannot_be_told(
    searched: Searched,
    over_seeds: str,
    fresh: int,
    known: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    task, _, record = searched
    monkeypatch.setattr(promote, "Outcomes", lambda *_: Played())
    (objective,) = task.search.objectives
    search = replace(task.search, objectives=(replace(objective, over_seeds=over_seeds),))
    chosen, path = winner(record, None), tmp_path / "promoted.toml"
    path.write_text(promoted_study(search, record, chosen))
    planned = make_plan(load_study(str(path)), Selection(seeds=tuple(range(fresh)), steps=record["steps"]))
    (found,) = promote.gains(search, record, chosen, planned, Store(tmp_path)).values()
    assert (found.fresh, found.difference, found.same_steps) == (0.5, 0.25, True)
    assert bool(found.incomparable) is not known and math.isnan(found.luck) is not known


def test_a_run_that_never_gets_there_leaves_the_gain_unknown() -> None:
    never = np.array([1e4, math.inf, 2e4])
    found = gain((0.5, 0.4), (0.5, 0.4), never, np.full(3, math.inf))
    assert math.isnan(found.difference) and all(map(math.isnan, found.interval))
    assert found.luck == 0
