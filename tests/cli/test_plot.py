"""A figure's file tells its origin: the command that draws it again, and its runs."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from pneuma import __version__

from ..figures.hand_made import HandMade
from .calls import call

IDS = {"tanh": ["aaaaaaaaaaaaaaa0", "aaaaaaaaaaaaaaa1"], "relu": ["bbbbbbbbbbbbbbb0"]}


@pytest.fixture
def results(tmp_path: Path) -> Path:
    """A results folder with a study called 'mine' of three runs."""
    study = HandMade(tmp_path)
    for condition, ids in IDS.items():
        for seed, run_id in enumerate(ids):
            study.add(condition, seed, run_id=run_id)
    selection = dict.fromkeys(("preset", "seeds", "steps", "engine"))
    study.record |= {"selection": {**selection, "conditions": [], "settings": {}}, "path": None}
    study.store.save_selection("mine", {**study.record, "baseline": "tanh"})
    return study.store.root


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ("plot mine --quantity actions --band minmax", None),
        ("plot mine --figure summary", "fig-mine-summary.svg"),
        (
            "plot mine --window trailing-100 --condition tanh --seeds 1",
            "fig-mine-tanh-seeds-0-trailing-100.svg",
        ),
        ("compare mine tanh relu --plot", "fig-mine-compare-tanh-relu.svg"),
        ("collapse mine", "fig-mine-collapse.svg"),
    ],
)
def test_a_figure_tells_its_runs_and_a_command_that_draws_the_same_bytes(
    results: Path, tmp_path: Path, words: str, name: str | None
) -> None:
    def draw(*words: str, out: str) -> Path:
        assert call(*words, "--results", results, "--out", tmp_path / out).code == 0
        (path,) = (tmp_path / out).iterdir()
        return path

    first = draw("study", *words.split(), "--format", "svg", out="first")
    assert name in (None, first.name)
    told = call("figure", first, "--json").document
    assert (told["file"], told["version"]) == (str(first), __version__)
    tanh = {"study": "mine", "condition": "tanh", "ids": IDS["tanh"], "seeds": "0..1"}
    assert told["runs"][0] == (
        tanh if "--seeds" not in words else tanh | {"ids": IDS["tanh"][:1], "seeds": "0"}
    )
    command, *again = shlex.split(told["command"])
    assert command == "pneuma"
    drawn = draw(*again, out="again")
    assert (drawn.name, drawn.read_bytes()) == (first.name, first.read_bytes())
    shown = call("figure", first).out
    assert told["command"] in shown and IDS["tanh"][0] in shown
