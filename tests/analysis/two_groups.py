"""Contrasts of two groups of runs, or of one with a number, for tests of statistics."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pneuma.analysis.claims import contrasts
from pneuma.analysis.claims.contrasts import Contrast


def compare(kind: str, a: ArrayLike, b: ArrayLike | float, level: float = 0.95) -> Contrast:
    group_a = {"a": np.asarray(a, dtype=float)}
    if isinstance(b, int | float):
        return contrasts.compare(kind, group_a, {}, level, constant=b)
    return contrasts.compare(kind, group_a, {"b": np.asarray(b, dtype=float)}, level)
