"""Curves: the mean over seeds, with a band that says what it is, on a common grid of steps.

A training curve is, for each run and at each point t of the grid, the mean of the episodes that
ended in the last twentieth of the budget before t; blank until every slot has finished one. Only
then are runs averaged, over those that have a value at t. Nothing is extrapolated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

GRID_POINTS = 200
WINDOW_SHARE = 0.05
WINDOWS = ("budget-5%", "trailing-100")
TRAILING_EPISODES = 100


@dataclass(frozen=True)
class Curve:
    """One condition's curve.

    Attributes:
        condition: its name.
        step: (points,) agent steps.
        runs: (seeds, points) each run's values, NaN where it has none.
    """

    condition: str
    step: np.ndarray
    runs: np.ndarray

    @property
    def count(self) -> np.ndarray:
        """How many runs have a value at each point, (points,)."""
        return np.isfinite(self.runs).sum(axis=0)

    @property
    def mean(self) -> np.ndarray:
        """Mean over the runs that have a value, NaN where none has, (points,)."""
        total = np.nansum(self.runs, axis=0)
        return np.divide(total, self.count, out=np.full(total.shape, np.nan), where=self.count > 0)

    @property
    def deviation(self) -> np.ndarray:
        """Sample standard deviation over runs, NaN where fewer than two have a value, (points,)."""
        squares = np.nansum((self.runs - self.mean) ** 2, axis=0)
        many = self.count > 1
        variance = np.divide(squares, self.count - 1, out=np.full(squares.shape, np.nan), where=many)
        return np.sqrt(variance)

    def band(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Return lower and upper edge of a band of `BANDS`, NaN where fewer than two runs are."""
        return BANDS[name].edges(self)


@dataclass(frozen=True)
class Band:
    """What a band shows: its words for a legend, and its edges."""

    label: str
    edges: Callable[[Curve], tuple[np.ndarray, np.ndarray]]


def _around(half: Callable[[Curve], np.ndarray]) -> Callable[[Curve], tuple[np.ndarray, np.ndarray]]:
    return lambda curve: (curve.mean - half(curve), curve.mean + half(curve))


def _extremes(curve: Curve) -> tuple[np.ndarray, np.ndarray]:
    low = np.where(np.isfinite(curve.runs), curve.runs, np.inf).min(axis=0)
    high = np.where(np.isfinite(curve.runs), curve.runs, -np.inf).max(axis=0)
    alone = curve.count < 2
    return np.where(alone, np.nan, low), np.where(alone, np.nan, high)


BANDS = {
    "std": Band("± 1 standard deviation", _around(lambda curve: curve.deviation)),
    "se": Band(
        "± 1 standard error",
        _around(lambda curve: curve.deviation / np.sqrt(np.maximum(curve.count, 1))),
    ),
    "minmax": Band("least to greatest", _extremes),
}


def training_curves(
    episodes: pd.DataFrame, record: Mapping[str, Any], column: str, window: str = WINDOWS[0]
) -> list[Curve]:
    """Return a training curve of an episode column (`return`, `length`, `kills`) per condition.

    Args:
        episodes: the table `episodes` of `analysis.tables`.
        record: the selection that it was loaded for.
        column: what to average.
        window: 'budget-5%', or 'trailing-100' for the mean of the last 100 episodes of a run, which
            is what Stable-Baselines3 logs.
    """
    budget = max(run["run"]["steps"] for run in record["runs"])
    grid = np.linspace(0, budget, GRID_POINTS + 1)[1:]
    curves = []
    for condition, part in _by_condition(episodes):
        slots = {run["run_id"]: run["run"]["slots"] for run in record["runs"]}
        runs = [
            _run_curve(run, column, grid, budget, slots[str(name)], window)
            for name, run in part.groupby("run_id", sort=False)
        ]
        curves.append(Curve(condition, grid, np.stack(runs)))
    return curves


def evaluation_curves(evaluations: pd.DataFrame, column: str = "share_killed") -> list[Curve]:
    """Return the curve of an evaluation column per condition, at the evaluations' own steps."""
    curves = []
    for condition, part in _by_condition(evaluations):
        wide = part.pivot(index="seed", columns="step", values=column)
        curves.append(Curve(condition, wide.columns.to_numpy(float), wide.to_numpy(float)))
    return curves


def curves_table(curves: Mapping[str, list[Curve]], band: str) -> pd.DataFrame:
    """Return curves as a tidy table, one row for each point of each condition and quantity."""
    frames = []
    for quantity, group in curves.items():
        for curve in group:
            low, high = curve.band(band)
            frames.append(
                pd.DataFrame(
                    {
                        "condition": curve.condition,
                        "quantity": quantity,
                        "step": curve.step,
                        "mean": curve.mean,
                        "low": low,
                        "high": high,
                        "band": band,
                        "runs": curve.count,
                    }
                )
            )
    return pd.concat(frames, ignore_index=True)


def _by_condition(table: pd.DataFrame) -> list[tuple[str, pd.DataFrame]]:
    return [(str(name), part) for name, part in table.groupby("condition", sort=False)]


def _run_curve(
    episodes: pd.DataFrame, column: str, grid: np.ndarray, budget: int, slots: int, window: str
) -> np.ndarray:
    """Return one run's curve on the grid, (points,)."""
    episodes = episodes.sort_values("step", kind="stable")
    step = episodes["step"].to_numpy()
    total = np.concatenate([[0.0], np.cumsum(episodes[column].to_numpy(float))])
    last = np.searchsorted(step, grid, side="right")  # episodes that ended at or before t
    if window == "trailing-100":
        first = np.maximum(last - TRAILING_EPISODES, 0)
    else:
        first = np.searchsorted(step, grid - WINDOW_SHARE * budget, side="right")
    ends = episodes.groupby("slot")["step"].min()
    from_step = ends.max() if len(ends) == slots else np.inf
    valid = (last > first) & (grid >= from_step)
    return np.divide(total[last] - total[first], last - first, out=np.full(grid.shape, np.nan), where=valid)
