"""What outcomes measure of a run: functions of its row, or of the values of one of its curves.

    Row → float; values → float

They are NaN if the run has no such value. `outcomes.toml` names them.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pneuma.analysis.collapse import diagnose
from pneuma.arithmetic import log
from pneuma.config import is_gymnasium_id
from pneuma.env.fields import ACTION_NAMES
from pneuma.store.rows import PEAK, STUCK, Row
from pneuma.store.series import NO_ENTROPY, mean_height
from pneuma.store.series import ONE_ACTION as ONE_ACTION_SIGN

Measure = Callable[[Row], float]
Take = Callable[[np.ndarray], float]
"""A function from values in the order of their steps, (points,), at least one, to a number."""
NAN = float("nan")
LATE = 5
"""The number of last evaluations from which late outcomes are taken."""
ONE_ACTION = 0.9
"""A run is in one action if that takes more than this share of an evaluation's steps."""
LATE_SHARE = 0.25
"""The last part of the budget from which late outcomes of updates are taken."""
LASTING_SHARE = 0.05
"""A spell of updates in one action lasts from this share of the budget on."""
LEAST_NORM = 1e-8
"""Smaller gradient norms count as this, in logarithms."""

# --- Values of evaluations ------------------------------------------------------------------------


def evaluated(run: Row, column: str, take: Take) -> float:
    """Return what a function takes from a column of the evaluations."""
    _, curve_values = run.evaluation_points(column)
    if not len(curve_values):
        return NAN
    return float(take(curve_values))


def last_value(curve_values: np.ndarray) -> float:
    return curve_values[-1]


def best(curve_values: np.ndarray) -> float:
    return curve_values.max()


def fall_from_best(curve_values: np.ndarray) -> float:
    return curve_values.max() - curve_values[-1]


def late_mean(curve_values: np.ndarray) -> float:
    return curve_values[-LATE:].mean()


def late_mean_of_known(curve_values: np.ndarray) -> float:
    """Return the mean of the last evaluations that have a value."""
    late_values = curve_values[-LATE:]
    finite_values = late_values[np.isfinite(late_values)]
    if not len(finite_values):
        return NAN
    return finite_values.mean()


def late_fall(curve_values: np.ndarray) -> float:
    """Return by how much the mean of the last evaluations is below that of as many best ones."""
    return _best_mean(curve_values) - late_mean(curve_values)


def shuffled_fall(curve_values: np.ndarray) -> float:
    """Return what `late_fall` is on average if the same evaluations come in random order."""
    return _best_mean(curve_values) - curve_values.mean()


def _best_mean(curve_values: np.ndarray) -> float:
    return np.sort(curve_values)[-LATE:].mean()


def late_one_action(curve_values: np.ndarray) -> float:
    """Return in what share of the last evaluations one action takes over `ONE_ACTION` of the steps."""
    return (curve_values[-LATE:] > ONE_ACTION).mean()


def rise(curve_values: np.ndarray) -> float:
    """Return how much a straight line through the last evaluations rises over them; NaN for one."""
    late_values = curve_values[-LATE:]
    if len(late_values) < 2:
        return NAN
    offsets = np.arange(len(late_values)) - (len(late_values) - 1) / 2
    return (len(late_values) - 1) * (offsets * late_values).sum() / (offsets**2).sum()


def roughness(curve_values: np.ndarray) -> float:
    """Return how far a curve goes up and down beyond its net change, per point; 0 if it is monotone."""
    if len(curve_values) < 3:
        return NAN
    travelled = np.abs(np.diff(curve_values)).sum()
    return (travelled - abs(curve_values[-1] - curve_values[0])) / (len(curve_values) - 1)


# --- Evaluations with their steps -----------------------------------------------------------------


def lasting_one_action(run: Row) -> float:
    """Return the step of the first of `LATE` evaluations in a row in which one action takes nearly all steps.

    Infinite if there are none.
    """
    steps, shares = run.evaluation_points("commonest_action")
    if not len(shares):
        return NAN
    in_one_action = shares > ONE_ACTION
    for first_index in range(len(shares) - LATE + 1):
        if in_one_action[first_index : first_index + LATE].all():
            return float(steps[first_index])
    return np.inf


def share_area(run: Row) -> float:
    return mean_height(*run.evaluation_points("share_killed"), run.budget)


def steps_to(run: Row, threshold: float, column: str) -> float:
    """Return the step at which evaluations, joined by lines, first reach a value; infinite if they never do.

    Conditions may be evaluated at other steps, so that the first evaluation that has reached it comes later
    in one than in another by chance of the steps alone. Before the first evaluation there is no line.
    """
    steps, curve_values = run.evaluation_points(column)
    if not len(curve_values):
        return NAN
    reached = np.flatnonzero(curve_values >= threshold)
    if not len(reached):
        return np.inf
    index = reached[0]
    if index == 0:
        return float(steps[0])
    value_before, value_after = curve_values[index - 1 : index + 1]
    part_of_line = (threshold - value_before) / (value_after - value_before)
    return float(steps[index - 1] + part_of_line * (steps[index] - steps[index - 1]))


def overestimation(run: Row) -> float:
    """Return by how much the learner's estimate of its return exceeds the actual return."""
    steps, estimates = run.evaluation_points("q_estimate")
    true_steps, returns = run.evaluation_points("q_true")
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
    return float(log(np.maximum(peak(run, name), LEAST_NORM)))


def log_growth(run: Row) -> float:
    """Return how much the norm's logarithm grows, from the mean of the first tenth to that of the last."""
    _, curve_values = run.curve_points("grad_norm")
    if not len(curve_values):
        return NAN
    log_norms = log(np.maximum(curve_values, LEAST_NORM))
    tenth_length = max(len(log_norms) // 10, 1)
    return float(log_norms[-tenth_length:].mean() - log_norms[:tenth_length].mean())


def low_entropy_share(run: Row) -> float:
    """Return the share of training in which the entropy is below `LEAST_ENTROPY`; NaN if not recorded."""
    stretches, update_steps = run.signs.get(NO_ENTROPY), run.update_steps
    if stretches is None or update_steps is None or run.end <= 0:
        return NAN
    low_entropy_steps = 0.0
    for first_step, last_step in stretches:
        if first_step <= run.end:
            low_entropy_steps += min(last_step, run.end) - first_step + update_steps
    return low_entropy_steps / run.end


def late_one_action_updates(run: Row) -> float:
    """Return the share of updates in one action over the last quarter of the budget, before the run's end."""
    return one_action_updates(run, run.end - LATE_SHARE * run.budget, run.end)


def one_action_updates(run: Row, after_step: float, last_step: float) -> float:
    """Return in what share of updates one action makes up nearly all of the rollout; NaN if not recorded.

    Args:
        run: a finished run.
        after_step: only updates that end after this step …
        last_step: … and at this step or before it count.
    """
    stretches, update_steps = run.signs.get(ONE_ACTION_SIGN), run.update_steps
    if stretches is None or update_steps is None:
        return NAN
    update_ends = update_steps * np.arange(1, run.end // update_steps + 1)
    update_ends = update_ends[(update_ends > after_step) & (update_ends <= last_step)]
    if not len(update_ends):
        return NAN
    in_one_action = np.zeros(len(update_ends), bool)
    for first_step, last_of_stretch in stretches:
        in_one_action |= (update_ends >= first_step) & (update_ends <= last_of_stretch)
    return float(in_one_action.mean())


def lasting_one_action_spell(run: Row) -> float:
    """Return the step of the first unbroken spell of updates in one action of `LASTING_SHARE` of the budget.

    Infinite if there is none; NaN if not recorded.
    """
    spells, update_steps = run.signs.get(ONE_ACTION_SIGN), run.update_steps
    if spells is None or update_steps is None:
        return NAN
    for first_step, last_step in spells:
        if last_step - first_step + update_steps >= LASTING_SHARE * run.budget:
            return first_step
    return np.inf


def stuck_share(run: Row) -> float:
    """Return the share of updates that are stuck; NaN if not known."""
    stuck_updates, updates, _ = (run.cell(column) or 0 for column in STUCK)
    return stuck_updates / (updates or NAN)


def share_of_commonest(run: Row) -> float:
    """Return the share of the most frequent action at the end of training."""
    shares = [run.statistic(f"action_{action}", "last") for action in range(len(ACTION_NAMES))]
    if not is_gymnasium_id(run.fields.get("env")):  # elsewhere the columns are the most frequent actions
        shares.append(1 - float(np.sum(shares)))  # flame and heal have no column: together
    return max(shares)


def diagnosed(run: Row, name: str) -> float:
    """Return an attribute of the diagnosis of collapse; NaN if it is None."""
    attribute_value = getattr(diagnose(run), name)
    if attribute_value is None:
        return NAN
    return float(attribute_value)


def wall_seconds(run: Row) -> float:
    """Return the seconds of training; NaN if not known."""
    return run.wall_seconds or NAN


def pace(run: Row) -> float:
    """Return the steps trained per second."""
    return run.end / wall_seconds(run)
