"""A figure's files have a name by what they show, and the same runs in their origin."""

from __future__ import annotations

from pathlib import Path

import pytest
from PIL import Image

from pneuma.cli.study_files import FIGURE_KINDS
from pneuma.config import as_fields
from pneuma.store.last_queries import note_query
from pneuma.store.store import Store
from pneuma.study.identity import config_id, run_id
from pneuma.study.plan import Query, make_plan
from pneuma.study.spec import load_study

from ..hand_made import save_run
from .calls import call, printed, save_finished

TWO_ENVIRONMENTS = """
title = "Two"
[factors.env]
pole = { env = "CartPole-v1" }
arms = { env = "Acrobot-v1" }
[factors.algorithm]
ppo = { algorithm = "ppo" }
a2c = { algorithm = "a2c" }
[presets.quick]
seeds = 2
steps = 4_096
"""
SHOWN = {
    "curves": "Return in training",
    "summary": "Return of an episode",
    "profile": "Share of runs above it",
    "one-action": "Not yet staying in one action",
}
"""Words that stand on figures of each kind alone."""


@pytest.mark.usefixtures("unshipped")
@pytest.mark.parametrize(
    ("words", "name"),
    [
        ("--quantity actions --band minmax", "5-quantities-minmax"),
        ("--figure summary", "summary"),
        ("--window trailing-100 --condition tanh --seeds 1", "tanh-seeds-0-trailing-100"),
        ("--x wall-clock --band minmax", "minmax-over-wall-clock"),
        ("--steps 1024", "steps-1024"),
    ],
)
def test_a_figure_tells_what_it_shows_by_its_name_and_its_runs(
    store: Store, tmp_path: Path, words: str, name: str
) -> None:
    picked = Query(conditions=("tanh", "relu"), seeds=(0, 1), steps=1024, settings={"gamma": 0.5})
    plan = make_plan(load_study("activation", "text"), picked)
    note_query(store, plan)
    for cell in plan.cells:
        save_finished(store, cell.run)
    options = ("--world", "text", "--set", "gamma=0.5", "--results", store.root, "--out", tmp_path / "there")
    called = call("study", "plot", "activation", *words.split(), *options)
    assert called.code == 0, called.err
    (drawn,) = (tmp_path / "there").glob("*.png")
    assert drawn.name == f"fig-6-5-text-gamma=0.5-{name}.png"
    with Image.open(drawn) as image:
        first, *lines = image.info["Description"].splitlines()
    assert first.startswith("Pneuma: Activation function")
    seeds = "0" if "--seeds" in words else "0..1"
    assert lines[0] == f"activation, tanh, seeds {seeds}, ids {config_id(plan.cells[0].run)}"
    assert len(lines) == (1 if "--condition" in words else 2)


@pytest.mark.parametrize("kind", FIGURE_KINDS)
def test_a_kind_of_figure_is_drawn_and_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("two.toml").write_text(TWO_ENVIRONMENTS)
    for cell in make_plan(load_study("two.toml"), Query()).cells:
        run, steps = cell.run, cell.run.steps
        random_player = {"random_return": -1.0, "random_spread": 1.0}
        episode = {"step": steps, "return": 1.0}
        evaluated = {"step": steps, "return": cell.seed, "commonest_action": 0.5, **random_player}
        store, fields = Store(tmp_path / "results"), as_fields(run)
        save_run(store, run_id(run), [episode], [], [evaluated], steps, "done", fields, config_id(run))
    printed("study", "plot", "two.toml", "--figure", kind, "--format", "svg", "--out", "there")
    (drawn,) = Path("there").glob("*.svg")
    assert [other for other, words in SHOWN.items() if words in drawn.read_text()] == [kind]
