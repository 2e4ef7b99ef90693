"""Promoting winners: their study trains just what their trials trained, on other seeds."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pneuma.errors import UserError
from pneuma.search import promote
from pneuma.search.promote import Winner, find_winners, gain, gains, incomparable, winners_study
from pneuma.search.spec import Budget, list_searches, load_search
from pneuma.search.storage import Searched
from pneuma.search.trials import Task
from pneuma.study.plan import Cell, Plan, Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Store
from pneuma.worlds import WORLDS

from .conftest import MakeTask, Solve, flat

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


def searched(task: Task, solve: Solve) -> Searched:
    return Searched(task, tuple(flat(solve(task))), task.identity, task.digest, "", "")


def plan(winners: list[Winner], folder: Path, seeds: tuple[int, ...] = (1000, 1001)) -> Plan:
    path = folder / "promoted.toml"
    path.write_text(winners_study(winners, seeds, 2048))
    return make_plan(load_study(str(path)), Selection())


def ids(planned: Plan, condition: str) -> tuple[str, ...]:
    return tuple(cell.run_id for cell in planned.cells if cell.condition == condition)


@pytest.fixture
def alike(make_task: MakeTask, solve: Solve) -> list[Searched]:
    """Return two searches that were tuned alike: of Adam, and of SGD with another horizon."""
    found = []
    for name, fixed in TUNED_ALIKE.items():
        task = make_task(8, more=fixed)
        found.append(searched(replace(task, search=replace(task.search, name=name)), solve))
    return found


def test_the_promoted_condition_is_the_trial(make_task: MakeTask, solve: Solve, tmp_path: Path) -> None:
    """On the search's own seeds its run ids are the trial's: it is the very same training."""
    own = searched(make_task(8, OPTIMIZERS), solve)
    for trial in own.trials:
        planned = plan([Winner(own, trial, "formula")], tmp_path)
        assert ids(planned, "formula-tuned") == trial.run_ids
        assert {c.run.learning_rate for c in planned.cells if c.condition == "formula"} == {3e-4}


@pytest.mark.parametrize("world", WORLDS)
@pytest.mark.parametrize("name", list_searches())
def test_whatever_a_shipped_search_finds_can_be_promoted(
    name: str, world: str, solve: Solve, tmp_path: Path
) -> None:
    own = searched(Task(load_search(name, world), Budget(2, (1000, 1001), 2048)), solve)
    for trial in own.trials:
        assert ids(plan([Winner(own, trial, "x")], tmp_path), "x-tuned") == trial.run_ids[-2:]


def test_winners_stand_beside_what_each_was_tuned_from(alike: list[Searched], tmp_path: Path) -> None:
    winners = find_winners(alike, None, (0, 1))
    planned = plan(winners, tmp_path)
    assert list(planned.conditions) == ["adam", "adam-tuned", "sgd", "sgd-tuned"]
    for own in winners:
        assert ids(planned, own.tuned) == own.trial.run_ids
    runs = {cell.condition: cell.run for cell in planned.cells}
    assert [(runs[name].optimizer, runs[name].horizon) for name in ("adam", "sgd")] == [
        ("adam", 256),
        ("sgd", 512),
    ]


def test_searches_that_were_not_tuned_alike_share_no_study(alike: list[Searched]) -> None:
    first, second = alike
    task = second.task
    space, (objective,) = task.search.space, task.search.objectives
    changes = {
        "steps": replace(task, budget=replace(task.budget, steps=4096)),
        "seeds": replace(task, budget=replace(task.budget, seeds=(5,))),
        "base": replace(task, search=replace(task.search, space=replace(space, base="table-6-1"))),
        "objectives": replace(
            task, search=replace(task.search, objectives=(replace(objective, over_seeds="median"),))
        ),
    }
    for key, value in (("env", "pneuma/PneumaGodot-v0"), ("reward", ("kills",)), ("engine", "sb3")):
        fixed = {**space.fixed, key: value}
        changes[key] = replace(task, search=replace(task.search, space=replace(space, fixed=fixed)))
    for told, changed in changes.items():
        with pytest.raises(UserError, match=f"tune-adam and tune-sgd are not tuned alike: .*{told}"):
            find_winners([first, replace(second, task=changed)], None, (0,))
    with pytest.raises(UserError, match="not tuned alike: trials differ"):
        find_winners([first, replace(second, trials=second.trials[:7])], None, (0,))
    with pytest.raises(UserError, match="name each search once"):
        find_winners([first, first], None, (0,))


def test_the_best_trial_is_promoted_unless_told_and_on_seeds_that_are_fresh(alike: list[Searched]) -> None:
    (best,) = find_winners(alike[:1], None, (0,))
    assert best.trial.values[0] == max(trial.values[0] for trial in alike[0].trials)
    assert find_winners(alike[:1], 3, (0,))[0].trial.number == 3
    with pytest.raises(UserError, match="--trial 99: no complete trial"):
        find_winners(alike[:1], 99, (0,))
    with pytest.raises(UserError, match="the search was run on 1001"):
        find_winners(alike, None, (0, 1001))


def test_what_an_untrusted_record_says_ends_no_comment(alike: list[Searched], tmp_path: Path) -> None:
    own = replace(alike[0], digest="0123456789ab\n[run]\nepochs = 1\n#")
    assert {cell.run.epochs for cell in plan(find_winners([own], None, (0,)), tmp_path).cells} == {10}


def test_gain_and_luck_by_hand() -> None:
    won, lost = np.array([0.5, 0.7]), np.array([0.4, 0.4])
    found = gain((0.9, math.nan), (0.6, 0.4), won, lost)
    assert (found.fresh, found.fresh_baseline, found.difference) == pytest.approx((0.6, 0.4, 0.2))
    assert found.luck == pytest.approx(0.3)
    assert gain((0.2, math.nan), (0.6, 0.4), won, lost, sign=-1).luck == pytest.approx(0.4)  # less is sought
    assert math.isnan(gain((0.9, math.nan), (0.6, 0.4), won, lost, why="other steps").luck)
    never = gain((0.5, 0.4), (0.5, 0.4), np.array([1e4, math.inf]), np.full(2, math.inf))
    assert math.isnan(never.difference) and all(map(math.isnan, never.interval))


def test_luck_is_not_told_of_what_hangs_on_the_number_of_seeds() -> None:
    """The least of ten is below that of two on average, though nobody was lucky."""
    assert incomparable("mean", 2, 10) == incomparable("least", 10, 10) == ""
    assert incomparable("least", 2, 10) and incomparable("deviation", 3, 10)


class Played:
    """Stands in for stored runs: every tuned run is worth 0.5, every other 0.25."""

    def read(self, cell: Cell, outcome: str) -> float:
        return 0.5 if cell.condition.endswith("-tuned") else 0.25

    def diverged(self, cell: Cell) -> bool:
        return False


def test_each_winner_is_held_against_its_own_base(
    alike: list[Searched], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(promote, "Outcomes", lambda *_: Played())
    winners = find_winners(alike, None, (0, 1, 2))
    planned = plan(winners, tmp_path, (0, 1, 2))
    for own in winners:
        (found,) = gains(own, planned, Store(tmp_path)).values()
        assert (found.fresh, found.fresh_baseline, found.difference) == (0.5, 0.25, 0.25)
        assert found.luck == pytest.approx(own.trial.values[0] - 0.5)
