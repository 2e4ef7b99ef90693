"""What outcomes measure of a run: functions of a view of it, or of the values of one of its curves.

    RunView → float; values → float

They are NaN if the run has no such value.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from pneuma.analysis.collapse import diagnose
from pneuma.analysis.frames import RunView
from pneuma.config import is_gymnasium_id
from pneuma.env.fields import ACTION_NAMES
from pneuma.study.rows import STUCK
from pneuma.study.series import EXTREMES, NO_ENTROPY, mean_height

Measure = Callable[[RunView], float]
Take = Callable[[np.ndarray], float]
"""A function from values in the order of their steps, (points,), at least one, to a number."""
NAN = float("nan")
LATE = 5
"""The number of last evaluations from which late outcomes are taken."""
LEAST_NORM = 1e-8
"""Smaller gradient norms count as this, in logarithms."""


def peak(quantity: str) -> Measure:
    """Return a function that measures the extreme update of a quantity; NaN without a value."""

    def measure(seen: RunView) -> float:
        exact = seen.run.exact(quantity, "peak") if seen.until >= seen.run.budget else NAN
        _, values = seen.peaks(quantity)
        return exact if not np.isnan(exact) or not len(values) else float(EXTREMES[quantity].reduce(values))

    return measure


def last_value(values: np.ndarray) -> float:
    return values[-1]


def late_mean(values: np.ndarray) -> float:
    return values[-LATE:].mean()


def late_mean_of_known(values: np.ndarray) -> float:
    """Return the same of the evaluations that have a value; NaN if none has."""
    known = values[-LATE:][np.isfinite(values[-LATE:])]
    return known.mean() if len(known) else NAN


def rise(values: np.ndarray) -> float:
    """Return how much a straight line through the last evaluations rises over them; NaN for one."""
    last = values[-LATE:]
    places = np.arange(len(last)) - (len(last) - 1) / 2
    squares = (places**2).sum()
    return (len(last) - 1) * (places @ last) / squares if squares > 0 else NAN


def roughness(values: np.ndarray) -> float:
    """Return how far a curve goes up and down beyond its net change, per point; 0 if it is monotone."""
    if len(values) < 3:
        return NAN
    travelled = np.abs(np.diff(values)).sum()
    return (travelled - abs(values[-1] - values[0])) / (len(values) - 1)


def log_growth(seen: RunView) -> float:
    """Return how much the norm's logarithm grows, from the mean of the first tenth to that of the last."""
    _, values = seen.curve("grad_norm")
    if not len(values):
        return NAN
    logs = np.log(np.maximum(values, LEAST_NORM))
    tenth = max(len(logs) // 10, 1)
    return float(logs[-tenth:].mean() - logs[:tenth].mean())


def log_max(quantity: str) -> Measure:
    """Return a function that measures the logarithm of the greatest update; NaN without a value."""
    greatest = peak(quantity)
    return lambda seen: float(np.log(np.maximum(greatest(seen), LEAST_NORM)))


def low_entropy_share(seen: RunView) -> float:
    """Return the share of training in which the entropy is below `LEAST_ENTROPY`; NaN if not recorded."""
    held = seen.run.signs.get(NO_ENTROPY)
    fields = seen.run.fields
    counts = fields.get("horizon"), fields.get("slots"), fields.get("players", 1)
    if held is None or not all(isinstance(count, int) for count in counts):
        return NAN
    update, end = math.prod(counts), min(seen.run.end, seen.until)
    steps = sum(min(last, end) - first + update for first, last in held if first <= end)
    return steps / (end - seen.run.begun) if end > seen.run.begun else NAN


def stuck_share(seen: RunView) -> float:
    """Return the share of updates that are stuck; NaN if not known, or up to an earlier step."""
    stuck, updates, _ = (seen.run.cell(name) or 0 for name in STUCK)
    return stuck / updates if updates and seen.until >= seen.run.budget else NAN


def share_of_commonest(seen: RunView) -> float:
    """Return the share of the most frequent action at the end of training."""
    shares = [seen.statistic(f"action_{i}", "last") for i in range(len(ACTION_NAMES))]
    most = is_gymnasium_id(seen.run.fields.get("env"))  # whose columns are the most frequent actions
    others = 0.0 if most else 1 - float(np.sum(shares))  # flame, heal and dash have none: together
    return max(*shares, others)


def share_area(seen: RunView) -> float:
    steps, shares = seen.evaluations("share_killed")
    first = min(np.searchsorted(steps, seen.since), max(len(steps) - 1, 0))  # one that diverged early has one
    return mean_height(steps[first:], shares[first:], seen.until)


def steps_to(seen: RunView, least: float, column: str) -> float:
    steps, values = seen.evaluations(column)
    reached = steps[values >= least]
    return float(reached[0]) if len(reached) else np.inf if len(values) else NAN


def overestimation(seen: RunView) -> float:
    """Return by how much the learner's estimate of its return exceeds the actual return."""
    steps, estimates = seen.evaluations("q_estimate")
    true_steps, true = seen.evaluations("q_true")
    _, of_estimate, of_true = np.intersect1d(steps, true_steps, return_indices=True)
    return float(estimates[of_estimate[-1]] - true[of_true[-1]]) if len(of_true) else NAN


def diagnosed(part: str) -> Measure:
    """Return an attribute of the diagnosis of collapse; NaN if it is None."""

    def measure(seen: RunView) -> float:
        value = getattr(diagnose(seen), part)
        return NAN if value is None else float(value)

    return measure


def wall_seconds(seen: RunView) -> float:
    """Return the seconds of training up to a step, at an even pace; without those of a fork's parent."""
    steps_a_second = pace(seen)
    trained = max(min(seen.run.end, seen.until) - seen.run.begun, 0)
    return trained / steps_a_second if steps_a_second > 0 else NAN


def pace(seen: RunView) -> float:
    seconds = seen.run.wall_seconds
    return (seen.run.end - seen.run.begun) / seconds if seconds else NAN
