"""Contrasts: one arm of runs against another arm or a constant, as an effect with its interval.

    values of two arms → Contrast, whose interval `verdicts.py` holds against 0 and the margin

An arm in which nothing varies has no interval, because so few runs cannot show how rare other values are.
docs/evidence.md explains the intervals and what they assume.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import permutations

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from pneuma.analysis import intervals
from pneuma.analysis.intervals import Interval, finite, no_interval


@dataclass(frozen=True)
class Contrast:
    """The result of one comparison.

    Attributes:
        effect: the mean of a, its mean distance from the median, its share of runs with an event, or the
            range of its means, minus that of b or the constant.
        interval: its 95 % interval.
        simultaneous: its interval at the level of a whole list of contrasts.
        seeds: runs of a and of b; 0 for a constant.
        means: the two numbers whose difference the effect is.
        reason: why nothing can be concluded; usually empty.
    """

    effect: float = float("nan")
    interval: Interval = no_interval()
    simultaneous: Interval = no_interval()
    seeds: tuple[int, int] = (0, 0)
    means: tuple[float, float] = (float("nan"), float("nan"))
    reason: str = ""


def compare_arms(
    kind: str, arms: Mapping[str, np.ndarray], a: Sequence[str], b: Sequence[str], value: float, level: float
) -> Contrast:
    """Compare arms by their names: a with b, or with a value if there is no b; of ranges all together."""
    if kind == "range":
        first, second = ([[*arms].index(name) for name in names] for names in (a, b))
        return compare_ranges([*arms.values()], first, second or value, level)
    return compare(kind, arms[a[0]], arms[b[0]] if b else value, level)


def compare(kind: str, a: ArrayLike, b: ArrayLike | float, level: float = intervals.LEVEL) -> Contrast:
    """Compare arm a with arm b or with a constant.

    Args:
        kind: mean, spread (of two arms), or incidence, of values 0 or 1.
        a: (runs,) finite values, one per run.
        b: the values of the other arm, or a number in a's unit, or a share of runs.
        level: of the simultaneous interval.

    Raises:
        ValueError: for values that are not finite, or an incidence with values other than 0 and 1.
    """
    first = finite(a)
    second = float(b) if isinstance(b, int | float) else finite(b)
    ends = interval_maker(kind, first, second)
    seeds = first.size, second.size if isinstance(second, np.ndarray) else 0
    if not (first.size and np.size(second)):
        return Contrast(seeds=seeds, reason="an arm has no runs")
    means = _mean_of(kind, first), second if isinstance(second, float) else _mean_of(kind, second)
    return _contrast(means[0] - means[1], ends, level, seeds, means)


def interval_maker(kind: str, a: np.ndarray, b: np.ndarray | float) -> Callable[[float], Interval]:
    """Return what makes the interval of a less b at a level."""
    if isinstance(b, float):
        if kind == "mean":
            return lambda level: intervals.mean_interval(a, level).less(b)
        return lambda level: intervals.incidence_interval(_count(a), a.size, level).less(b)
    if kind == "incidence":
        return partial(intervals.incidence_difference_interval, _count(a), a.size, _count(b), b.size)
    return partial(intervals.spread_interval if kind == "spread" else intervals.difference_interval, a, b)


def _mean_of(kind: str, arm: np.ndarray) -> float:
    return float((intervals.distances(arm) if kind == "spread" else arm).mean())


# --- Ranges ----------------------------------------------------------------------------------------


def compare_ranges(
    arms: Sequence[ArrayLike], a: Sequence[int], b: Sequence[int] | float, level: float = intervals.LEVEL
) -> Contrast:
    """Compare the range of the means of some arms, best less worst, with that of others or with a constant.

    The range of a is above that of b by more than d exactly if some step from one of a's arms to another is
    above every step of b's by more than d. Each pair of steps has Welch's interval, corrected for the number
    of steps that are tried; of all steps of b the widest counts (Berger 1982), and of a the farthest.

    Args:
        arms: (runs,) finite values of each arm.
        a: places of arms in `arms`, two or more.
        b: places of other arms, of which some may be the same; or a number.
        level: of the simultaneous interval.
    """
    values = [finite(arm) for arm in arms]
    constant = isinstance(b, int | float)
    of_b: Sequence[int] = [] if isinstance(b, int | float) else b
    seeds = values[a[0]].size, values[of_b[0]].size if of_b else 0
    if reason := intervals.why_none(*values):
        return Contrast(seeds=seeds, reason=reason)
    means = np.array([arm.mean() for arm in values])
    errors = np.array([arm.var(ddof=1) / arm.size for arm in values])
    weights = _steps(a, len(values))[:, None] - _steps(of_b, len(values))[None]  # (steps of a, of b, arms)
    value = float(b) if isinstance(b, int | float) else 0.0
    effect, squares = weights @ means - value, weights**2 @ errors
    below = weights**4 @ (errors**2 / [arm.size - 1 for arm in values])
    freedom = np.divide(squares**2, below, out=np.ones_like(squares), where=below > 0)
    ends = partial(_range_ends, effect, np.sqrt(squares), freedom)
    ranges = float(np.ptp(means[[*a]])), value if constant else float(np.ptp(means[[*of_b]]))
    return _contrast(float(effect.min(axis=1).max()), ends, level, seeds, ranges)


def _steps(places: Sequence[int], arms: int) -> np.ndarray:
    """Return the weights of every step from one arm to another, (steps, arms); one of nothing for no arms."""
    unit = np.eye(arms)
    every = [unit[i] - unit[j] for i, j in permutations(places, 2)]
    return np.array(every or [np.zeros(arms)])


def _range_ends(effect: np.ndarray, error: np.ndarray, freedom: np.ndarray, level: float) -> Interval:
    half = [error * special.stdtrit(freedom, 1 - (1 - level) / 2 / steps) for steps in effect.shape]
    low, high = (effect - half[0]).min(axis=1).max(), (effect + half[1]).max(axis=0).min()
    return Interval(float(low), float(high), "steps by Welch t")


def _contrast(
    effect: float,
    ends: Callable[[float], Interval],
    level: float,
    seeds: tuple[int, int],
    means: tuple[float, float],
) -> Contrast:
    interval = ends(intervals.LEVEL)
    return Contrast(effect, interval, ends(level), seeds, means, interval.reason)


def _count(runs: np.ndarray) -> int:
    if not np.isin(runs, (0, 1)).all():
        raise ValueError("an incidence is of values 0 or 1")
    return int(runs.sum())
