"""Functions that numba compiles, kept on disk where there is a folder for it.

Numba's cache on disk checks the types of arguments and the file of the kernel itself, but no other file. So
the handle of a world's state (`pneuma.env.state.HANDLE`) has an unused field whose name is a digest of all
files with kernels. If one of them changes, every kernel that takes a handle is compiled again. A kernel that
takes no handle must not use code from other files.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from numba import njit

PACKAGE = Path(__file__).parents[1]
KERNEL_SOURCES = (
    "env/compiled.py", "env/rules.py", "env/state.py",
    "engines/batched/rollout.py", "engines/evaluation.py", "engines/mlp.py",
)  # fmt: skip
"""Files whose code, or whose constants, are compiled into kernels."""
DIGEST = hashlib.sha256(b"".join((PACKAGE / name).read_bytes() for name in KERNEL_SOURCES)).hexdigest()[:16]


def cached(**options: Any) -> Callable[[Any], Any]:
    """Return `njit` with its cache; where no folder can be written, each process compiles anew.

    Numba writes beside the code, in the user's cache, or in NUMBA_CACHE_DIR. If none of these can be written,
    as in some containers, it raises an error, and the function is compiled without a cache.
    """

    def compiled(function: Any) -> Any:
        try:
            return njit(cache=True, **options)(function)
        except RuntimeError:
            return njit(**options)(function)

    return compiled
