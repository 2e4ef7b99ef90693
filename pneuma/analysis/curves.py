"""Curves: the mean of runs with a named band, on a common grid.

    StudyData → `study_curves` → a `Curve` for each quantity and condition → `Curve.frame`

A training curve has at each point t of the grid the mean of the run's episodes that ended in the last
twentieth of the budget before t. It is blank until every slot has finished an episode. Runs are then averaged
over those that have a value at t. Nothing is extrapolated.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy import special

from pneuma.analysis import X_AXES
from pneuma.analysis.intervals import LEAST_RUNS, LEVEL
from pneuma.analysis.outcomes import LARGEST, is_foreign
from pneuma.analysis.study_data import StudyData
from pneuma.errors import Hint, UserError, unknown_name
from pneuma.schema import normalize
from pneuma.store.quantities import ACTION_QUANTITIES, EVALUATION_QUANTITIES, evaluation_column
from pneuma.store.rows import Row
from pneuma.store.series import make_grid
from pneuma.study.shipped import random_returns_file

STEPS, EPISODES, WALL_CLOCK = X_AXES


@dataclass(frozen=True, eq=False)
class Curve:
    """The curve of one condition.

    Attributes:
        runs: a row for each point, by its place on the horizontal axis, and a column for each run; NaN where
            it has no value.
        diverged: (runs,) whether each run diverged.
        log: whether mean and bands are of logarithms, for a logarithmic axis. Values of zero or less then
            count as none.
    """

    condition: str
    runs: pd.DataFrame
    diverged: Sequence[bool] = ()
    log: bool = False

    def frame(self, band: str = "none") -> pd.DataFrame:
        """Return x, mean, low, high of a band, and the number of runs with a value, of each point.

        They are NaN where there are none, or too few for the band.
        """
        run_values, band = self.values, checked_band(band)
        run_counts = run_values.count(axis=1)
        low, high = _edges(run_values, band)
        has_enough = run_counts >= BANDS[band].least_runs
        curve_table = pd.DataFrame({
            "mean": run_values.mean(axis=1),
            "low": low.where(has_enough),
            "high": high.where(has_enough),
        })  # fmt: skip
        if self.log:
            curve_table = 10.0**curve_table
        return curve_table.assign(runs=run_counts).rename_axis("x").reset_index()

    @property
    def run_count(self) -> int:
        return self.runs.shape[1]

    @cached_property
    def values(self) -> pd.DataFrame:
        """The known values of runs, or their logarithms."""
        known_runs = self.runs.where(self.runs.abs() <= LARGEST)
        if self.log:
            return pd.DataFrame(np.log10(known_runs.where(known_runs > 0)))
        return known_runs

    @property
    def stops(self) -> list[tuple[float, float]]:
        """Where the curve of each diverged run ends, and its value there, for runs with any value."""
        stops: list[tuple[float, float]] = []
        for run_values in self.runs.loc[:, np.array(self.diverged, bool)].T.to_numpy():
            points = np.flatnonzero(~np.isnan(run_values))
            if len(points):
                stops.append((float(self.runs.index[points[-1]]), float(run_values[points[-1]])))
        return stops


def study_curves(
    study_data: StudyData,
    quantities: Sequence[str],
    window: str | None = None,
    x: str = STEPS,
) -> dict[str, list[Curve]]:
    """Return some of `curve_names` for every condition that has runs, by name.

    Curves of evaluations are at the evaluations' own steps. If runs were evaluated at different steps, as
    imported ones may be, the steps are those of the run with the fewest, and the other runs are interpolated.
    Over anything else than steps, all are interpolated on a common grid.

    The window 'trailing-100', the last 100 episodes of a run, is what Stable-Baselines3 logs. `x` is one of
    `X_AXES`: over wall-clock time a run goes on at an even pace, and episodes are counted by their mean
    length up to each point.

    Raises:
        UserError: for a quantity that the data lack, or an axis for which some run lacks the records.
    """
    available = curve_names(study_data)
    curves: dict[str, list[Curve]] = {}
    for quantity in quantities:
        if quantity not in available:
            raise unknown_name(
                f"curve in {study_data.origin} of study {study_data.study.name}", quantity, available
            )
        curves[quantity] = []
        for condition in study_data.conditions:
            runs = study_data.of_condition(condition)
            if runs:
                run_series = [_series(study_data, run, quantity, window, x) for run in runs]
                diverged = [run.status == "diverged" for run in runs]
                curves[quantity].append(
                    Curve(condition, _on_one_grid(run_series, is_even=x != STEPS), diverged)
                )
    return curves


def _series(study_data: StudyData, run: Row, quantity: str, window: str | None, x: str) -> pd.Series:
    """Return the values of one run's curve by their places."""
    if quantity in EVALUATION_QUANTITIES:
        steps, curve_values = run.evaluations("step"), run.evaluations(evaluation_column(quantity))
        if not len(curve_values):
            curve_values = np.full(len(steps), np.nan)
    else:
        steps, curve_values = study_data.grid, study_data.curve(run, quantity, window)
    if x == WALL_CLOCK:
        steps = _seconds(run, steps)
    elif x == EPISODES:
        steps = _episodes(run, steps)
    series = pd.Series(curve_values, steps, dtype=float)
    return series[~series.index.duplicated(keep="last")]  # of several evaluations at one step


def _on_one_grid(run_series: Sequence[pd.Series], is_even: bool) -> pd.DataFrame:
    """Return the values of runs at common places: even ones, their own, or those of the run with fewest."""
    longest_index = max(run_series, key=len).index
    if not is_even and all(series.index.equals(longest_index[: len(series)]) for series in run_series):
        return pd.DataFrame(dict(enumerate(run_series)), index=longest_index)
    grid: Any = min(
        (series.index for series in run_series if len(series)),
        key=len,
        default=longest_index,
    )
    if is_even:
        grid = make_grid(max(series.index.max() for series in run_series if len(series)))
    columns: dict[int, Any] = {}
    for run_number, series in enumerate(run_series):
        known_values = series[np.isfinite(series)]
        columns[run_number] = np.nan
        if len(known_values):
            columns[run_number] = np.interp(grid, known_values.index, known_values, left=np.nan, right=np.nan)
    return pd.DataFrame(columns, index=grid)


def _seconds(run: Row, steps: np.ndarray) -> np.ndarray:
    """Return the seconds that a run had trained at some steps."""
    if not run.wall_seconds or run.end <= 0:
        raise UserError(Hint("x", WALL_CLOCK), f": run {run.run_id} in {run.origin} has no times")
    return steps * run.wall_seconds / run.end


def _episodes(run: Row, steps: np.ndarray) -> np.ndarray:
    """Return the episodes that a run had finished at some steps."""
    known_steps, lengths = run.curve_points("length")
    if not len(lengths):
        raise UserError(Hint("x", EPISODES), f": run {run.run_id} in {run.origin} has no lengths of episodes")
    finished_episodes = np.cumsum(np.diff(run.grid, prepend=0.0) / np.interp(run.grid, known_steps, lengths))
    return np.interp(steps, np.insert(run.grid, 0, 0.0), np.insert(finished_episodes, 0, 0.0))


def curve_names(study_data: StudyData) -> list[str]:
    """Return the names of all curves of a study's data.

    Quantities of evaluations without any value are left out. So are, where there are no monsters, those of
    training, and actions that no run takes.
    """
    quantities: list[str] = []
    if study_data.evaluated:
        evaluations = study_data.evaluations
        for quantity in EVALUATION_QUANTITIES:
            column = evaluation_column(quantity)
            if column in evaluations and evaluations[column].notna().any():
                quantities.append(quantity)
    are_all_shown = not is_foreign(study_data)
    for quantity in study_data.quantities:
        if are_all_shown or _shows_something(study_data, quantity):
            quantities.append(quantity)
    return quantities


def _shows_something(study_data: StudyData, quantity: str) -> bool:
    """Return whether some run has a value of a quantity, or takes the action whose share it is."""
    least_value = 0.0 if quantity in ACTION_QUANTITIES else -np.inf
    return any((study_data.curve(run, quantity) > least_value).any() for run in study_data.rows)


def curves_table(curves: Mapping[str, Sequence[Curve]], bands: Iterable[str]) -> pd.DataFrame:
    """Return curves with their bands as a tidy table, one row per point, band, condition and quantity."""
    curve_frames: list[pd.DataFrame] = []
    for quantity, condition_curves in curves.items():
        for curve in condition_curves:
            for band in map(checked_band, bands):
                frame = curve.frame(band)
                curve_frames.append(frame.assign(band=band, condition=curve.condition, quantity=quantity))
    curve_table = pd.concat(curve_frames, ignore_index=True)
    return curve_table[["condition", "quantity", "x", "mean", "low", "high", "band", "runs"]]


def reach(curves: Iterable[Curve]) -> tuple[float, float]:
    """Return the least and greatest value of any run; 0 if none has a value."""
    low, high = np.inf, -np.inf
    for curve in curves:
        curve_values = curve.runs.to_numpy()
        finite_values = curve_values[np.isfinite(curve_values)]
        low, high = finite_values.min(initial=low), finite_values.max(initial=high)
    return (0.0, 0.0) if low > high else (float(low), float(high))


# --- The random player -------------------------------------------------------------------------------

NEAR = 0.02
"""Levels closer than this are drawn as one line."""


def random_levels(study_data: StudyData, quantity: str) -> dict[str, float]:
    """Return the level of the random player in each condition's world.

    Its share of monsters killed is that of `studies/scripts/random_returns.py`, one number for a world.
    Elsewhere it is what the evaluations of the condition recorded. Its normalised score is 0 by definition.
    Near levels are one. Empty if no player was recorded.
    """
    if quantity == "score":
        return dict.fromkeys(study_data.conditions, 0.0)
    column = "random_share_killed"
    if quantity == "evaluated_return":
        column = "random_return"
    if quantity not in EVALUATION_QUANTITIES or column not in study_data.evaluations:
        return {}  # an imported log may have evaluations without a random player
    levels = study_data.evaluations.groupby("condition", sort=False)[column].mean().dropna()
    kill_shares: dict[str, float] = {}
    for condition in levels.index:
        for world in measured_worlds():
            if column in world and has_settings(study_data.fields[condition], world["kill_settings"]):
                kill_shares[condition] = world[column]
    levels.update(pd.Series(kill_shares))
    if len(levels) and np.ptp(levels) <= NEAR:
        levels[:] = next(iter(kill_shares.values()), levels.mean())
    return {str(name): float(level) for name, level in levels.items()}


def random_returns(study_data: StudyData, last_step: float) -> pd.Series | None:
    """Return what a random player earns in training, by step; None if it was not measured in such a world.

    It was measured over a million steps of four environments, as training curves are
    (`studies/scripts/random_returns.py`). Where XP is never reset, it depends on both. Elsewhere it is the
    same at every step up to the end.
    """
    for world in measured_worlds():
        if all(has_settings(fields, world["settings"]) for fields in study_data.fields.values()):
            mean_returns = pd.Series(world["mean"], make_grid(world["steps"]), dtype=float).dropna()
            if world["settings"]["xp_scope"] == "episode":
                return pd.Series(mean_returns.mean(), [0.0, last_step])
            return mean_returns[mean_returns.index <= last_step]
    return None


def has_settings(fields: Mapping[str, Any], settings: Mapping[str, Any]) -> bool:
    """Return whether fields have all the settings on which a random player's numbers depend."""
    return all(
        normalize(fields.get(field_name)) == normalize(value) for field_name, value in settings.items()
    )


@cache
def measured_worlds() -> list[dict[str, Any]]:
    returns_file = random_returns_file()
    if not returns_file.is_file():
        return []
    return list(json.loads(returns_file.read_text(encoding="utf-8")).values())


# --- Bands -----------------------------------------------------------------------------------------


class Band(NamedTuple):
    """A band around the mean of runs.

    Attributes:
        label: its words in a legend.
        least_runs: with fewer, there is no band.
        enough_runs: with fewer, the runs are drawn too.
    """

    label: str
    least_runs: int = 2
    enough_runs: int = LEAST_RUNS


LEAST_INSIDE = 7
"""With fewer runs, the interval of the mean is wider than ± 1 SD, as Student's t is above their root."""
ENOUGH_FOR_INTERVAL = 20
"""With fewer runs, the interval covers the mean less often than 90 % for some of the distributions in
docs/claims.md."""

BANDS = {
    "sd": Band("± 1 SD between runs", least_runs=3, enough_runs=LEAST_INSIDE),
    "ci": Band("95 % interval of the mean", LEAST_RUNS, ENOUGH_FOR_INTERVAL),
    "minmax": Band("least to greatest run"),
    "runs": Band("every run"),
    "none": Band("", least_runs=0),
}


def checked_band(band: str) -> str:
    """Return a band's name in `BANDS`: people ask for mean and variance, whose root is drawn."""
    if band == "variance":
        band = "sd"
    if band not in BANDS:
        raise unknown_name("band", band, BANDS)
    return band


def _edges(run_values: pd.DataFrame, band: str) -> tuple[pd.Series, pd.Series]:
    """Return the lower and upper edge of a band; NaN for one without edges."""
    if band == "minmax":
        return run_values.min(axis=1), run_values.max(axis=1)
    mean, half_width = run_values.mean(axis=1), run_values.std(axis=1)
    if band == "ci":
        run_counts = run_values.count(axis=1)
        half_width *= special.stdtrit(np.maximum(run_counts - 1, 1), (1 + LEVEL) / 2) / np.sqrt(run_counts)
    elif band != "sd":
        half_width *= np.nan
    return mean - half_width, mean + half_width
