"""Power: how many seeds decide a contrast, and what difference so many seeds find.

Both take the normal approximation with Student's quantiles, and the exact chances where shares are compared.
"""

from __future__ import annotations

from math import comb

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from pneuma.analysis.contrasts import CONTRAST_KINDS
from pneuma.analysis.estimates import finite

MOST_SEEDS = 10_000
"""More than this is answered with None: no number of seeds that anyone trains decides it."""
POWER = 0.8
"""The chance with which a contrast is to be decided."""


def seeds_needed(
    kind: str, a: ArrayLike, b: ArrayLike, margin: float | None, alpha: float, direction: str = "different"
) -> int | None:
    """Return how many seeds each arm needs, in all, for a contrast to be decided either way.

    Args:
        kind: one of `CONTRAST_KINDS`.
        a: (runs,) values seen so far: their means, deviations and shares are taken for the truth.
        b: the same of the other arm.
        margin: as for `compare`; decided is also what is shown to lie within it.
        alpha: the error rate that the two-sided test must reach, after any correction.
        direction: what is claimed, of `pneuma.analysis.verdicts.DIRECTIONS`: a claim of no difference is
            not decided by any difference, but by one beyond the margin.

    Returns:
        The least number of runs per arm, counting those there are, and not below what a permutation test of
        that alpha takes; None where that is above `MOST_SEEDS`, where what was seen has no spread to plan
        with, and for "spread", whose tests take far more runs than a normal approximation says.
    """
    if kind not in CONTRAST_KINDS:
        raise ValueError(f"contrast of kind {kind!r}; there are " + ", ".join(CONTRAST_KINDS))
    first, second = finite(a), finite(b)
    if kind == "spread" or min(first.size, second.size) < (1 if kind == "incidence" else 2):
        return None
    error = _error(kind, first, second)
    if error <= 0:
        return None
    counts = np.arange(2, MOST_SEEDS + 1)
    effect = float(first.mean() - second.mean())
    enough = _power(effect, error / np.sqrt(counts), margin or 0.0, alpha, 2.0 * (counts - 1), direction)
    decided = counts[(enough >= POWER) & (counts >= _fewest(alpha))]
    return int(decided[0]) if decided.size else None


def _error(kind: str, a: np.ndarray, b: np.ndarray) -> float:
    """Return the standard error of the difference with one seed an arm."""
    if kind == "mean":
        return float(np.sqrt(a.var(ddof=1) + b.var(ddof=1)))
    share_a, share_b = ((arm.sum() + 0.5) / (arm.size + 1) for arm in (a, b))
    return float(np.sqrt(share_a * (1 - share_a) + share_b * (1 - share_b)))


def _power(
    effect: float, error: np.ndarray, margin: float, alpha: float, degrees: np.ndarray, direction: str
) -> np.ndarray:
    """Return the chance that the difference, or else equivalence, is shown with each error."""
    cut = special.stdtrit(degrees, 1 - alpha / 2)
    if direction == "equal":
        deciding = np.abs(effect) - margin
    elif direction == "not-less":
        deciding = max(effect, -effect - margin)
    else:
        deciding = np.abs(effect)
    different = special.ndtr(deciding / error - cut)
    cut = special.stdtrit(degrees, 1 - alpha)
    inside = special.ndtr((margin - effect) / error - cut) + special.ndtr((margin + effect) / error - cut) - 1
    return np.maximum(different, inside)


def _fewest(alpha: float) -> int:
    """Return the least number of runs per arm whose smallest two-sided p-value is at most alpha."""
    return next((n for n in range(2, MOST_SEEDS) if 2 / comb(2 * n, n) <= alpha), MOST_SEEDS)
