"""`pneuma study trajectories`: from stored policies, and in a fresh clone from what was published."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from pneuma.analysis.trajectories import encode_trajectories, gathered
from pneuma.env.level import LEVELS
from pneuma.study.store import Status, Store

from .calls import call, described, printed, refused

SETTINGS = ("horizon=64", "minibatch=32", "epochs=1", "evaluation_episodes=2", "episode_steps=40")
TINY = ["--engine", "sb3", "--steps", "128", *(part for own in SETTINGS for part in ("--set", own))]
TWO = ["--seeds", "2", "--condition", "tanh", "--condition", "relu"]
GODOT = ["activation", "--world", "godot"]


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A results folder with two conditions of two seeds."""
    results = tmp_path_factory.mktemp("trained") / "results"
    printed("study", "run", *GODOT, *TINY, *TWO, "--results", str(results), "--quiet")
    return results


def told_of(*arguments: str | Path) -> Any:
    """Return the JSON document that the command prints."""
    return described("study", "trajectories", *arguments, "--json", "--quiet")


def test_it_says_how_the_episodes_of_each_condition_end(trained: Path) -> None:
    document = told_of(*GODOT, "--episodes", "3", "--results", trained)
    assert (document["study"], document["episodes"]) == ("activation-godot", 3)
    rows = document["endings"]
    assert {row["condition"] for row in rows} == {"tanh", "relu"}
    assert {row["runs"] for row in rows} == {2}
    for condition in ("tanh", "relu"):
        own = {row["outcome"]: row["value"] for row in rows if row["condition"] == condition}
        shares = [value for outcome, value in own.items() if outcome not in ("steps", "kills")]
        assert sum(shares) == pytest.approx(1)
        assert 0 < own["steps"] <= 40


def test_it_draws_the_same_figure_from_policies_and_in_a_fresh_clone(trained: Path, tmp_path: Path) -> None:
    results = shutil.copytree(trained, tmp_path / "results")
    store = Store(results)  # a published table does not say what a variant changed
    record = store.selection("activation-godot") or {}
    store.save_selection("activation-godot", {**record, "selection": {**record["selection"], "settings": {}}})
    printed("study", "publish", *GODOT, "--results", str(results))
    ours = told_of(*GODOT, "--episodes", "2", "--publish", "--out", tmp_path / "ours", "--results", results)
    clone = tmp_path / "clone"
    shutil.copytree(results / "published", clone / "published")
    theirs = told_of(*GODOT, "--out", tmp_path / "theirs", "--format", "png", "--results", clone)
    assert [Path(file).suffix for file in theirs["files"]] == [".png"]
    assert ours["endings"] == theirs["endings"]
    name = "fig-6-5-godot-trajectories.png"
    assert (tmp_path / "ours" / name).read_bytes() == (tmp_path / "theirs" / name).read_bytes()
    store.save_selection("activation-godot", record)
    alone = told_of(*GODOT, "--condition", "relu", "--results", clone)
    assert {row["condition"] for row in alone["endings"]} == {"relu"}
    assert (alone["source"], alone["steps"]) == ("the published table", 256)
    published = results / "published" / "trajectories" / "activation-godot.parquet"
    whole = published.read_bytes()
    told_of(*GODOT, "--episodes", "2", "--condition", "relu", "--publish", "--results", results)
    assert published.read_bytes() == whole


def test_where_neither_policies_nor_trajectories_are_it_says_so(trained: Path, tmp_path: Path) -> None:
    results = shutil.copytree(trained, tmp_path / "results")
    printed("study", "publish", *GODOT, "--results", str(results))
    shutil.rmtree(results / "runs")
    line = refused("study", "trajectories", *GODOT, "--results", results)
    train = "run `pneuma study run activation --world godot` with the same options"
    nowhere = f"study activation-godot: its policies are not in {results}; "
    assert line == nowhere + train
    folder = results / "published" / "trajectories"
    folder.mkdir()
    other = {"condition": "tanh", "seed": 3, "run_id": "f" * 16, "episode": 0, "player": 0, "steps": 1}
    rows = [{**other, "kills": 0, "ending": "killed", "places": np.zeros((2, 2))}]
    (folder / "activation-godot.parquet").write_bytes(encode_trajectories(gathered("thesis", rows)))
    told = "those of other runs are published; pick them, or "
    assert refused("study", "trajectories", *GODOT, "--results", results) == nowhere + told + train


@pytest.mark.slow
def test_a_level_of_a_runs_own_is_opened_only_if_trusted(tmp_path: Path) -> None:
    level = shutil.copytree(LEVELS / "thesis", tmp_path / "island")
    told = ["activation", "--results", str(tmp_path / "results")]
    one = ["--seeds", "1", "--condition", "tanh", "--set", f"level={level}"]
    printed("study", "run", *told, *TINY, *one, "--quiet")
    line = refused("study", "trajectories", *told)
    assert f"would read the level {level}; if you trust where it is from, give --trust" in line
    document = told_of(*told, "--trust", "--episodes", "1", "--out", tmp_path / "figures")
    assert [Path(file).suffix for file in document["files"]] == [".png", ".svg"]
    drawn = np.asarray(Image.open(document["files"][0]).convert("RGB"))
    assert (drawn == 255).all(axis=2).mean() < 0.5  # most of it is the map
    assert "name a folder for the figure by --out DIR" in refused(
        "study", "trajectories", *told, "--format", "svg"
    )


def test_a_world_without_places_is_refused(tmp_path: Path) -> None:
    told = ["tabular", "--results", str(tmp_path)]
    condition = ["--condition", "rate-1", "--seeds", "1", "--steps", "500"]
    printed("study", "run", *told, *condition, "--quiet")
    assert "pneuma/Mailman-v0 has no places to go to" in refused("study", "trajectories", *told)


def test_a_run_that_diverged_is_left_out_and_said(trained: Path, tmp_path: Path) -> None:
    results = shutil.copytree(trained, tmp_path / "results")
    store = Store(results)
    runs = json.loads((results / "studies" / "activation-godot.json").read_text())["runs"]
    for number, run in enumerate(runs):
        kept = {name: store.read_file(run["run_id"], name) for name in ("run.json", "provenance.json")}
        store.save_run(run["run_id"], Status("diverged", 128), kept)
        if number == 0:
            told = call("study", "trajectories", *GODOT, "--episodes", "1", "--results", results)
            assert told.code == 0
            assert "Note: 1 of 4 runs diverged, and left no policy to play." in told.err
    assert "every run diverged, and left no policy" in refused(
        "study", "trajectories", *GODOT, "--results", results
    )
