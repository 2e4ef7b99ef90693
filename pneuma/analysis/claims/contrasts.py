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

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from pneuma.analysis import intervals
from pneuma.analysis.intervals import Interval, finite, no_interval

Arms = Mapping[str, np.ndarray]
"""The values of runs, (runs,), by the names of conditions."""


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

    effect: float = math.nan
    interval: Interval = no_interval()
    simultaneous: Interval = no_interval()
    seeds: tuple[int, int] = (0, 0)
    means: tuple[float, float] = (math.nan, math.nan)
    reason: str = ""


def compare(
    contrast_kind: str, a: ArrayLike, b: ArrayLike | float, level: float = intervals.LEVEL
) -> Contrast:
    """Compare an arm with another one or with a constant.

    Args:
        contrast_kind: mean, spread (of two arms), or incidence (of values 0 or 1).
        a: (runs,) finite values, one per run.
        b: the values of the other arm, or a number in the unit of a, or a share of runs.
        level: of the simultaneous interval.

    Raises:
        ValueError: for values that are not finite, or an incidence with values other than 0 and 1.
    """
    if isinstance(b, int | float):
        return compare_arms(contrast_kind, {"a": finite(a)}, {}, level, constant=b)
    return compare_arms(contrast_kind, {"a": finite(a)}, {"b": finite(b)}, level)


def compare_arms(
    contrast_kind: str, a: Arms, b: Arms, level: float = intervals.LEVEL, constant: float = 0.0
) -> Contrast:
    """Compare arms with others, of which some may be the same, or with a constant.

    Args:
        contrast_kind: of `KINDS`.
        a: finite values by condition; several if the kind is range, main-effect or interaction. Of a hazard
            each is (2, runs): when a run got there, or was last seen, and whether it got there.
        b: the same; none if a is compared with a constant.
        level: of the simultaneous interval.
        constant: in the unit of a.
    """
    sizes_of_a, sizes_of_b = [[runs.shape[-1] for runs in arms.values()] for arms in (a, b)]
    seeds = sizes_of_a[0], (sizes_of_b or [0])[0]
    if 0 in sizes_of_a + sizes_of_b:
        return Contrast(seeds=seeds, reason="an arm has no runs")
    means, interval = KINDS[contrast_kind](a, b, constant, intervals.LEVEL)
    _, simultaneous = KINDS[contrast_kind](a, b, constant, level)
    effect = means[0] - means[1]
    if contrast_kind == "hazard":
        effect = (interval.low + interval.high) / 2
    return Contrast(effect, interval, simultaneous, seeds, means, interval.reason)


# --- Kinds -----------------------------------------------------------------------------------------


Estimate = tuple[tuple[float, float], Interval]
"""The two numbers that are compared, and the interval of the effect at a level."""


def _compare_means(a: Arms, b: Arms, constant: float, level: float) -> Estimate:
    """Compare the mean over some arms' means with that over others, or with a constant."""
    weights = dict.fromkeys(a, 1 / len(a))
    for condition in b:
        weights[condition] = -1 / len(b)
    means = float(np.mean(_means(a))), float(np.mean(_means(b) or [constant]))
    return means, _interval_of_sum({**a, **b}, weights, level).less(constant)


def _compare_differences(a: Arms, b: Arms, constant: float, level: float) -> Estimate:
    """Compare the difference between the first of a and of b with that between the second ones."""
    arms = {**a, **b}
    weights = dict(zip(arms, (1, -1, -1, 1), strict=True))
    first, second, third, fourth = _means(arms)
    return (first - third, second - fourth), _interval_of_sum(arms, weights, level)


def _means(arms: Arms) -> list[float]:
    return [float(runs.mean()) for runs in arms.values()]


def _interval_of_sum(arms: Arms, weights: Mapping[str, float], level: float) -> Interval:
    """Return Welch and Satterthwaite's interval of a weighted sum of means; of one arm it is Student's."""
    reason = intervals.why_none(*arms.values())
    if reason:
        return no_interval(reason)
    return intervals.around(*weighted_sum(arms, weights), level, "Welch t")


def weighted_sum(arms: Arms, weights: Mapping[str, float]) -> tuple[float, float, float]:
    """Return a weighted sum of means, its standard error, and Satterthwaite's degrees of freedom."""
    effect = variance = denominator = 0.0
    for condition, weight in weights.items():
        runs = arms[condition]
        squared_error = weight**2 * runs.var(ddof=1) / runs.size
        effect += weight * runs.mean()
        variance += squared_error
        denominator += squared_error**2 / (runs.size - 1)
    freedom = 1.0
    if denominator > 0:
        freedom = variance**2 / denominator
    return effect, math.sqrt(variance), freedom


def _compare_spreads(a: Arms, b: Arms, constant: float, level: float) -> Estimate:
    (runs_a,), (runs_b,) = a.values(), b.values()
    means = float(intervals.distances(runs_a).mean()), float(intervals.distances(runs_b).mean())
    return means, intervals.spread_interval(runs_a, runs_b, level)


def _compare_shares(a: Arms, b: Arms, constant: float, level: float) -> Estimate:
    (runs_a,) = a.values()
    if not np.isin(runs_a, (0, 1)).all():
        raise ValueError("an incidence is of values 0 or 1")
    count_a, size_a = int(runs_a.sum()), runs_a.size
    if not b:
        interval = intervals.incidence_interval(count_a, size_a, level)
        return (count_a / size_a, constant), interval.less(constant)
    (runs_b,) = b.values()
    count_b, size_b = int(runs_b.sum()), runs_b.size
    interval = intervals.incidence_difference_interval(count_a, size_a, count_b, size_b, level)
    return (count_a / size_a, count_b / size_b), interval


def _compare_hazards(a: Arms, b: Arms, constant: float, level: float) -> Estimate:
    """Compare the rates at which runs get somewhere, by the log-rank test (Peto and Peto 1972).

    The logarithm of their ratio is the number of runs of a that got there less the number that is expected if
    all runs do at one rate, divided by the variance of that number.
    """
    (runs_a,), (runs_b,) = a.values(), b.values()
    shares = float(runs_a[1].mean()), float(runs_b[1].mean())
    times, is_event = np.concatenate([runs_a, runs_b], axis=1)
    is_first = np.arange(times.size) < runs_a.shape[1]
    event_times = np.unique(times[is_event == 1])[:, None]
    # each is (times of events, runs), and its sum over runs (times of events,)
    at_risk, has_event = times >= event_times, (times == event_times) & (is_event == 1)
    runs_at_risk, events = at_risk.sum(axis=1), has_event.sum(axis=1)
    share_of_first = at_risk[:, is_first].sum(axis=1) / runs_at_risk
    surplus = (has_event[:, is_first].sum(axis=1) - events * share_of_first).sum()
    tied = (runs_at_risk - events) / np.maximum(runs_at_risk - 1, 1)
    variance = (events * share_of_first * (1 - share_of_first) * tied).sum()
    if variance == 0:
        return shares, no_interval("no run gets there")
    effect = surplus / variance
    half_width = special.ndtri((1 + level) / 2) / math.sqrt(variance)
    return shares, Interval(effect - half_width, effect + half_width, "log-rank")


def _compare_ranges(a: Arms, b: Arms, constant: float, level: float) -> Estimate:
    """Compare the range of the means of some arms, best less worst, with that of others or with a constant.

    The range of a is above that of b by more than d exactly if some step from one of a's arms to another is
    above every step of b's by more than d. Each pair of steps has Welch's interval, corrected for the number
    of steps that are tried; of all steps of b the widest counts (Berger 1982), and of a the farthest.
    """
    arms = {**a, **b}
    means = np.ptp(_means(a)), np.ptp(_means(b) or [0, constant])
    reason = intervals.why_none(*arms.values())
    if reason:
        return means, no_interval(reason)
    steps_of_a = list(permutations(a, 2))
    steps_of_b: list[tuple[str, ...]] = list(permutations(b, 2)) or [()]
    shape = len(steps_of_a), len(steps_of_b)
    lower_ends, upper_ends = np.empty(shape), np.empty(shape)
    for i, step in enumerate(steps_of_a):
        for j, step_of_b in enumerate(steps_of_b):
            weights = dict.fromkeys(arms, 0.0)
            for step_conditions, sign in ((step, 1.0), (step_of_b, -1.0)):
                # an arm of both may cancel
                for condition, weight in zip(step_conditions, (sign, -sign), strict=False):
                    weights[condition] += weight
            effect, standard_error, freedom = weighted_sum(arms, weights)
            tail = (1 - level) / 2
            lower_ends[i, j] = effect - standard_error * special.stdtrit(freedom, 1 - tail / len(steps_of_a))
            upper_ends[i, j] = effect + standard_error * special.stdtrit(freedom, 1 - tail / len(steps_of_b))
    low, high = lower_ends.min(axis=1).max(), upper_ends.max(axis=0).min()
    interval = Interval(float(low), float(high), "steps by Welch t").less(constant)
    return means, interval


KINDS: Mapping[str, Callable[[Arms, Arms, float, float], Estimate]] = {
    "mean": _compare_means,
    "spread": _compare_spreads,
    "incidence": _compare_shares,
    "range": _compare_ranges,
    "main-effect": _compare_means,
    "interaction": _compare_differences,
    "hazard": _compare_hazards,
}
"""How each kind of contrast is made at a level, of arms a and b, or a and a constant."""
