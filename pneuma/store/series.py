"""Resample a run's records to 200 points, and find where signs of collapse hold.

Every function takes values with their steps. A curve is an array (points,) with NaN where there is no value.
No point uses later values, except where those of an imported log are further apart than the grid's. Nothing
is extrapolated past the run's end. A sign of collapse is stored as the stretches of updates in which it
holds, which is short enough to be published.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from operator import itemgetter
from typing import Any

import numpy as np

from pneuma.files import parse_json
from pneuma.store.quantities import ACTION_QUANTITIES, QUANTITIES

GRID_POINTS = 200
WINDOW_POINTS = 10
"""A twentieth of the grid: the window of a training curve."""
SLACK = 1 / 40
"""Budgets that differ by less than this share are equal: half the distance between evaluations."""
TRAILING_EPISODES = 100
HUGE = 1e6
"""The largest value for which differences of a running total keep all digits that are drawn."""
_FUNCTIONS = {"least": np.fmin, "greatest": np.fmax}
EXTREMES = {name: _FUNCTIONS[row.extreme] for name, row in QUANTITIES.items() if row.extreme}
"""Quantities whose extreme is kept, and the function that finds it."""

Series = tuple[np.ndarray, np.ndarray]
"""Steps and values, (points,) each; steps do not decrease."""


@dataclass(frozen=True)
class Recorded:
    """What a finished run recorded.

    Attributes:
        series: step and value of every episode or update, by quantity; steps do not decrease.
        evaluations: rows of the evaluations.
        first_step: the step by which every slot has finished an episode; infinite if one has not.
        averaged_over: episodes over which a log's returns are averaged; None for runs trained here.
    """

    series: Mapping[str, Series]
    evaluations: Sequence[Mapping[str, Any]]
    first_step: float = math.inf
    averaged_over: int | None = None


def make_grid(budget_steps: int) -> np.ndarray:
    """Return the grid of a budget: `GRID_POINTS` even steps up to it, (points,)."""
    return budget_steps * np.arange(1, GRID_POINTS + 1) / GRID_POINTS


def episode_curve(
    step: np.ndarray, values: np.ndarray, grid: np.ndarray, *, trailing: bool, from_step: float, end: int
) -> np.ndarray:
    """Return, at each t of the grid, the mean of the episodes that ended in the window before t.

    Args:
        step: (episodes,) the steps at which they ended, not decreasing.
        values: (episodes,) the values to average.
        grid: (points,).
        trailing: whether the window is the last 100 episodes (in single precision, as loggers have it)
            instead of the last twentieth of the grid; blank until there are as many.
        from_step: the step at which every slot has finished an episode; the curve is blank before it.
        end: the agent steps that the run trained; the curve is blank after it.
    """
    first_index, end_index = _window(step, grid)
    has_enough = end_index > first_index
    if trailing:  # the mean of fewer episodes would not be a mean of 100
        first_index = np.maximum(end_index - TRAILING_EPISODES, 0)
        has_enough = end_index >= TRAILING_EPISODES
    is_valid = has_enough & (grid >= from_step) & (grid <= end)
    curve = _means(values, first_index, end_index, is_valid)
    return _single(curve) if trailing else curve


def update_curve(step: np.ndarray, values: np.ndarray, grid: np.ndarray, end: int) -> np.ndarray:
    """Return, at each t, the mean of the updates in the last twentieth before t, or the last one's value.

    An update stands for all steps since the one before it, so that a window without updates is no gap. Values
    that are not finite are ignored. All are in single precision, as in published tables.
    """
    step, values = finite_points(step, values)
    first_index, end_index = _window(step, grid)
    # an empty window contains the update before it
    first_index = np.minimum(first_index, np.maximum(end_index - 1, 0))
    return _single(_means(values, first_index, end_index, (end_index > 0) & (grid <= end)))


def peak_curve(step: np.ndarray, values: np.ndarray, grid: np.ndarray, extreme: np.ufunc) -> np.ndarray:
    """Return, at each t, the extreme of the updates since the point before, NaN where there was none.

    Values that are not finite are ignored. Those past the grid's end belong to its last point.
    """
    step, values = finite_points(step, values)
    points = np.minimum(np.searchsorted(grid, step, side="left"), len(grid) - 1)
    curve = np.full(grid.shape, np.nan)
    extreme.at(curve, points, values)
    return without_minus_zero(_single(curve))


def held_curve(step: np.ndarray, values: np.ndarray, grid: np.ndarray, end: int) -> np.ndarray:
    """Return, at each t, the last value at or before t; one that is NaN or infinite is a blank."""
    values_before = np.concatenate([[np.nan], values])
    curve = values_before[np.searchsorted(step, grid, side="right")]
    return np.where(np.isfinite(curve) & (grid <= end), curve, np.nan)


def joined_points(step: np.ndarray, values: np.ndarray, grid: np.ndarray) -> Series:
    """Return the points of a log, with points on the lines between them where the grid is finer.

    Each grid point that no value precedes since the grid point before gets one, except before the first value
    and after the last. A line to a value that is NaN is NaN.
    """
    logged_counts = np.searchsorted(step, grid, side="right")
    is_between = (np.diff(logged_counts, prepend=0) == 0) & (logged_counts > 0) & (logged_counts < len(step))
    all_steps = np.concatenate([step, grid[is_between]])
    all_values = np.concatenate([values, np.interp(grid[is_between], step, values)])
    order = np.argsort(all_steps, kind="stable")
    return all_steps[order], all_values[order]


def finite_points(step: np.ndarray, values: np.ndarray) -> Series:
    """Return the finite values with their steps."""
    is_finite = np.isfinite(values)
    return step[is_finite], values[is_finite]


def without_minus_zero(values: np.ndarray) -> np.ndarray:
    """Return the values with 0 for -0: which of the two an extreme is depends on the processor."""
    return values + 0.0


def _single(curve: np.ndarray) -> np.ndarray:
    return curve.astype(np.float32).astype(float)


def _window(step: np.ndarray, grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the first index of each point's window, and the one after its last: values at or before t."""
    window_start = np.concatenate([np.zeros(WINDOW_POINTS), grid[:-WINDOW_POINTS]])
    first_index = np.searchsorted(step, window_start, side="right")
    end_index = np.searchsorted(step, grid, side="right")
    return first_index, end_index


def _means(
    values: np.ndarray, first_index: np.ndarray, end_index: np.ndarray, is_valid: np.ndarray
) -> np.ndarray:
    """Return the mean of the values of each window, NaN where it is not valid.

    Differences of a running total are used, unless a value is huge or not finite, which would spoil all later
    means.
    """
    if len(values) and not np.abs(values).max() <= HUGE:
        sums = np.array(
            [values[start:stop].sum() for start, stop in zip(first_index, end_index, strict=True)]
        )
    else:
        running_total = np.concatenate([[0.0], np.cumsum(values)])
        sums = running_total[end_index] - running_total[first_index]
    return np.divide(sums, end_index - first_index, out=np.full(sums.shape, np.nan), where=is_valid)


# --- Statistics of a curve ---------------------------------------------------------------------------


def mean_height(step: np.ndarray, values: np.ndarray, until: float) -> float:
    """Return the mean height of a curve, by trapezoids over its steps.

    If a run ended early, its last value extends to `until`. NaN without a value.
    """
    if not len(values):
        return math.nan
    step = np.append(step, max(until, step[-1]))
    values = np.append(values, values[-1])
    span = step[-1] - step[0]
    if span <= 0:
        return float(values[0])
    return float(np.trapezoid(values, step) / span)


STATISTICS: dict[str, Callable[[np.ndarray], Any]] = {
    "last": itemgetter(-1),
    "best": np.max,
    "median": np.median,
    "average": np.mean,
    "early": np.mean,
}


def curve_statistic(statistic: str, step: np.ndarray, values: np.ndarray, until: float) -> float:
    """Return one of `STATISTICS` of a curve up to a step, or its mean `height`, from its points with a value.

    `early` is the mean of the first tenth. NaN without a point.
    """
    if statistic == "height":
        return mean_height(step, values, until)
    if statistic == "early":
        values = values[step <= 0.1 * until]
    values = without_minus_zero(values)
    return float(STATISTICS[statistic](values)) if len(values) else math.nan


# --- Signs of collapse -----------------------------------------------------------------------------

NO_ENTROPY, ONE_ACTION, DEAD_UNITS, FALL = "no entropy", "one action", "dead units", "fall"
LOSS = "return below zero"
SIGNS = (NO_ENTROPY, ONE_ACTION, DEAD_UNITS, FALL, LOSS)
"""What thesis section 6.1 describes; the last two are found in evaluations and returns, not in updates."""

LEAST_ENTROPY = 0.1
"""In nats; five equally likely actions have 1.6. Thesis 6.1: "the agent had 0 entropy". One action then has a
probability of 0.985 or more if the others share the rest equally."""
MOST_OF_ONE = 0.95
"""Share of a rollout's actions. Thesis 6.1: the agent "always picked a single state"."""
MOST_DEAD = 0.5
"""Share of hidden units, actor and critic together, that are dead over a rollout."""

STUCK_SHARE = 0.99
"""An update without entropy is stuck if one action is more than this share of its rollout."""

Stretch = tuple[float, float]
"""Step of the first and of the last update over which a sign holds."""


def update_signs(
    step: np.ndarray, columns: Mapping[str, np.ndarray]
) -> tuple[dict[str, list[Stretch]], tuple[int, int, int]]:
    """Return where the signs hold that can be seen in the columns, and how many updates are stuck.

    Args:
        step: (updates,) increasing.
        columns: (updates,) each: entropy, dead_units, `ACTION_QUANTITIES`. NaN is no sign. A column of NaN
            only, such as the entropy of learners of action values, is ignored.

    Returns:
        The stretches of each sign; and the number of stuck updates, of all updates, and of unbroken spells of
        stuck ones: (0, 0, 0) if entropy or actions were not recorded, or there is a single action.
    """
    recorded = {quantity: values for quantity, values in columns.items() if not np.isnan(values).all()}
    signs: dict[str, list[Stretch]] = {}
    stuck_counts = 0, 0, 0
    # where there is a single action, the entropy is always 0
    has_choice = "entropy" in recorded and np.nanmax(recorded["entropy"]) > 0
    is_low = recorded.get("entropy", np.zeros(0)) < LEAST_ENTROPY
    # the entropy of continuous actions may have any size
    if has_choice and ("action_0" in recorded or "action_0" not in columns):
        signs[NO_ENTROPY] = stretches(step, is_low)
    if recorded.keys() >= set(ACTION_QUANTITIES):
        action_shares = np.array([recorded[quantity] for quantity in ACTION_QUANTITIES])  # (actions, updates)
        # the spells, without columns, count as one action
        most_used = np.maximum(action_shares.max(axis=0), 1 - action_shares.sum(axis=0))
        signs[ONE_ACTION] = stretches(step, most_used >= MOST_OF_ONE)
        if has_choice:
            is_stuck = is_low & (most_used > STUCK_SHARE)
            stuck_counts = int(is_stuck.sum()), len(step), len(stretches(step, is_stuck))
    if "dead_units" in recorded:
        signs[DEAD_UNITS] = stretches(step, recorded["dead_units"] >= MOST_DEAD)
    return signs, stuck_counts


def stretches(step: np.ndarray, holds: np.ndarray) -> list[Stretch]:
    """Return first and last step of every unbroken stretch over which something holds."""
    edges = np.diff(np.concatenate([[False], holds, [False]]).astype(int))
    first_steps = step[np.flatnonzero(edges == 1)].astype(float).tolist()
    last_steps = step[np.flatnonzero(edges == -1) - 1].astype(float).tolist()
    return list(zip(first_steps, last_steps, strict=True))


def pack_signs(signs: Mapping[str, list[Stretch]]) -> str:
    """Return where signs hold as JSON: a unit of steps, and for each sign gaps and lengths in turn."""
    ends = {sign: np.array(periods, int).ravel() for sign, periods in signs.items()}
    unit = math.gcd(*np.hstack([0, *ends.values()]).tolist()) or 1
    packed = {sign: np.diff(sign_ends // unit, prepend=0).tolist() for sign, sign_ends in ends.items()}
    return json.dumps({"unit": unit, "signs": packed}, separators=(",", ":"))


def unpack_signs(packed_text: str, last_step: int) -> dict[str, list[Stretch]]:
    """Return what `pack_signs` was given; ValueError for steps that are not in order, or after the last."""
    packed = parse_json(packed_text)
    signs = {}
    for sign, gaps in packed["signs"].items():
        stretch_ends = [stretch_end * packed["unit"] for stretch_end in accumulate(map(float, gaps))]
        if stretch_ends != sorted(stretch_ends) or not all(0 <= end <= last_step for end in stretch_ends):
            raise ValueError(f"the steps of the sign {sign[:20]} are not in its run")
        signs[sign] = list(zip(stretch_ends[::2], stretch_ends[1::2], strict=True))
    return signs
