"""The first words of the command line, and the examples of its commands."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from pneuma.cli import app
from pneuma.cli.examples import EXAMPLES
from pneuma.errors import UserError
from pneuma.training import execute

from .calls import call

ANSWERS = {
    "study run": "it trains",
    "study check": "it trains",
    "search run": "it trains",
    "search promote": "it trains",
    "study publish": "none of its runs",
    "study delete": "nothing to delete",
    "run delete": "no run '3f2a'",
    "run show": "no run '3f2a'",
    "run export": "no run '3f2a'",
    "import tensorboard": "logs/PPO_1",
    "import csv": "runs.csv",
    "import zoo": "ppo.yml",
}
"""What examples answer that train, or need runs or files of one's own."""


def _examples() -> Iterator[tuple[str, str]]:
    root: Any = get_command(app)
    for group_name in root.commands:
        group = root.commands[group_name]
        for name, command in getattr(group, "commands", {"": group}).items():
            yield f"{group_name} {name}".strip(), command.epilog or ""


@pytest.mark.parametrize(("command", "epilog"), [*_examples()], ids=lambda text: text.replace(" ", "-"))
def test_every_command_has_an_example_that_does_what_it_says(
    command: str, epilog: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise UserError("it trains")

    monkeypatch.setattr(execute, "execute", refuse)
    monkeypatch.chdir(tmp_path)
    assert command in EXAMPLES
    example = epilog.removeprefix("Example: ")
    assert example.startswith(f"pneuma {command}") and len(epilog) <= 76, "it is one line of help"
    called = call(*shlex.split(example)[1:])
    answer = ANSWERS.get(command, "")
    assert called.code == (2 if answer else 0), called.err
    assert answer in called.err


def test_pneuma_alone_says_what_it_is_and_what_to_begin_with() -> None:
    called = call()
    assert called.code == 0 and called.err == ""
    commands = [line.split("  ")[1] for line in called.out.splitlines() if line.startswith("  pneuma")]
    assert len(commands) == 3 and commands[0] == "pneuma study run activation"
    assert max(map(len, called.out.splitlines())) <= 100
