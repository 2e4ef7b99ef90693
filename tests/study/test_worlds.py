"""The worlds of a study: as the thesis's text, as the published code, and in the arena."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from pneuma.config import make_run
from pneuma.errors import UserError
from pneuma.study.execute import selection_record
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import list_studies, load_study, run_command
from pneuma.worlds import WORLDS, in_world, split_world

PLAIN = """\
title = "T"
figure = "fig"
base = "table-6-2"

[run]
env = "pneuma/Pneuma-v0"

[conditions.low]
epochs = 5

[conditions.high]
epochs = 10

[presets.quick]
seeds = 1
steps = 4096
"""


def _write(folder: Path, text: str, name: str = "mine.toml") -> str:
    (folder / name).write_text(text, encoding="utf-8")
    return str(folder / name)


def test_godots_world_is_the_published_code(tmp_path: Path) -> None:
    """Facts 3: four slots, clip range 0.2, actor [256]; facts 1: the environment."""
    study = load_study(_write(tmp_path, PLAIN), "godot")
    run = make_run(study.fields("low"))
    assert (run.env, run.slots, run.clip_range, run.actor) == ("pneuma/PneumaGodot-v0", 4, 0.2, (256,))
    assert (run.scale, run.order, run.reward, run.epochs) == ("raw", "fixed", ("godot",), 5)


def test_the_arena_is_the_texts_with_another_reward_and_the_facing_observed(tmp_path: Path) -> None:
    run = make_run(load_study(_write(tmp_path, PLAIN), "arena").fields("low"))
    assert (run.env, run.slots, run.clip_range, run.actor) == ("pneuma/PneumaArena-v0", 1, 0.1, (128,))
    assert (run.scale, run.order, run.reward, run.epochs) == ("unit", "nearest", ("kills",), 5)


def test_the_texts_world_is_the_file_as_it_stands(tmp_path: Path) -> None:
    path = _write(tmp_path, PLAIN)
    run = make_run(load_study(path, "text").fields("low"))
    assert (run.env, run.slots, run.clip_range, run.actor) == ("pneuma/Pneuma-v0", 1, 0.1, (128,))
    assert load_study(path) == load_study(path, "text")


def test_what_a_study_varies_or_sets_itself_stays_in_godots_world(tmp_path: Path) -> None:
    text = PLAIN.replace("epochs = 5", "actor = [64]").replace("[run]", "[run]\nclip_range = 0.3")
    study = load_study(_write(tmp_path, text), "godot")
    runs = [make_run(study.fields(name)) for name in study.conditions]
    assert [run.actor for run in runs] == [(64,), (128,)]  # the second as in Table 6.2, not [256]
    assert [run.clip_range for run in runs] == [0.3, 0.3]


def test_the_worlds_have_names_figures_and_run_ids_of_their_own(tmp_path: Path) -> None:
    path = _write(tmp_path, PLAIN)
    text, godot = load_study(path), load_study(path, "godot")
    assert (text.name, text.figure) == ("mine", "fig")
    assert (godot.name, godot.figure) == ("mine-godot", "fig-godot")
    plans = [make_plan(study, Selection()) for study in (text, godot)]
    assert [selection_record(plan)["world"] for plan in plans] == ["text", "godot"]
    assert not {cell.run_id for cell in plans[0].cells} & {cell.run_id for cell in plans[1].cells}


def test_a_shipped_study_in_godots_world_goes_by_its_name_too() -> None:
    assert load_study("activation-godot") == load_study("activation", "godot")
    with pytest.raises(UserError, match="--world text: the name activation-godot stands for"):
        load_study("activation-godot", "text")


@pytest.mark.parametrize(
    ("name", "path", "told"),
    [
        ("activation", None, "activation"),
        ("activation-godot", None, "activation --world godot"),
        ("activation", ["untrusted"], "activation"),
        ("mine", "/here/mine.toml", "/here/mine.toml"),
        ("mine-godot", "/my own/mine.toml", "'/my own/mine.toml' --world godot"),
    ],
)
def test_a_study_is_trained_by_its_name_or_its_file(name: str, path: object, told: str) -> None:
    assert run_command(name, path) == f"pneuma study run {told}"


def test_a_name_in_a_world_can_be_taken_apart() -> None:
    for name, world in itertools.product(list_studies(), WORLDS):
        assert split_world(in_world(name, world)) == (name, world)
        assert in_world(in_world(name, "godot"), "godot") == f"{name}-godot"


def test_every_shipped_study_resolves_in_its_worlds() -> None:
    for name, world in itertools.product(list_studies(), WORLDS):
        if world not in load_study(name).worlds:
            continue
        study = load_study(name, world)
        runs = [make_run(study.fields(condition)) for condition in study.conditions]
        if world != "text":
            assert {run.env for run in runs} == {WORLDS[world].env}
        else:
            assert not {run.env for run in runs} & {"pneuma/PneumaGodot-v0", "pneuma/PneumaArena-v0"}


def test_a_study_is_run_in_its_first_world_by_its_plain_name() -> None:
    study = load_study("published-logs")
    assert (study.world, study.worlds, study.figure) == ("godot", ("godot",), "published-logs")
    assert load_study("published-logs", "godot") == load_study("published-logs-godot") == study
    assert {make_run(study.fields(name)).env for name in study.conditions} == {"pneuma/PneumaGodot-v0"}


def test_a_study_of_one_world_is_refused_in_another(tmp_path: Path) -> None:
    path = _write(tmp_path, 'worlds = ["text"]\n' + PLAIN)
    with pytest.raises(UserError, match="mine is not run in the world godot; it is in text"):
        load_study(path, "godot")
    with pytest.raises(UserError, match=r"unknown world 'gdot' \(did you mean godot\?\)"):
        load_study(path, "gdot")


def test_a_study_that_compares_environments_is_run_in_the_texts_world_alone(tmp_path: Path) -> None:
    text = PLAIN.replace("epochs = 5", 'env = "pneuma/PneumaGodot-v0"')
    assert load_study(_write(tmp_path, text)).worlds == ("text",)


def test_a_file_may_not_be_called_like_a_study_in_a_world(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="a name with -godot stands for the world"):
        load_study(_write(tmp_path, PLAIN, "mine-godot.toml"))
