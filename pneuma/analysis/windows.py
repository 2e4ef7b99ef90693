"""One run's curve: what its episodes, updates or log entries come to at each point of a grid of steps.

Every function takes a run's values by the step at which they were had, and gives (points,) values,
NaN where there is none. Nothing is taken from after a point, and nothing is extrapolated past the
run's end.
"""

from __future__ import annotations

import numpy as np

GRID_POINTS = 200
WINDOW_POINTS = 10
"""A twentieth of the grid: the window of a training curve."""
TRAILING_EPISODES = 100
HUGE = 1e6
"""Up to which a running total of a run's values still has all their digits that are ever drawn."""
EXTREMES: dict[str, np.ufunc] = {"entropy": np.fmin, "grad_norm": np.fmax}
"""Which extreme is kept of each of `PEAKED_QUANTITIES`."""


def make_grid(budget_steps: int) -> np.ndarray:
    """Return the grid of a budget: `GRID_POINTS` even steps up to it, (points,)."""
    return budget_steps * np.arange(1, GRID_POINTS + 1) / GRID_POINTS


def episode_curve(
    step: np.ndarray,
    values: np.ndarray,
    grid: np.ndarray,
    *,
    trailing: bool,
    from_step: float,
    end: int,
) -> np.ndarray:
    """Return, at each t of the grid, the mean of the episodes that ended in the window before t.

    Args:
        step: (episodes,) where each ended, not decreasing.
        values: (episodes,) what is averaged.
        grid: (points,).
        trailing: whether the window is the last 100 episodes, in single precision as a logger has it,
            and not the last twentieth of the grid.
        from_step: where every slot has finished an episode; the curve is blank before.
        end: agent steps that the run trained; blank after.
    """
    first, last = _window(step, grid)
    if trailing:
        first = np.maximum(last - TRAILING_EPISODES, 0)
    valid = (last > first) & (grid >= from_step) & (grid <= end)
    curve = _quotient(_sums(values, first, last), last - first, valid)
    return curve.astype(np.float32).astype(float) if trailing else curve


def update_curve(step: np.ndarray, values: np.ndarray, grid: np.ndarray, end: int) -> np.ndarray:
    """Return, at each t, the mean of the updates in the last twentieth before t, or the last one's value.

    An update stands for all steps since the one before it, so a window without any is no gap. An
    update whose value is not finite counts as none. Values are in single precision, which is what a
    published table keeps of them.
    """
    step, values = step[np.isfinite(values)], values[np.isfinite(values)]
    first, last = _window(step, grid)
    first = np.minimum(first, np.maximum(last - 1, 0))
    curve = _quotient(_sums(values, first, last), last - first, (last > 0) & (grid <= end))
    return curve.astype(np.float32).astype(float)


def peak_curve(step: np.ndarray, values: np.ndarray, grid: np.ndarray, take: np.ufunc) -> np.ndarray:
    """Return, at each t, the extreme of the updates since the point before, NaN where there was none.

    Args:
        step: (updates,).
        values: (updates,); one that is not finite counts as none.
        grid: (points,); an update past its end belongs to the last point.
        take: `np.fmin` or `np.fmax`.
    """
    curve = np.full(grid.shape, np.nan)
    finite = np.isfinite(values)
    places = np.minimum(np.searchsorted(grid, step[finite], side="left"), len(grid) - 1)
    take.at(curve, places, values[finite])
    return curve.astype(np.float32).astype(float)


def logged_curve(step: np.ndarray, values: np.ndarray, grid: np.ndarray, end: int) -> np.ndarray:
    """Return, at each t, the last value logged at or before t; a logged NaN or infinity is a blank.

    Values are in single precision, in which event files hold them.
    """
    last = np.searchsorted(step, grid, side="right")
    held = np.concatenate([[np.nan], values])[last].astype(np.float32).astype(float)
    return np.where(np.isfinite(held) & (grid <= end), held, np.nan)


def _window(step: np.ndarray, grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where the window of each point begins and ends among a run's values."""
    before = np.concatenate([np.zeros(WINDOW_POINTS), grid[:-WINDOW_POINTS]])
    # what was had at or before t
    return np.searchsorted(step, before, side="right"), np.searchsorted(step, grid, side="right")


def _sums(values: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """Return the sum of the values of each window.

    By differences of a running total; but beside a value that is huge, or not finite, that would lose all the
    others from there on.
    """
    if len(values) and not np.abs(values).max() <= HUGE:
        return np.array([values[a:b].sum() for a, b in zip(first, last, strict=True)])
    total = np.concatenate([[0.0], np.cumsum(values)])
    return np.asarray(total[last] - total[first])


def _quotient(total: np.ndarray, count: np.ndarray, valid: np.ndarray) -> np.ndarray:
    return np.divide(total, count, out=np.full(total.shape, np.nan), where=valid)
