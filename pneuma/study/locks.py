"""Who trains a run: a lock that goes with its holder's process.

Two `study run` on one results folder share the work: a run that another process holds is left to it.

On a file system that several machines share, the server lets go of a dead machine's locks late or never.
So a holder renews its lock's time while it lives, and names its machine in it; a lock of another machine
that was not renewed for `STALE_SECONDS` is broken. Where a lock keeps nobody out (some file systems have
none, or keep them to one machine), two processes may train one run: to the same bits, in files that are
put in place whole, so nothing is lost but time.
"""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import stat
import threading
import time
from contextlib import suppress
from pathlib import Path

RENEW_SECONDS = 30.0
STALE_SECONDS = 600.0
"""Twenty renewals; and more than the five minutes by which clocks of a Slurm cluster may differ."""
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
        self._released = threading.Event()

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
                stale = _is_stale(self._descriptor)
                if stale and self._is_there():  # and not that of who broke it just before
                    self._path.unlink(missing_ok=True)
                self._close()
                if not stale:
                    return False
                continue
            except OSError:
                return True
            if self._is_there():
                self._sign()
                return True
            self._close()  # its holder let go, and removed the file, after it was opened here

    def __exit__(self, *_: object) -> None:
        """Let go."""
        self._released.set()
        if self._descriptor >= 0:
            if self._is_there():  # and not another's, who broke this one
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

    def _sign(self) -> None:
        """Name this machine in the lock, and renew its time from now on."""
        with suppress(OSError):
            os.ftruncate(self._descriptor, 0)
            os.pwrite(self._descriptor, socket.gethostname().encode(), 0)
        threading.Thread(target=self._renew, daemon=True).start()

    def _renew(self) -> None:
        while not self._released.wait(RENEW_SECONDS):
            with suppress(OSError):
                if self._is_there():
                    os.utime(self._path)


def is_held(folder: Path) -> bool:
    """Tell whether some process trains the run of this folder now."""
    try:
        descriptor = _open(folder / ".lock", os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return not _is_stale(descriptor)
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


def _is_stale(descriptor: int) -> bool:
    """Tell whether a lock that is held belongs to another machine which has not renewed it for long."""
    try:
        holder = os.pread(descriptor, 300, 0).decode(errors="replace")
        age = time.time() - os.fstat(descriptor).st_mtime
    except OSError:
        return False
    return bool(holder) and holder != socket.gethostname() and age > STALE_SECONDS
