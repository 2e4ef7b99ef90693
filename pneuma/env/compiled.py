"""Functions that numba compiles, kept on disk where there is a folder for it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit


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
