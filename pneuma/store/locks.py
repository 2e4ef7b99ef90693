"""Locks on the folders of runs, which end with the process that holds them.

Two `study run` on one results folder share the work: a process skips a run that another one holds. On file
systems without locks, or with locks for one machine only, two processes may train the same run. Both give the
same bits, and files are written whole, so that only time is lost. A lock's file stays, held or not, until the
run is finished: if it were removed sooner, two processes could hold the lock.
"""

from __future__ import annotations

import fcntl
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO
from weakref import WeakSet

from pneuma.files import open_stored, write_error

LOCK_FILE = ".lock"
ATTEMPTS, ATTEMPT_SECONDS = 5, 0.002
"""Attempts to take a lock, and seconds between them: `is_held` in another process holds it for a moment."""

_LOCK_FILES: WeakSet[BinaryIO] = WeakSet()
"""Files that this process has locked."""


def _let_go_in_fork() -> None:
    """Close the locks in a process made by `fork`, which would hold them after the end of this one."""
    null_device = os.open(os.devnull, os.O_RDONLY)
    for lock_file in _LOCK_FILES:
        if not lock_file.closed:
            os.dup2(null_device, lock_file.fileno())
    os.close(null_device)


os.register_at_fork(after_in_child=_let_go_in_fork)


@contextmanager
def run_lock(folder: Path) -> Iterator[bool]:
    """Hold the lock of a run's folder, if no other process does; yield whether it is held.

    The operating system releases the lock when the process ends, however it ends.

    Raises:
        UserError: when it cannot be created.
    """
    lock_path = folder / LOCK_FILE
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock_file = open(lock_path, "a+b", opener=open_stored)  # noqa: SIM115 (it is held outside `try`)
    except OSError as error:
        raise write_error(lock_path, error) from None
    with lock_file:
        yield take_lock(lock_file)


def is_held(folder: Path) -> bool:
    """Return whether some process trains the run in this folder now."""
    try:
        with open(folder / LOCK_FILE, "rb", opener=open_stored) as lock_file:
            fcntl.flock(lock_file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError as error:
        return isinstance(error, BlockingIOError)
    return False


def take_lock(lock_file: BinaryIO) -> bool:
    """Lock a file for this process; return whether no other process holds it."""
    _LOCK_FILES.add(lock_file)
    for _ in range(ATTEMPTS):
        try:
            fcntl.flock(lock_file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except BlockingIOError:
            time.sleep(ATTEMPT_SECONDS)
        except OSError:  # there are no locks on this file system
            return True
    return False
