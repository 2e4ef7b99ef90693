"""`--world`: which records, tables and figures a study's name stands for in each world."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from pneuma.cli import main
from pneuma.study.execute import selection_record
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Store
from pneuma.worlds import WORLDS

Captured = pytest.CaptureFixture[str]


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """A results folder with records of one study in every world: one seed in the text's, two elsewhere."""
    for world in WORLDS:
        study = load_study("activation", world)
        seeds = (0,) if world == "text" else (0, 1)
        record = selection_record(make_plan(study, Selection(seeds=seeds, conditions=("relu",))))
        Store(tmp_path).save_selection(study.name, record)
    return tmp_path


def _document(captured: Captured, *arguments: str | Path) -> Any:
    assert main([str(argument) for argument in (*arguments, "--json")]) == 0
    return json.loads(captured.readouterr().out)


def test_a_plan_in_godots_world_is_of_other_runs(tmp_path: Path, capsys: Captured) -> None:
    command = ("study", "plan", "activation", "--results", tmp_path)
    text = _document(capsys, *command)
    godot = _document(capsys, *command, "--world", "godot")
    assert (text["study"], godot["study"]) == ("activation", "activation-godot")
    ids = [{run["run_id"] for run in document["runs"]} for document in (text, godot)]
    assert [len(own) for own in ids] == [9, 9]
    assert not ids[0] & ids[1]


def test_status_tells_each_worlds_record(recorded: Path, capsys: Captured) -> None:
    command = ("study", "status", "activation", "--results", recorded)
    assert len(_document(capsys, *command)["runs"]) == 1  # text is the usual one
    assert len(_document(capsys, *command, "--world", "text")["runs"]) == 1
    assert len(_document(capsys, *command, "--world", "godot")["runs"]) == 2
    assert len(_document(capsys, "study", "status", "activation-godot", "--results", recorded)["runs"]) == 2


@pytest.mark.parametrize(
    ("world", "names"),
    [
        ((), ["activation", "activation-arena", "activation-godot"]),
        (("--world", "godot"), ["activation-godot"]),
    ],
)
def test_status_of_all_is_of_all_worlds_or_of_one(
    world: tuple[str, ...], names: list[str], recorded: Path, capsys: Captured
) -> None:
    document = _document(capsys, "study", "status", *world, "--results", recorded)
    assert [study["study"] for study in document["studies"]] == names


def test_a_selection_in_godots_world_goes_over_its_own_record(recorded: Path, capsys: Captured) -> None:
    command = ("study", "status", "activation", "--world", "godot", "--steps", "8192")
    runs = _document(capsys, *command, "--results", recorded)["runs"]
    assert [(run["condition"], run["seed"]) for run in runs] == [("relu", 0), ("relu", 1)]


@pytest.mark.parametrize("command", ["plan", "run", "status", "plot", "publish", "show"])
def test_a_misspelt_world_is_told_with_the_right_one(command: str, tmp_path: Path, capsys: Captured) -> None:
    assert main(["study", command, "activation", "--world", "gdot", "--results", str(tmp_path)]) == 2
    assert "unknown world 'gdot' (did you mean godot?)" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_what_worlds_were_called_before_is_refused_with_their_name(tmp_path: Path, capsys: Captured) -> None:
    (tmp_path / "mine.toml").write_text('title = "T"\nsettings = ["text"]\n')
    for arguments, told in (
        (["activation", "--setting", "godot"], "pneuma: --setting is called --world now\n"),
        ([str(tmp_path / "mine.toml")], "mine.toml, line 2: settings is called worlds now\n"),
    ):
        assert main(["study", "plan", *arguments]) == 2
        assert capsys.readouterr().err.endswith(told)


def test_what_was_not_run_in_a_world_is_told_with_the_command(tmp_path: Path, capsys: Captured) -> None:
    assert main(["study", "status", "activation", "--world", "godot", "--results", str(tmp_path)]) == 2
    assert "run `pneuma study run activation --world godot` first" in capsys.readouterr().err
