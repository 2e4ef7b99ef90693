"""Who trains a run: a lock that its holder's death lets go of.

Two `study run` on one results folder share the work: a run that another process holds is left to it.
"""

from __future__ import annotations

import fcntl
import os
from pathlib import Path


class RunLock:
    """The lock of one run; a context manager that tells whether it was free.

        with RunLock(store.run_folder(name)) as mine:
            if mine: ...

    The operating system lets go of it when the process ends, however it ends. On a file system that has no
    locks nobody is kept out: two processes then train the same run, to the same bits.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / ".lock"
        self._descriptor = -1

    def __enter__(self) -> bool:
        """Take the lock if nobody holds it; return whether that was so."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        flags = os.O_RDWR | os.O_CREAT | os.O_CLOEXEC | os.O_NOFOLLOW
        while True:
            self._descriptor = os.open(self._path, flags, 0o644)
            try:
                fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(self._descriptor)
                self._descriptor = -1
                return False
            except OSError:
                return True
            if self._is_there():
                return True
            os.close(self._descriptor)  # its holder let go, and removed the file, after it was opened here

    def _is_there(self) -> bool:
        """Tell whether the file that is held is still the one that others would open."""
        try:
            there = os.stat(self._path, follow_symlinks=False)
        except FileNotFoundError:
            return False
        return os.path.samestat(there, os.fstat(self._descriptor))

    def __exit__(self, *_: object) -> None:
        """Let go."""
        if self._descriptor >= 0:
            self._path.unlink(missing_ok=True)
            os.close(self._descriptor)


def is_held(folder: Path) -> bool:
    """Tell whether some process trains the run of this folder now."""
    try:
        descriptor = os.open(folder / ".lock", os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
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
