"""Point estimates: what one number per run comes to, over runs.

The seed is the unit. Every function takes finite values with the runs along the last axis and gives
one number for each row. A run without the outcome is not a zero and not to be passed over in silence:
a value that is not finite is refused, so that the caller drops it, counts it and says so. Of no runs
at all every estimate is NaN.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

TRIMMED = 0.25
"""The share of runs that an interquartile mean leaves out at each end."""


def finite(values: ArrayLike) -> np.ndarray:
    """Return values as an array of floats, at least one-dimensional.

    Raises:
        ValueError: if one is not finite; its caller should have dropped and counted it.
    """
    array = np.atleast_1d(np.asarray(values, dtype=float))
    if not np.isfinite(array).all():
        raise ValueError(f"{(~np.isfinite(array)).sum()} of {array.size} values are not finite")
    return array


def mean(values: ArrayLike) -> np.ndarray:
    """Return the mean over the last axis, (…, runs) to (…)."""
    runs = finite(values)
    return runs.mean(axis=-1) if runs.shape[-1] else _nothing(runs)


def median(values: ArrayLike) -> np.ndarray:
    """Return the median over the last axis, (…, runs) to (…)."""
    runs = finite(values)
    return np.median(runs, axis=-1) if runs.shape[-1] else _nothing(runs)


def interquartile_mean(values: ArrayLike) -> np.ndarray:
    """Return the mean of the middle half over the last axis, (…, runs) to (…).

    A quarter of the runs, rounded down, is left out at each end, as in rliable (Agarwal et al. 2021)
    and SciPy's `trim_mean`: of three runs or fewer it is the mean.
    """
    runs = finite(values)
    cut = int(TRIMMED * runs.shape[-1])
    return mean(np.sort(runs, axis=-1)[..., cut : runs.shape[-1] - cut])


def deviation(values: ArrayLike) -> np.ndarray:
    """Return the sample standard deviation over the last axis, NaN of fewer than two runs.

    Of equal runs it is 0, which the mean's last bit would hide.
    """
    runs = finite(values)
    if runs.shape[-1] < 2:
        return _nothing(runs)
    return np.where(np.ptp(runs, axis=-1) > 0, runs.std(axis=-1, ddof=1), 0.0)


def performance_profile(values: ArrayLike, thresholds: ArrayLike) -> np.ndarray:
    """Return the share of runs above each threshold, (runs,) and (thresholds,) to (thresholds,).

    Source: rliable's `create_performance_profile`: strictly above.
    """
    runs, levels = finite(values), finite(thresholds)
    return mean((runs > levels[:, None]).astype(float))


def probability_of_improvement(a: ArrayLike, b: ArrayLike) -> float:
    """Return the chance that a run of a is above a run of b; a tie counts one half.

    Source: rliable's `probability_of_improvement` of one task: the Mann–Whitney U over both counts.
    """
    first, second = finite(a), finite(b)
    if not first.size or not second.size:
        return float("nan")
    difference = first[:, None] - second[None, :]
    return float(((difference > 0) + 0.5 * (difference == 0)).mean())


def _nothing(runs: np.ndarray) -> np.ndarray:
    return np.full(runs.shape[:-1], np.nan)[()]


def welch_error(a: np.ndarray, b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the standard error of a difference of means and its degrees of freedom.

    Source: Welch (1947). Arms that do not spread have an error of 0, and 1 degree.

    Args:
        a: (..., runs) of one arm.
        b: (..., runs) of the other.
    """
    part_a, part_b = (arm.var(axis=-1, ddof=1) / arm.shape[-1] for arm in (a, b))
    squared = np.asarray(part_a + part_b)
    below = part_a**2 / (a.shape[-1] - 1) + part_b**2 / (b.shape[-1] - 1)
    return np.sqrt(squared), np.divide(squared**2, below, out=np.ones_like(squared), where=below > 0)
