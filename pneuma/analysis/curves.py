"""Curves: the mean over seeds, with a band that says what it is, on a common grid of steps.

A training curve is, for each run and at each point t of the grid, the mean of the episodes that
ended in the last twentieth of the budget before t; blank until every slot has finished one. Only
then are runs averaged, over those that have a value at t. Nothing is extrapolated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from pneuma.analysis.tables import StudyData


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


def training_curves(data: StudyData, quantity: str, window: str | None = None) -> list[Curve]:
    """Return the training curve of a quantity of `StudyData.quantities` of every condition.

    Args:
        data: the study's finished runs.
        quantity: `return`, `length`, `kills`, or what updates have, such as `entropy`.
        window: 'budget-5%', or 'trailing-100' for the mean of the last 100 episodes of a run, which
            is what Stable-Baselines3 logs; the study's usual one when left out.

    Raises:
        UserError: for a quantity or window that the study's data does not have.
    """
    groups = {condition: data.of_condition(condition) for condition in data.conditions}
    return [
        Curve(condition, data.grid, np.stack([data.curve(run, quantity, window) for run in runs]))
        for condition, runs in groups.items()
        if runs
    ]


def evaluation_curves(data: StudyData, column: str = "share_killed") -> list[Curve]:
    """Return the curve of an evaluation column of every condition, at the evaluations' own steps."""
    evaluations = data.table("evaluations")
    curves = []
    for condition in data.conditions:
        runs = [run.run_id for run in data.of_condition(condition)]
        own = evaluations[evaluations["condition"] == condition]
        wide = own.pivot(index="run_id", columns="step", values=column).reindex(runs)
        if runs:
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
