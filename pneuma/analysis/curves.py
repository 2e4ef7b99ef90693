"""Curves: the centre of runs with a named band, on a common grid.

    StudyData → `study_curves` → a `Curve` for each quantity and condition → `Curve.frame`

A training curve has at each point t of the grid the mean of the run's episodes that ended in the last
twentieth of the budget before t. It is blank until every slot has finished an episode. Runs are then averaged
over those that have a value at t. Nothing is extrapolated.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy import special

from pneuma.analysis import intervals
from pneuma.analysis.intervals import LEAST_RUNS, LEVEL
from pneuma.analysis.outcomes import LARGEST, is_foreign
from pneuma.analysis.study_data import StudyData
from pneuma.errors import UserError, unknown_name
from pneuma.schema import plain
from pneuma.store.quantities import ACTION_QUANTITIES, EVALUATION_QUANTITIES, evaluation_column
from pneuma.store.rows import Row
from pneuma.store.series import Series, make_grid
from pneuma.study.shipped import random_returns_file

STEPS, EPISODES, WALL_CLOCK = "steps", "episodes", "wall-clock"
"""What curves may lie over, as `X_AXES` has it."""


@dataclass(frozen=True, eq=False)
class Curve:
    """The curve of one condition.

    Attributes:
        runs: a row for each point, by its place on the horizontal axis, and a column for each run; NaN where
            it has no value.
        diverged: (runs,) whether each run diverged.
        center: one of `CENTERS`.
        log: whether centre and bands are of logarithms, for a logarithmic axis. Values of zero or less then
            count as none.
    """

    condition: str
    runs: pd.DataFrame
    diverged: Sequence[bool] = ()
    center: str = "mean"
    log: bool = False

    def frame(self, band: str = "none") -> pd.DataFrame:
        """Return x, centre, low, high of a band, and the count of runs with a value, of each point.

        They are NaN where there are none, or too few for the band.
        """
        values, band = self.values, checked_band(band)
        count = values.count(axis=1)
        centre = _centre(values, self.center)
        low, high = _edges(values, band, self.center, centre)
        enough = count >= BANDS[band].least_runs
        found = {"centre": centre, "low": low.where(enough), "high": high.where(enough)}
        table = pd.DataFrame(found, self.runs.index, dtype=float)
        table = pd.DataFrame(10.0**table) if self.log else table
        return table.assign(count=count).rename_axis("x").reset_index()

    @cached_property
    def values(self) -> pd.DataFrame:
        """The known values of runs, or their logarithms."""
        known = self.runs.where(self.runs.abs() <= LARGEST)
        return pd.DataFrame(np.log10(known.where(known > 0))) if self.log else known

    @property
    def stops(self) -> list[tuple[float, float]]:
        """Where the curve of each diverged run ends, and its value there, for runs with any value."""
        ended = self.runs.loc[:, [*self.diverged]] if any(self.diverged) else self.runs.iloc[:, :0]
        known = [runs.dropna() for _, runs in ended.items()]
        return [(float(runs.index[-1]), float(runs.iloc[-1])) for runs in known if len(runs)]


def study_curves(
    data: StudyData,
    names: Sequence[str],
    window: str | None = None,
    x: str = STEPS,
    center: str = "mean",
) -> dict[str, list[Curve]]:
    """Return some of `curve_names` for every condition that has runs, by name.

    Curves of evaluations are at the evaluations' own steps. Where runs were evaluated at unlike steps, as
    imported ones may be, they are at those of the run with the fewest, and the others are interpolated. Over
    anything else than steps, all are interpolated on a common grid.

    The window 'trailing-100', the last 100 episodes of a run, is what Stable-Baselines3 logs. `x` is one of
    `X_AXES`: over wall-clock time a run goes on at an even pace, and episodes are counted by their mean
    length up to each point. `center` is one of `CENTERS`.

    Raises:
        UserError: for a quantity that the data lack, or an axis that some run does not tell.
    """
    known = curve_names(data)
    for name in names:
        if name not in known:
            raise unknown_name(f"curve in {data.what} of study {data.study.name}", name, known)
    evaluated = {*EVALUATION_QUANTITIES} & {*known}
    found: dict[str, list[Curve]] = {name: [] for name in names}
    for name, condition in ((name, each) for name in names for each in data.conditions):
        if runs := data.of_condition(condition):
            if name in evaluated:
                series = [_evaluated(run, evaluation_column(name)) for run in runs]
            else:
                series = [(data.grid, data.curve(run, name, window)) for run in runs]
            if x != STEPS:
                pairs = zip(runs, series, strict=True)
                series = [(_along(run, x, step), values) for run, (step, values) in pairs]
            diverged = [run.status == "diverged" for run in runs]
            found[name].append(Curve(condition, _joined(series, even=x != STEPS), diverged, center))
    return found


def _joined(series: Sequence[Series], even: bool = False) -> pd.DataFrame:
    """Return the values of runs at common places: even ones, their own, or those of the run with fewest."""
    longest = max((places for places, _ in series), key=len)
    grid = min((places for places, _ in series if len(places)), key=len, default=longest)
    if even:
        grid = make_grid(max(np.nanmax(places, initial=0.0) for places, _ in series))
    elif all(np.array_equal(places, longest[: len(places)]) for places, _ in series):
        grid = longest
        series = [(grid, np.pad(of, (0, len(grid) - len(of)), constant_values=np.nan)) for _, of in series]
    columns = [of if places is grid else _between(grid, places, of) for places, of in series]
    return pd.DataFrame(np.transpose(columns), index=grid)


def _between(grid: np.ndarray, step: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return values at the steps of a grid, by straight lines; NaN outside the steps that are known."""
    known = np.isfinite(values) & np.isfinite(step)
    if not known.any():
        return np.full(len(grid), np.nan)
    return np.interp(grid, step[known], values[known], left=np.nan, right=np.nan)


def _evaluated(run: Row, column: str) -> Series:
    """Return the steps of a run's evaluations, and a column; of several at one step the last."""
    steps, values = run.evaluations("step"), run.evaluations(column)
    kept = np.append(steps[1:] != steps[:-1], True)[: len(steps)]
    return steps[kept], values[kept] if len(values) else np.full(kept.sum(), np.nan)


def _along(run: Row, x: str, steps: np.ndarray) -> np.ndarray:
    """Return the seconds or episodes that a run had trained at some steps, from its own start."""
    trained, lengths = run.end - run.begun, run.curve("length")
    known = np.isfinite(lengths)
    if (x == WALL_CLOCK and not (run.wall_seconds and trained > 0)) or (x == EPISODES and not known.any()):
        told = "the time" if x == WALL_CLOCK else "the length of episodes"
        raise UserError(f"--x {x}: run {run.run_id} in {run.what} does not tell {told}")
    if x == WALL_CLOCK:
        return (steps - run.begun) * (run.wall_seconds or 0.0) / trained
    length = np.interp(run.grid, run.grid[known], lengths[known])
    ended = np.cumsum(np.diff(run.grid, prepend=0.0) / length)
    return np.interp(steps, [0.0, *run.grid], [0.0, *ended])


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
    if is_foreign(data):
        trained = [name for name in trained if not _shows_nothing(data, name)]
    if not data.evaluated:
        return trained
    table = data.evaluations
    columns = {name: evaluation_column(name) for name in EVALUATION_QUANTITIES}
    evaluated = [name for name, of in columns.items() if of in table and table[of].notna().any()]
    return [*evaluated, *trained]


def curves_table(curves: Mapping[str, list[Curve]], band: str) -> pd.DataFrame:
    """Return curves as a tidy table, one row per point, condition and quantity."""

    def named() -> Iterator[pd.DataFrame]:
        for quantity, group in curves.items():
            for curve in group:
                frame = curve.frame(band).assign(band=checked_band(band))
                yield frame.assign(condition=curve.condition, quantity=quantity)

    table = pd.concat(named(), ignore_index=True)
    table = table.rename(columns={"x": "step", "centre": "mean", "count": "runs"})
    return table[["condition", "quantity", "step", "mean", "low", "high", "band", "runs"]]


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


OF_OBSERVATION = ("observation", "perceive", "order", "scale", "observe_facing")
"""Settings of a world that change nothing for a player who does not look."""


def random_returns(data: StudyData) -> pd.Series | None:
    """Return what a random player earns in training, by step; None if it was not measured in such a world.

    It was measured over a million steps of four environments, as training curves are
    (`studies/random_returns.py`). Where XP is never reset, it depends on both.
    """
    for measured in _measured_returns():
        if all(_is_measured_world(measured, fields) for fields in data.fields.values()):
            curve = pd.Series(measured["mean"], make_grid(measured["steps"]), dtype=float)
            return curve[curve.index <= data.budget].dropna()
    return None


def _is_measured_world(measured: Mapping[str, Any], fields: Mapping[str, Any]) -> bool:
    """Return whether fields are of the world in which a random player was measured."""
    if fields.get("env") != measured["env"]:
        return False
    settings = measured["settings"]
    if settings["xp_scope"] != "episode" and fields.get("slots") != measured["slots"]:
        return False
    decisive = [name for name in settings if name not in OF_OBSERVATION]
    return all(plain(fields.get(name)) == plain(settings[name]) for name in decisive)


@cache
def _measured_returns() -> list[dict[str, Any]]:
    file = random_returns_file()
    return [*json.loads(file.read_text(encoding="utf-8")).values()] if file.is_file() else []


# --- Centres and bands -----------------------------------------------------------------------------

CENTERS = {"mean": intervals.mean, "iqm": intervals.interquartile_mean, "median": intervals.median}
CENTER_WORDS = {"mean": "mean", "iqm": "interquartile mean", "median": "median"}
RESAMPLES = 500
"""Of each point, for the interval of a centre that is no mean."""


class Band(NamedTuple):
    """A band around the centre of runs.

    Attributes:
        label: its words in a legend.
        least_runs: with fewer, there is no band.
        enough_runs: with fewer, the runs are drawn too, because a band that estimates the mean covers it less
            often than 90 % for some of the distributions in docs/claims.md. 0 for bands that show how far
            runs lie apart.
    """

    label: str
    least_runs: int = 2
    enough_runs: float = 0


BANDS = {
    "sd": Band("± 1 SD between runs", least_runs=3),
    "ci": Band("95 % interval of the {center}", LEAST_RUNS, 20),
    "minmax": Band("least to greatest run"),
    "runs": Band("every run"),
    "none": Band("", least_runs=0),
}


def checked_band(name: str) -> str:
    """Return a band's name in `BANDS`: people ask for mean and variance, whose root is drawn."""
    name = "sd" if name == "variance" else name
    if name not in BANDS:
        raise unknown_name("band", name, BANDS)
    return name


def _centre(values: pd.DataFrame, center: str) -> pd.Series:
    if center == "iqm":  # pandas has none
        return values.apply(lambda point: _known(CENTERS[center], point.dropna()), axis=1)
    return values.mean(axis=1) if center == "mean" else values.median(axis=1)


def _known(statistic: Callable[[ArrayLike], np.ndarray], runs: pd.Series) -> float:
    return float(statistic(runs)) if len(runs) else math.nan


def _edges(values: pd.DataFrame, band: str, center: str, centre: pd.Series) -> tuple[pd.Series, pd.Series]:
    if band == "minmax":
        return values.min(axis=1), values.max(axis=1)
    if band == "sd":
        half = values.std(axis=1)
    elif band == "ci" and center == "mean":
        count = values.count(axis=1)
        quantile = special.stdtrit(np.maximum(count - 1, 1), (1 + LEVEL) / 2)
        half = quantile * values.std(axis=1) / np.sqrt(count)
    elif band == "ci":
        return _bootstrap(values, center)
    else:
        half = centre * np.nan
    return centre - half, centre + half


def _bootstrap(values: pd.DataFrame, center: str) -> tuple[pd.Series, pd.Series]:
    """Return the ends of percentile intervals, of points at which all runs have a value."""
    whole, runs = values.dropna(), values.shape[1]
    drawn = np.random.default_rng(0).integers(runs, size=(RESAMPLES, runs))
    found = CENTERS[center](whole.to_numpy()[:, drawn])  # (points, resamples)
    ends = np.quantile(found, [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=1)
    low, high = (pd.Series(end, whole.index).reindex(values.index) for end in ends)
    return low, high
