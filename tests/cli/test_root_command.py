"""`pneuma` itself, as a process: its help, what it loads, its output alone, and how it ends."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from pneuma.cli import app
from pneuma.cli.output import say
from pneuma.training.executors.local import worker_environment

from .calls import printed, refused


def _commands(group: Any, path: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """Yield the words of every group and command, beginning with none."""
    yield path
    for name, options in getattr(group, "commands", {}).items():
        yield from _commands(options, (*path, name))


def test_every_command_has_help_and_no_list_of_commands_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    commands = [*_commands(get_command(app))]
    assert len(commands) > 1
    for path in commands:
        usage, _, *rest = printed(*path, "--help").splitlines()
        assert " ".join([*path, "[OPTIONS]"]) in usage
        assert rest[0].strip(), "says nothing of what it does"
        assert [line for line in rest if line.endswith("...") and "[" not in line] == []


@pytest.mark.parametrize("threads", ["0", "1.5"])
def test_a_variable_that_numba_cannot_read_is_one_line(threads: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NUMBA_NUM_THREADS", threads)
    assert f"NUMBA_NUM_THREADS = {threads} is not allowed" in refused("--version")


HEAVY = ["torch", "numba", "pandas", "matplotlib", "optuna"]
MAIN = "from pneuma.cli import main; assert main({}) == 0"


@pytest.mark.parametrize(
    ("statement", "heavy"),
    [
        (MAIN.format(["--help"]), [*HEAVY, "pydantic", "numpy", "gymnasium"]),
        (MAIN.format(["study", "run", "--help"]), [*HEAVY, "gymnasium"]),
        (MAIN.format(["study", "list"]), [*HEAVY, "gymnasium"]),
        (MAIN.format(["study", "summary", "cartpole@paper"]), ["torch", "numba", "matplotlib", "gymnasium"]),
        ("import gymnasium, pneuma; gymnasium.spec('pneuma/Pneuma-v0')", [*HEAVY, "pydantic"]),
        ("import pneuma, gymnasium; gymnasium.spec('pneuma/Pneuma-v0')", [*HEAVY, "pydantic"]),
    ],
)
def test_nothing_heavy_is_loaded(statement: str, heavy: list[str]) -> None:
    code = f"{statement}\nimport sys\nprint('loaded:', *sorted(set({heavy}) & set(sys.modules)))"
    assert subprocess.check_output([sys.executable, "-c", code], text=True).splitlines()[-1] == "loaded:"


NOISY = """
import ctypes, os, sys
import gymnasium
from gymnasium.envs.classic_control import CartPoleEnv

C = ctypes.CDLL(None)
print("imported")

class Noisy(CartPoleEnv):
    def __init__(self):
        print("made")
        super().__init__()

    def reset(self, **options):
        C.puts(b"reset, by C, which keeps it until it ends")
        sys.__stdout__.write("reset, by another way\\n")
        return super().reset(**options)

    def step(self, action):
        os.write(1, b"step, past Python\\n")
        return super().step(action)

gymnasium.register("Noisy-v0", Noisy)
"""
STUDY = """
title = "Noisy"
base = "table-6-2"
[run]
env = "Noisy-v0"
env_module = "noisy"
engine = "sb3"
[conditions.one]
[presets.quick]
seeds = 1
steps = 64
"""


def test_json_is_one_document_whatever_an_environment_prints(tmp_path: Path) -> None:
    (tmp_path / "noisy.py").write_text(NOISY)
    (tmp_path / "mine.toml").write_text(STUDY)
    command = [sys.executable, "-m", "pneuma", "study", "plan", "mine.toml", "--json"]
    options = {"cwd": tmp_path, "env": worker_environment()}
    done = subprocess.run(command, **options, capture_output=True, text=True, check=True)  # type: ignore[call-overload]
    assert json.loads(done.stdout)["study"]
    for printed_text in ("imported", "made", "by C", "by another way", "past Python"):
        assert printed_text in done.stderr


@pytest.mark.parametrize(
    ("words", "closed"), [("study list --json", "<&- >&- 2>&-"), ("run show nothing", ">&-")]
)
def test_untrusted_closed_output_is_no_traceback(words: str, closed: str) -> None:
    command = f"{sys.executable} -m pneuma {words} {closed}"
    done = subprocess.run(["sh", "-c", command], capture_output=True, text=True)
    assert done.returncode == (2 if "nothing" in words else 0)
    assert done.stdout == "" and done.stderr.count("\n") == ("nothing" in words)


def test_a_reader_who_has_gone_is_no_mistake(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in `pneuma study list | head -1`; 1 would say that a run crashed."""
    command = [sys.executable, str(Path(__file__).parents[2] / "cli.py"), "study", "list"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.close()
    assert process.wait(60) == 0

    class Gone(io.StringIO):
        def write(self, text: str) -> int:
            raise BrokenPipeError

    monkeypatch.setattr(sys, "stderr", Gone())
    say("for people")  # a command goes on where nobody reads its words
