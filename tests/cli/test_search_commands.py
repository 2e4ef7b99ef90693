"""`pneuma search …` with real runs, small ones."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from pneuma.api import promote
from pneuma.engines import loop
from pneuma.search.trials import Unfinished
from pneuma.store.store import Store
from pneuma.study.plan import Plan
from pneuma.training.execute import CellResult

from ..training_here import training_here
from .calls import call, described, printed, refused

pytestmark = pytest.mark.usefixtures("trains_here")

SEARCH = """
title = "A small search"
base = "table-6-2"
generation = 2

[run]
evaluation_episodes = 2
horizon = 64
actor = [8]
critic = [8]

[objectives.killed]
outcome = "auc-share-killed"
direction = "minimize"

[space.learning_rate]
low = 1e-5
high = 1e-2
log = true

[presets.quick]
trials = 4
seeds = 2
steps = 128
"""


@pytest.fixture(scope="module")
def searched(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Return a search file and the results folder that it was run in."""
    folder = tmp_path_factory.mktemp("search")
    path = folder / "small.toml"
    path.write_text(SEARCH)
    with training_here():
        printed("search", "run", path, "--results", folder / "results", "--quiet")
    return path, folder / "results"


def test_a_search_is_printed_as_json_and_trains_nothing_twice(
    searched: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    path, results = searched
    assert "unknown search 'small'" in refused("search", "status", "small", "--results", results)
    monkeypatch.chdir(path.parent)
    before = {p: p.stat().st_mtime_ns for p in results.glob("runs/*/status.json")}
    document = described("search", "run", path, "--results", results, "--json")
    assert [trial["state"] for trial in document["trials"]] == ["complete"] * 4
    assert {i for trial in document["trials"] for i in trial["run_ids"]} == {p.parent.name for p in before}
    best = document["trials"][document["best"]]["values"]
    assert best == min(trial["values"] for trial in document["trials"])
    assert {p: p.stat().st_mtime_ns for p in results.glob("runs/*/status.json")} == before
    status = described("search", "status", "small", "--results", results, "--json")  # its file is here
    assert status["trials"] == document["trials"]
    assert f"Best: trial {document['best']}." in printed("search", "status", path, "--results", results)
    again = described("search", "run", "small", "--results", results, "--json")
    assert again["trials"] == document["trials"]
    assert "A small search" in printed("search", "show", "small")


@pytest.mark.parametrize("stop", [Unfinished("trial-002 seed 1000 crashed"), KeyboardInterrupt()])
def test_a_search_that_is_stopped_prints_the_trials_that_had_ended(
    stop: BaseException, searched: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, results = searched[0], tmp_path / "results"
    shutil.copytree(searched[1] / "runs", results / "runs")

    def train(planned: Plan, *_: object, **how: object) -> list[CellResult]:
        if "trial-002" in planned.conditions:
            raise stop
        return []

    monkeypatch.setattr("pneuma.api.train_plan", train)
    done = call("search", "run", path, "--results", results, "--json")
    assert done.code == (1 if isinstance(stop, Unfinished) else 130)
    assert [trial["number"] for trial in done.document["trials"]] == [0, 1]


def test_the_best_trial_is_promoted_on_fresh_seeds_by_a_command_and_in_python(
    searched: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(searched[1].parent)
    trained = call("search", "promote", searched[0], "--seeds", "5")
    assert "pneuma study plot results/searches/promoted-small-arena.toml\n" in trained.out
    assert trained.err.index("Time to train: about") < trained.err.index("Training 10 runs")
    at = ("--results", searched[1])
    document = described("search", "promote", searched[0], *at, "--seeds", "5", "--json")
    study = searched[1] / "searches" / "promoted-small-arena.toml"
    assert document["study"] == str(study)
    runs = [(run["condition"], run["seed"], run["status"]) for run in document["runs"]]
    assert sorted(runs) == [(name, seed, "done") for name in ("base", "tuned") for seed in range(5)]
    data = promote(searched[0], results=searched[1], seeds=5, quiet=True)
    assert data.conditions == ["base", "tuned"] and data.budget == 128
    written = call("search", "promote", searched[0], *at, "--seeds", "5", "--out", tmp_path / "mine.toml")
    assert f"Train it with: pneuma study run {tmp_path / 'mine.toml'}" in written.out
    assert (tmp_path / "mine.toml").read_bytes() == study.read_bytes()


def test_the_runs_of_a_pruned_trial_stop_where_it_was_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And those of the others, which paused there, report what they are evaluated at in the end."""
    monkeypatch.setattr(loop, "SHORT_STEPS", 0)  # evaluated as often as long ones
    path, results = tmp_path / "pruned.toml", tmp_path / "results"
    pruner = '[pruner]\nname = "median"\nn_startup_trials = 1\nn_warmup_steps = 10\ninterval_steps = 10\n'
    text = SEARCH.replace("steps = 128", "steps = 1280").replace("trials = 4", "trials = 5")
    path.write_text(text.replace('direction = "minimize"', "") + pruner)
    words = ("search", "run", path, "--results", results, "--seeds", "1", "--json")
    trials = described(*words)["trials"]
    store = Store(results)
    states = {trial["state"] for trial in trials}
    assert states == {"complete", "pruned"}
    for trial in trials:
        status, pruned = store.status(trial["run_ids"][0]), trial["state"] == "pruned"
        assert (status.name, status.step) == (("partial", 640) if pruned else ("done", 1280))
        assert [*trial["reports"]] == [str(k) for k in range(1, 11 if status.step == 640 else 21)]
        if trial["state"] == "complete":
            assert [trial["reports"]["20"]] == trial["values"]
    assert described(*words)["trials"] == trials


def test_an_outcome_that_the_environment_cannot_have_is_refused_before_training(tmp_path: Path) -> None:
    search, at = tmp_path / "search.toml", ("--results", tmp_path / "results")
    search.write_text(SEARCH.replace("[run]", '[run]\nenv = "CartPole-v1"'))
    assert "unknown outcome of CartPole-v1 'auc-share-killed'" in refused("search", "run", search, *at)
    assert not (tmp_path / "results").exists()
