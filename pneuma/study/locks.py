"""Locks on the folders of runs, which end with the process that holds them.

Two `study run` on one results folder share the work: a run that another process holds is left to it. On file
systems without locks, or with locks for one machine only, two processes may train the same run. Both give the
same bits, and files are written whole, so that only time is lost.
"""

from __future__ import annotations

import errno
import fcntl
import os
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

LOOKS, LOOK_SECONDS = 5, 0.002
"""Attempts to take a lock, and seconds between them: whoever only looks holds it for a moment."""


@contextmanager
def run_lock(folder: Path) -> Iterator[bool]:
    """Hold the lock of a run's folder, if no other process does; yield whether it is held.

        with run_lock(store.run_folder(name)) as mine:
            if mine: ...

    The operating system releases the lock when the process ends, however it ends.

    Raises:
        OSError: when it cannot be created, or its path is not a file.
    """
    folder.mkdir(parents=True, exist_ok=True)
    path, mine = folder / ".lock", True
    descriptor = _open(path, os.O_RDWR | os.O_CREAT)
    try:
        while (mine := _take(descriptor)) and not _is_there(path, descriptor):
            os.close(descriptor)  # its holder released and removed it after it was opened here
            descriptor = _open(path, os.O_RDWR | os.O_CREAT)
        yield mine
    finally:
        if mine and _is_there(path, descriptor):
            path.unlink(missing_ok=True)
        os.close(descriptor)


def is_held(folder: Path) -> bool:
    """Return whether some process trains the run in this folder now."""
    try:
        descriptor = _open(folder / ".lock", os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError as error:
        return isinstance(error, BlockingIOError)
    else:
        return False
    finally:
        os.close(descriptor)


def _open(path: Path, flags: int) -> int:
    """Open a lock file without following a link or waiting for a pipe.

    Raises:
        OSError: when it cannot be opened, or is not an ordinary file.
    """
    descriptor = os.open(path, flags | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK, 0o644)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, f"{path.name} is no ordinary file; remove it")
    return descriptor


def _take(descriptor: int) -> bool:
    """Lock a file for this process; wait briefly for others that only look (`is_held`)."""
    for _ in range(LOOKS):
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            time.sleep(LOOK_SECONDS)
        except OSError:  # there are no locks here
            return True
        else:
            return True
    return False


def _is_there(path: Path, descriptor: int) -> bool:
    """Return whether the locked file is still the one that others would open."""
    with suppress(FileNotFoundError):
        return os.path.samestat(os.stat(path, follow_symlinks=False), os.fstat(descriptor))
    return False
