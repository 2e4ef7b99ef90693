"""Resample a run's records to 200 points, and find where signs of collapse hold.

Every function takes values with their steps. A curve is an array (points,) with NaN where there is no value.
No point uses later values, and nothing is extrapolated past the run's end. A sign of collapse is stored as
the stretches of updates in which it holds, which is short enough to be published.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pneuma.files import parse_json
from pneuma.store.quantities import ACTION_QUANTITIES

GRID_POINTS = 200
WINDOW_POINTS = 10
"""A twentieth of the grid: the window of a training curve."""
SLACK = 1 / 40
"""Budgets that differ by less than this share are equal: half the distance between evaluations."""
TRAILING_EPISODES = 100
HUGE = 1e6
"""Up to which a running total of a run's values still has all their digits that are ever drawn."""
EXTREMES: dict[str, np.ufunc] = {"entropy": np.fmin, "grad_norm": np.fmax, "approx_kl": np.fmax}
"""Quantities of which an extreme is kept, as means would hide it, and which."""

Series = tuple[np.ndarray, np.ndarray]
"""Steps and values, (points,) each; steps do not decrease."""


@dataclass(frozen=True)
class Recorded:
    """What a finished run recorded.

    Attributes:
        series: step and value of every episode or update, by quantity; steps do not decrease.
        evaluations: rows of the evaluations.
        first_step: from which every slot has finished an episode; infinite if one has none.
        averaged_over: episodes over which returns were averaged when they were logged; None if they were not.
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
    first, last = _window(step, grid)
    enough = last > first
    if trailing:  # of fewer episodes it would be called what it is not
        first, enough = np.maximum(last - TRAILING_EPISODES, 0), last >= TRAILING_EPISODES
    curve = _means(values, first, last, enough & (grid >= from_step) & (grid <= end))
    return _single(curve) if trailing else curve


def update_curve(step: np.ndarray, values: np.ndarray, grid: np.ndarray, end: int) -> np.ndarray:
    """Return, at each t, the mean of the updates in the last twentieth before t, or the last one's value.

    An update stands for all steps since the one before it, so that a window without updates is no gap. Values
    that are not finite are ignored. All are in single precision, as in published tables.
    """
    step, values = step[np.isfinite(values)], values[np.isfinite(values)]
    first, last = _window(step, grid)
    first = np.minimum(first, np.maximum(last - 1, 0))
    return _single(_means(values, first, last, (last > 0) & (grid <= end)))


def peak_curve(step: np.ndarray, values: np.ndarray, grid: np.ndarray, take: np.ufunc) -> np.ndarray:
    """Return, at each t, the extreme of the updates since the point before, NaN where there was none.

    Values that are not finite are ignored. Those past the grid's end belong to its last point.
    """
    curve = np.full(grid.shape, np.nan)
    finite = np.isfinite(values)
    places = np.minimum(np.searchsorted(grid, step[finite], side="left"), len(grid) - 1)
    take.at(curve, places, values[finite])
    return _single(curve)


def held_curve(step: np.ndarray, values: np.ndarray, grid: np.ndarray, end: int) -> np.ndarray:
    """Return, at each t, the last value at or before t; one that is NaN or infinite is a blank."""
    curve = np.concatenate([[np.nan], values])[np.searchsorted(step, grid, side="right")]
    return np.where(np.isfinite(curve) & (grid <= end), curve, np.nan)


def finite_points(step: np.ndarray, values: np.ndarray) -> Series:
    """Return the finite values with their steps."""
    finite = np.isfinite(values)
    return step[finite], values[finite]


def _single(curve: np.ndarray) -> np.ndarray:
    return curve.astype(np.float32).astype(float)


def _window(step: np.ndarray, grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    before = np.concatenate([np.zeros(WINDOW_POINTS), grid[:-WINDOW_POINTS]])
    # values at or before t
    return np.searchsorted(step, before, side="right"), np.searchsorted(step, grid, side="right")


def _means(values: np.ndarray, first: np.ndarray, last: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Return the mean of the values of each window, NaN where it is not valid.

    Differences of a running total are used, unless a value is huge or not finite, which would spoil all later
    means.
    """
    if len(values) and not np.abs(values).max() <= HUGE:
        sums = np.array([values[a:b].sum() for a, b in zip(first, last, strict=True)])
    else:
        total = np.concatenate([[0.0], np.cumsum(values)])
        sums = total[last] - total[first]
    return np.divide(sums, last - first, out=np.full(sums.shape, np.nan), where=valid)


# --- Statistics of a curve ---------------------------------------------------------------------------


def mean_height(step: np.ndarray, values: np.ndarray, until: float) -> float:
    """Return the mean height of a curve, by trapezoids over its steps.

    If a run ended early, its last value extends to `until`. NaN without a value.
    """
    if not len(values):
        return math.nan
    step, values = np.append(step, max(until, step[-1])), np.append(values, values[-1])
    span = step[-1] - step[0]
    return float(np.trapezoid(values, step) / span) if span > 0 else float(values[0])


def _early(step: np.ndarray, values: np.ndarray, until: float) -> float:
    early = values[step <= 0.1 * until]
    return float(early.mean()) if len(early) else math.nan


STATISTICS: dict[str, Callable[[np.ndarray, np.ndarray, float], float]] = {
    "last": lambda step, values, until: float(values[-1]),
    "best": lambda step, values, until: float(values.max()),
    "height": mean_height,
    "median": lambda step, values, until: float(np.median(values)),
    "average": lambda step, values, until: float(values.mean()),
    "early": _early,
}
"""Numbers of a curve up to a step, from its points with a value, at least one; `early`: its first tenth."""


# --- Signs of collapse -----------------------------------------------------------------------------

NO_ENTROPY, ONE_ACTION, DEAD_UNITS, FALL = "no entropy", "one action", "dead units", "fall"
LOSS = "return below zero"
SIGNS = (NO_ENTROPY, ONE_ACTION, DEAD_UNITS, FALL, LOSS)
"""What thesis section 6.1 describes; the last two show in evaluations and in returns, not in updates."""

LEAST_ENTROPY = 0.1
"""Nats; of the 1.6 of five equal actions. Thesis 6.1: "the agent had 0 entropy". One action then has a
probability of 0.985 or more where the others share the rest."""
MOST_OF_ONE = 0.95
"""Share of a rollout's actions. Thesis 6.1: the agent "always picked a single state"."""
MOST_DEAD = 0.5
"""Share of hidden units, actor and critic together, that are dead over a rollout."""

Stretch = tuple[float, float]
"""Step of the first and of the last update over which a sign holds."""


def update_signs(step: np.ndarray, columns: Mapping[str, np.ndarray]) -> dict[str, list[Stretch]]:
    """Return where each sign holds that the columns tell of.

    Args:
        step: (updates,) increasing.
        columns: (updates,) each: entropy, dead_units, `ACTION_QUANTITIES`. NaN is no sign. A column of NaN
            only, such as the entropy of learners of action values, is ignored.
    """
    known = {name: values for name, values in columns.items() if not np.isnan(values).all()}
    if "action_0" in {*columns} - {*known} or not _has_choice(columns):
        known.pop("entropy", None)  # of actions that are numbers it may be of any size
    holding: dict[str, np.ndarray] = {}
    if "entropy" in known:
        holding[NO_ENTROPY] = known["entropy"] < LEAST_ENTROPY
    if {*ACTION_QUANTITIES} <= {*known}:
        holding[ONE_ACTION] = _most_used(known) >= MOST_OF_ONE
    if "dead_units" in known:
        holding[DEAD_UNITS] = known["dead_units"] >= MOST_DEAD
    return {sign: stretches(step, holds) for sign, holds in holding.items()}


def _has_choice(columns: Mapping[str, np.ndarray]) -> bool:
    """Return whether a policy ever had any entropy, which it never has where there is a single action."""
    return bool(np.nanmax(columns.get("entropy", 0.0), initial=0.0) > 0)


def _most_used(columns: Mapping[str, np.ndarray]) -> np.ndarray:
    """Return the share of each update's most used action; the spells, without columns, count as one."""
    shares = np.array([columns[name] for name in ACTION_QUANTITIES])  # (actions, updates)
    return np.maximum(shares.max(axis=0), 1 - shares.sum(axis=0))


STUCK_SHARE = 0.99
"""An update without entropy is stuck if one action is more than this share of its rollout."""


def stuck_updates(step: np.ndarray, columns: Mapping[str, np.ndarray]) -> tuple[int, int, int]:
    """Return the number of stuck updates, of all updates, and of unbroken spells of stuck ones.

    (0, 0, 0) if entropy or actions were not recorded, or there is a single action.

    Args:
        step: (updates,) increasing.
        columns: (updates,) each: entropy and `ACTION_QUANTITIES`. NaN is not stuck.
    """
    names = ("entropy", *ACTION_QUANTITIES)
    unknown = any(name not in columns or np.isnan(columns[name]).all() for name in names)
    if unknown or not _has_choice(columns):
        return 0, 0, 0
    holds = (columns["entropy"] < LEAST_ENTROPY) & (_most_used(columns) > STUCK_SHARE)
    return int(holds.sum()), len(step), len(stretches(step, holds))


def stretches(step: np.ndarray, holds: np.ndarray) -> list[Stretch]:
    """Return first and last step of every unbroken stretch over which something holds."""
    edges = np.diff(np.concatenate([[False], holds, [False]]).astype(int))
    firsts, lasts = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return [(float(step[first]), float(step[last])) for first, last in zip(firsts, lasts, strict=True)]


def pack_signs(signs: Mapping[str, list[Stretch]]) -> str:
    """Return where signs hold as JSON: a unit of steps, and for each sign gaps and lengths in turn."""
    ends = {sign: [int(end) for stretch in parts for end in stretch] for sign, parts in signs.items()}
    unit = math.gcd(*(end for sign_ends in ends.values() for end in sign_ends)) or 1
    packed = {sign: np.diff(np.array([0, *sign_ends]) // unit).tolist() for sign, sign_ends in ends.items()}
    return json.dumps({"unit": unit, "signs": packed}, separators=(",", ":"))


def unpack_signs(text: str) -> dict[str, list[Stretch]]:
    """Return what `pack_signs` was given.

    Raises:
        ValueError: for any other text.
    """
    packed = parse_json(text)
    try:
        found: dict[str, list[Stretch]] = {}
        for sign, gaps in packed["signs"].items():
            ends = (np.cumsum(gaps) * packed["unit"]).astype(float).tolist()
            found[sign] = list(zip(ends[::2], ends[1::2], strict=True))
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"signs of collapse that make no sense: {error}") from None
    return found
