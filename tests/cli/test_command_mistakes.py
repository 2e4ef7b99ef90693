"""Mistakes on the command line: exit code 2, one line that says what to fix, and nothing written."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from pneuma.cli import study_run
from pneuma.cli.options import count, seeds
from pneuma.errors import UserError
from pneuma.store.provenance import uncommitted
from pneuma.study import shipped
from pneuma.training.executors import local
from pneuma.training.executors.base import Job

from ..checkout import commit_all
from .calls import call, refused


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory, so that even the default results folder would be seen."""

    def refuse(job: Job, *_: object) -> None:
        assert not job.runs, "training was started"

    monkeypatch.setattr(local, "train_runs", refuse)
    monkeypatch.setattr(study_run, "uncommitted", lambda: ["pneuma/engines/ppo.py", "studies/early.toml"])
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PNEUMA_RESULTS", raising=False)
    return tmp_path


RUN = "study run activation"
MISTAKES = {
    "study run activaton": "'activaton' (did you mean activation?)",
    "study run ppo": "ppo is a search, not a study: `pneuma search run ppo`",
    "study run nothing-like-it": " more; `pneuma study list` lists the shipped ones",
    "search run nothing-like-it": "; known are ",
    "env play": "No such command 'play'. It was removed: play with gymnasium.utils.play",
    "run fork abc": "It was removed: `pneuma study run NAME --set KEY=VALUE` trains other settings",
    "study compare activation tanh relu --plot": "pneuma study plot STUDY --figure summary",
    "study plot activation --center median": "It was removed: curves are means; ",
    "figure x.png": "It was removed: `pneuma study plot` draws figures",
    "env render pneuma/PneumaArena-v0 --out x.mp4": "must end in .gif or .png (`ffmpeg -i x.gif x.mp4`",
    "run export abc --out x.onnx": "must end in .zip (docs/engines.md",
    "run shorter.toml": "`pneuma study run shorter.toml`",
    "plot activation": "no such command 'plot': `pneuma study plot`",
    f"{RUN} --steps 100k": "--steps 100k: must be a whole number from 1 to 1e15, as 100_000 or 1e5",
    f"{RUN} --set optimizer=sdg": "did you mean sgd?",
    f"{RUN} --set gamma": "--set gamma: must be KEY=VALUE",
    f"{RUN} --set momentum=0.9": "momentum",  # Adam does not read it
    "study run collapse --set scale=raw": "--set scale: conditions of study collapse differ in it",
    f"{RUN} --address a:1": "--address requires --executor ray",
    f"{RUN} --seeds 0": "--seeds 0: must be a count",
    f"{RUN} --seeds 0..{10**20}": "must be a count",
    f"{RUN} --preset claims": "pneuma/engines/ppo.py is not as committed (2 files",
    "study summary activation@last": "activation@last: was not run in",
    "run list activation": "`pneuma run list --study NAME`",
    f"{RUN} --workers 0": "--workers 0: must be a whole number of at least 1",
    f"{RUN} --workers 1e30": "must be a whole number of at least 1, and at most 1,000,000",
    "study plan cartpole --set wolrds=3": "unknown key 'wolrds'; known are env_kwargs",
    "study verify activation": "activation is a study; name claims, such as its tanh-",
    "search run activation": "activation is a study, not a search: `pneuma study run activation`",
    "search plot tune-ppo --world godot": "`pneuma search run tune-ppo --world godot`",
    "study compare activation": "no condition and --with STUDY: tanh; relu; leaky-relu",
    "study plot activation --width 3,25": "Write 3.25",
    "study publish activation --seeds 77": "77 is a count of seeds; the seed alone is '77,'.",
    "study plan cartpole --world text": "--world text: has no effect in CartPole-v1",
    "study summary activation --world mars": "--world mars: must be one of",
    "study summary own-game --world text": "study own-game cannot run in the world text",
    "study summary activation@quick --preset paper": "names the preset quick; leave out paper",
    "study export activation --out x.csv": "Missing option '--table'",
    "study plot activation --width x": "Invalid value for '--width': ",
    "study plot algorithms --world text": "pneuma study run algorithms",
    "study compare activation tanh relu --format svg": "--format svg: must be one of table",
    f"{RUN} --executor slurm": "--executor slurm: must be one of local, ray; docs/scaling.md shows",
    "study plan breakout": "pip install 'pneuma-rl[minatar]'",
}


@pytest.mark.parametrize("words", MISTAKES)
def test_a_mistake_is_one_line_and_nothing_is_written(words: str, here: Path) -> None:
    assert MISTAKES[words] in refused(*words.split())
    assert os.listdir(here) == []


@pytest.mark.parametrize("words", ["activation@paper --with activation@paper", "activation@paper tanh tanh"])
def test_what_is_compared_with_itself_is_refused(words: str, here: Path) -> None:
    code, out, err = call("study", "compare", *words.split(), "--format", "markdown")
    problem = err.splitlines()[-1]
    assert (code, out) == (2, "") and ("compared with itself" in problem or "same condition" in problem)


def test_an_installation_without_tables_says_so(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shipped, "shipped_tables", lambda: here / "published")
    for file_of_tables in (shipped.claims_history_file, shipped.random_returns_file):
        with pytest.raises(UserError, match="published has no published tables: install Pneuma with them"):
            file_of_tables()


def test_a_file_here_is_suggested_for_a_mistyped_study(here: Path) -> None:
    (here / "shorter.toml").touch()
    assert "unknown study 'shortr' (did you mean shorter?)" in refused("study", "run", "shortr")


CARTPOLE = """\
title = "CartPole"
{above}
[run]
env = "CartPole-v1"
{below}
[conditions.usual]
[presets.quick]
seeds = 1
steps = 1_000
"""


def test_an_outcome_that_runs_cannot_have_is_refused_with_its_line(here: Path) -> None:
    outcomes = 'outcomes = ["final-share-killed"]'
    (here / "cartpole.toml").write_text(CARTPOLE.format(above=outcomes, below=""))
    message = refused("study", "run", "cartpole.toml")
    assert "cartpole.toml, line 2: outcomes: unknown outcome of CartPole-v1 'final-share-killed'" in message
    (here / "cartpole.toml").write_text(CARTPOLE.format(above="", below=outcomes))
    message = refused("study", "run", "cartpole.toml")
    assert "line 5: [run] outcomes is not allowed here: it belongs above [run]" in message


def test_of_an_endless_message_both_ends_are_printed(here: Path) -> None:
    (here / "x.toml").write_text(f'base = "{"x" * 99_999}"')
    message = refused("study", "plan", "x.toml")
    assert len(message) < 5000 and "x.toml" in message and "missing" in message


def test_a_study_is_found_by_its_figure_and_a_folder_without_results_is_noted(here: Path) -> None:
    called = call("study", "summary", "fig-6-4", "--results", "nowhere")
    assert called.out.startswith("Optimizer") and "Note: nowhere has no results." in called.err


def test_a_file_in_place_of_a_folder_is_refused(here: Path) -> None:
    (here / "afile").touch()
    for out in ("afile/a.csv", "afile/b/a.csv"):
        table = ("--table", "summary", "--world", "godot", "--out", out)
        code, _, err = call("study", "export", "activation", *table)
        assert code == 2 and err.endswith(f"pneuma: --out {out}: {Path(out).parent} is not a folder\n")


@pytest.mark.parametrize(
    ("read", "typed", "expected"),
    [
        (count("").parser, "1e4", 10_000),
        (count("").parser, "10_000", 10_000),
        (seeds("").parser, "1..3,7", (1, 2, 3, 7)),
        (seeds("", first_seed=1000).parser, "2", (1000, 1001)),
    ],
)
def test_counts_and_seeds_are_read_as_they_look(
    read: Callable[[str], object], typed: str, expected: object
) -> None:
    assert read(typed) == expected


def test_only_changes_of_code_and_studies_keep_claims_from_being_trained(tmp_path: Path) -> None:
    (tmp_path / "pneuma").mkdir()
    (tmp_path / "pneuma" / "code.py").write_text("1")
    assert uncommitted(tmp_path) == []  # an installed copy has no tree
    commit_all(tmp_path)
    (tmp_path / "notes.md").write_text("mine")
    assert uncommitted(tmp_path) == []
    (tmp_path / "studies").mkdir()
    (tmp_path / "studies" / "new.toml").write_text("")
    (tmp_path / "pneuma" / "code.py").write_text("2")
    assert uncommitted(tmp_path) == ["pneuma/code.py", "studies/"]


STUDY = 'title = "Cart"\n[run]\nenv = "{}"\n{}\n[conditions.a]\n[presets.quick]\nseeds = 1\nsteps = 64\n'
FILES = {
    'title = "Cart\n[run]\n': "at line 1, column 14); the text that line 1 opens is not closed",
    'title = "a"\nabout = """\nit is\n[run]\n': "the text that line 2 opens is not closed",
    "title = 'it\n": "the text that line 1 opens is not closed",
    STUDY.format("CartPole", ""): "with its version, as CartPole-v1",
    STUDY.format("mine:Cart-v1", ""): 'write env_module = "module" and env = "ID"',
    STUDY.format("CartPole-v1", "foo_bar = 1"): "known are env_kwargs, normalize_rewards, algorithm_kwargs",
}


@pytest.mark.parametrize("text", FILES)
def test_a_mistake_in_a_file_is_named(text: str, here: Path) -> None:
    (here / "mine.toml").write_text(text)
    assert FILES[text] in refused("study", "plan", "mine.toml")


def test_presets_and_folders_that_cannot_be_are_not_offered(here: Path) -> None:
    (here / "mine.toml").write_text(STUDY.format("CartPole-v1", ""))
    assert refused("study", "plan", "mine.toml@paper").endswith("known are quick, last")
    for command in ("study summary activation", "study run activation", "run list"):
        assert "--results mine.toml: is not a folder" in refused(*command.split(), "--results", "mine.toml")


@pytest.mark.parametrize(("minibatch", "rest"), [(100, 48), (64, 0), (4096, 0)])
def test_a_minibatch_that_does_not_divide_an_update_is_noted(minibatch: int, rest: int, here: Path) -> None:
    """An update has 2,048 steps, of which 20 minibatches of 100 leave 48."""
    (here / "mine.toml").write_text(STUDY.format("CartPole-v1", f"minibatch = {minibatch}"))
    called = call("study", "plan", "mine.toml")
    note = f"minibatch = 100 does not divide an update's 2,048 steps: the last one has {rest}"
    assert called.code == 0 and (note in called.out + called.err) == bool(rest)
