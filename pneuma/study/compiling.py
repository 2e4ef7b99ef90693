"""When a run has to compile its programs first: numba and JAX keep them on disk for later runs."""

from __future__ import annotations

import hashlib
import json
import os
import platform
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

from pneuma.config import Run

COMPILES = "compiling for the first time (up to a minute; kept for later runs)"
SHAPED_BY = (
    "algorithm", "engine", "actor", "critic", "activation", "horizon", "minibatch", "epochs", "slots",
    "optimizer", "env", "players", "observation", "observe_facing", "perceive", "magic",
)  # fmt: skip
"""Settings by which a run's programs differ."""


def compiled_mark(run: Run) -> Path | None:
    """Return the file, beside JAX's programs, that is there once a run's programs are compiled.

    None where this process keeps no programs.
    """
    folder = os.environ.get("JAX_COMPILATION_CACHE_DIR")
    return Path(folder) / f"compiled-{_digest(run)}" if folder else None


def leave_mark(mark: Path | None) -> None:
    """Note that a run's programs are compiled; where that cannot be written, it is only said again."""
    if mark is not None:
        with suppress(OSError):
            mark.parent.mkdir(parents=True, exist_ok=True)
            mark.touch()


def _digest(run: Run) -> str:
    """Return a hash of what tells one set of programs from another; only a message depends on it."""
    from pneuma.env.compiled import KERNEL_SOURCES, PACKAGE  # numba: not for whoever only reads runs

    stamps = [(PACKAGE / name).stat().st_mtime_ns for name in (*KERNEL_SOURCES, "engines/batched/update.py")]
    shapes = [getattr(run, name) for name in SHAPED_BY]
    versions = [platform.python_version(), *(version(name) for name in ("numba", "jax", "jaxlib"))]
    told = json.dumps([stamps, shapes, run.weight_decay != 0, versions, platform.machine()])
    return hashlib.sha256(told.encode()).hexdigest()[:16]
