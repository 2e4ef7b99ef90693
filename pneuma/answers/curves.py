"""The curves of a study: means of runs with their bands, and what stands beside them in a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from pneuma.analysis import BAND_NAMES
from pneuma.analysis.curves import (
    BANDS,
    EPISODES,
    STEPS,
    WALL_CLOCK,
    Curve,
    checked_band,
    curve_names,
    curves_table,
    random_levels,
    random_returns,
    reach,
    study_curves,
)
from pneuma.analysis.environments import in_environment_of
from pneuma.analysis.outcomes import have_one_return, is_foreign
from pneuma.analysis.quantities import POWERS, QUANTITIES
from pneuma.analysis.study_data import StudyData
from pneuma.answers.answer import Answer
from pneuma.answers.notes import merge_notes, notes_on_runs
from pneuma.errors import Hint, UserError, counted
from pneuma.store.quantities import EPISODE_QUANTITIES, UPDATE_QUANTITIES, WINDOWS
from pneuma.store.series import GRID_POINTS

DEFAULT_QUANTITIES, EVALUATED = ("return", "share_killed", "success"), "evaluated_return"
DEFAULT_BAND, INTERVAL = BAND_NAMES[0], "ci"
TRAILING_WINDOW = WINDOWS[1]
LEAST_POINTS = GRID_POINTS // 2
"""With a mean of all runs at fewer points, a curve of training is stubs."""
OF_BUDGET = "mean of the last 5 % of the budget at each point"
X_NOTES = {
    STEPS: "",
    EPISODES: "Episodes are counted by their mean length up to each point.",
    WALL_CLOCK: "Within a run, all steps are taken to last equally long.",
}


@dataclass(frozen=True)
class CurveOptions:
    """Which curves are computed.

    Attributes:
        band: one of `BANDS`; None for the deviation, and inside it the interval of the mean.
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
        """What is drawn around means: in the deviation there is their interval."""
        band = checked_band(self.band or DEFAULT_BAND)
        return [band, INTERVAL] if band == DEFAULT_BAND else [band]

    def averaging(self, data: StudyData) -> str:
        """Return what a point of a study's returns is the mean of."""
        if data.averaged_over == 1:
            return "as logged"
        if data.averaged_over or (self.window or data.windows[0]) == TRAILING_WINDOW:
            return f"mean of the last {data.averaged_over or 100} episodes"
        return OF_BUDGET


Curves = Mapping[str, Sequence[Curve]]
"""By quantity."""


@dataclass(frozen=True)
class Column:
    """The curves of a study's runs in one environment, by quantity, and those of a study beside it.

    Attributes:
        reference: of the random player, quantity, condition, x and value; x is NaN for a level.
    """

    data: StudyData
    curves: Curves
    reference: pd.DataFrame
    beside: StudyData | None = None
    beside_curves: Curves = field(default_factory=dict)

    @property
    def all_curves(self) -> list[Curve]:
        return [curve for curves in self.curves.values() for curve in curves]


@dataclass(frozen=True, kw_only=True)
class CurvesAnswer(Answer):
    """The curves of a study.

    Attributes:
        columns: by environment or world; a single one has no title.
        quantities: of all columns.
        is_default: whether these are the study's default quantities.
        options: which curves.
    """

    columns: Mapping[str, Column]
    quantities: Sequence[str]
    is_default: bool
    options: CurveOptions


def find_curves(
    studies: Mapping[str, StudyData],
    quantities: Sequence[str] = (),
    beside: StudyData | None = None,
    **options: Any,
) -> CurvesAnswer:
    """Return the curves of the finished runs of a study.

    Args:
        studies: its runs in each environment, by title; "" for a single one.
        quantities: of `curve_names`; default: the return, in other environments than Pneuma's that of
            evaluations, and the share killed, as far as recorded. If returns are of different rewards, the
            length of episodes replaces them.
        beside: another study, whose runs are drawn in the columns of their environment: of the conditions
            that were asked for, if it has some of these.
        options: those of `CurveOptions`.

    Returns:
        The table `curves` has a row for each point, band, condition and quantity; `reference` has the random
        player.

    Raises:
        UserError: for a quantity that no study has, or runs beside that are all of other environments.
    """
    settings = CurveOptions(**options)
    first = next(iter(studies.values()))
    default = default_quantities(first, beside)
    names = list(dict.fromkeys(quantities)) or default
    recorded = {title: curve_names(data) for title, data in studies.items()}
    study_curves(first, sorted(set(names).difference(*recorded.values())))  # refuses what no study has
    columns: dict[str, Column] = {}
    for title, data in studies.items():
        shared = [name for name in names if name in recorded[title]]
        if shared:
            columns[title] = _column(data, shared, beside, settings)
    if beside and not any(column.beside for column in columns.values()):
        environments = f"{' and '.join(beside.environments)}, not in {' and '.join(first.environments)}"
        raise UserError(Hint("beside", beside.study.name), f": its runs are in {environments}")
    curves, references, notes = [], [], {}
    for title, column in columns.items():
        where = {"environment": title} if title else {}
        curves.append(curves_table(column.curves, settings.bands).assign(**where))
        references.append(column.reference.assign(**where))
        notes[title] = _notes(column, settings)
    shown_studies = {title: column.data for title, column in columns.items()}
    runs = first.runs["condition"].value_counts(sort=False).rename_axis("condition").reset_index(name="runs")
    return CurvesAnswer(
        title=first.full_title,
        about={**first.about, "quantities": names, "x": settings.x, "bands": settings.bands},
        tables={"curves": pd.concat(curves), "reference": pd.concat(references)},
        cells=[runs],
        notes=merge_notes(shown_studies, notes),
        columns=columns,
        quantities=names,
        is_default=names == default,
        options=settings,
    )


def default_quantities(data: StudyData, beside: StudyData | None = None) -> list[str]:
    """Return the quantities of a study's default figure, or of that with another study beside.

    The return is that of evaluations, where both have it, in environments that are not Pneuma's, and where
    episodes are so long for the budget that a training curve has gaps.
    """
    recorded = curve_names(data)
    first, *alternatives = DEFAULT_QUANTITIES
    evaluated = EVALUATED in recorded and (beside is None or EVALUATED in curve_names(beside))
    if not have_one_return(data):
        first = "length"
    elif evaluated and (is_foreign(data) or (first in recorded and _has_stubs(data, first))):
        first = EVALUATED
    return [name for name in (first, *alternatives) if name in recorded] or recorded[:1] or ["return"]


def _has_stubs(data: StudyData, quantity: str) -> bool:
    """Return whether in some condition all runs together have values at too few points for a line."""
    for curve in study_curves(data, [quantity])[quantity]:
        points = curve.runs.loc[:, np.logical_not(curve.diverged)].notna().all(axis=1)
        if points.sum() < LEAST_POINTS:
            return True
    return False


def _column(data: StudyData, names: Sequence[str], beside: StudyData | None, options: CurveOptions) -> Column:
    """Return a study's curves; on a logarithmic axis, means and bands are of logarithms."""
    curves = study_curves(data, names, options.window, options.x)
    for name, group in curves.items():
        if (options.log or QUANTITIES[name].kind == POWERS) and reach(group)[1] > 0:
            curves[name] = [replace(curve, log=True) for curve in group]
    other = beside and in_environment_of(data, beside)
    if not other:
        return Column(data, curves, _reference(data, curves, {}, options))
    if data.asked.conditions:
        same_names = [name for name in other.conditions if name in data.fields and other.of_condition(name)]
        other = other.of_conditions(same_names or other.conditions)
    recorded = curve_names(other)
    shared = [name for name in names if name in recorded]
    if not shared:
        raise UserError(f"study {other.study.name} has no {' or '.join(names)} to draw")
    window = options.window if options.window in other.windows else None
    beside_curves = study_curves(other, shared, window, options.x)
    return Column(data, curves, _reference(data, curves, beside_curves, options), other, beside_curves)


def _reference(data: StudyData, curves: Curves, beside_curves: Curves, options: CurveOptions) -> pd.DataFrame:
    """Return the random player's levels in evaluations, and its return in training by step."""
    rows: list[tuple[str, str, Any, float]] = []
    for name in curves:
        for condition, level in random_levels(data, name).items():
            rows.append((name, condition, np.nan, level))
    if "return" in curves and options.x == STEPS:
        shown_curves = list(curves["return"]) + list(beside_curves.get("return", []))
        ends = [float(curve.runs.index.max()) for curve in shown_curves]
        returns = random_returns(data, max(data.budget, *ends))
        if returns is not None:
            rows += [("return", "", step, value) for step, value in returns.items()]
    return pd.DataFrame(rows, columns=["quantity", "condition", "x", "value"])


# --- Notes ------------------------------------------------------------------------------------------


def _notes(column: Column, options: CurveOptions) -> list[str]:
    """Return the notes on a study and on what is drawn of it, the most important first."""
    data, beside = column.data, column.beside
    notes = notes_on_runs(data, not column.curves.keys().isdisjoint(("return", EVALUATED)), beside)
    for name, group in column.curves.items():
        if options.log and not group[0].log:
            notes.append(f"{QUANTITIES[name].title}: no value is above 0, so the axis is linear.")
    least_runs = BANDS[options.bands[0]].least_runs
    for curve in column.all_curves:
        runs = f"{curve.condition} ({counted(curve.run_count, 'run')})"
        if curve.stops:
            notes.append("×: a run diverged, and its curve ends there.")
        elif _has_gaps(curve):
            notes.append("Faint parts have no interval, because some run has no value there.")
        if curve.log:
            notes.append(
                "On logarithmic axes, means and bands are of logarithms and leave out values of 0 or below."
            )
        if options.band and curve.run_count < least_runs:
            notes.append(f"The band {options.band} needs {counted(least_runs, 'run')}: not drawn for {runs}.")
        if curve.values.isna().all().any():
            notes.append(f"Some of {runs} have no value in a panel and are left out of its means.")
    if not column.curves.keys().isdisjoint(EPISODE_QUANTITIES):
        notes.append(f"Returns and lengths: {options.averaging(data)}.")
    if not column.curves.keys().isdisjoint(UPDATE_QUANTITIES):
        notes.append(f"Updates: {OF_BUDGET}.")
    if beside and beside.averaged_over is not None:
        name = beside.study.name
        notes.append(f"{name}: {options.averaging(beside)}. The environment of {name} is not recorded.")
    return [*notes, X_NOTES[options.x]]


def _has_gaps(curve: Curve) -> bool:
    """Return whether some run lacks a value after all had one."""
    complete = curve.runs.notna().all(axis=1).to_numpy()
    return bool(complete.any() and not complete[complete.argmax() :].all())
