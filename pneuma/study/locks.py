"""Who trains a run: a lock that goes with its holder's process.

Two `study run` on one results folder share the work: a run that another process holds is left to it. Where a
lock keeps nobody out (some file systems have none, or keep them to one machine), two processes may train one
run: to the same bits, in files that are put in place whole, so nothing is lost but time.
"""

from __future__ import annotations

import errno
import fcntl
import os
import stat
import time
from contextlib import suppress
from pathlib import Path

LOOKS, LOOK_SECONDS = 5, 0.002
"""How often a lock that is held is tried again, and after how long: who only looks holds it for a moment."""


class RunLock:
    """The lock of one run; a context manager that tells whether it was free.

        with RunLock(store.run_folder(name)) as mine:
            if mine: ...

    The operating system lets go of it when the process ends, however it ends.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / ".lock"
        self._descriptor = -1

    def __enter__(self) -> bool:
        """Take the lock if nobody holds it; return whether that was so.

        Raises:
            OSError: where it cannot be made, or something lies there that is no file.
        """
        self._path.parent.mkdir(parents=True, exist_ok=True)
        while True:
            self._descriptor = _open(self._path, os.O_RDWR | os.O_CREAT)
            try:
                _take(self._descriptor)
            except BlockingIOError:
                self._close()
                return False
            except OSError:  # there are no locks here
                return True
            if self._is_there():
                return True
            self._close()  # its holder let go, and removed the file, after it was opened here

    def __exit__(self, *_: object) -> None:
        """Let go."""
        if self._descriptor >= 0:
            if self._is_there():
                self._path.unlink(missing_ok=True)
            self._close()

    def _close(self) -> None:
        os.close(self._descriptor)
        self._descriptor = -1

    def _is_there(self) -> bool:
        """Tell whether the file that is held is still the one that others would open."""
        try:
            there = os.stat(self._path, follow_symlinks=False)
        except FileNotFoundError:
            return False
        return os.path.samestat(there, os.fstat(self._descriptor))


def is_held(folder: Path) -> bool:
    """Tell whether some process trains the run of this folder now."""
    try:
        descriptor = _open(folder / ".lock", os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    else:
        return False
    finally:
        os.close(descriptor)


def _open(path: Path, flags: int) -> int:
    """Open a lock without following a link or waiting for a pipe.

    Raises:
        OSError: where it cannot be opened, or is no ordinary file.
    """
    descriptor = os.open(path, flags | os.O_CLOEXEC | os.O_NOFOLLOW | os.O_NONBLOCK, 0o644)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, f"{path.name} is no ordinary file; remove it")
    return descriptor


def _take(descriptor: int) -> None:
    """Lock a file for this process alone; who only looks, by `is_held`, is waited for.

    Raises:
        BlockingIOError: where another holds it.
    """
    for _ in range(LOOKS):
        with suppress(BlockingIOError):
            return fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        time.sleep(LOOK_SECONDS)
    return fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
