"""`pneuma` itself: its help, and how it ends."""

from __future__ import annotations

import io
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from pneuma.cli import app
from pneuma.cli.output import say

from .calls import printed

CLI = Path(__file__).parents[2] / "cli.py"


def _commands(group: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Yield the words of every group and command, beginning with none."""
    yield path
    for name, own in getattr(group, "commands", {}).items():
        yield from _commands(own, (*path, name))


def test_every_command_has_help_and_no_list_of_commands_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    commands = [*_commands(get_command(app))]
    assert len(commands) > 1
    for path in commands:
        usage, _, *rest = printed(*path, "--help").splitlines()
        assert " ".join([*path, "[OPTIONS]"]) in usage
        assert rest[0].strip(), "says nothing of what it does"
        assert [line for line in rest if line.endswith("...") and "[" not in line] == []


def test_a_reader_who_has_gone_is_no_mistake(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in `pneuma study list | head -1`; 1 would say that a run crashed."""
    process = subprocess.Popen([sys.executable, str(CLI), "study", "list"], stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.close()
    assert process.wait(60) == 0

    class Gone(io.StringIO):
        def write(self, text: str) -> int:
            raise BrokenPipeError

    monkeypatch.setattr(sys, "stderr", Gone())
    say("for people")  # a command goes on where nobody reads its words
