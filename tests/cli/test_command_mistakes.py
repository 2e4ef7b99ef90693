"""Mistakes on the command line: exit code 2, one line that says what to mend, and nothing written."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest

from pneuma.cli import main
from pneuma.study.execute import selection_record
from pneuma.study.executors import local
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Status, Store

CLI = Path(__file__).parents[2] / "cli.py"

Captured = pytest.CaptureFixture[str]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory, so that even the default results folder would be seen."""

    def refuse(groups: Iterable[object], *_: object) -> None:
        assert not list(groups), "training was started"

    monkeypatch.setattr(local, "run_groups", refuse)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PNEUMA_RESULTS", raising=False)
    return tmp_path


def _refusal(arguments: list[str], captured: Captured) -> str:
    """Run a command that must be refused, and return its one line."""
    assert main(arguments) == 2
    output = captured.readouterr()
    assert output.out == ""
    (line,) = output.err.splitlines()
    assert line.startswith("pneuma: ")
    return line


RUN = ["study", "run", "activation"]
MISTAKES: dict[str, tuple[list[str], tuple[str, ...]]] = {
    "unknown study": (["study", "run", "activaton"], ("'activaton'", "did you mean activation?")),
    "unknown condition": ([*RUN, "--condition", "tahn"], ("'tahn'", "did you mean tanh?")),
    "unknown key": ([*RUN, "--set", "lerning_rate=1"], ("'lerning_rate'", "did you mean learning_rate?")),
    "value out of range": ([*RUN, "--set", "gamma=2"], ("gamma = 2", "at most 1")),
    "value of a wrong type": ([*RUN, "--set", "epochs=many"], ('epochs = "many"', "a whole number")),
    "word misspelt": ([*RUN, "--set", "optimizer=sdg"], ('optimizer = "sdg"', "did you mean sgd?")),
    "setting without a value": ([*RUN, "--set", "gamma"], ("--set gamma", "KEY=VALUE")),
    "setting without a key": ([*RUN, "--set", "=3"], ("--set =3", "KEY=VALUE")),
    "setting of the seed": ([*RUN, "--set", "seed=3"], ("seed", "--seeds")),
    "setting of the steps": ([*RUN, "--set", "steps=3"], ("steps", "--steps")),
    "setting that Adam does not read": ([*RUN, "--set", "momentum=0.9"], ("momentum", "adam")),
    "minibatch too large": ([*RUN, "--set", "minibatch=512"], ("minibatch = 512", "256")),
    "unknown level": ([*RUN, "--set", "level=thesi"], ("'thesi'", "did you mean thesis?")),
    "steps of zero": ([*RUN, "--steps", "0"], ("--steps 0", "at least 1")),
    "negative steps": ([*RUN, "--steps", "-5"], ("--steps -5", "at least 1")),
    "steps that are no number": ([*RUN, "--steps", "many"], ("--steps", "many")),
    "no workers": ([*RUN, "--workers", "0"], ("--workers 0", "at least 1")),
    "workers that are no number": ([*RUN, "--workers", "two"], ("--workers", "two")),
    "unknown executor": ([*RUN, "--executor", "lcal"], ("--executor lcal", "did you mean local?")),
    "address of no cluster": ([*RUN, "--address", "a:1"], ("--address a:1", "--executor ray")),
    "Slurm's option elsewhere": ([*RUN, "--slurm", "mem=1GB"], ("--slurm mem=1GB", "--executor slurm")),
    "nothing to be detached from": ([*RUN, "--detach"], ("--detach", "--executor slurm")),
    "option of Slurm without a value": (
        [*RUN, "--executor", "slurm", "--slurm", "mem"],
        ("--slurm mem", "KEY=VALUE"),
    ),
    "unknown engine": ([*RUN, "--engine", "sb4"], ("sb4", "did you mean sb3?")),
    "unknown preset": ([*RUN, "--preset", "quik"], ("'quik'", "did you mean quick?")),
    "file that is not there": (["study", "run", "nowhere.toml"], ("nowhere.toml", "No such file")),
    "unknown option": ([*RUN, "--sedes", "3"], ("--sedes", "--seeds")),
    "unknown command of a group": (["study", "rn"], ("'rn'", "'run'")),
    "unknown command": (["studdy"], ("'studdy'", "'study'")),
    "no study named": (["study", "run"], ("NAME",)),
    "no table named": (["study", "export", "activation", "--out", "x.csv"], ("--table",)),
    "status of an unknown study": (["study", "status", "activaton"], ("did you mean activation?",)),
    "plan of an unknown study": (["study", "plan", "activaton"], ("did you mean activation?",)),
    "show of an unknown study": (["study", "show", "activaton"], ("did you mean activation?",)),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_line_and_nothing_is_written(mistake: str, here: Path, capsys: Captured) -> None:
    arguments, words = MISTAKES[mistake]
    line = _refusal(arguments, capsys)
    for word in words:
        assert word in line
    assert os.listdir(here) == []


@pytest.mark.parametrize("seeds", ["-1", "0", "x", "", ",", "1.5", "3,x", "3,3", "-1,", "3;5"])
def test_seeds_that_mean_nothing_are_refused(seeds: str, here: Path, capsys: Captured) -> None:
    line = _refusal([*RUN, "--seeds", seeds], capsys)
    assert f"--seeds {seeds}" in line
    assert "3,5,8" in line  # an example of what is right
    assert os.listdir(here) == []


@pytest.mark.parametrize(("seeds", "greatest"), [("10001", "10000"), ("4294967296,", "4294967295")])
def test_seeds_beyond_the_greatest_are_told_what_it_is(
    seeds: str, greatest: str, here: Path, capsys: Captured
) -> None:
    line = _refusal([*RUN, "--seeds", seeds], capsys)
    assert greatest in line.replace(",", "").replace("_", "")


def test_a_file_that_is_not_toml_is_told_with_its_line(here: Path, capsys: Captured) -> None:
    (here / "mine.toml").write_text('title = "Mine"\nbase = \n')
    line = _refusal(["study", "run", "mine.toml"], capsys)
    assert "mine.toml" in line and "line 2" in line
    assert os.listdir(here) == ["mine.toml"]


@pytest.mark.parametrize("folder", ["file", "file/below"])
def test_results_that_cannot_be_written_are_refused(folder: str, here: Path, capsys: Captured) -> None:
    (here / "file").write_text("mine")
    line = _refusal([*RUN, "--results", folder], capsys)
    assert f"--results {folder}" in line
    assert os.listdir(here) == ["file"]
    assert (here / "file").read_text() == "mine"


@pytest.mark.parametrize(
    ("folder", "read"), [("~/mine", "{here}/mine"), ("~nobody-at-all/mine", "~nobody-at-all/mine")]
)
def test_a_home_folder_is_read_as_a_shell_reads_it(
    folder: str, read: str, here: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bash leaves `--results=~/mine` as it is, and a folder named `~` is nobody's wish."""
    monkeypatch.setenv("HOME", str(here))
    monkeypatch.setenv("USERPROFILE", str(here))
    line = _refusal(["study", "status", "activation", f"--results={folder}"], capsys)
    assert f"has no runs in {read.format(here=here)}:" in line
    assert os.listdir(here) == []


@pytest.mark.parametrize("arguments", [[], ["study"]])
def test_a_command_left_out_is_answered_with_readable_help(arguments: list[str], capsys: Captured) -> None:
    main(arguments)
    output = capsys.readouterr()
    lines = (output.out + output.err).splitlines()
    assert len(lines) > 5
    assert any(line.startswith("Usage:") for line in lines)
    assert max(map(len, lines)) < 200


# --- Asking for what is not there yet ------------------------------------------------------------


@pytest.mark.parametrize(
    "command", [["status"], ["plot"], ["export", "--table", "episodes", "--out", "below/x.csv"]]
)
def test_before_any_run_a_person_is_told_what_to_do(command: list[str], here: Path, capsys: Captured) -> None:
    line = _refusal(["study", command[0], "activation", *command[1:]], capsys)
    assert "pneuma study run activation" in line and "--results" in line
    assert os.listdir(here) == []


def test_plotting_all_studies_before_any_run_says_what_to_do(here: Path, capsys: Captured) -> None:
    assert "pneuma study run" in _refusal(["study", "plot"], capsys)
    assert os.listdir(here) == []


def test_the_status_of_nothing_is_no_mistake(here: Path, capsys: Captured) -> None:
    assert main(["study", "status"]) == 0
    assert "No study was run" in capsys.readouterr().out
    assert main(["study", "status", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"schema": 1, "studies": []}


@pytest.mark.parametrize(
    "command",
    [["plot"], ["plot", "--out", "below"], ["export", "--table", "episodes", "--out", "below/x.csv"]],
)
def test_a_selection_that_was_not_run_says_what_to_do(
    command: list[str], here: Path, capsys: Captured
) -> None:
    line = _refusal(["study", command[0], "activation", *command[1:], "--seeds", "4"], capsys)
    assert "pneuma study run activation" in line
    assert os.listdir(here) == []


# --- Choices that are checked once there is something to show -------------------------------------


@pytest.fixture
def recorded(here: Path) -> Path:
    """A results folder in which the activation study is recorded as run."""
    plan = make_plan(load_study("activation"), Selection(seeds=(0,)))
    store = Store(here / "results")
    store.save_selection("activation", selection_record(plan))
    for cell in plan.cells:
        store.save_run(cell.run_id, Status("done", cell.run.steps), {})
    return here


EXPORT = ["study", "export", "activation"]
CHOICES: dict[str, tuple[list[str], tuple[str, ...]]] = {
    "table": ([*EXPORT, "--table", "episods", "--out", "x"], ("--table", "'episods'", "mean episodes?")),
    "format": (
        [*EXPORT, "--table", "episodes", "--format", "cvs", "--out", "x"],
        ("--format", "mean csv?"),
    ),
    "band": (["study", "plot", "activation", "--band", "sdt"], ("--band", "'sdt'", "did you mean std?")),
    "window": (["study", "plot", "activation", "--window", "trailing"], ("--window", "trailing-100")),
    "figure format": (["study", "plot", "activation", "--format", "pgn"], ("--format", "mean png?")),
    "folder": (["study", "plot", "activation", "--out", "results/studies/activation.json"], ("--out",)),
    "figure for a folder": (
        ["study", "plot", "activation", "--out", "figure.PDF"],
        ("--out figure.PDF: is the folder", "--format pdf"),
    ),
    "folder of a file": (
        [*EXPORT, "--table", "episodes", "--out", "results/studies/activation.json/x"],
        ("--out",),
    ),
}


@pytest.mark.parametrize("choice", CHOICES)
def test_a_wrong_choice_is_one_line_and_nothing_is_written(
    choice: str, recorded: Path, capsys: Captured
) -> None:
    before = sorted(recorded.rglob("*"))
    arguments, words = CHOICES[choice]
    line = _refusal(arguments, capsys)
    for word in words:
        assert word in line
    assert sorted(recorded.rglob("*")) == before


# --- As a command of its own ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["study", "run", "activaton"], "did you mean activation?"),
        (["study", "run", "activation", "--set", "gamma=2"], "gamma = 2"),
        (["--sedes"], "--sedes"),
    ],
)
def test_a_process_leaves_with_code_2_and_one_line(arguments: list[str], word: str, here: Path) -> None:
    command = [sys.executable, str(CLI), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert line.startswith("pneuma: ") and word in line
    assert os.listdir(here) == []
