"""Power: how many seeds a contrast needs before it is decided."""

from __future__ import annotations

from collections.abc import Callable
from math import comb

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from pneuma.analysis.contrasts import CONTRAST_KINDS
from pneuma.analysis.estimates import finite

MOST_SEEDS = 10_000
"""More than this is answered with None: no number of seeds that anyone trains decides it."""


def seeds_needed(
    kind: str,
    a: ArrayLike,
    b: ArrayLike,
    margin: float | None,
    alpha: float,
    direction: str = "different",
    power: float = 0.8,
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
        power: the chance with which it is to be decided.

    Returns:
        The least number of runs per arm, counting those there are, by a normal approximation and not
        below what a permutation test of that alpha takes; None where that is above `MOST_SEEDS`, where
        what was seen has no spread to plan with, and for "spread", whose three tests at once take far more
        runs than a normal approximation says.
    """
    if kind not in CONTRAST_KINDS:
        raise ValueError(f"contrast of kind {kind!r}; there are " + ", ".join(CONTRAST_KINDS))
    plan = _SCALES[kind](finite(a), finite(b), margin) if kind in _SCALES else None
    if plan is None:
        return None
    effect, error, width = plan
    counts = np.arange(2, MOST_SEEDS + 1)
    degrees = (counts - 1) * (1.0 if kind == "paired" else 2.0)
    enough = _power(effect, error / np.sqrt(counts), width, alpha, degrees, direction) >= power
    fewest = _fewest(kind, alpha)
    decided = counts[enough & (counts >= fewest)]
    return int(decided[0]) if decided.size else None


_Plan = tuple[float, float, float] | None
"""Effect, its standard error at one seed per arm, and the margin, all on one scale; None: no spread."""


def _means(a: np.ndarray, b: np.ndarray, margin: float | None) -> _Plan:
    if min(a.size, b.size) < 2:
        return None
    error = np.sqrt(a.var(ddof=1) + b.var(ddof=1))
    return (a.mean() - b.mean(), error, margin or 0.0) if error > 0 else None


def _pairs(a: np.ndarray, b: np.ndarray, margin: float | None) -> _Plan:
    difference = a - b
    if difference.size < 2 or np.ptp(difference) == 0:
        return None
    return difference.mean(), difference.std(ddof=1), margin or 0.0


def _shares(a: np.ndarray, b: np.ndarray, margin: float | None) -> _Plan:
    if not a.size or not b.size:
        return None
    share_a, share_b = ((arm.sum() + 0.5) / (arm.size + 1) for arm in (a, b))
    error = np.sqrt(share_a * (1 - share_a) + share_b * (1 - share_b))
    return a.mean() - b.mean(), error, margin or 0.0


_SCALES: dict[str, Callable[[np.ndarray, np.ndarray, float | None], _Plan]] = {
    "mean": _means,
    "incidence": _shares,
    "paired": _pairs,
}


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


def _fewest(kind: str, alpha: float) -> int:
    """Return the least number of runs per arm whose smallest two-sided p-value is at most alpha."""
    for count in range(2, MOST_SEEDS):
        ways = 2**count if kind == "paired" else comb(2 * count, count)
        if 2 / ways <= alpha:
            return count
    return MOST_SEEDS
