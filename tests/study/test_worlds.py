"""The worlds of a study: as the thesis's text, as the published code, and in the arena."""

from __future__ import annotations

from pathlib import Path

from pneuma.config import make_run
from pneuma.study.execute import selection_record
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import load_study

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
