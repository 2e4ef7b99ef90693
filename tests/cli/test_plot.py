"""A figure's file tells its origin: the command that draws it again, and its runs."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from pneuma import __version__
from pneuma.config import make_run
from pneuma.store.last_queries import note_query
from pneuma.store.store import Store
from pneuma.study.identity import config_id
from pneuma.study.plan import Plan, Query, make_plan
from pneuma.study.spec import load_study

from .calls import call, save_finished


@pytest.fixture
def plan() -> Plan:
    """Of the activation study, with a changed field."""
    picked = Query(conditions=("tanh", "relu"), seeds=(0, 1), steps=1024, settings={"gamma": 0.5})
    return make_plan(load_study("activation", "text"), picked)


@pytest.mark.usefixtures("unshipped")
@pytest.mark.parametrize(
    ("words", "name"),
    [
        ("plot activation --quantity actions --band minmax", None),
        ("plot activation --figure summary", "fig-6-5-text-gamma=0.5-summary.png"),
        (
            "plot activation --window trailing-100 --condition tanh --seeds 1",
            "fig-6-5-text-gamma=0.5-tanh-seeds-0.png",
        ),
        ("plot activation --x wall-clock --center iqm", "fig-6-5-text-gamma=0.5-iqm-over-wall-clock.png"),
        ("plot activation --steps 1024", "fig-6-5-text-gamma=0.5-steps-1024.png"),
        ("compare activation tanh relu --plot", "fig-6-5-text-gamma=0.5-tanh-relu-compare-tanh-relu.png"),
    ],
)
def test_a_figure_tells_its_runs_and_a_command_that_draws_the_same_bytes(
    plan: Plan, store: Store, tmp_path: Path, words: str, name: str | None
) -> None:
    def draw(*words: str, out: str) -> Path:
        called = call(*words, "--out", tmp_path / out)
        assert called.code == 0, called.err
        (path,) = (tmp_path / out).glob("*.png")
        return path

    note_query(store, plan)
    for cell in plan.cells:
        save_finished(store, cell.run)
    asked = ("--world", "text", "--set", "gamma=0.5", "--results", str(store.root))
    first = draw("study", *words.split(), *asked, out="first")
    assert name in (None, first.name)
    told = call("figure", first, "--json").document
    assert (told["file"], told["version"]) == (str(first), __version__)
    tanh = {"study": "activation", "condition": "tanh", "ids": [config_id(plan.cells[0].run)]}
    assert told["runs"][0] == {**tanh, "seeds": "0" if "--seeds" in words else "0..1"}
    command, *again = shlex.split(told["command"])
    assert command == "pneuma"
    for cell in plan.cells:  # what is trained later is not drawn
        save_finished(store, make_run({**vars(cell.run), "steps": 2048}))
    drawn = draw(*again, out="again")
    assert "steps-1024" in drawn.name and drawn.read_bytes() == first.read_bytes()
    shown = call("figure", first).out
    assert told["command"] in shown and tanh["ids"][0] in shown


def test_the_command_of_a_figure_names_the_seeds_that_it_shows(
    plan: Plan, store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    asked = ("study", "plot", "activation", "--world", "text", "--set", "gamma=0.5")
    note_query(store, plan)
    for cell in plan.cells:
        save_finished(store, cell.run)
    assert call(*asked, "--results", store.root, "--out", "first.png").code == 0
    for cell in plan.cells:
        save_finished(store, make_run({**vars(cell.run), "seed": 7}))
    _, *again = shlex.split(call("figure", "first.png", "--json").document["command"])
    assert "--seeds 0..1" in " ".join(again)
    assert call(*again, "--out", "again.png").code == 0
    assert Path("again.png").read_bytes() == Path("first.png").read_bytes()
