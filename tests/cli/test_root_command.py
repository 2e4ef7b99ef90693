"""`pneuma` itself: help, version, what it ships, and how it ends."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.main import get_command

from pneuma.cli import app, main
from pneuma.cli.options import say
from pneuma.study import spec
from pneuma.study.store import Store

CLI = Path(__file__).parents[2] / "cli.py"
Captured = pytest.CaptureFixture[str]


def test_help_lists_every_group_of_commands(capsys: Captured) -> None:
    assert main(["--help"]) == 0
    output = capsys.readouterr()
    assert output.err == ""
    words = output.out.split()
    assert "study" in words and "bench" in words


def _commands(group: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Yield the words of every group and command, beginning with none."""
    yield path
    for name, own in getattr(group, "commands", {}).items():
        yield from _commands(own, (*path, name))


COMMANDS = [*_commands(get_command(app))]


def test_there_are_commands_in_every_group() -> None:
    assert {path[0] for path in COMMANDS if len(path) == 2} == {
        "study", "run", "search", "env", "bench", "import",
    }  # fmt: skip
    assert {path[0] for path in COMMANDS if len(path) == 1} >= {"report", "doctor"}


@pytest.mark.parametrize("path", COMMANDS, ids=" ".join)
def test_every_command_has_help_and_no_list_of_commands_is_cut(
    path: tuple[str, ...], capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert main([*path, "--help"]) == 0
    usage, _, *rest = capsys.readouterr().out.splitlines()
    assert " ".join([*path, "[OPTIONS]"]) in usage
    assert rest[0].strip(), "says nothing of what it does"
    assert [line for line in rest if line.endswith("...") and "[" not in line] == []


def test_the_shipped_studies_are_listed(capsys: Captured) -> None:
    assert main(["study", "list", "--json"]) == 0
    names = [study["study"] for study in json.loads(capsys.readouterr().out)["studies"]]
    assert "activation" in names
    assert main(["study", "list"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == names


def test_show_says_what_a_study_compares(capsys: Captured) -> None:
    assert main(["study", "show", "activation"]) == 0
    text = capsys.readouterr().out
    assert "activation: tanh (tanh); relu (relu); leaky-relu (leaky-relu)" in text
    assert "Compared with: relu" in text
    assert "gradient_limit = 0.5" in text
    assert main(["study", "show", "activation", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["baseline"] == "relu"
    assert list(document["conditions"]) == ["tanh", "relu", "leaky-relu"]
    assert document["presets"]["paper"]["steps"] == 1_000_000


def test_the_shim_says_what_it_needs_where_that_is_not_installed() -> None:
    done = subprocess.run([sys.executable, "-S", str(CLI), "--help"], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (2, "")
    (line,) = done.stderr.splitlines()
    assert line.endswith("is not installed: pip install -c constraints.txt .")


def test_the_version_is_that_of_the_package(capsys: Captured) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"pneuma {version('pneuma')}\n"


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, typer.Abort])
def test_an_interrupted_command_leaves_with_code_130(
    interruption: type[BaseException], monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    def interrupt() -> None:
        raise interruption

    monkeypatch.setattr(spec, "list_studies", interrupt)
    assert main(["study", "list"]) == 130
    assert capsys.readouterr().err in ("", "pneuma: stopped\n")


def test_a_command_that_leaves_by_itself_leaves_with_its_own_code(monkeypatch: pytest.MonkeyPatch) -> None:
    def leave() -> None:
        raise SystemExit(143)

    monkeypatch.setattr(spec, "list_studies", leave)
    with pytest.raises(SystemExit, match="143"):
        main(["study", "list"])


def test_a_reader_who_has_gone_is_no_mistake() -> None:
    """As in `pneuma study list | head -1`; 1 would say that a run crashed."""
    process = subprocess.Popen([sys.executable, str(CLI), "study", "list"], stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.close()
    assert process.wait(60) == 0


def test_a_command_goes_on_where_nobody_reads_its_words(monkeypatch: pytest.MonkeyPatch) -> None:
    class Gone(io.StringIO):
        def write(self, text: str) -> int:
            raise BrokenPipeError

    monkeypatch.setattr(sys, "stderr", Gone())
    say("for people", aside=True)
    monkeypatch.setattr(sys, "stdout", Gone())
    with pytest.raises(BrokenPipeError):
        say("what was asked for")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_folder_that_may_not_be_read_is_told_in_a_line(tmp_path: Path, capsys: Captured) -> None:
    closed = tmp_path / "closed"
    closed.mkdir(mode=0)
    assert main(["study", "status", "activation", "--results", str(closed / "results")]) == 2
    assert "Permission denied" in capsys.readouterr().err


def test_what_the_system_refuses_is_told_in_a_line(
    tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As above, for whoever runs these tests as root."""

    def refuse(*_: object) -> None:
        raise PermissionError(13, "Permission denied", str(tmp_path / "closed"))

    monkeypatch.setattr(Store, "status", refuse)
    monkeypatch.setattr(Store, "selection", refuse)
    assert main(["study", "status", "activation", "--results", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "Permission denied" in error and len(error.splitlines()) == 1


def test_a_name_too_long_for_the_disk_is_told_in_a_line(capsys: Captured) -> None:
    assert main(["search", "status", "x" * 300]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
