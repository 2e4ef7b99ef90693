"""What outcomes measure of a run: functions of its row, or of the values of one of its curves.

    Row → float; values → float

They are NaN if the run has no such value. `outcomes.toml` names them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pneuma.analysis.collapse import diagnose
from pneuma.config import is_gymnasium_id
from pneuma.env.fields import ACTION_NAMES
from pneuma.store.rows import PEAK, STUCK, Row
from pneuma.store.series import NO_ENTROPY, mean_height

Measure = Callable[[Row], float]
Take = Callable[[np.ndarray], float]
"""A function from values in the order of their steps, (points,), at least one, to a number."""
NAN = float("nan")
LATE = 5
"""The number of last evaluations from which late outcomes are taken."""
ONE_ACTION = 0.9
"""A run is in one action if that takes more than this share of an evaluation's steps."""
LEAST_NORM = 1e-8
"""Smaller gradient norms count as this, in logarithms."""

# --- Values of evaluations ------------------------------------------------------------------------


def evaluated(run: Row, column: str, take: Take) -> float:
    """Return what a function takes from a column of the evaluations."""
    _, values = run.known_evaluations(column)
    return float(take(values)) if len(values) else NAN


def last_value(values: np.ndarray) -> float:
    return values[-1]


def best(values: np.ndarray) -> float:
    return values.max()


def fall_from_best(values: np.ndarray) -> float:
    return values.max() - values[-1]


def late_mean(values: np.ndarray) -> float:
    return values[-LATE:].mean()


def late_mean_of_known(values: np.ndarray) -> float:
    """Return the mean of the last evaluations that have a value."""
    late = values[-LATE:]
    finite = late[np.isfinite(late)]
    return finite.mean() if len(finite) else NAN


def late_fall(values: np.ndarray) -> float:
    """Return by how much the mean of the last evaluations is below that of as many best ones."""
    return _best_mean(values) - late_mean(values)


def shuffled_fall(values: np.ndarray) -> float:
    """Return what `late_fall` is on average if the same evaluations come in random order."""
    return _best_mean(values) - values.mean()


def _best_mean(values: np.ndarray) -> float:
    return np.sort(values)[-LATE:].mean()


def late_one_action(values: np.ndarray) -> float:
    """Return in what share of the last evaluations one action takes over `ONE_ACTION` of the steps."""
    return (values[-LATE:] > ONE_ACTION).mean()


def rise(values: np.ndarray) -> float:
    """Return how much a straight line through the last evaluations rises over them; NaN for one."""
    late = values[-LATE:]
    if len(late) < 2:
        return NAN
    offsets = np.arange(len(late)) - (len(late) - 1) / 2
    return (len(late) - 1) * (offsets @ late) / (offsets**2).sum()


def roughness(values: np.ndarray) -> float:
    """Return how far a curve goes up and down beyond its net change, per point; 0 if it is monotone."""
    if len(values) < 3:
        return NAN
    travelled = np.abs(np.diff(values)).sum()
    return (travelled - abs(values[-1] - values[0])) / (len(values) - 1)


# --- Evaluations with their steps -----------------------------------------------------------------


def lasting_one_action(run: Row) -> float:
    """Return the step of the first of `LATE` evaluations in a row in which one action takes nearly all steps.

    Infinite if there are none.
    """
    steps, shares = run.known_evaluations("commonest_action")
    if not len(shares):
        return NAN
    in_one_action = shares > ONE_ACTION
    for start in range(len(shares) - LATE + 1):
        if in_one_action[start : start + LATE].all():
            return float(steps[start])
    return np.inf


def share_area(run: Row) -> float:
    return mean_height(*run.known_evaluations("share_killed"), run.budget)


def steps_to(run: Row, threshold: float, column: str) -> float:
    """Return the step of the first evaluation that reaches a value; infinite if none does."""
    steps, values = run.known_evaluations(column)
    if not len(values):
        return NAN
    reached = steps[values >= threshold]
    return float(reached[0]) if len(reached) else np.inf


def overestimation(run: Row) -> float:
    """Return by how much the learner's estimate of its return exceeds the actual return."""
    steps, estimates = run.known_evaluations("q_estimate")
    true_steps, returns = run.known_evaluations("q_true")
    _, estimate_places, return_places = np.intersect1d(steps, true_steps, return_indices=True)
    if not len(return_places):
        return NAN
    return float(estimates[estimate_places[-1]] - returns[return_places[-1]])


# --- Training -------------------------------------------------------------------------------------


def peak(run: Row, name: str) -> float:
    """Return the extreme update of a quantity."""
    return run.statistic(name, PEAK)


def log_max(run: Row, name: str) -> float:
    """Return the logarithm of the greatest update of a quantity."""
    return float(np.log(np.maximum(peak(run, name), LEAST_NORM)))


def log_growth(run: Row) -> float:
    """Return how much the norm's logarithm grows, from the mean of the first tenth to that of the last."""
    _, values = run.known_curve("grad_norm")
    if not len(values):
        return NAN
    logs = np.log(np.maximum(values, LEAST_NORM))
    tenth = max(len(logs) // 10, 1)
    return float(logs[-tenth:].mean() - logs[:tenth].mean())


def low_entropy_share(run: Row) -> float:
    """Return the share of training in which the entropy is below `LEAST_ENTROPY`; NaN if not recorded."""
    stretches, update = run.signs.get(NO_ENTROPY), run.update_steps
    if stretches is None or update is None or run.end <= run.begun:
        return NAN
    steps = 0.0
    for first, last in stretches:
        if first <= run.end:
            steps += min(last, run.end) - first + update
    return steps / (run.end - run.begun)


def stuck_share(run: Row) -> float:
    """Return the share of updates that are stuck; NaN if not known."""
    stuck, updates, _ = (run.cell(name) or 0 for name in STUCK)
    return stuck / updates if updates else NAN


def share_of_commonest(run: Row) -> float:
    """Return the share of the most frequent action at the end of training."""
    shares = [run.statistic(f"action_{number}", "last") for number in range(len(ACTION_NAMES))]
    if not is_gymnasium_id(run.fields.get("env")):  # elsewhere the columns are the most frequent actions
        shares.append(1 - float(np.sum(shares)))  # flame and heal have no column: together
    return max(shares)


def diagnosed(run: Row, name: str) -> float:
    """Return an attribute of the diagnosis of collapse; NaN if it is None."""
    value = getattr(diagnose(run), name)
    return NAN if value is None else float(value)


def wall_seconds(run: Row) -> float:
    """Return the seconds of training, without those of a fork's parent; NaN if not known."""
    return run.wall_seconds or NAN


def pace(run: Row) -> float:
    """Return the steps trained per second."""
    return (run.end - run.begun) / run.wall_seconds if run.wall_seconds else NAN
