"""Locks of runs: one holder at a time, and none that is dead."""

from __future__ import annotations

import fcntl
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pneuma.errors import UserError
from pneuma.store.locks import is_held, run_lock


def test_one_holder_at_a_time(tmp_path: Path) -> None:
    with run_lock(tmp_path) as first:
        assert first and is_held(tmp_path)
        with run_lock(tmp_path) as second:
            assert not second
        assert is_held(tmp_path)
    assert not is_held(tmp_path)
    with run_lock(tmp_path) as again:
        assert again


def test_a_process_that_only_looks_excludes_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As `study status` does, again and again, while a run's end is to be stored."""
    (tmp_path / ".lock").touch()
    looking = os.open(tmp_path / ".lock", os.O_RDONLY)
    fcntl.flock(looking, fcntl.LOCK_SH)
    monkeypatch.setattr(time, "sleep", lambda seconds: os.close(looking))
    with run_lock(tmp_path) as mine:
        assert mine


def test_untrusted_a_lock_is_a_file_and_no_link(tmp_path: Path) -> None:
    """A link would lead out of the results; opening a pipe would not end."""
    lock_path, elsewhere = tmp_path / ".lock", tmp_path / "elsewhere"
    elsewhere.touch()
    lock_path.symlink_to(elsewhere)
    with open(elsewhere) as held_file:
        fcntl.flock(held_file, fcntl.LOCK_EX)
        assert not is_held(tmp_path)
        with pytest.raises(UserError, match=r"\.lock: cannot be written \(is a link\)"), run_lock(tmp_path):
            pass
    lock_path.unlink()
    os.mkfifo(lock_path)
    assert not is_held(tmp_path)
    with (
        pytest.raises(UserError, match=r"\.lock: cannot be written \(is not a regular file\)"),
        run_lock(tmp_path),
    ):
        pass


FORKED_AND_KILLED = """
import os, pathlib, signal, sys, time
from pneuma.store.locks import run_lock
with run_lock(pathlib.Path(sys.argv[1])):
    child = os.fork()
    if child == 0:
        os.close(1)
        time.sleep(60)
        os._exit(0)
    print(child, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_a_fork_does_not_hold_the_lock_of_a_process_that_was_killed(tmp_path: Path) -> None:
    """Environments have helpers that are made by `fork`, and these outlive a killed worker."""
    command = [sys.executable, "-c", FORKED_AND_KILLED, str(tmp_path)]
    killed = subprocess.run(command, stdout=subprocess.PIPE, text=True)
    child = int(killed.stdout)
    try:
        os.kill(child, 0)  # it lives
        assert not is_held(tmp_path)
    finally:
        os.kill(child, signal.SIGKILL)
