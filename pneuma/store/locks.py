"""Locks on the folders of runs, which end with the process that holds them.

Two `study run` on one results folder share the work: a process skips a run that another one holds. On file
systems without locks, or with locks for one machine only, two processes may train the same run. Both give the
same bits, and files are written whole, so that only time is lost. A lock's file stays, held or not, until the
run is finished: if it were removed sooner, two processes could hold the lock.
"""

from __future__ import annotations

import fcntl
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pneuma.files import open_stored, write_error

LOCK_FILE = ".lock"
ATTEMPTS, ATTEMPT_SECONDS = 5, 0.002
"""Attempts to take a lock, and seconds between them: `is_held` in another process holds it for a moment."""


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
        yield take_lock(lock_file.fileno())


def is_held(folder: Path) -> bool:
    """Return whether some process trains the run in this folder now."""
    try:
        with open(folder / LOCK_FILE, "rb", opener=open_stored) as lock_file:
            fcntl.flock(lock_file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError as error:
        return isinstance(error, BlockingIOError)
    return False


def take_lock(descriptor: int) -> bool:
    """Lock a file for this process; return whether no other process holds it."""
    for _ in range(ATTEMPTS):
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except BlockingIOError:
            time.sleep(ATTEMPT_SECONDS)
        except OSError:  # there are no locks on this file system
            return True
    return False
