"""`--world`: which records, tables and figures a study's name stands for in each world."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.study.execute import selection_record
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Store
from pneuma.worlds import WORLDS

from .calls import described


@pytest.fixture
def recorded(tmp_path: Path) -> Path:
    """A results folder with records of one study in every world: one seed in the text's, two elsewhere."""
    for world in WORLDS:
        study = load_study("activation", world)
        seeds = (0,) if world == "text" else (0, 1)
        record = selection_record(make_plan(study, Selection(seeds=seeds, conditions=("relu",))))
        Store(tmp_path).save_selection(study.name, record)
    return tmp_path


def test_status_tells_each_worlds_record_and_without_a_name_all_or_one_worlds(recorded: Path) -> None:
    status = ("study", "status", "--results", recorded, "--json")
    told = {
        "activation": 1,
        "activation --world text": 1,
        "activation --world godot": 2,
        "activation-godot": 2,
    }
    for words, runs in told.items():
        assert len(described(*status, *words.split())["runs"]) == runs
    every = [study["study"] for study in described(*status)["studies"]]
    assert every == ["activation", "activation-arena", "activation-godot"]
    (one,) = described(*status, "--world", "godot")["studies"]
    assert one["study"] == "activation-godot"
