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

    The operating system lets go of it when the process ends, however it ends.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / ".lock"
        self._descriptor = -1

    def __enter__(self) -> bool:
        """Take the lock if nobody holds it; return whether that was so."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._descriptor = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
        try:
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(self._descriptor)
            self._descriptor = -1
        return self._descriptor >= 0

    def __exit__(self, *_: object) -> None:
        """Let go."""
        if self._descriptor >= 0:
            self._path.unlink(missing_ok=True)
            os.close(self._descriptor)


def is_held(folder: Path) -> bool:
    """Tell whether some process trains the run of this folder now."""
    try:
        descriptor = os.open(folder / ".lock", os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    else:
        return False
    finally:
        os.close(descriptor)
