"""The study of several winners: it trains what their trials trained, beside what they were tuned from."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from pneuma.errors import UserError
from pneuma.search.record import read_record, save_record
from pneuma.search.spec import Budget, load_search
from pneuma.search.trials import Task
from pneuma.search.winners import Winner, find_winner, winners_study
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Store

from .conftest import MakeTask, Solve, flat

OPTIMIZERS = {"tune-adam": '[run]\noptimizer = "adam"', "tune-sgd": '[run]\noptimizer = "sgd"\nhorizon = 512'}


@pytest.fixture
def winners(make_task: MakeTask, solve: Solve, tmp_path: Path) -> list[Winner]:
    """Return two searches' winners: of Adam, and of SGD with another horizon."""
    found = []
    for name, fixed in OPTIMIZERS.items():
        task = make_task(8, more=f"{fixed}\nenv = 'pneuma/Pneuma-v0'")
        task = replace(task, search=replace(task.search, name=name))
        told = flat(solve(task))
        save_record(Store(tmp_path / "results"), task, told, "sqlite:///x.db", "x")
        found.append(find_winner(task.search, read_record(Store(tmp_path / "results"), name)))
    return found


def test_conditions_are_the_winners_and_what_they_were_tuned_from(
    winners: list[Winner], tmp_path: Path
) -> None:
    """On the searches' own seeds their run ids are the trials': it is the very same training."""
    path = tmp_path / "tuned.toml"
    path.write_text(winners_study(winners))
    plan = make_plan(load_study(str(path)), Selection(seeds=(1000, 1001), steps=2048))
    assert list(plan.conditions) == ["adam", "adam-tuned", "sgd", "sgd-tuned"]
    ids: dict[str, list[str]] = {}
    for cell in plan.cells:
        ids.setdefault(cell.condition, []).append(cell.run_id)
    for own in winners:
        assert ids[f"{own.search.name.removeprefix('tune-')}-tuned"] == own.trial["run_ids"]
    runs = {cell.condition: cell.run for cell in plan.cells}
    assert (runs["adam"].optimizer, runs["sgd"].optimizer) == ("adam", "sgd")
    assert (runs["adam"].learning_rate, runs["sgd"].learning_rate) == (3e-4, 3e-4)
    assert (runs["adam"].horizon, runs["sgd"].horizon) == (256, 512)
    assert f"trial {winners[0].trial['number']} of search tune-adam" in path.read_text()


def _changed(own: Winner, **changes: Any) -> Winner:
    return replace(own, record={**own.record, **changes})


def test_searches_that_were_not_tuned_alike_share_no_study(winners: list[Winner]) -> None:
    first, second = winners
    with pytest.raises(UserError, match=r"not tuned alike: steps 2048 and 4096"):
        winners_study([first, _changed(second, steps=4096)])
    with pytest.raises(UserError, match=r"not tuned alike: seeds \[1000, 1001\] and \[1000\]"):
        winners_study([first, _changed(second, seeds=[1000])])
    with pytest.raises(UserError, match=r"not tuned alike: trials 8 and 7"):
        winners_study([first, _changed(second, trials=second.record["trials"][:7])])
    space = replace(second.search.space, base="table-6-1")
    other = replace(second, search=replace(second.search, space=space))
    with pytest.raises(UserError, match=r"different bases, table-6-2 and table-6-1"):
        winners_study([first, other])


def test_searches_that_sought_different_things_share_no_study(winners: list[Winner]) -> None:
    first, second = winners
    (sought,) = second.record["identity"]["objectives"]
    identity = {**second.record["identity"], "objectives": [{**sought, "over_seeds": "median"}]}
    with pytest.raises(UserError, match="objectives maximize mean final-share-killed and maximize median"):
        winners_study([first, _changed(second, identity=identity)])


def test_searches_in_different_worlds_or_by_different_engines_share_no_study(winners: list[Winner]) -> None:
    first, second = winners
    there = replace(second, search=replace(second.search, world="godot"))
    with pytest.raises(UserError, match="not tuned alike: worlds text and godot"):
        winners_study([first, there])
    for key, value, told in (
        ("env", "pneuma/PneumaGodot-v0", "environments pneuma/Pneuma-v0 and pneuma/PneumaGodot-v0"),
        ("reward", ("kills",), "reward differ; run both the same"),
        ("engine", "sb3", "engines batched and sb3"),
    ):
        space = replace(second.search.space, fixed={**second.search.space.fixed, key: value})
        with pytest.raises(UserError, match=f"not tuned alike: {told}"):
            winners_study([first, replace(second, search=replace(second.search, space=space))])


def test_a_search_that_has_not_ended_has_no_winner(winners: list[Winner]) -> None:
    asked = {**winners[0].record, "trials_asked": 16}
    with pytest.raises(UserError, match="has 8 of 16 trials; `pneuma search run` it to its end first"):
        find_winner(winners[0].search, asked)


def test_its_seeds_are_of_no_search(winners: list[Winner], tmp_path: Path) -> None:
    seen = [_changed(own, seeds=[0, 4]) for own in winners]
    path = tmp_path / "tuned.toml"
    path.write_text(winners_study(seen))
    assert make_plan(load_study(str(path)), Selection()).seeds == (1, 2, 3, 5, 6, 7, 8, 9, 10, 11)


def test_one_search_in_two_settings_would_give_two_conditions_of_a_name(winners: list[Winner]) -> None:
    there = replace(winners[0], search=winners[0].search.in_world("godot"))
    with pytest.raises(UserError, match="search tune-adam: two conditions would be called adam"):
        winners_study([winners[0], there])


def test_winners_of_the_shipped_searches_are_studies_in_the_published_codes_world(
    solve: Solve, tmp_path: Path
) -> None:
    """That world comes with a clip range, which four of the five algorithms do not read."""
    found = []
    for name in ("ppo", "trpo", "a2c", "dqn", "double-dqn"):
        task = Task(load_search(f"tune-{name}", "godot"), Budget(2, (1000, 1001), 2048))
        save_record(Store(tmp_path / "results"), task, flat(solve(task)), "sqlite:///x.db", "x")
        found.append(find_winner(task.search, read_record(Store(tmp_path / "results"), f"tune-{name}-godot")))
    path = tmp_path / "tuned.toml"
    path.write_text(winners_study(found))
    plan = make_plan(load_study(str(path)), Selection(seeds=(1000, 1001), steps=2048))
    ids = {own: [c.run_id for c in plan.cells if c.condition == own] for own in plan.conditions}
    assert [ids["trpo-tuned"], ids["dqn-tuned"]] == [found[1].trial["run_ids"], found[3].trial["run_ids"]]
    assert {cell.run.env for cell in plan.cells} == {"pneuma/PneumaGodot-v0"}


def test_a_search_that_is_named_twice_is_refused(winners: list[Winner]) -> None:
    with pytest.raises(UserError, match="search tune-adam: two conditions would be called adam"):
        winners_study([*winners, winners[0]])


def test_one_search_keeps_its_name(winners: list[Winner]) -> None:
    assert "[conditions.tune-adam-tuned]" in winners_study(winners[:1])


def test_a_front_has_no_one_winner(winners: list[Winner]) -> None:
    search = winners[0].search
    (objective,) = search.objectives
    two = replace(search, objectives=(objective, replace(objective, name="again")))
    with pytest.raises(UserError, match="search tune-adam: has several objectives"):
        find_winner(two, winners[0].record)
