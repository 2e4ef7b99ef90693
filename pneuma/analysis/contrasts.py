"""Contrasts: one arm of runs against another arm or a constant, with effect, interval and tests.

A contrast has one-sided p-values, each valid by itself: the effect is above zero, below zero, within the
margin, beyond it above, beyond it below, and not beyond it below. `pneuma.analysis.judgement` decides what
they mean for a claim. docs/evidence.md explains the tests and their assumptions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import permutations

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from pneuma.analysis import intervals, pvalues
from pneuma.analysis.intervals import Interval, finite, no_interval
from pneuma.analysis.pvalues import ManyPValues, PValues
from pneuma.config import stream_seed


@dataclass(frozen=True)
class Contrast:
    """The result of one comparison.

    Attributes:
        effect: the mean of a, its mean distance from the median, its share of runs with an event, or the
            range of its means, minus that of b or the constant.
        interval: its 95 % interval.
        p: its one-sided p-values.
        seeds: runs of a and of b; 0 for a constant.
        reason: why nothing can be concluded; usually empty.
        smallest: the smallest p-values, above and below zero, that so many runs can give.
        simultaneous: its interval at the level of a whole list of contrasts.
        margin: that of the means; None without one, and of shares.
        means: the two numbers whose difference the effect is.
    """

    effect: float
    interval: Interval
    p: PValues[float]
    seeds: tuple[int, int]
    reason: str = ""
    smallest: tuple[float, float] = (0.0, 0.0)
    simultaneous: Interval = no_interval()
    margin: float | None = None
    means: tuple[float, float] = (float("nan"), float("nan"))

    @property
    def p_different(self) -> float:
        """The two-sided p-value of a difference: twice the smaller one-sided p-value."""
        return min(1.0, 2 * min(self.p.greater, self.p.less))


def compare(
    kind: str,
    a: ArrayLike,
    b: ArrayLike | float,
    margin: float | None,
    level: float = intervals.LEVEL,
) -> Contrast:
    """Compare arm a with arm b or with a constant.

    Args:
        kind: mean, spread (of two arms), or incidence, of values 0 or 1.
        a: (runs,) finite values, one per run.
        b: the values of the other arm, or a number in a's unit, or a share of runs.
        margin: smaller differences count as none; in the outcome's unit, or as a share of runs. None for no
            margin.
        level: of the simultaneous interval.

    Raises:
        ValueError: for values that are not finite, or an incidence with values other than 0 and 1.
    """
    first, value = finite(a), b if isinstance(b, int | float) else None
    second = np.empty(0) if value is not None else finite(b)
    n, m = seeds = first.size, second.size
    effect, make = estimate(kind, first, second if value is None else value)
    if too_few := _too_few(kind, n if value is not None else min(seeds)):
        return undecided(too_few, seeds, effect)
    means = _mean_of(kind, first), _mean_of(kind, second) if value is None else float(value)
    made = replace(_contrast(effect, make, level, seeds), means=means)
    if kind == "incidence":
        return _compare_shares(made, first, second, value, margin)
    if kind == "spread":
        tested = pvalues.spread_p_values(first[None], second[None], margin)
        smallest = 0.0
    elif value is not None:
        ways = _sign_flips(n)
        tested = pvalues.one_mean_p_values((first - value)[None], margin, ways)
        smallest = 1 / len(ways)
    else:
        ways = _relabelings(n, m)
        tested = pvalues.mean_p_values(first[None], second[None], margin, ways)
        smallest = 1 / len(ways)
    return replace(made, p=_only(tested), smallest=(smallest,) * 2, margin=margin)


def _mean_of(kind: str, arm: np.ndarray) -> float:
    return float((intervals.distances(arm) if kind == "spread" else arm).mean())


@lru_cache(maxsize=4)  # 50 MB for 30 runs against 30
def _relabelings(size_a: int, size_b: int) -> np.ndarray:
    """Return relabelings of arms of these sizes, the same for all contrasts."""
    generator = np.random.default_rng(stream_seed("relabelings", f"{size_a}/{size_b}"))
    return pvalues.relabel(size_a, size_b, generator)


@lru_cache(maxsize=4)
def _sign_flips(runs: int) -> np.ndarray:
    return pvalues.sign_flips(runs, np.random.default_rng(stream_seed("sign flips", str(runs))))


def estimate(kind: str, a: np.ndarray, b: np.ndarray | float) -> tuple[float, Callable[[float], Interval]]:
    """Return the effect of arm a against arm b or a constant, and what makes its interval at a level."""
    if isinstance(b, int | float):
        effect = float((a - b).mean()) if kind == "mean" else float(a.mean() - b)
        if kind == "mean":
            return effect, partial(intervals.mean_interval, a - b)
        return effect, partial(_share_interval, _count(a), a.size, b)
    if not min(a.size, b.size):
        return float("nan"), lambda level: no_interval()
    if kind == "spread":
        from_a, from_b = map(intervals.distances, (a, b))
        return float(from_a.mean() - from_b.mean()), partial(intervals.spread_interval, a, b)
    effect = float(a.mean() - b.mean())
    if kind == "mean":
        return effect, partial(intervals.difference_interval, a, b)
    counts = _count(a), a.size, _count(b), b.size
    return effect, partial(intervals.incidence_difference_interval, *counts)


def _compare_shares(
    made: Contrast, a: np.ndarray, b: np.ndarray, value: float | None, margin: float | None
) -> Contrast:
    n, m, count, other = a.size, b.size, _count(a), _count(b)
    if value is not None:
        test = partial(pvalues.one_share_p_values, runs=n, value=value)
        tested, extremes = test(np.array([count]), margin=margin), test(np.array([n, 0]), margin=None)
    else:
        tested = pvalues.incidence_p_values(np.array([count]), n, np.array([other]), m, margin)
        extremes = pvalues.incidence_p_values(np.array([n, 0]), n, np.array([0, m]), m, None)
    smallest = float(extremes.greater[0]), float(extremes.less[1])
    return replace(made, p=_only(tested), smallest=smallest)


def _share_interval(count: int, runs: int, value: float, level: float) -> Interval:
    made = intervals.incidence_interval(count, runs, level)
    return replace(made, low=made.low - value, high=made.high - value)


# --- Ranges ----------------------------------------------------------------------------------------


def compare_ranges(
    arms: Sequence[ArrayLike],
    a: Sequence[int],
    b: Sequence[int] | float,
    margin: float | None,
    level: float = intervals.LEVEL,
) -> Contrast:
    """Compare the range of the means of some arms, best less worst, with that of others or with a constant.

    The range of a is beyond that of b if some step from one of a's arms to another is greater than every
    step of b's. Each step is tested against each of b's by Welch's t; the greatest of these p-values counts
    (Berger 1982), and of all steps of a the smallest, times their number.

    Args:
        arms: (runs,) finite values of each arm.
        a: places of arms in `arms`, two or more.
        b: places of other arms, of which some may be the same; or a number.
        margin: smaller differences of ranges count as none; or None.
        level: of the simultaneous interval.
    """
    values = [finite(arm) for arm in arms]
    of_a = values[a[0]].size if a else 0
    seeds = of_a, 0 if isinstance(b, int | float) else values[b[0]].size
    if too_few := _too_few("mean", min(arm.size for arm in values)):
        return undecided(too_few, seeds)
    means, errors = np.array([arm.mean() for arm in values]), _errors(values)
    if not errors.max() > 0:
        return undecided("in no arm do runs differ", seeds)
    value = float(b) if isinstance(b, int | float) else 0.0
    steps = _steps(a, len(values)), _steps([] if isinstance(b, int | float) else b, len(values))
    weights = steps[0][:, None] - steps[1][None]  # (steps of a, steps of b, arms)
    effect = weights @ means - value
    squares = weights**2 @ errors
    freedom = squares**2 / np.maximum((weights**4) @ (errors**2 / [arm.size - 1 for arm in values]), 1e-300)
    error = np.sqrt(squares)
    ends = partial(_range_ends, effect, error, freedom)
    beyond = [[_beyond(sign * effect, error, freedom, shift, sign) for shift in pvalues.shifts(margin)]
              for sign in (1, -1)]  # fmt: skip
    greater, less = beyond[0], [beyond[1][0], *beyond[1][:0:-1]]  # of b over a, shifts are turned
    tested = pvalues.p_values(greater, less, 1)
    made = _contrast(float(effect.min(axis=1).max()), ends, level, seeds)
    ranges = float(np.ptp(means[[*a]])), value if isinstance(b, int | float) else float(np.ptp(means[[*b]]))
    return replace(made, p=_only(tested), smallest=(0.0, 0.0), margin=margin, means=ranges)


def _errors(values: Sequence[np.ndarray]) -> np.ndarray:
    """Return the squared standard error of each arm's mean; 0 for runs that differ by rounding alone."""
    alike = [np.ptp(arm) <= pvalues.ROUNDING * np.abs(arm).max() for arm in values]
    errors = np.array([arm.var(ddof=1) / arm.size for arm in values])
    return np.where(alike, 0.0, errors)


def _steps(places: Sequence[int], arms: int) -> np.ndarray:
    """Return the weights of every step from one arm to another, (steps, arms); one of nothing for no arms."""
    unit = np.eye(arms)
    every = [unit[i] - unit[j] for i, j in permutations(places, 2)]
    return np.array(every or [np.zeros(arms)])


def _beyond(effect: np.ndarray, error: np.ndarray, freedom: np.ndarray, shift: float, sign: int) -> float:
    """Return the p-value that one range is above the other by more than -shift.

    Effects, with their errors and degrees of freedom, are (steps of a, steps of b): of a less b, and for the
    sign -1 of b less a.
    """
    sure = error > 0
    t = np.divide(effect + shift, error, out=np.zeros_like(error), where=sure)
    p = np.where(sure, special.stdtr(np.where(sure, freedom, 1.0), -t), effect + shift <= 0)
    own, other = (0, 1) if sign > 0 else (1, 0)
    return float(min(1.0, p.shape[own] * p.max(axis=other).min()))


def _range_ends(effect: np.ndarray, error: np.ndarray, freedom: np.ndarray, level: float) -> Interval:
    """Return the interval whose ends are the shifts at which `_beyond` just decides."""
    freedom = np.where(error > 0, freedom, 1.0)
    half = [error * special.stdtrit(freedom, 1 - (1 - level) / 2 / steps) for steps in effect.shape]
    low, high = (effect - half[0]).min(axis=1).max(), (effect + half[1]).max(axis=0).min()
    return Interval(float(low), float(high), "steps by Welch t")


def undecided(reason: str, seeds: tuple[int, int] = (0, 0), effect: float = float("nan")) -> Contrast:
    return Contrast(effect, no_interval(), PValues(*[1.0] * 6), seeds, reason, (1.0, 1.0))


def _contrast(
    effect: float, interval: Callable[[float], Interval], level: float, seeds: tuple[int, int]
) -> Contrast:
    """Return a contrast that is not tested yet, with an interval at the 95 % level and one at the list's."""
    made = undecided("", seeds, effect)
    return replace(made, interval=interval(intervals.LEVEL), simultaneous=interval(level))


def _only(tested: ManyPValues) -> PValues[float]:
    return PValues(*(float(of_sample[0]) for of_sample in tested))


def _too_few(kind: str, seeds: int) -> str:
    """Return the reason that an arm has too few runs; empty if it has enough."""
    if seeds == 0:
        return "an arm has no runs"
    lonely = seeds == 1 and kind != "incidence"
    return "an arm has 1 run; it takes 2 to see how runs differ" if lonely else ""


def _count(runs: np.ndarray) -> int:
    if not np.isin(runs, (0, 1)).all():
        raise ValueError("an incidence is of values 0 or 1")
    return int(runs.sum())
