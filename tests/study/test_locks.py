"""Locks of runs: one holder at a time, and none that is dead."""

from __future__ import annotations

import fcntl
import os
import socket
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from pneuma.study import locks
from pneuma.study.locks import STALE_SECONDS, RunLock, is_held
from pneuma.study.store import Store


def test_one_holder_at_a_time(tmp_path: Path) -> None:
    with RunLock(tmp_path) as first:
        assert first and is_held(tmp_path)
        with RunLock(tmp_path) as second:
            assert not second
        assert is_held(tmp_path)
    assert not is_held(tmp_path)
    assert not list(tmp_path.iterdir())
    with RunLock(tmp_path) as again:
        assert again


def test_who_only_looks_keeps_nobody_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As `study status` does, again and again, while a run's end is to be stored."""
    (tmp_path / ".lock").touch()
    looking = os.open(tmp_path / ".lock", os.O_RDONLY)
    fcntl.flock(looking, fcntl.LOCK_SH)
    monkeypatch.setattr(time, "sleep", lambda seconds: os.close(looking))  # it has seen what it wanted
    with RunLock(tmp_path) as mine:
        assert mine


def test_who_opened_the_file_before_it_was_removed_does_not_hold_the_lock_of_a_ghost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A holder lets go, and removes the file, between another's opening and locking it."""
    holder = RunLock(tmp_path)
    assert holder.__enter__()
    lock = fcntl.flock

    def let_go_first(descriptor: int, operation: int) -> None:
        monkeypatch.setattr(fcntl, "flock", lock)
        holder.__exit__()
        lock(descriptor, operation)

    monkeypatch.setattr(fcntl, "flock", let_go_first)
    with RunLock(tmp_path) as mine:
        assert mine and is_held(tmp_path)
        with RunLock(tmp_path) as other:
            assert not other


def test_where_there_are_no_locks_nobody_is_kept_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(37, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    with RunLock(tmp_path) as mine:
        assert mine and not is_held(tmp_path)


def test_a_link_a_pipe_or_a_folder_in_the_locks_place_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    store, name = Store(tmp_path), "0123456789abcdef"
    folder = store.run_folder(name)
    folder.mkdir(parents=True)
    path = folder / ".lock"
    cases: list[tuple[Callable[[], object], Callable[[], object], str]] = [
        (lambda: path.symlink_to(tmp_path / "elsewhere"), path.unlink, "symbolic links"),
        (lambda: os.mkfifo(path), path.unlink, "is no ordinary file; remove it"),
        (path.mkdir, path.rmdir, "directory"),
    ]
    for make, undo, why in cases:
        make()
        with pytest.raises(OSError, match=why), RunLock(folder):
            pass
        assert not is_held(folder) and store.status(name).name == "planned"
        undo()
    assert not (tmp_path / "elsewhere").exists()


@pytest.mark.parametrize(
    ("holder", "age", "broken"),
    [("elsewhere", STALE_SECONDS + 60, True), ("elsewhere", STALE_SECONDS - 60, False), ("", 1e6, False)],
)
def test_a_lock_that_a_dead_machine_holds_is_broken_in_the_end(
    holder: str, age: float, broken: bool, tmp_path: Path
) -> None:
    """A file server may never let go of it; this machine's own locks go with their processes."""
    path = tmp_path / ".lock"
    with RunLock(tmp_path) as mine:
        assert mine and path.read_text() == socket.gethostname()
        path.write_text(holder or socket.gethostname())
        os.utime(path, (time.time() - age, time.time() - age))
        assert is_held(tmp_path) is not broken
        with RunLock(tmp_path) as other:
            assert other is broken
            assert is_held(tmp_path)
    assert path.exists() is False


def test_a_holder_renews_its_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(locks, "RENEW_SECONDS", 0.01)
    with RunLock(tmp_path):
        os.utime(tmp_path / ".lock", (0, 0))
        until = time.monotonic() + 10
        while (tmp_path / ".lock").stat().st_mtime == 0 and time.monotonic() < until:
            time.sleep(0.01)
        assert (tmp_path / ".lock").stat().st_mtime > 0


def test_who_breaks_a_dead_machines_lock_leaves_that_of_who_broke_it_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another breaks it, and takes its place, between this one's look at it and its removal."""
    dead, first, judge = RunLock(tmp_path), RunLock(tmp_path), locks._is_stale
    assert dead.__enter__()
    (tmp_path / ".lock").write_text("elsewhere")
    os.utime(tmp_path / ".lock", (0, 0))

    def judge_late(descriptor: int) -> bool:
        monkeypatch.setattr(locks, "_is_stale", judge)
        assert first.__enter__()
        return True

    monkeypatch.setattr(locks, "_is_stale", judge_late)
    with RunLock(tmp_path) as second:
        assert not second and is_held(tmp_path)
    first.__exit__()
    dead.__exit__()
    assert not is_held(tmp_path)
