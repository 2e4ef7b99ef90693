"""`pneuma search …` with real runs, small ones."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pneuma.cli import main
from pneuma.search.trials import Unfinished
from pneuma.study.plan import Plan
from pneuma.study.store import Status, Store

SEARCH = """
title = "A small search"
base = "table-6-2"
start = ["table-6-2"]
generation = 2

[run]
evaluation_episodes = 2
horizon = 64
actor = [8]
critic = [8]

[objectives.killed]
outcome = "auc-share-killed"

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
    assert main(["search", "run", str(path), "--results", str(folder / "results"), "--quiet"]) == 0
    return path, folder / "results"


def test_the_shipped_searches_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["search", "list", "--json"]) == 0
    names = [search["search"] for search in json.loads(capsys.readouterr().out)["searches"]]
    assert {"ppo", "tune-ppo", "return-and-spread"} <= set(names)
    assert main(["search", "list"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == names


def test_show_says_what_a_search_varies_and_seeks(
    searched: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["search", "show", str(searched[0])]) == 0
    told = capsys.readouterr().out
    for words in (
        "A small search\n",
        "  learning_rate          ",
        "1e-05",
        "maximize the mean over seeds of auc-share-killed",
        "Trials are asked for 2 at a time.",
        "  quick     4 trials, 2 seeds each, 128 steps a run",
    ):
        assert words in told
    assert main(["search", "show", str(searched[0]), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [parameter["name"] for parameter in document["space"]] == ["learning_rate"]


def test_a_search_is_told_as_json_and_trains_nothing_twice(
    searched: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    path, results = searched
    before = {p: p.stat().st_mtime_ns for p in results.glob("runs/*/status.json")}
    assert main(["search", "run", str(path), "--results", str(results), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [trial["number"] for trial in document["trials"]] == [0, 1, 2, 3]
    assert {trial["state"] for trial in document["trials"]} == {"complete"}
    assert {name for trial in document["trials"] for name in trial["run_ids"]} == {
        p.parent.name for p in before
    }
    best = document["trials"][document["best"]]["value"]
    assert best == max(trial["value"] for trial in document["trials"])
    assert {p: p.stat().st_mtime_ns for p in results.glob("runs/*/status.json")} == before


def test_a_search_says_what_it_trains_anew(
    searched: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, results = searched
    again = shutil.copytree(results, tmp_path / "results")
    (run,) = [*(again / "runs").iterdir()][:1]
    (run / "evaluations.parquet").write_bytes(b"damaged")
    for file in again.glob("searches/*.db*"):
        file.unlink()
    assert main(["search", "run", str(path), "--results", str(again)]) == 0
    told = capsys.readouterr().err
    assert told.count("'evaluations.parquet' is damaged; the run is trained again") == 1


@pytest.mark.parametrize(
    ("stop", "code"), [(Unfinished("trial-002 seed 1000 crashed"), 1), (KeyboardInterrupt(), 130)]
)
def test_a_search_that_is_stopped_tells_the_trials_that_had_ended(
    stop: BaseException,
    code: int,
    searched: tuple[Path, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path, results = searched[0], tmp_path / "results"
    shutil.copytree(searched[1] / "runs", results / "runs")

    def train(planned: Plan, *_: object) -> None:
        if "trial-002" in planned.conditions:
            raise stop

    monkeypatch.setattr("pneuma.cli.search_run.train_plan", train)
    assert main(["search", "run", str(path), "--results", str(results), "--json"]) == code
    document = json.loads(capsys.readouterr().out)
    assert [trial["number"] for trial in document["trials"]] == [0, 1]
    assert document["best"] in (0, 1)


def test_a_search_that_is_stopped_before_it_began_has_no_trials(
    searched: tuple[Path, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("pneuma.search.storage.run_search", stop)
    assert main(["search", "run", str(searched[0]), "--results", str(tmp_path), "--json"]) == 130
    document = json.loads(capsys.readouterr().out)
    assert (document["trials"], document["best"]) == ([], None)


def test_a_search_is_exported_like_a_study(
    searched: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["study", "export", "search-small", "--table", "evaluations", "--out", "-"]
    assert main([*arguments, "--results", str(searched[1])]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("condition,seed,run_id")
    assert {line.split(",")[0] for line in lines[1:]} == {f"trial-{n:03}" for n in range(4)}


def test_a_winner_is_promoted_on_fresh_seeds(
    searched: tuple[Path, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    path, results = searched
    assert main(["search", "promote", str(path), "--results", str(results), "--seeds", "2", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    gained = document["winners"][0]["objectives"]["killed"]
    assert gained["luck"] == pytest.approx(gained["seen"] - gained["fresh"])
    assert document["seeds"] == [0, 1]
    assert {len(names) for names in document["run_ids"].values()} == {2}
    assert main(["search", "promote", str(path), "--results", str(results), "--seeds", "1000,3"]) == 2
    assert "the search was run on 1000" in capsys.readouterr().err


def test_winners_are_written_as_a_study_that_can_be_trained_and_nothing_is_overwritten(
    searched: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, results = tmp_path / "tuned.toml", ["--results", str(searched[1])]
    arguments = ["search", "promote", str(searched[0]), *results, "--out"]
    assert main([*arguments, str(out)]) == 0
    wrote, train = capsys.readouterr().out.splitlines()
    assert wrote == f"wrote {out}"
    assert train == f"Train it with: pneuma study run {out} --results {searched[1]}"
    assert main(["study", "plan", str(out), "--seeds", "1000", *results, "--json"]) == 0
    written = out.read_bytes()
    for again in (out, tmp_path / "tuned.txt"):
        assert main([*arguments, str(again)]) == 2
    assert out.read_bytes() == written


def test_a_search_of_the_published_codes_world_is_promoted_there(
    searched: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [str(searched[0]), "--world", "godot", "--results", str(tmp_path)]
    assert main(["search", "run", *arguments, "--trials", "2", "--quiet"]) == 0
    assert main(["search", "status", *arguments]) == 0
    told = f"Confirm it with: pneuma search promote {searched[0]} --world godot"
    assert told in capsys.readouterr().out
    assert main(["search", "promote", *arguments, "--seeds", "1", "--json"]) == 0
    study = json.loads(capsys.readouterr().out)["study"]
    assert Path(study).name == "promoted-godot-small.toml"
    assert 'env = "pneuma/PneumaGodot-v0"' in Path(study).read_text()


def test_a_diverged_run_counts_on_fresh_seeds_as_in_the_search(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "spare.toml"
    path.write_text(SEARCH.replace("[space.", 'direction = "minimize"\n\n[space.', 1))
    arguments = [str(path), "--results", str(tmp_path / "results"), "--json"]
    assert main(["search", "run", *arguments, "--trials", "2", "--quiet"]) == 0
    capsys.readouterr()
    arguments = ["search", "promote", *arguments, "--seeds", "2", "--trial", "1", "--quiet"]
    assert main(arguments) == 0
    sound = json.loads(capsys.readouterr().out)
    lost = sound["run_ids"]["spare-tuned"][0]
    status = Store.status

    def diverged(self: Store, run_id: str) -> Status:
        found = status(self, run_id)
        return Status("diverged", found.step) if run_id == lost else found

    monkeypatch.setattr(Store, "status", diverged)
    assert main(arguments) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["diverged"] == {"spare": 0, "spare-tuned": 1}
    before, after = (own["winners"][0]["objectives"]["killed"]["fresh"] for own in (sound, document))
    assert before < 0.5 <= after  # one of two counts with all monsters killed, the worst that is sought here


def test_a_figure_that_the_trials_are_too_few_for_says_what_it_needs(
    searched: tuple[Path, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, results = searched
    arguments = ["search", "plot", str(path), "--results", str(results), "--out", str(tmp_path)]
    assert main([*arguments, "--what", "importances", "--what", "front"]) == 0
    assert capsys.readouterr().err == (
        "not drawn: importances needs 10 complete trials, five of them better than the worst; "
        "front needs two objectives\n"
    )
    assert main([*arguments, "--what", "history", "--what", "front"]) == 0
    assert capsys.readouterr().err == "not drawn: front needs two objectives\n"


def test_figures_in_a_results_folder_follow_no_link(searched: tuple[Path, Path], tmp_path: Path) -> None:
    path, results = searched
    mine = tmp_path / "mine.svg"
    mine.write_text("mine")
    figures = results / "figures"
    figures.mkdir(exist_ok=True)
    (figures / "search-small-history.svg").symlink_to(mine)
    arguments = ["search", "plot", str(path), "--results", str(results), "--format", "svg"]
    assert main([*arguments, "--what", "history"]) == 0
    assert mine.read_text() == "mine"
    assert b"</svg>" in (figures / "search-small-history.svg").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["run", "pop"], "unknown search 'pop' (did you mean ppo?)"),
        (["run", "ppo", "--trials", "0"], "--trials 0: must be a whole number"),
        (
            ["run", "ppo", "--set", "learning_rate=1"],
            "learning_rate is searched by [space.learning_rate]",
        ),
        (["run", "ppo", "--set", "sloths=1"], "unknown key of --set 'sloths' (did you mean slots?)"),
        (["run", "ppo", "--preset", "quik"], "unknown preset of search ppo 'quik' (did you mean quick?)"),
        (["run", "return-and-spread", "--seeds", "5,"], "a deviation needs --seeds 2 at least"),
        (["status", "pop"], "search pop was not run"),
        (["status", "ppo", "--world", "godot"], "search ppo-godot was not run"),
        (["status", "my.toml"], "search my was not run"),
        (["plot", "ppo"], "search ppo was not run"),
        (["promote", "ppo"], "search ppo was not run"),
        (["plot", "ppo", "--what", "histroy"], "did you mean history"),
    ],
)
def test_mistakes_are_told_in_one_line_and_train_nothing(
    arguments: list[str], told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["search", *arguments, "--results", str(tmp_path / "results")]) == 2
    error = capsys.readouterr().err
    assert told in error
    assert error.count("\n") == 1
    assert not (tmp_path / "results" / "runs").exists()


@pytest.mark.slow
def test_killed_half_way_it_comes_to_the_same(searched: tuple[Path, Path], tmp_path: Path) -> None:
    path, results = searched
    command = [sys.executable, "-m", "pneuma", "search", "run", str(path), "--results", str(tmp_path / "r")]
    process = subprocess.Popen(command, stderr=subprocess.DEVNULL, start_new_session=True)
    while not list((tmp_path / "r").glob("runs/*/status.json")) and process.poll() is None:
        time.sleep(0.05)
    assert process.poll() is None  # of a search that has ended already nothing would be shown
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    again = subprocess.run([*command, "--json"], capture_output=True, check=True)
    whole = subprocess.run(
        [*command[:-1], str(results), "--json"], capture_output=True, check=True, text=True
    )
    keys = ("trials", "best", "optuna_study")
    one, other = json.loads(again.stdout), json.loads(whole.stdout)
    assert [one[key] for key in keys] == [other[key] for key in keys]
