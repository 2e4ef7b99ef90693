"""Estimates over runs, and their intervals.

The unit is the seed. Estimates and intervals take finite values of at least one run: callers drop, count and
report the others.

Every interval names its method. With too few runs, or equal ones, its ends are NaN and its method is "none".
docs/claims.md has the coverage of each.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

TRIMMED = 0.25
"""The share of runs that the interquartile mean leaves out at each end."""
LEVEL = 0.95
LEAST_RUNS = 5
"""The fewest runs of which tables and figures give an interval."""
RESAMPLES, RESAMPLES_AT_ONCE = 2_000, 200
WIDE_GAP = 3.0
"""Standard deviations of runs that a gap between two groups of them exceeds."""
ROUNDING = 1e-12
"""Runs that differ by less, in proportion to the largest, are equal."""
HALF_WIDTH_DIGITS = 2
"""Digits of an interval's half width that are shown."""
MOST_DECIMALS = 6
"""Most decimal places, for runs that are nearly equal."""
DIGITS_WITHOUT_INTERVAL = 3
"""Digits of a number without an interval."""

Groups = Mapping[str, np.ndarray]
"""The values of runs, (runs,), by the names of conditions."""
Bounds = tuple[float, float]
"""The least and the greatest possible value; infinite if there is none."""
NO_BOUNDS: Bounds = (-math.inf, math.inf)

# --- Estimates -------------------------------------------------------------------------------------


def interquartile_mean(values: ArrayLike) -> np.ndarray:
    """Return the mean of the middle half over the last axis, (…, runs) to (…).

    A quarter of the runs, rounded down, is left out at each end, as in rliable (Agarwal et al. 2021) and
    SciPy's `trim_mean`. With three runs or fewer it is the mean.
    """
    runs = np.sort(values, axis=-1)
    trimmed = int(TRIMMED * runs.shape[-1])
    return np.asarray(runs[..., trimmed : runs.shape[-1] - trimmed].mean(axis=-1))


def deviation(runs: np.ndarray) -> float:
    """Return the sample standard deviation of (runs,); NaN for fewer than two.

    For equal runs it is exactly 0, despite rounding of the mean.
    """
    if runs.size < 2:
        return math.nan
    return float(runs.std(ddof=1)) if np.ptp(runs) > 0 else 0.0


def probability_of_improvement(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the probability that a run of a is above a run of b, a tie one half: (…, runs) to (…).

    Values may be infinite. Source: rliable's `probability_of_improvement` of one task: the Mann–Whitney U
    over both counts.
    """
    runs_a, runs_b = a[..., :, None], b[..., None, :]
    return np.asarray(((runs_a > runs_b) + 0.5 * (runs_a == runs_b)).mean(axis=(-2, -1)))


def is_constant(values: np.ndarray) -> bool:
    """Return whether runs differ by rounding alone."""
    return bool(np.ptp(values) <= ROUNDING * np.abs(values).max())


def has_two_modes(runs: np.ndarray) -> bool:
    """Return whether runs, (runs,), fall into two groups with a wide gap between them.

    The widest gap is then over `WIDE_GAP` standard deviations of the larger group, as in 7 % of ten normal
    runs, and 0.2 % of thirty.
    """
    if runs.size < 3 or is_constant(runs):
        return False
    ordered = np.sort(runs)
    gaps = np.diff(ordered)
    split = int(gaps.argmax()) + 1
    larger_group = max(ordered[:split], ordered[split:], key=len)
    return bool(gaps.max() > WIDE_GAP * deviation(larger_group))


def distances(values: np.ndarray) -> np.ndarray:
    """Return how far each run lies from its group's median, (…, runs)."""
    return np.abs(values - np.median(values, axis=-1, keepdims=True))


# --- Intervals -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Interval:
    """The ends of an interval and its method; without an interval NaN, "none" and the reason."""

    low: float
    high: float
    method: str
    reason: str = ""

    @property
    def exists(self) -> bool:
        return self.method != "none"

    def minus(self, constant: float) -> Interval:
        return replace(self, low=self.low - constant, high=self.high - constant)


def no_interval(reason: str = "") -> Interval:
    return Interval(float("nan"), float("nan"), "none", reason)


def no_interval_reason(*groups: np.ndarray) -> str:
    """Return why groups have no interval of their means; empty if they have one."""
    if min(runs.size for runs in groups) < 2:
        return "each group needs at least 2 runs"
    if any(map(is_constant, groups)):
        return "all runs of a group are equal, so no interval can be computed"
    return ""


def around(centre: float, standard_error: float, freedom: float, level: float, method: str) -> Interval:
    """Return Student's interval of an estimate, given its standard error."""
    half_width = standard_error * special.stdtrit(freedom, (1 + level) / 2)
    return Interval(float(centre - half_width), float(centre + half_width), method)


def mean_interval(runs: np.ndarray, level: float = LEVEL) -> Interval:
    """Return Student's t interval of the mean of (runs,)."""
    if reason := no_interval_reason(runs):
        return no_interval(reason)
    standard_error = runs.std(ddof=1) / np.sqrt(runs.size)
    return around(runs.mean(), standard_error, runs.size - 1, level, "t")


def within(interval: Interval, low: float, high: float) -> Interval:
    """Return an interval without the part that no mean can have; it covers as often as before."""
    return replace(interval, low=max(interval.low, low), high=min(interval.high, high))


def difference_interval(a: np.ndarray, b: np.ndarray, level: float = LEVEL) -> Interval:
    """Return Welch's t interval of the difference of means, a - b (Welch 1947)."""
    return interval_of_sum({"a": a, "b": b}, {"a": 1, "b": -1}, level)


def interval_of_sum(
    groups: Groups, weights: Mapping[str, float], level: float, bounds: Bounds = NO_BOUNDS
) -> Interval:
    """Return the t interval of a weighted sum of means, with Satterthwaite's degrees of freedom.

    If the runs of a group are all equal, and their values have bounds, it is that of `_combined`.
    """
    reason = no_interval_reason(*groups.values())
    if not reason:
        return around(*weighted_sum(groups, weights), level, "Welch t")
    if np.isfinite(bounds).all() and min(runs.size for runs in groups.values()) > 1:
        return _combined(groups, weights, level, bounds)
    return no_interval(reason)


def equal_runs_interval(runs: np.ndarray, level: float, bounds: Bounds) -> Interval:
    """Return an interval of the mean of equal runs, whose values have bounds.

    Clopper and Pearson's interval says which share of runs may be unlike these at most. The mean is farthest
    from their value if all unlike ones are at one of the bounds.
    """
    value = float(runs.mean())
    unlike_share = incidence_interval(0, runs.size, level).high
    low, high = value - unlike_share * (value - bounds[0]), value + unlike_share * (bounds[1] - value)
    return Interval(low, high, "Clopper-Pearson")


def _combined(groups: Groups, weights: Mapping[str, float], level: float, bounds: Bounds) -> Interval:
    """Return an interval of a weighted sum of means, from the interval of each mean.

    The distances of their ends from the means add up as squares (Zou and Donner 2008), as in Newcombe's
    interval of two shares.
    """
    total = squares_below = squares_above = 0.0
    for name, runs in groups.items():
        weight, mean = weights.get(name, 0.0), float(runs.mean())
        interval = mean_interval(runs, level)
        if is_constant(runs):
            interval = equal_runs_interval(runs, level, bounds)
        distances_of_ends = weight * (interval.low - mean), weight * (interval.high - mean)
        total += weight * mean
        squares_below += min(distances_of_ends) ** 2
        squares_above += max(distances_of_ends) ** 2
    return Interval(
        total - math.sqrt(squares_below), total + math.sqrt(squares_above), "squares of t and C-P"
    )


def weighted_sum(groups: Groups, weights: Mapping[str, float]) -> tuple[float, float, float]:
    """Return a weighted sum of means, its standard error, and Satterthwaite's degrees of freedom."""
    total = variance = denominator = 0.0
    for name, runs in groups.items():
        weight = weights.get(name, 0.0)
        squared_error = weight**2 * runs.var(ddof=1) / runs.size
        total += weight * runs.mean()
        variance += squared_error
        denominator += squared_error**2 / (runs.size - 1)
    freedom = 1.0
    if denominator > 0:
        freedom = variance**2 / denominator
    return total, math.sqrt(variance), freedom


def spread_interval(a: np.ndarray, b: np.ndarray, level: float = LEVEL) -> Interval:
    """Return Student's interval of the difference of mean distances from the median, a - b."""
    distances_a, distances_b = distances(a), distances(b)
    if reason := _no_spread_reason(a, b):
        return no_interval(reason)
    freedom = distances_a.size + distances_b.size - 2
    squares = distances_a.var() * distances_a.size + distances_b.var() * distances_b.size
    standard_error = np.sqrt(squares / freedom * (1 / distances_a.size + 1 / distances_b.size))
    return around(
        distances_a.mean() - distances_b.mean(), float(standard_error), freedom, level, "Brown-Forsythe t"
    )


def spread_ratio_interval(a: np.ndarray, b: np.ndarray, level: float = LEVEL) -> Interval:
    """Return an interval of the logarithm of the ratio of mean distances from the median, a over b.

    It is Welch's t interval of the difference of both logarithms, whose standard errors are those of the mean
    distances in proportion to them (delta method).
    """
    if reason := _no_spread_reason(a, b):
        return no_interval(reason)
    relative_distances = {"a": distances(a) / distances(a).mean(), "b": distances(b) / distances(b).mean()}
    _, standard_error, freedom = weighted_sum(relative_distances, {"a": 1, "b": -1})
    log_ratio = float(np.log(distances(a).mean() / distances(b).mean()))
    return around(log_ratio, standard_error, freedom, level, "Welch t of logarithms")


def _no_spread_reason(a: np.ndarray, b: np.ndarray) -> str:
    """Return why the spreads of two groups have no interval; empty if they have one."""
    reason = no_interval_reason(a, b)
    if not reason and (is_constant(distances(a)) or is_constant(distances(b))):
        reason = "all runs of a group are equally far from their median, so no interval can be computed"
    return reason


def deviation_interval(runs: np.ndarray) -> Interval:
    """Return Bonett's 95 % interval of the standard deviation, which does not assume normality.

    Source: Bonett (2006), Approximate confidence interval for standard deviation of nonnormal distributions.
    """
    if runs.size < LEAST_RUNS or is_constant(runs):
        return no_interval()
    z = special.ndtri((1 + LEVEL) / 2)
    trimmed = int(runs.size / (2 * np.sqrt(runs.size - 4)))
    middle_runs = np.sort(runs)[trimmed : runs.size - trimmed]
    fourth_moment, squares = ((runs - middle_runs.mean()) ** 4).sum(), (runs.size - 1) * runs.var(ddof=1)
    kurtosis = runs.size * fourth_moment / squares**2
    standard_error = np.sqrt((kurtosis - (runs.size - 3) / runs.size) / (runs.size - 1))
    correction = runs.size / (runs.size - z)
    log_variance, half_width = np.log(correction * runs.var(ddof=1)), z * correction * standard_error
    return Interval(
        math.exp((log_variance - half_width) / 2), math.exp((log_variance + half_width) / 2), "Bonett"
    )


def incidence_interval(event_count: int, run_count: int, level: float = LEVEL) -> Interval:
    """Return Clopper and Pearson's interval of a share, which never covers less than its level."""
    if run_count < 1:
        return no_interval()
    low, high = exact_ends(event_count, run_count, level)
    return Interval(float(low), float(high), "Clopper-Pearson")


def exact_ends(
    event_counts: ArrayLike, run_count: int, level: float = LEVEL
) -> tuple[np.ndarray, np.ndarray]:
    """Return the ends of Clopper and Pearson's intervals of counts of runs."""
    event_counts, tail = np.asarray(event_counts), (1 - level) / 2
    low = special.betaincinv(np.maximum(event_counts, 1), run_count - event_counts + 1, tail)
    high = special.betaincinv(event_counts + 1, np.maximum(run_count - event_counts, 1), 1 - tail)
    return np.where(event_counts > 0, low, 0.0), np.where(event_counts < run_count, high, 1.0)


def incidence_difference_interval(
    count_a: int, runs_a: int, count_b: int, runs_b: int, level: float = LEVEL
) -> Interval:
    """Return Newcombe's interval of a difference of shares, a - b, from the exact ends of either share.

    Source: Newcombe (1998), method 10, which has Wilson's ends. With these, two runs of two against none of
    two differ at 95 %, which happens by chance in an eighth of all pairs of groups.
    """
    a, b = incidence_interval(count_a, runs_a, level), incidence_interval(count_b, runs_b, level)
    share_a, share_b = count_a / runs_a, count_b / runs_b
    centre = share_a - share_b
    low = centre - np.hypot(share_a - a.low, b.high - share_b)
    high = centre + np.hypot(a.high - share_a, share_b - b.low)
    return Interval(float(low), float(high), "Newcombe")


def bootstrap_interval(
    runs: np.ndarray, statistic: Callable[[ArrayLike], np.ndarray], generator: np.random.Generator
) -> Interval:
    """Return the 95 % BCa bootstrap interval of a statistic over runs (Efron 1987).

    With few runs its coverage is smaller (docs/claims.md). There is none for fewer than
    `LEAST_RUNS`, or if both ends are equal, as for the median of mostly equal runs. `statistic` works along
    the last axis, as `mean` and `median` do. SciPy's `bootstrap` gives the same ends, but none if the
    statistic stays the same whichever run is left out.
    """
    if runs.size < LEAST_RUNS or is_constant(runs):
        return no_interval()
    estimate = float(statistic(runs))
    parts = []
    for _ in range(0, RESAMPLES, RESAMPLES_AT_ONCE):  # all at once take 24 MB for 500 runs
        parts.append(statistic(runs[generator.integers(0, runs.size, (RESAMPLES_AT_ONCE, runs.size))]))
    resampled = np.concatenate(parts)
    share_below = (
        np.count_nonzero(resampled < estimate) + 0.5 * np.count_nonzero(resampled == estimate)
    ) / RESAMPLES
    bias = special.ndtri(np.clip(share_below, 0.5 / RESAMPLES, 1 - 0.5 / RESAMPLES))
    z = special.ndtri(np.array([(1 - LEVEL) / 2, (1 + LEVEL) / 2]))
    percentiles = special.ndtr(bias + (bias + z) / (1 - _acceleration(runs, statistic) * (bias + z)))
    low, high = np.quantile(resampled, percentiles)
    if low == high:  # mostly equal runs: an interval without width would claim too much
        return no_interval()
    return Interval(float(low), float(high), "BCa bootstrap")


def _acceleration(runs: np.ndarray, statistic: Callable[[ArrayLike], np.ndarray]) -> float:
    """Return BCa's acceleration: the skew of the statistic with each run left out once."""
    without_one = statistic(np.array([np.delete(runs, omitted) for omitted in range(runs.size)]))
    skew = without_one.mean() - without_one
    squares = (skew**2).sum()
    return float((skew**3).sum() / (6 * squares**1.5)) if squares > 0 else 0.0


# --- In digits -------------------------------------------------------------------------------------


def decimals(value: float, low: float = math.nan, high: float = math.nan) -> int:
    """Return how many decimal places a number is shown with; negative for tens and more."""
    half_width = (high - low) / 2
    if math.isfinite(half_width) and round(half_width, MOST_DECIMALS) > 0:
        return min(MOST_DECIMALS, HALF_WIDTH_DIGITS - 1 - math.floor(math.log10(half_width)))
    if not math.isfinite(value) or round(value, MOST_DECIMALS) == 0:
        return 0
    return min(MOST_DECIMALS, DIGITS_WITHOUT_INTERVAL - 1 - math.floor(math.log10(abs(value))))


def number_text(value: float, decimal_places: int) -> str:
    """Return a rounded number as text; – for NaN."""
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "never" if value > 0 else "-inf"
    rounded = round(value, decimal_places) + 0.0  # no minus zero
    return f"{rounded:,.{max(decimal_places, 0)}f}"


def number_with_interval(value: float, low: float, high: float) -> str:
    """Return a number and its interval as text, with the digits that the interval supports."""
    digits = decimals(value, low, high)
    ends = number_text(low, digits), number_text(high, digits)
    if math.isnan(low) or math.isnan(high) or ends[0] == ends[1]:  # nearly equal runs: no width would show
        return number_text(value, digits)
    return f"{number_text(value, digits)} [{' to '.join(ends)}]"
