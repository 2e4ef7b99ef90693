"""Commands that people type, as processes of their own; none outlives its test."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from pneuma.store.rows import decode_row
from pneuma.store.store import ROW_FILE
from pneuma.training.executors.local import worker_environment

from .tiny import TINY_RUN

FOR_EVER = 64 * 10_000_000

RUNNING: list[subprocess.Popen[str]] = []


def write_study(folder: Path, steps: int = 256, seeds: int = 1, settings: str = "") -> Path:
    path = folder / "trouble.toml"
    preset = f"[presets.quick]\nseeds = {seeds}\nsteps = {steps}\n"
    path.write_text(f'title = "Trouble"\n{TINY_RUN}{settings}\n[conditions.one]\n{preset}')
    return path


def begin(folder: Path, study: Path, *options: str) -> subprocess.Popen[str]:
    """Start `study run` in `folder`, with its results there."""
    command = [sys.executable, "-m", "pneuma", "study", "run", str(study), "--results", "results", "--json"]
    process = subprocess.Popen(
        [*command, "--checkpoint-seconds", "0.1", *options],
        cwd=folder,
        env=worker_environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),  # a shell's background ignores it
    )
    RUNNING.append(process)
    return process


def hold(folder: Path) -> str:
    """Let the runs of a folder wait in the middle as long as there is `hold`; return their reward's name."""
    path = Path(shutil.copy(Path(__file__).with_name("held.py"), folder))
    (folder / "hold").touch()
    return f"{path}:paid"


def end_commands() -> None:
    """End the commands that a failed test left."""
    while RUNNING:
        process = RUNNING.pop()
        process.kill()
        process.communicate()


def wait_until(true: Callable[[], object], seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def outcome(results: Path) -> dict[str, bytes]:
    """Return the contents of every file of all runs, without provenance, which differs between machines."""
    contents_by_file = {}
    for path in (results / "runs").rglob("*"):
        if path.is_file() and path.name not in ("provenance.json", "status.json"):
            contents = path.read_bytes()
            if path.name == ROW_FILE:
                contents = repr(decode_row(contents).table.drop_columns(["provenance"]).to_pydict()).encode()
            contents_by_file[str(path.relative_to(results))] = contents
    return contents_by_file
