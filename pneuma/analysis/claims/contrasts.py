"""Contrasts: groups of runs against other groups or a constant, as an effect with its interval.

    values of runs by condition → `compare` → Contrast; `verdicts.py` compares its interval with the margin

A group in which nothing varies has no interval, because so few runs cannot show how far off other values are,
unless the outcome has a least and a greatest value. docs/claims.md explains the intervals and what they
assume.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from scipy import special

from pneuma.analysis.intervals import (
    LEVEL,
    NO_BOUNDS,
    Bounds,
    Groups,
    Interval,
    distances,
    incidence_difference_interval,
    incidence_interval,
    interval_of_sum,
    no_interval,
    no_interval_reason,
    spread_interval,
    spread_ratio_interval,
    weighted_sum,
)


@dataclass(frozen=True)
class Contrast:
    """The result of one comparison.

    Attributes:
        effect: the mean of a, its share of runs with an event, or the range of its means, minus that of b or
            the constant; of an interaction, the difference of two such differences; of a spread, the
            logarithm of the ratio of mean distances from the median, and of a hazard, of two rates.
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
    contrast_kind: str,
    a: Groups,
    b: Groups,
    level: float = LEVEL,
    constant: float = 0.0,
    bounds: Bounds = NO_BOUNDS,
) -> Contrast:
    """Compare groups with others, of which some may be the same, or with a constant.

    Args:
        contrast_kind: of `KINDS`.
        a: finite values by condition; several if the kind is range, main-effect or interaction. Values of an
            incidence are 0 or 1. Of a hazard each group is (2, runs): when a run got there, or was last seen,
            and whether it got there.
        b: the same; none if a is compared with a constant.
        level: of the simultaneous interval.
        constant: in the unit of a, or a share of runs.
        bounds: the least and the greatest value that a run may have.
    """
    means, interval = KINDS[contrast_kind](a, b, constant, LEVEL, bounds)
    _, simultaneous = KINDS[contrast_kind](a, b, constant, level, bounds)
    effect = means[0] - means[1]
    if contrast_kind in LOGARITHMIC:
        effect = (interval.low + interval.high) / 2
    return Contrast(
        effect=effect,
        interval=interval,
        simultaneous=simultaneous,
        seeds=(_count_runs(a), _count_runs(b)),
        means=means,
        reason=interval.reason,
    )


def _count_runs(groups: Groups) -> int:
    """Return the number of runs of the first group; 0 without groups."""
    return next(iter(groups.values())).shape[-1] if groups else 0


# --- Kinds -----------------------------------------------------------------------------------------


Estimate = tuple[tuple[float, float], Interval]
"""The two numbers that are compared, and the interval of the effect at a level."""


def _compare_means(a: Groups, b: Groups, constant: float, level: float, bounds: Bounds) -> Estimate:
    """Compare the mean over some groups' means with that over others, or with a constant."""
    means = float(np.mean(_means(a))), float(np.mean(_means(b) or [constant]))
    weights = dict.fromkeys(a, 1 / len(a))
    for condition in b:
        weights[condition] = weights.get(condition, 0.0) - 1 / len(b)
    return means, interval_of_sum({**a, **b}, weights, level, bounds).minus(constant)


def _compare_differences(a: Groups, b: Groups, constant: float, level: float, bounds: Bounds) -> Estimate:
    """Compare the difference between the first of a and of b with that between the second ones."""
    (a_first, a_second), (b_first, b_second) = _means(a), _means(b)
    weights = _weights(a, b)
    return (a_first - b_first, a_second - b_second), interval_of_sum({**a, **b}, weights, level, bounds)


def _weights(a: Iterable[str], b: Iterable[str]) -> dict[str, float]:
    """Return the weights of a step from the first of a to the second, minus such a step of b.

    Those of a condition in both add up, and may cancel.
    """
    weights: dict[str, float] = {}
    for step, sign in ((a, 1.0), (b, -1.0)):
        for condition, weight in zip(step, (sign, -sign), strict=False):
            weights[condition] = weights.get(condition, 0.0) + weight
    return weights


def _means(groups: Groups) -> list[float]:
    return [float(runs.mean()) for runs in groups.values()]


def _compare_spreads(a: Groups, b: Groups, constant: float, level: float, bounds: Bounds) -> Estimate:
    (runs_a,), (runs_b,) = a.values(), b.values()
    return _mean_distances(runs_a, runs_b), spread_ratio_interval(runs_a, runs_b, level)


def _compare_differences_of_spreads(
    a: Groups, b: Groups, constant: float, level: float, bounds: Bounds
) -> Estimate:
    """Compare spreads as the rules of the judge did before version 6, by their difference."""
    (runs_a,), (runs_b,) = a.values(), b.values()
    return _mean_distances(runs_a, runs_b), spread_interval(runs_a, runs_b, level)


def _mean_distances(runs_a: np.ndarray, runs_b: np.ndarray) -> tuple[float, float]:
    return float(distances(runs_a).mean()), float(distances(runs_b).mean())


def _compare_shares(a: Groups, b: Groups, constant: float, level: float, bounds: Bounds) -> Estimate:
    (runs_a,) = a.values()
    count_a, size_a = int(runs_a.sum()), runs_a.size
    if not b:
        return (count_a / size_a, constant), incidence_interval(count_a, size_a, level).minus(constant)
    (runs_b,) = b.values()
    count_b, size_b = int(runs_b.sum()), runs_b.size
    interval = incidence_difference_interval(count_a, size_a, count_b, size_b, level)
    return (count_a / size_a, count_b / size_b), interval


def _compare_hazards(a: Groups, b: Groups, constant: float, level: float, bounds: Bounds) -> Estimate:
    """Compare the rates at which runs get somewhere, by the log-rank test (Peto and Peto 1972).

    The logarithm of their ratio is the number of runs of a that got there, minus the number that is expected
    if all runs do at one rate, divided by the variance of that number.
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


def _compare_ranges(a: Groups, b: Groups, constant: float, level: float, bounds: Bounds) -> Estimate:
    """Compare the range of the means of some groups, best minus worst, with that of others or a constant.

    The range of a is above that of b by more than d exactly if some step from one of a's groups to another is
    above every step of b's by more than d. Each pair of steps has Welch's interval, corrected for the number
    of steps that are tried; of all steps of b the widest counts (Berger 1982), and of a the farthest.
    """
    groups = {**a, **b}
    means = np.ptp(_means(a)), np.ptp(_means(b) or [0, constant])
    reason = no_interval_reason(*groups.values())
    if reason:
        return means, no_interval(reason)
    steps_of_a = list(permutations(a, 2))
    steps_of_b: list[tuple[str, ...]] = list(permutations(b, 2)) or [()]
    shape = len(steps_of_a), len(steps_of_b)
    lower_ends, upper_ends = np.empty(shape), np.empty(shape)
    for i, step in enumerate(steps_of_a):
        for j, step_of_b in enumerate(steps_of_b):
            effect, standard_error, freedom = weighted_sum(groups, _weights(step, step_of_b))
            tail = (1 - level) / 2
            lower_ends[i, j] = effect - standard_error * special.stdtrit(freedom, 1 - tail / len(steps_of_a))
            upper_ends[i, j] = effect + standard_error * special.stdtrit(freedom, 1 - tail / len(steps_of_b))
    low, high = lower_ends.min(axis=1).max(), upper_ends.max(axis=0).min()
    return means, Interval(float(low), float(high), "steps by Welch t").minus(constant)


DIFFERENCE_OF_SPREADS = "difference of spreads"
LOGARITHMIC = ("spread", "hazard")
"""Kinds whose effect is the logarithm of a ratio."""
KINDS: Mapping[str, Callable[[Groups, Groups, float, float, Bounds], Estimate]] = {
    "mean": _compare_means,
    "spread": _compare_spreads,
    DIFFERENCE_OF_SPREADS: _compare_differences_of_spreads,
    "incidence": _compare_shares,
    "range": _compare_ranges,
    "main-effect": _compare_means,
    "interaction": _compare_differences,
    "hazard": _compare_hazards,
}
"""How each kind of contrast is made at a level, of groups a and b, or a and a constant, and their bounds."""
