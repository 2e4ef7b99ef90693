"""Curves: the mean over seeds with a named band, on a common grid of steps.

A training curve has at each point t of the grid the mean of the run's episodes that ended in the last
twentieth of the budget before t. It is blank until every slot has finished an episode. Runs are then averaged
over those that have a value at t. Nothing is extrapolated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy import special

from pneuma.analysis.intervals import LEAST_RUNS
from pneuma.analysis.outcomes import without_monsters
from pneuma.analysis.study_data import StudyData
from pneuma.errors import unknown_name
from pneuma.study.quantities import ACTION_QUANTITIES, EVALUATION_QUANTITIES, evaluation_column
from pneuma.study.rows import Row

Edges = tuple[np.ndarray, np.ndarray]
"""Lower and upper edge of a band, (points,) each; NaN where fewer than two runs have a value."""


@dataclass(frozen=True)
class Curve:
    """The curve of one condition.

    Attributes:
        step: (points,) agent steps.
        runs: (seeds, points) the values of each run; NaN if it has none.
        diverged: (seeds,) whether each run diverged.
        log: whether mean and bands are of logarithms, for a logarithmic axis. Values of zero or less then
            count as none.
    """

    condition: str
    step: np.ndarray
    runs: np.ndarray
    diverged: tuple[bool, ...] = ()
    log: bool = False

    @property
    def count(self) -> np.ndarray:
        """The number of runs with a value at each point, (points,)."""
        return np.isfinite(self._values).sum(axis=0)

    @property
    def mean(self) -> np.ndarray:
        """The mean over runs with a value, (points,); NaN where there are none."""
        return self._back(_moments(self._values)[1])

    def band(self, name: str) -> Edges:
        band = BANDS[checked_band(name)]
        low, high = band.edges(self._values) if band.edges else (np.full(self.step.shape, np.nan),) * 2
        enough = self.count >= band.least_runs
        return self._back(np.where(enough, low, np.nan)), self._back(np.where(enough, high, np.nan))

    @property
    def _values(self) -> np.ndarray:
        if not self.log:
            return self.runs
        return np.log10(self.runs, out=np.full(self.runs.shape, np.nan), where=self.runs > 0)

    def _back(self, values: np.ndarray) -> np.ndarray:
        return 10.0**values if self.log else values

    @property
    def stops(self) -> list[tuple[float, float]]:
        """The step and value at which the curve of each diverged run ends, for runs with any value."""
        ends = [np.flatnonzero(np.isfinite(run))[-1:] for run in self.runs]
        return [
            (float(self.step[end[0]]), float(run[end[0]]))
            for run, end, diverged in zip(self.runs, ends, self.diverged, strict=False)
            if diverged and len(end)
        ]


def training_curves(data: StudyData, quantity: str, window: str | None = None) -> list[Curve]:
    """Return each condition's training curve of a quantity, one of `StudyData.quantities`.

    The window 'trailing-100', the last 100 episodes of a run, is what Stable-Baselines3 logs.
    """
    return [
        _curve(runs, data.grid, np.array([data.curve(run, quantity, window) for run in runs]))
        for runs in _groups(data)
    ]


def evaluation_curves(data: StudyData, quantity: str = "share_killed") -> list[Curve]:
    """Return each condition's curve of a quantity of evaluations.

    It is at the steps of the evaluations. Where runs were evaluated at unlike steps, as imported ones may be,
    it is at those of the run with the fewest, and the others are interpolated.
    """
    column, curves = evaluation_column(quantity), []
    for runs in _groups(data):
        series = [_evaluated(run, column) for run in runs]
        longest = max((step for step, _ in series), key=len)
        if all(np.array_equal(step, longest[: len(step)]) for step, _ in series):
            grid = longest
            values = [np.pad(of, (0, len(grid) - len(of)), constant_values=np.nan) for _, of in series]
        else:
            grid = min((step for step, _ in series if len(step)), key=len)
            values = [_between(grid, *each) for each in series]
        curves.append(_curve(runs, grid, np.array(values)))
    return curves


def _between(grid: np.ndarray, step: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return values at the steps of a grid, by straight lines; NaN outside the steps that are known."""
    known = np.isfinite(values)
    if not known.any():
        return np.full(len(grid), np.nan)
    return np.interp(grid, step[known], values[known], left=np.nan, right=np.nan)


def _evaluated(run: Row, column: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the steps of a run's evaluations, and a column; of several at one step the last."""
    steps, values = run.evaluations("step"), run.evaluations(column)
    kept = np.append(steps[1:] != steps[:-1], True)[: len(steps)]
    return steps[kept], values[kept] if len(values) else np.full(kept.sum(), np.nan)


def _shows_nothing(data: StudyData, name: str) -> bool:
    """Return whether no run has a value of a quantity, or ever takes the action whose share it is."""
    least = 0.0 if name in ACTION_QUANTITIES else -math.inf
    return not any((data.curve(run, name) > least).any() for run in data.rows)


def curve_names(data: StudyData) -> list[str]:
    """Return the names of all curves of a study's data.

    Quantities of evaluations without any value are left out. So are, where there are no monsters, those of
    training, and actions that no run takes.
    """
    trained = list(data.quantities)
    if without_monsters(data):
        trained = [name for name in trained if not _shows_nothing(data, name)]
    if not data.evaluated:
        return trained
    table = data.evaluations
    columns = {name: evaluation_column(name) for name in EVALUATION_QUANTITIES}
    evaluated = [name for name, of in columns.items() if of in table and table[of].notna().any()]
    return [*evaluated, *trained]


def study_curves(data: StudyData, names: Sequence[str], window: str | None = None) -> dict[str, list[Curve]]:
    """Return some of `curve_names` for every condition, by name.

    Raises:
        UserError: for a quantity that the data lack.
    """
    known = curve_names(data)
    for name in names:
        if name not in known:
            raise unknown_name(f"curve in {data.what} of study {data.study.name}", name, known)
    evaluated = {*EVALUATION_QUANTITIES} & {*known}
    return {
        name: evaluation_curves(data, name) if name in evaluated else training_curves(data, name, window)
        for name in names
    }


def _groups(data: StudyData) -> list[list[Row]]:
    return [runs for condition in data.conditions if (runs := data.of_condition(condition))]


def _curve(runs: Sequence[Row], step: np.ndarray, values: np.ndarray) -> Curve:
    return Curve(runs[0].condition, step, values, tuple(run.status == "diverged" for run in runs))


def curves_table(curves: Mapping[str, list[Curve]], band: str) -> pd.DataFrame:
    """Return curves as a tidy table, one row per point, condition and quantity."""
    frames, band = [], checked_band(band)
    for quantity, group in curves.items():
        for curve in group:
            low, high = curve.band(band)
            about = {"condition": curve.condition, "quantity": quantity, "step": curve.step}
            columns = {"mean": curve.mean, "low": low, "high": high, "band": band, "runs": curve.count}
            frames.append(pd.DataFrame({**about, **columns}))
    return pd.concat(frames, ignore_index=True)


# --- The random player -------------------------------------------------------------------------------

NEAR = 0.02
"""Levels closer than this are drawn as one line."""


def random_levels(data: StudyData, quantity: str) -> dict[str, float]:
    """Return the level of the random player that the evaluations of each condition recorded.

    Its normalised score is 0 by definition, and its return is not recorded. Near levels are one. Empty if no
    player was recorded.
    """
    if quantity == "score":
        return dict.fromkeys(data.conditions, 0.0)
    column = "random_return" if quantity == "evaluated_return" else "random_share_killed"
    if quantity not in EVALUATION_QUANTITIES or column not in data.evaluations:
        return {}  # an imported log may have evaluations without a random player
    rows = data.evaluations.groupby("condition", sort=False)[column]
    every = {str(name): float(np.ascontiguousarray(shares, float).mean()) for name, shares in rows}
    levels = {name: level for name, level in every.items() if np.isfinite(level)}
    if levels and np.ptp([*levels.values()]) <= NEAR:
        return dict.fromkeys(levels, float(np.mean([*levels.values()])))
    return levels


# --- Bands -----------------------------------------------------------------------------------------


class Band(NamedTuple):
    """A band around the mean over runs.

    Attributes:
        label: its words in a legend.
        edges: takes (runs, points) values, NaN where a run has none; None if the runs themselves are drawn.
        least_runs: with fewer, there is no band.
        enough_runs: with fewer, the runs are drawn too, because a band that estimates the mean covers it less
            often than 90 % for some of the distributions in docs/evidence.md. 0 for bands that show how far
            runs lie apart.
    """

    label: str
    edges: Callable[[np.ndarray], Edges] | None
    least_runs: int = 2
    enough_runs: float = 0


def _moments(runs: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return how many runs have a value, their mean and their sample variance, (points,) each; else NaN."""
    known = np.isfinite(runs)
    count = known.sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.where(known, runs, 0.0).sum(axis=0) / count
        squares = np.where(known, (runs - mean) ** 2, 0.0).sum(axis=0)
        return count, mean, np.where(count > 1, squares / (count - 1), np.nan)


def _deviations(runs: np.ndarray) -> Edges:
    _, mean, variance = _moments(runs)
    return mean - np.sqrt(variance), mean + np.sqrt(variance)


def _t_interval(runs: np.ndarray) -> Edges:
    count, mean, variance = _moments(runs)
    half = special.stdtrit(np.maximum(count - 1, 1), 0.975) * np.sqrt(variance / np.maximum(count, 1))
    return mean - half, mean + half


def _extremes(runs: np.ndarray) -> Edges:
    known = np.isfinite(runs)
    several = np.where(known & (known.sum(axis=0) > 1), runs, np.nan)
    return np.fmin.reduce(several), np.fmax.reduce(several)


BANDS = {
    "sd": Band("± 1 SD between runs", _deviations, least_runs=3),
    "ci": Band("95 % interval of the mean", _t_interval, LEAST_RUNS, 20),
    "minmax": Band("least to greatest run", _extremes),
    "runs": Band("every run", None),
    "none": Band("", None, least_runs=0),
}


def checked_band(name: str) -> str:
    """Return a band's name in `BANDS`: people ask for mean and variance, whose root is drawn."""
    name = "sd" if name == "variance" else name
    if name not in BANDS:
        raise unknown_name("band", name, BANDS)
    return name
