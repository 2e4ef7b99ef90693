"""Curves: the mean of runs with a named band, on a common grid.

    StudyData → `study_curves` → a `Curve` for each quantity and condition → `Curve.frame`
    StudyData of each environment → `find_curves` → an answer, of which a figure is drawn

A training curve has at each point t of the grid the mean of the run's episodes that ended in the last
twentieth of the budget before t. It is blank until every slot has finished an episode. Runs are then averaged
over those that have a value at t. Nothing is extrapolated.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy import special

from pneuma.analysis import BAND_NAMES, X_AXES
from pneuma.analysis.answer import Answer
from pneuma.analysis.drawing import drawing_of, run_table
from pneuma.analysis.environments import in_environment_of
from pneuma.analysis.intervals import LEAST_RUNS, LEVEL
from pneuma.analysis.notes import (
    BUDGET_AVERAGE,
    TRAILING_WINDOW,
    averaging,
    merge_notes,
    notes_on_runs,
    notes_on_windows,
    notes_on_zero_xp,
)
from pneuma.analysis.outcomes import LARGEST, have_one_return, is_foreign
from pneuma.analysis.study_data import StudyData
from pneuma.errors import Hint, UserError, counted, unknown_name
from pneuma.schema import normalize
from pneuma.store.quantities import (
    ACTION_QUANTITIES,
    EPISODE_QUANTITIES,
    EVALUATION_QUANTITIES,
    POWERS,
    QUANTITIES,
    SHARES,
    UPDATE_QUANTITIES,
    VALUES,
    evaluation_column,
)
from pneuma.store.rows import Row
from pneuma.store.series import GRID_POINTS, make_grid
from pneuma.study.shipped import random_returns_file
from pneuma.values import per_cent

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


# --- The answer -------------------------------------------------------------------------------------

DEFAULT_QUANTITIES, EVALUATED = ("return", "share_killed", "success"), "evaluated_return"
DEFAULT_BAND, INTERVAL = BAND_NAMES[0], "ci"
MOST_LEVELS = 4
"""Most different levels of random players that a note names."""
LEAST_EVALUATIONS = 3
"""With fewer, a curve of evaluations is a dot or two."""
LEAST_POINTS = GRID_POINTS // 2
"""With a mean of all runs at fewer points, a curve of training is stubs."""
MOST_IN_A_NAME = 3
"""With more quantities, the name of a figure's files has their number."""
RETURN_BOUNDS = {"CartPole-v1": (0.0, 500.0), "Acrobot-v1": (-500.0, 0.0), "MountainCar-v0": (-200.0, 0.0)}
X_NOTES = {
    EPISODES: "Episodes are counted by their mean length up to each point.",
    WALL_CLOCK: "Within a run, all steps are taken to last equally long.",
}


@dataclass(frozen=True)
class CurveOptions:
    """Which curves are computed.

    Attributes:
        band: one of `BANDS`; None for the deviation, and inside it, from `LEAST_INSIDE` runs on, the interval
            of the mean.
        window: of the study's windows; None for the first.
        x: one of `X_AXES`.
        log: whether all curves are of logarithms, and not only those of quantities that go through powers of
            ten.
    """

    band: str | None = None
    window: str | None = None
    x: str = STEPS
    log: bool = False

    @property
    def bands(self) -> list[str]:
        """What tables have around means: the deviation comes with their interval."""
        band = checked_band(self.band or DEFAULT_BAND)
        return [band, INTERVAL] if band == DEFAULT_BAND else [band]


Curves = Mapping[str, Sequence[Curve]]
"""By quantity."""


def drawn_bands(bands: Sequence[str], run_count: int) -> list[str]:
    """Return what is drawn around the mean of so many runs: an interval only inside the deviation."""
    if bands[0] == DEFAULT_BAND and run_count < LEAST_INSIDE:
        return [DEFAULT_BAND]
    return list(bands)


def find_curves(
    studies: Mapping[str, StudyData],
    quantities: Sequence[str] = (),
    beside: StudyData | None = None,
    **options: Any,
) -> Answer:
    """Return the curves of the finished runs of a study.

    Args:
        studies: its runs in each environment, by title; "" for a single one.
        quantities: of `curve_names`; default: the return, in other environments than Pneuma's that of
            evaluations, and the share killed, as far as recorded. If returns are of different rewards, the
            length of episodes replaces them.
        beside: another study, whose runs are drawn in the columns of their environment: those of the selected
            conditions, if it has some of these.
        options: those of `CurveOptions`.

    Returns:
        The table `curves` has a row for each point, band, condition and quantity; `reference` has the random
        player. For a figure there are also `panels`, the curves `beside`, the single `lines` of runs, where
        they are few, and `stops`, where runs diverged.

    Raises:
        UserError: for a quantity that no study has, or another study with runs in other environments only.
    """
    curve_options = CurveOptions(**options)
    first_data = next(iter(studies.values()))
    default_names = default_quantities(first_data, beside)
    quantity_names = list(dict.fromkeys(quantities)) or default_names
    names_by_title = {title: curve_names(study_data) for title, study_data in studies.items()}
    missing_names = sorted(set(quantity_names).difference(*names_by_title.values()))
    study_curves(first_data, missing_names)  # refuses what no study has
    columns = {
        title: study_data
        for title, study_data in studies.items()
        if set(quantity_names).intersection(names_by_title[title])
    }
    tables: dict[str, list[pd.DataFrame]] = {name: [] for name in (*DRAWN_TABLES, "curves", "reference")}
    notes_by_title: dict[str, list[str]] = {}
    for title, study_data in columns.items():
        shared_names = [quantity for quantity in quantity_names if quantity in names_by_title[title]]
        curves = _curves(study_data, shared_names, curve_options)
        beside_curves: Curves = {}
        beside_data = beside and _beside_data(study_data, beside)
        if beside_data:
            beside_curves = _beside_curves(beside_data, shared_names, curve_options)
            beside_table = curves_table(beside_curves, curve_options.bands)
            labels = beside_table["condition"].map(beside_data.labelled)
            beside_title = _beside_title(study_data, beside_data)
            tables["beside"].append(beside_table.assign(environment=title, label=labels, title=beside_title))
            tables["beside_runs"].append(run_table({title: beside_data}))
        # Logs do not contain their environment, and may be of another panel's.
        has_own_limits = bool(len(columns) > 1 and beside_data and beside_data.averaged_over)
        panels = _panels(study_data, curves, beside_curves, curve_options, has_own_limits)
        tables["panels"].append(panels.assign(environment=title))
        for is_beside, drawn_curves in ((False, curves), (True, beside_curves)):
            for lines in _single_lines(drawn_curves, curve_options.bands[0]):
                tables["lines"].append(lines.assign(environment=title, beside=is_beside))
        tables["stops"].append(_stops(curves).assign(environment=title))
        reference = _reference(study_data, curves, beside_curves, curve_options)
        environment_column = {"environment": title} if title else {}
        tables["curves"].append(curves_table(curves, curve_options.bands).assign(**environment_column))
        tables["reference"].append(reference.assign(**environment_column))
        notes_by_title[title] = _notes(study_data, curves, reference, beside_data, curve_options)
        is_return_in_training = not quantities and "return" in curves
        if is_return_in_training and is_foreign(study_data) and _has_few_evaluations(study_data):
            few_text = f"With fewer than {LEAST_EVALUATIONS} evaluations, the return is that in training."
            notes_by_title[title].insert(0, few_text)
    if beside and not tables["beside"]:
        environments = f"{' and '.join(beside.environments)}, not in {' and '.join(first_data.environments)}"
        raise UserError(Hint("beside", beside.study.name), f": its runs are in {environments}")
    drawn_tables: dict[str, Any] = {}
    for name in DRAWN_TABLES:
        drawn_tables[name] = NO_ROWS
        if tables[name]:
            drawn_tables[name] = pd.concat(tables[name], ignore_index=True)
    suffixes = _differences(curve_options, quantity_names, default_names, beside)
    run_counts = first_data.runs["condition"].value_counts(sort=False).rename_axis("condition")
    return Answer(
        title=first_data.full_title,
        about={
            **first_data.about,
            "quantities": quantity_names,
            "x": curve_options.x,
            "bands": curve_options.bands,
        },
        tables={"curves": pd.concat(tables["curves"]), "reference": pd.concat(tables["reference"])},
        cells=[run_counts.reset_index(name="runs")],
        notes=merge_notes(columns, notes_by_title),
        drawing=drawing_of(columns, *suffixes, **drawn_tables),
    )


def _differences(
    options: CurveOptions, quantities: Sequence[str], default_names: Sequence[str], beside: StudyData | None
) -> list[str]:
    """Return how a figure differs from the study's default one, for the name of its files."""
    suffixes: list[str] = []
    if quantities != default_names:
        suffixes += quantities if len(quantities) < MOST_IN_A_NAME else [f"{len(quantities)}-quantities"]
    if options.bands[0] != DEFAULT_BAND:
        suffixes.append(options.bands[0])
    if options.log:
        suffixes.append("log")
    if options.x != STEPS:
        suffixes.append(f"over-{options.x}")
    if options.window == TRAILING_WINDOW:
        suffixes.append(options.window)
    if beside:
        suffixes += ["beside", beside.study.name]
    return suffixes


def default_quantities(study_data: StudyData, beside: StudyData | None = None) -> list[str]:
    """Return the quantities of a study's default figure, which may have another study in it.

    The return is that of evaluations, where both have it at three steps or more, in environments that are not
    Pneuma's, and where episodes are so long for the budget that a training curve has gaps. Evaluations that
    begin with 0 XP, although XP is never reset, are of another game than training.
    """
    recorded = curve_names(study_data)
    first_quantity, *alternatives = DEFAULT_QUANTITIES
    has_evaluations = (
        EVALUATED in recorded
        and (beside is None or EVALUATED in curve_names(beside))
        and not (first_quantity in recorded and _has_few_evaluations(study_data))
        and not notes_on_zero_xp(study_data)
    )
    if not have_one_return(study_data):
        first_quantity = "length"
    elif has_evaluations and (
        is_foreign(study_data) or (first_quantity in recorded and _has_stubs(study_data, first_quantity))
    ):
        first_quantity = EVALUATED
    return (
        [quantity for quantity in (first_quantity, *alternatives) if quantity in recorded]
        or recorded[:1]
        or ["return"]
    )


def _has_few_evaluations(study_data: StudyData) -> bool:
    return max(len(run.evaluations("step")) for run in study_data.rows) < LEAST_EVALUATIONS


def _has_stubs(study_data: StudyData, quantity: str) -> bool:
    """Return whether in some condition all runs together have values at too few points for a line."""
    for curve in study_curves(study_data, [quantity])[quantity]:
        complete_points = curve.runs.loc[:, np.logical_not(curve.diverged)].notna().all(axis=1)
        if complete_points.sum() < LEAST_POINTS:
            return True
    return False


def _curves(study_data: StudyData, quantity_names: Sequence[str], options: CurveOptions) -> Curves:
    """Return a study's curves; on a logarithmic axis, means and bands are of logarithms."""
    curves = study_curves(study_data, quantity_names, options.window, options.x)
    for quantity, quantity_curves in curves.items():
        if (options.log or QUANTITIES[quantity].kind == POWERS) and reach(quantity_curves)[1] > 0:
            curves[quantity] = [replace(curve, log=True) for curve in quantity_curves]
    return curves


def _beside_data(study_data: StudyData, beside: StudyData) -> StudyData | None:
    """Return another study's runs in a study's environment, of the selected conditions if it has some."""
    beside_data = in_environment_of(study_data, beside)
    if not beside_data or not study_data.query.conditions:
        return beside_data
    same_names = [
        condition
        for condition in beside_data.conditions
        if condition in study_data.fields and beside_data.of_condition(condition)
    ]
    return beside_data.of_conditions(same_names or beside_data.conditions)


def _beside_curves(beside_data: StudyData, quantity_names: Sequence[str], options: CurveOptions) -> Curves:
    beside_names = curve_names(beside_data)
    shared_names = [quantity for quantity in quantity_names if quantity in beside_names]
    if not shared_names:
        raise UserError(f"study {beside_data.study.name} has no {' or '.join(quantity_names)} to draw")
    window = options.window if options.window in beside_data.windows else None
    return study_curves(beside_data, shared_names, window, options.x)


def _reference(
    study_data: StudyData, curves: Curves, beside_curves: Curves, options: CurveOptions
) -> pd.DataFrame:
    """Return the random player's levels in evaluations, and its return in training by step."""
    reference_rows: list[tuple[str, str, Any, float]] = []
    for quantity in curves:
        for condition, level in random_levels(study_data, quantity).items():
            reference_rows.append((quantity, condition, np.nan, level))
    if "return" in curves and options.x == STEPS:
        shown_curves = list(curves["return"]) + list(beside_curves.get("return", []))
        last_steps = [float(curve.runs.index.max()) for curve in shown_curves]
        returns = random_returns(study_data, max(study_data.budget, *last_steps))
        if returns is not None:
            reference_rows += [("return", "", step, mean_return) for step, mean_return in returns.items()]
    return pd.DataFrame(reference_rows, columns=["quantity", "condition", "x", "value"])


# --- What a figure needs -----------------------------------------------------------------------------

DRAWN_TABLES = ("panels", "stops", "lines", "beside", "beside_runs")
NO_ROWS = pd.DataFrame(
    columns=["environment", "study", "quantity", "condition", "beside", "run", "x", "value"], dtype=object
)
"""A table of lines, or of another study, where none are drawn."""


def _panels(
    study_data: StudyData, curves: Curves, beside_curves: Curves, options: CurveOptions, has_own_limits: bool
) -> pd.DataFrame:
    """Return the words and ends of the axes of each quantity's panel.

    Returns:
        quantity; title, label and kind of the upright axis; the bounds of bands, `least` and `greatest`, NaN
        without; `low` and `high`, the reach of runs; `end`, the last place on the other axis; and
        `own_limits`, whether another study's runs beside move none of these.
    """
    rows: list[dict[str, Any]] = []
    for quantity, own_curves in curves.items():
        declared = QUANTITIES[quantity]
        title, label, kind, bounds = declared.title, declared.label, declared.kind, declared.bounds
        if study_data.averaged_over:  # in the log
            label = label.replace(" of an episode", f", {averaging(study_data, options.window)}")
        if quantity.startswith("action_") and is_foreign(study_data):
            title = f"Share of action {quantity.removeprefix('action_')}"
        if own_curves[0].log:
            kind = POWERS
        elif kind == POWERS:
            kind = VALUES
        if quantity in ("return", EVALUATED):
            bounds = RETURN_BOUNDS.get(" ".join(study_data.environments), bounds)
        reaching_curves = list(own_curves)
        if not has_own_limits:
            reaching_curves += beside_curves.get(quantity, [])
        low, high = reach(reaching_curves)
        end = max(float(curve.runs.index.max()) for curve in reaching_curves)
        if options.x == STEPS:
            end = max(end, study_data.budget)
        least, greatest = (bound if np.isfinite(bound) else np.nan for bound in bounds)
        rows.append({
            "quantity": quantity, "title": title, "label": label, "kind": kind, "least": least,
            "greatest": greatest, "low": low, "high": high, "end": end, "own_limits": has_own_limits,
        })  # fmt: skip
    return pd.DataFrame(rows)


def _single_lines(curves: Curves, band: str) -> Iterator[pd.DataFrame]:
    """Yield quantity, condition, x, run and value of runs to draw: in the band `runs`, or too few for one."""
    for quantity, quantity_curves in curves.items():
        for curve in quantity_curves:
            if band == "runs" or (band != "none" and 1 < curve.run_count < BANDS[band].enough_runs):
                lines = curve.runs.rename_axis("x").reset_index().melt("x", var_name="run")
                yield lines.assign(quantity=quantity, condition=curve.condition)


def _stops(curves: Curves) -> pd.DataFrame:
    rows: list[tuple[str, str, float, float]] = []
    for quantity, quantity_curves in curves.items():
        for curve in quantity_curves:
            rows += [(quantity, curve.condition, x, value) for x, value in curve.stops]
    return pd.DataFrame(rows, columns=["quantity", "condition", "x", "value"])


def _beside_title(study_data: StudyData, beside_data: StudyData) -> str:
    """Return what another study is called in a legend: its preset, if that is the difference."""
    if beside_data.study.name == study_data.study.name and beside_data.plan:
        return f"preset {beside_data.plan.preset}"
    return beside_data.full_title


# --- Notes ------------------------------------------------------------------------------------------


def _notes(
    study_data: StudyData,
    curves: Curves,
    reference: pd.DataFrame,
    beside: StudyData | None,
    options: CurveOptions,
) -> list[str]:
    """Return the notes on a study and on what is drawn of it, the most important first."""
    notes = notes_on_runs(study_data, not curves.keys().isdisjoint(("return", EVALUATED)), beside)
    if not curves.keys().isdisjoint(EVALUATION_QUANTITIES):
        notes += notes_on_zero_xp(study_data)
    for quantity, quantity_curves in curves.items():
        if options.log and not quantity_curves[0].log:
            notes.append(f"{QUANTITIES[quantity].title}: no value is above 0, so the axis is linear.")
    least_runs = BANDS[options.bands[0]].least_runs
    for curve in chain.from_iterable(curves.values()):
        curve_text = f"{curve.condition} ({counted(curve.run_count, 'run')})"
        if options.bands[0] == DEFAULT_BAND and least_runs <= curve.run_count < LEAST_INSIDE:
            notes.append(
                f"Of fewer than {LEAST_INSIDE} runs, the 95 % interval of the mean is wider than ± 1 SD and "
                "not drawn."
            )
        if curve.stops:
            notes.append("×: a run diverged, and its curve ends there.")
        elif _has_gaps(curve):
            notes.append("Faint parts have no interval, because some run has no value there.")
        if curve.log:
            notes.append(
                "On logarithmic axes, means and bands are of logarithms and leave out values of 0 or below."
            )
        if options.band and curve.run_count < least_runs:
            notes.append(
                f"The band {options.band} needs {counted(least_runs, 'run')}: not drawn for {curve_text}."
            )
        if curve.values.isna().all().any():
            notes.append(f"Some of {curve_text} have no value in a panel and are left out of its means.")
    notes += _notes_on_random_levels(study_data, reference)
    averaged: dict[str, list[str]] = {}
    for quantity in curves:
        if quantity in EPISODE_QUANTITIES:
            average = averaging(study_data, options.window)
            averaged.setdefault(average, []).append(QUANTITIES[quantity].words)
        elif quantity in UPDATE_QUANTITIES:
            averaged.setdefault(BUDGET_AVERAGE, []).append("values of updates")
    for average, averaged_words in averaged.items():
        averaged_text = " and ".join(dict.fromkeys(averaged_words))
        notes.append(f"{averaged_text[0].upper()}{averaged_text[1:]}: {average}.")
    is_logged_beside = beside is not None and beside.averaged_over is not None
    if BUDGET_AVERAGE in averaged:
        notes += notes_on_windows(study_data, None if is_logged_beside else beside)
    if beside and is_logged_beside:
        beside_name = beside.study.name
        average = averaging(beside, options.window)
        notes.append(f"{beside_name}: {average}. The environment of {beside_name} is not recorded.")
    if options.x in X_NOTES:
        notes.append(X_NOTES[options.x])
    return notes


def _notes_on_random_levels(study_data: StudyData, reference: pd.DataFrame) -> list[str]:
    """Return whose lines those of random players are, if they differ between conditions."""
    notes: list[str] = []
    levels = reference[reference["x"].isna()]
    for quantity, of_quantity in levels.groupby("quantity", sort=False):
        if QUANTITIES[str(quantity)].kind == SHARES and 1 < of_quantity["value"].nunique() <= MOST_LEVELS:
            texts = []
            for level in of_quantity["value"].unique().tolist():
                names = of_quantity["condition"][of_quantity["value"] == level]
                labels = map(study_data.labelled, names)
                texts.append(f"{per_cent(level)} ({'; '.join(labels)})")
            notes.append(f"Random players kill {', '.join(texts)}.")
    return notes


def _has_gaps(curve: Curve) -> bool:
    """Return whether some run lacks a value after all had one."""
    complete = curve.runs.notna().all(axis=1).to_numpy()
    return bool(complete.any() and not complete[complete.argmax() :].all())
