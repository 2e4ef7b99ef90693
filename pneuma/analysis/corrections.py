"""Corrections for many tests at once.

Of each test one p-value, against one hypothesis: `holm`. Where a p-value is the lesser of two, of opposite
hypotheses, only `bonferroni` holds: see there.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike


def bonferroni(p_values: ArrayLike) -> np.ndarray:
    """Return Bonferroni's adjusted p-values, (tests,): each times their number.

    It is what holds for the lesser of the p-values of a difference and of equivalence. Holm's steps suppose
    that what was found leaves fewer hypotheses that could still be true. But a contrast found to be
    equivalent leaves the list because its effect looked small, and those that are left are the ones that
    look large: most lists of 60 true equivalences, judged in steps, can hold a false difference.
    """
    p = np.asarray(p_values, dtype=float)
    return np.minimum(p * p.size, 1.0)


def holm(p_values: ArrayLike) -> np.ndarray:
    """Return Holm's adjusted p-values, (tests,): each is to be held against the error rate of the list.

    Source: Holm (1979). The least is multiplied by their number, the next by one less, and so on; none
    is less than one before it.
    """
    p = np.asarray(p_values, dtype=float)
    order = np.argsort(p, kind="stable")
    stepped = np.maximum.accumulate(p[order] * (p.size - np.arange(p.size)))
    adjusted = np.empty_like(p)
    adjusted[order] = np.minimum(stepped, 1.0)
    return adjusted
