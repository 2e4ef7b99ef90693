"""Functions that numba compiles, kept on disk where there is a folder for it.

The cache on disk looks at the types of arguments and at the file that a kernel is in, and at no other. So
the handle of a world's state (`pneuma.env.state.HANDLE`) has a field that nobody reads, named by a digest
of all files with kernels: where one has changed, every kernel that takes a handle is compiled anew. A
kernel that takes none may use nothing of another file.
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
    "engines/acting.py", "engines/batched/rollout.py", "engines/mlp.py",
)  # fmt: skip
"""Files whose code, or whose constants, are compiled into kernels."""
DIGEST = hashlib.sha256(b"".join((PACKAGE / name).read_bytes() for name in KERNEL_SOURCES)).hexdigest()[:16]


def cached(**options: Any) -> Callable[[Any], Any]:
    """Return `njit` with its cache; where no folder can be written, each process compiles anew.

    Numba writes beside the code, in the user's cache, or in NUMBA_CACHE_DIR. Where it can in none, as in a
    container whose user owns nothing, it refuses the function: that is no reason not to play.
    """

    def compiled(function: Any) -> Any:
        try:
            return njit(cache=True, **options)(function)
        except RuntimeError:
            return njit(**options)(function)

    return compiled
