"""Which runs share compiled programs, and whether these are there: numba and JAX keep them on disk."""

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
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

    None where this process keeps no programs. Only a message depends on it.
    """
    from pneuma.env.compiled import DIGEST  # numba: not for whoever only reads runs

    folder = os.environ.get("JAX_COMPILATION_CACHE_DIR")
    told = repr([DIGEST, *(getattr(run, name) for name in SHAPED_BY)])
    return Path(folder) / f"compiled-{hashlib.sha256(told.encode()).hexdigest()[:16]}" if folder else None


def leave_mark(mark: Path | None) -> None:
    """Note that a run's programs are compiled; where that cannot be written, it is only said again."""
    if mark is not None:
        with suppress(OSError):
            mark.parent.mkdir(parents=True, exist_ok=True)
            mark.touch()
