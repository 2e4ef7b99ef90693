"""Contrasts: one arm of runs against another arm or a constant, with effect, interval and tests.

A contrast has five one-sided p-values, each valid by itself: the effect is above zero, below zero, within the
margin, beyond it above, and beyond it below. `pneuma.analysis.judgement` decides what they mean for a claim.
docs/evidence.md explains the tests and their assumptions.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from pneuma.analysis import intervals, pvalues
from pneuma.analysis.intervals import Interval, finite, no_interval
from pneuma.analysis.pvalues import ManyPValues, PValues


@dataclass(frozen=True)
class Contrast:
    """The result of one comparison.

    Attributes:
        effect: the mean of a, or its share of runs with an event, minus that of b or the constant.
        interval: its 95 % interval.
        p: its one-sided p-values.
        seeds: runs of a and of b; 0 for a constant.
        reason: why nothing can be concluded; usually empty.
        smallest: the smallest p-values, above and below zero, that so many runs can give.
        simultaneous: its interval at the level of a whole list of contrasts.
        margin: that of the means; None without one, and of shares.
    """

    effect: float
    interval: Interval
    p: PValues[float]
    seeds: tuple[int, int]
    reason: str = ""
    smallest: tuple[float, float] = (0.0, 0.0)
    simultaneous: Interval = no_interval()
    margin: float | None = None

    @property
    def p_different(self) -> float:
        """The two-sided p-value of a difference: twice the smaller one-sided p-value."""
        return min(1.0, 2 * min(self.p.greater, self.p.less))


def compare(
    kind: str,
    a: ArrayLike,
    b: ArrayLike | float,
    margin: float | None,
    generator: np.random.Generator,
    level: float = intervals.LEVEL,
) -> Contrast:
    """Compare arm a with arm b or with a constant.

    Args:
        kind: mean, or incidence, of values 0 or 1.
        a: (runs,) finite values, one per run.
        b: the values of the other arm, or a number in a's unit, or a share of runs.
        margin: smaller differences count as none; in the outcome's unit, or as a share of runs. None for no
            margin.
        generator: draws relabelings or sign flips if there are too many to enumerate.
        level: of the simultaneous interval.

    Raises:
        ValueError: for values that are not finite, or an incidence with values other than 0 and 1.
    """
    first, value = finite(a), b if isinstance(b, int | float) else None
    second = np.empty(0) if value is not None else finite(b)
    n, m = seeds = first.size, second.size
    effect = float("nan")
    if n and value is not None:
        effect = float((first - value).mean()) if kind == "mean" else float(first.mean() - value)
    elif n and m:
        effect = float(first.mean() - second.mean())
    if too_few := _too_few(kind, n if value is not None else min(seeds)):
        return undecided(too_few, seeds, effect)
    make: Callable[[float], Interval]
    if kind == "mean":
        if value is not None:
            ways = pvalues.sign_flips(n, generator)
            tested = pvalues.one_mean_p_values((first - value)[None], margin, ways)
            make = partial(intervals.mean_interval, first - value)
        else:
            ways = pvalues.relabel(n, m, generator)
            tested = pvalues.mean_p_values(first[None], second[None], margin, ways)
            make = partial(intervals.difference_interval, first, second)
        made = _contrast(effect, make, level, tested, seeds, (1 / len(ways),) * 2)
        return replace(made, margin=margin)
    count, other = _count(first), _count(second)
    if value is not None:
        test = partial(pvalues.one_share_p_values, runs=n, value=value)
        tested, extremes = test(np.array([count]), margin=margin), test(np.array([n, 0]), margin=None)
        make = partial(_share_interval, count, n, value)
    else:
        tested = pvalues.incidence_p_values(np.array([count]), n, np.array([other]), m, margin)
        extremes = pvalues.incidence_p_values(np.array([n, 0]), n, np.array([0, m]), m, None)
        make = partial(intervals.incidence_difference_interval, count, n, other, m)
    return _contrast(
        effect, make, level, tested, seeds, (float(extremes.greater[0]), float(extremes.less[1]))
    )


def _share_interval(count: int, runs: int, value: float, level: float) -> Interval:
    made = intervals.incidence_interval(count, runs, level)
    return replace(made, low=made.low - value, high=made.high - value)


def compare_effects(
    arms: Sequence[ArrayLike], margin: float | None, level: float = intervals.LEVEL
) -> Contrast:
    """Compare the difference of means a - b with c - d, by Student's distribution over four arms.

    The degrees of freedom are Welch's for four arms (Satterthwaite 1946).

    Args:
        arms: (runs,) finite values of a, b, c and d.
        margin: smaller differences of differences count as none; or None.
        level: of the simultaneous interval.
    """
    values = [finite(arm) for arm in arms]
    seeds = min(of_arm.size for of_arm in values[:2]), min(of_arm.size for of_arm in values[2:])
    if too_few := _too_few("mean", min(seeds)):
        return undecided(too_few, seeds)
    means = [of_arm.mean() for of_arm in values]
    effect = float(means[0] - means[1] - means[2] + means[3])
    parts = np.array([of_arm.var(ddof=1) / of_arm.size for of_arm in values])
    error, degrees = float(np.sqrt(parts.sum())), np.array([of_arm.size - 1 for of_arm in values])
    size = max(np.abs(of_arm).max() for of_arm in values)  # so that units do not matter
    if error**2 <= pvalues.LEAST_VARIANCE * size**2:
        return undecided("in no arm do runs differ", seeds, effect)
    freedom = float(parts.sum() ** 2 / (parts**2 / degrees).sum())
    shifted = np.array([effect + shift for shift in pvalues.shifts(margin)])
    tails = pvalues.student_tails(shifted / size, np.full(shifted.shape, error / size), freedom)
    make = partial(intervals.around, effect, error, freedom, method="Welch t, four arms")
    return _contrast(effect, make, level, pvalues.p_values(*tails, 1), seeds, (0.0, 0.0))


def undecided(reason: str, seeds: tuple[int, int] = (0, 0), effect: float = float("nan")) -> Contrast:
    """Return a contrast that says nothing, with the reason."""
    return Contrast(effect, no_interval(), PValues(1.0, 1.0, 1.0, 1.0, 1.0), seeds, reason, (1.0, 1.0))


def _contrast(
    effect: float,
    interval: Callable[[float], Interval],
    level: float,
    tested: ManyPValues,
    seeds: tuple[int, int],
    smallest: tuple[float, float],
) -> Contrast:
    """Return the contrast of one sample, with an interval at the 95 % level and one at the list's."""
    p = PValues(*(float(of_sample[0]) for of_sample in tested))
    return Contrast(effect, interval(intervals.LEVEL), p, seeds, "", smallest, interval(level))


def _too_few(kind: str, seeds: int) -> str:
    """Return the reason that an arm has too few runs; empty if it has enough."""
    if seeds == 0:
        return "an arm has no runs"
    lonely = seeds == 1 and kind == "mean"
    return "an arm has 1 run; it takes 2 to see how runs differ" if lonely else ""


def _count(runs: np.ndarray) -> int:
    if not np.isin(runs, (0, 1)).all():
        raise ValueError("an incidence is of values 0 or 1")
    return int(runs.sum())
