"""Contrasts: arms of runs against other arms or a constant, as an effect with its interval.

    values of named arms → `compare_arms` → Contrast; `verdicts.py` compares its interval with the margin

An arm in which nothing varies has no interval, because so few runs cannot show how rare other values are.
docs/claims.md explains the intervals and what they assume.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import permutations
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from pneuma.analysis import intervals
from pneuma.analysis.intervals import Interval, finite, no_interval

Arms = Mapping[str, np.ndarray]
"""The values of runs, (runs,), by the names of conditions."""
AtLevel = Callable[[float], Interval]
"""Makes the interval of an effect at a level."""


@dataclass(frozen=True)
class Contrast:
    """The result of one comparison.

    Attributes:
        effect: the mean of a, its mean distance from the median, its share of runs with an event, or the
            range of its means, minus that of b or the constant; of an interaction, the difference of two
            such differences; of a hazard, the logarithm of the ratio of two rates.
        interval: its 95 % interval.
        simultaneous: its interval at the level of a whole list of contrasts.
        seeds: runs of the first condition of a and of b; 0 for a constant.
        means: the two numbers that are compared; of a hazard the shares of runs that get there.
        reason: why nothing can be concluded; usually empty.
    """

    effect: float = float("nan")
    interval: Interval = no_interval()
    simultaneous: Interval = no_interval()
    seeds: tuple[int, int] = (0, 0)
    means: tuple[float, float] = (float("nan"), float("nan"))
    reason: str = ""


def compare(kind: str, a: ArrayLike, b: ArrayLike | float, level: float = intervals.LEVEL) -> Contrast:
    """Compare an arm with another one or with a constant.

    Args:
        kind: mean, spread (of two arms), or incidence (of values 0 or 1).
        a: (runs,) finite values, one per run.
        b: the values of the other arm, or a number in the unit of a, or a share of runs.
        level: of the simultaneous interval.

    Raises:
        ValueError: for values that are not finite, or an incidence with values other than 0 and 1.
    """
    if isinstance(b, int | float):
        return compare_arms(kind, {"a": finite(a)}, float(b), level)
    return compare_arms(kind, {"a": finite(a)}, {"b": finite(b)}, level)


def compare_arms(kind: str, a: Arms, b: Arms | float, level: float = intervals.LEVEL) -> Contrast:
    """Compare arms with others, of which some may be the same, or with a constant.

    Args:
        kind: of `KINDS`.
        a: finite values by condition; several if the kind is range, main-effect or interaction. Of a hazard
            each is (2, runs): when a run got there, or was last seen, and whether it got there.
        b: the same, or a constant.
        level: of the simultaneous interval.
    """
    first_sizes = [runs.shape[-1] for runs in a.values()]
    other_sizes = [] if isinstance(b, float) else [runs.shape[-1] for runs in b.values()]
    seeds = first_sizes[0], other_sizes[0] if other_sizes else 0
    if 0 in first_sizes + other_sizes:
        return Contrast(seeds=seeds, reason="an arm has no runs")
    estimate = KINDS[kind](a, b)
    means, interval_at = estimate.means, estimate.interval_at
    interval = interval_at(intervals.LEVEL)
    return Contrast(
        effect=means[0] - means[1] if estimate.effect is None else estimate.effect,
        interval=interval,
        simultaneous=interval_at(level),
        seeds=seeds,
        means=means,
        reason=interval.reason,
    )


# --- Kinds -----------------------------------------------------------------------------------------


class Estimate(NamedTuple):
    """Two numbers that are compared, and the interval of the effect: their difference, if none is given."""

    means: tuple[float, float]
    interval_at: AtLevel
    effect: float | None = None


def _compare_means(a: Arms, b: Arms | float) -> Estimate:
    (first,) = a.values()
    if isinstance(b, float):
        return Estimate((float(first.mean()), b), lambda level: intervals.mean_interval(first, level).less(b))
    return _compare_main_effects(a, b)


def _compare_main_effects(a: Arms, b: Arms | float) -> Estimate:
    """Compare the mean over some arms' means with that over others."""
    assert not isinstance(b, float)
    weights = {**dict.fromkeys(a, 1 / len(a)), **dict.fromkeys(b, -1 / len(b))}
    means = _mean_of_means(a), _mean_of_means(b)
    return Estimate(means, _interval_of_sum({**a, **b}, weights))


def _compare_differences(a: Arms, b: Arms | float) -> Estimate:
    """Compare the difference between the first of a and of b with that between the second ones."""
    assert not isinstance(b, float)
    (first, second), (other, another) = a, b
    arms = {**a, **b}
    weights = {first: 1.0, other: -1.0, second: -1.0, another: 1.0}
    means = {name: float(runs.mean()) for name, runs in arms.items()}
    differences = means[first] - means[other], means[second] - means[another]
    return Estimate(differences, _interval_of_sum(arms, weights))


def _mean_of_means(arms: Arms) -> float:
    return float(np.mean([runs.mean() for runs in arms.values()]))


def _interval_of_sum(arms: Arms, weights: Mapping[str, float]) -> AtLevel:
    """Return Welch and Satterthwaite's interval of a weighted sum of means."""
    reason = intervals.why_none(*arms.values())
    if reason:
        return lambda level: no_interval(reason)
    effect, error, freedom = weighted_sum(arms, weights)
    return lambda level: intervals.around(effect, error, freedom, level, "Welch t")


def _compare_spreads(a: Arms, b: Arms | float) -> Estimate:
    assert not isinstance(b, float)
    (first,), (second,) = a.values(), b.values()
    means = float(intervals.distances(first).mean()), float(intervals.distances(second).mean())
    return Estimate(means, lambda level: intervals.spread_interval(first, second, level))


def _compare_shares(a: Arms, b: Arms | float) -> Estimate:
    (first,) = a.values()
    count, runs = _count(first), first.size
    if isinstance(b, float):
        means = count / runs, b
        return Estimate(means, lambda level: intervals.incidence_interval(count, runs, level).less(b))
    (second,) = b.values()
    other_count, other_runs = _count(second), second.size

    def interval_at(level: float) -> Interval:
        return intervals.incidence_difference_interval(count, runs, other_count, other_runs, level)

    return Estimate((count / runs, other_count / other_runs), interval_at)


def _compare_hazards(a: Arms, b: Arms | float) -> Estimate:
    """Compare the rates at which runs get somewhere, by the log-rank test (Peto and Peto 1972).

    The logarithm of their ratio is the number of runs of a that got there less the number that is expected if
    all runs do at one rate, divided by the variance of that number.
    """
    assert not isinstance(b, float)
    (first,), (second,) = a.values(), b.values()
    shares = float(first[1].mean()), float(second[1].mean())
    observed = expected = variance = 0.0
    for time in np.unique(np.concatenate([first[0][first[1] == 1], second[0][second[1] == 1]])):
        at_risk, others_at_risk = (first[0] >= time).sum(), (second[0] >= time).sum()
        events = ((first[0] == time) & (first[1] == 1)).sum()
        all_events = events + ((second[0] == time) & (second[1] == 1)).sum()
        everyone = at_risk + others_at_risk
        observed += events
        expected += all_events * at_risk / everyone
        if everyone > 1:
            tied = (everyone - all_events) / (everyone - 1)
            variance += all_events * at_risk * others_at_risk / everyone**2 * tied
    if variance == 0:
        return Estimate(shares, lambda level: no_interval("no run gets there"))
    effect = (observed - expected) / variance

    def interval_at(level: float) -> Interval:
        half = special.ndtri((1 + level) / 2) / math.sqrt(variance)
        return Interval(effect - half, effect + half, "log-rank")

    return Estimate(shares, interval_at, effect)


def _count(runs: np.ndarray) -> int:
    if not np.isin(runs, (0, 1)).all():
        raise ValueError("an incidence is of values 0 or 1")
    return int(runs.sum())


def _compare_ranges(a: Arms, b: Arms | float) -> Estimate:
    """Compare the range of the means of some arms, best less worst, with that of others or with a constant.

    The range of a is above that of b by more than d exactly if some step from one of a's arms to another is
    above every step of b's by more than d. Each pair of steps has Welch's interval, corrected for the number
    of steps that are tried; of all steps of b the widest counts (Berger 1982), and of a the farthest.
    """
    arms = {**a, **({} if isinstance(b, float) else b)}
    constant = b if isinstance(b, float) else 0.0
    other_range = b if isinstance(b, float) else _range(b)
    means = _range(a), other_range
    if reason := intervals.why_none(*arms.values()):
        return Estimate(means, lambda level: no_interval(reason))
    steps_of_a = [*permutations(a, 2)]
    steps_of_b = [("", "")] if isinstance(b, float) else [*permutations(b, 2)]
    estimates = [[_step_difference(arms, step, other) for other in steps_of_b] for step in steps_of_a]
    effect, error, freedom = np.moveaxis(np.array(estimates), -1, 0)  # each (steps of a, steps of b)

    def interval_at(level: float) -> Interval:
        tail = (1 - level) / 2
        lower_ends = effect - error * special.stdtrit(freedom, 1 - tail / len(steps_of_a))
        upper_ends = effect + error * special.stdtrit(freedom, 1 - tail / len(steps_of_b))
        low, high = lower_ends.min(axis=1).max(), upper_ends.max(axis=0).min()
        return Interval(float(low), float(high), "steps by Welch t").less(constant)

    return Estimate(means, interval_at)


def _range(arms: Arms) -> float:
    means = [float(runs.mean()) for runs in arms.values()]
    return max(means) - min(means)


def _step_difference(arms: Arms, step: tuple[str, str], other: tuple[str, str]) -> tuple[float, float, float]:
    """Return a step between two arms less another step, which may be empty: see `weighted_sum`."""
    weights = dict.fromkeys(arms, 0.0)
    for (end, start), sign in ((step, 1.0), (other, -1.0)):
        if end:
            weights[end] += sign
            weights[start] -= sign
    return weighted_sum(arms, weights)


def weighted_sum(arms: Arms, weights: Mapping[str, float]) -> tuple[float, float, float]:
    """Return a weighted sum of means, its standard error, and Satterthwaite's degrees of freedom."""
    effect = variance = below = 0.0
    for name, weight in weights.items():
        runs = arms[name]
        part = weight**2 * runs.var(ddof=1) / runs.size
        effect += weight * runs.mean()
        variance += part
        below += part**2 / (runs.size - 1)
    freedom = variance**2 / below if below > 0 else 1.0
    return effect, math.sqrt(variance), freedom


KINDS: Mapping[str, Callable[[Arms, Arms | float], Estimate]] = {
    "mean": _compare_means,
    "spread": _compare_spreads,
    "incidence": _compare_shares,
    "range": _compare_ranges,
    "main-effect": _compare_main_effects,
    "interaction": _compare_differences,
    "hazard": _compare_hazards,
}
"""How each kind of contrast is made: the two numbers that are compared, and the interval at a level."""
