"""Programs are compiled once: the first worker that needs them does it, the others wait and load them.

Compiled programs are kept on disk by numba and JAX. Workers that begin at the same time, with nothing
there yet, would each compile all of them, and share the rules of the world though not their networks; so
one at a time holds a lock, up to its first update, and leaves a mark beside JAX's programs. Whoever finds
the mark of its own shapes goes ahead.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
import platform
import time
from collections.abc import Callable
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from threading import Event

from pneuma.config import Run

COMPILES = "compiling for the first time (up to a minute; kept for later runs)"
WAITS = "waiting while another run compiles for the first time"
WAIT_SECONDS = 0.2
SHAPED_BY = (
    "algorithm", "engine", "actor", "critic", "activation", "horizon", "minibatch", "epochs", "slots",
    "optimizer", "env", "players", "observation", "observe_facing", "perceive", "magic",
)  # fmt: skip
"""Settings by which a run's programs are others."""


class FirstCompile:
    """A context manager around a run's training; `done` at its first update lets the others go on.

    Args:
        run: what is trained.
        folder: where marks are left; None to compile whatever is missing without a word.
        tell: takes a sentence for people.
        stop: while set, nothing is waited for.
    """

    def __init__(self, run: Run, folder: Path | None, tell: Callable[[str], None], stop: Event) -> None:
        self._tell, self._stop = tell, stop
        self._mark = folder / f"compiled-{_digest(run)}" if folder else None
        self._descriptor = -1

    def __enter__(self) -> FirstCompile:
        """Wait for whoever compiles, or become the one who does."""
        if self._mark is None or self._mark.exists():
            return self
        try:
            self._mark.parent.mkdir(parents=True, exist_ok=True)
            lock = self._mark.with_name("compiling.lock")
            self._descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o644)
            self._wait()
        except OSError:  # nowhere to leave a mark, or no locks there: everyone compiles
            self._let_go()
        if self._mark.exists():
            self._let_go()
        else:
            self._tell(COMPILES)
        return self

    def done(self) -> None:
        """Note that everything is compiled."""
        if self._descriptor >= 0 and self._mark is not None:
            with suppress(OSError):  # a full disk, say: others compile too
                self._mark.touch()
            self._let_go()

    def __exit__(self, *_: object) -> None:
        """Let go, compiled or not."""
        self._let_go()

    def _wait(self) -> None:
        told = False
        while not self._stop.is_set():
            try:
                return fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                if not told:
                    self._tell(WAITS)
                told = True
                time.sleep(WAIT_SECONDS)

    def _let_go(self) -> None:
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def programs_folder() -> Path | None:
    """Return where JAX keeps this process's programs; None where it was not told to."""
    folder = os.environ.get("JAX_COMPILATION_CACHE_DIR")
    return Path(folder) if folder else None


def _digest(run: Run) -> str:
    """Return a hash of what tells one set of programs from another.

    Where it takes two for one, the second is compiled without a word; nothing depends on it.
    """
    from pneuma.env.compiled import KERNEL_SOURCES, PACKAGE  # numba: not for whoever only reads runs

    sources = (*KERNEL_SOURCES, "engines/batched/update.py")
    stamps = [(PACKAGE / name).stat().st_mtime_ns for name in sources]
    shapes = [getattr(run, name) for name in SHAPED_BY]
    versions = [platform.python_version(), *(version(name) for name in ("numba", "jax", "jaxlib"))]
    told = json.dumps([stamps, shapes, run.weight_decay != 0, versions, platform.machine()])
    return hashlib.sha256(told.encode()).hexdigest()[:16]
