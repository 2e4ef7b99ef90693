"""The curves of a study: means of runs with their bands, and what else is in their figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from pneuma.analysis import BAND_NAMES
from pneuma.analysis.answer import Answer
from pneuma.analysis.curves import (
    BANDS,
    EPISODES,
    LEAST_INSIDE,
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
from pneuma.analysis.notes import BUDGET_AVERAGE, averaging, merge_notes, notes_on_runs, notes_on_windows
from pneuma.analysis.outcomes import have_one_return, is_foreign
from pneuma.analysis.quantities import POWERS, QUANTITIES, SHARES
from pneuma.analysis.study_data import StudyData
from pneuma.errors import Hint, UserError, counted
from pneuma.store.quantities import UPDATE_QUANTITIES
from pneuma.store.series import GRID_POINTS
from pneuma.values import per_cent

DEFAULT_QUANTITIES, EVALUATED = ("return", "share_killed", "success"), "evaluated_return"
DEFAULT_BAND, INTERVAL = BAND_NAMES[0], "ci"
MOST_LEVELS = 4
"""Most different levels of random players that a note names."""
LEAST_EVALUATIONS = 3
"""With fewer, a curve of evaluations is a dot or two."""
LEAST_POINTS = GRID_POINTS // 2
"""With a mean of all runs at fewer points, a curve of training is stubs."""
EPISODE_WORDS = {
    "return": "returns in training",
    "length": "lengths of episodes",
    "kills": "kills in training",
    "hp": "HP left in training",
}
"""What notes call the `EPISODE_QUANTITIES`."""
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

    def drawn_bands(self, run_count: int) -> list[str]:
        """Return what is drawn around the mean of so many runs: an interval only inside the deviation."""
        if self.bands[0] == DEFAULT_BAND and run_count < LEAST_INSIDE:
            return [DEFAULT_BAND]
        return self.bands


Curves = Mapping[str, Sequence[Curve]]
"""By quantity."""


@dataclass(frozen=True)
class Column:
    """The curves of a study's runs in one environment, by quantity, and those of another study drawn with it.

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
        beside: another study, whose runs are drawn in the columns of their environment: those of the selected
            conditions, if it has some of these.
        options: those of `CurveOptions`.

    Returns:
        The table `curves` has a row for each point, band, condition and quantity; `reference` has the random
        player.

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
    columns: dict[str, Column] = {}
    for title, study_data in studies.items():
        shared_names = [quantity for quantity in quantity_names if quantity in names_by_title[title]]
        if shared_names:
            columns[title] = _column(study_data, shared_names, beside, curve_options)
    if beside and not any(column.beside for column in columns.values()):
        environments = f"{' and '.join(beside.environments)}, not in {' and '.join(first_data.environments)}"
        raise UserError(Hint("beside", beside.study.name), f": its runs are in {environments}")
    curve_tables, reference_tables, notes_by_title = [], [], {}
    for title, column in columns.items():
        environment_column = {"environment": title} if title else {}
        curve_tables.append(curves_table(column.curves, curve_options.bands).assign(**environment_column))
        reference_tables.append(column.reference.assign(**environment_column))
        notes_by_title[title] = _notes(column, curve_options)
        is_return_in_training = not quantities and "return" in column.curves
        if is_return_in_training and is_foreign(column.data) and _has_few_evaluations(column.data):
            few_text = f"With fewer than {LEAST_EVALUATIONS} evaluations, the return is that in training."
            notes_by_title[title].insert(0, few_text)
    shown_studies = {title: column.data for title, column in columns.items()}
    run_counts = first_data.runs["condition"].value_counts(sort=False).rename_axis("condition")
    return CurvesAnswer(
        title=first_data.full_title,
        about={
            **first_data.about,
            "quantities": quantity_names,
            "x": curve_options.x,
            "bands": curve_options.bands,
        },
        tables={"curves": pd.concat(curve_tables), "reference": pd.concat(reference_tables)},
        cells=[run_counts.reset_index(name="runs")],
        notes=merge_notes(shown_studies, notes_by_title),
        columns=columns,
        quantities=quantity_names,
        is_default=quantity_names == default_names,
        options=curve_options,
    )


def default_quantities(study_data: StudyData, beside: StudyData | None = None) -> list[str]:
    """Return the quantities of a study's default figure, which may have another study in it.

    The return is that of evaluations, where both have it at three steps or more, in environments that are not
    Pneuma's, and where episodes are so long for the budget that a training curve has gaps.
    """
    recorded = curve_names(study_data)
    first_quantity, *alternatives = DEFAULT_QUANTITIES
    has_evaluations = (
        EVALUATED in recorded
        and (beside is None or EVALUATED in curve_names(beside))
        and not (first_quantity in recorded and _has_few_evaluations(study_data))
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


def _column(
    study_data: StudyData, quantity_names: Sequence[str], beside: StudyData | None, options: CurveOptions
) -> Column:
    """Return a study's curves; on a logarithmic axis, means and bands are of logarithms."""
    curves = study_curves(study_data, quantity_names, options.window, options.x)
    for quantity, quantity_curves in curves.items():
        if (options.log or QUANTITIES[quantity].kind == POWERS) and reach(quantity_curves)[1] > 0:
            curves[quantity] = [replace(curve, log=True) for curve in quantity_curves]
    beside_data = beside and in_environment_of(study_data, beside)
    if not beside_data:
        return Column(study_data, curves, _reference(study_data, curves, {}, options))
    if study_data.query.conditions:
        same_names = [
            condition
            for condition in beside_data.conditions
            if condition in study_data.fields and beside_data.of_condition(condition)
        ]
        beside_data = beside_data.of_conditions(same_names or beside_data.conditions)
    beside_names = curve_names(beside_data)
    shared_names = [quantity for quantity in quantity_names if quantity in beside_names]
    if not shared_names:
        raise UserError(f"study {beside_data.study.name} has no {' or '.join(quantity_names)} to draw")
    window = options.window if options.window in beside_data.windows else None
    beside_curves = study_curves(beside_data, shared_names, window, options.x)
    return Column(
        study_data, curves, _reference(study_data, curves, beside_curves, options), beside_data, beside_curves
    )


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


# --- Notes ------------------------------------------------------------------------------------------


def _notes(column: Column, options: CurveOptions) -> list[str]:
    """Return the notes on a study and on what is drawn of it, the most important first."""
    study_data, beside = column.data, column.beside
    notes = notes_on_runs(study_data, not column.curves.keys().isdisjoint(("return", EVALUATED)), beside)
    for quantity, quantity_curves in column.curves.items():
        if options.log and not quantity_curves[0].log:
            notes.append(f"{QUANTITIES[quantity].title}: no value is above 0, so the axis is linear.")
    least_runs = BANDS[options.bands[0]].least_runs
    for curve in column.all_curves:
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
    notes += _notes_on_random_levels(column)
    averaged: dict[str, list[str]] = {}
    for quantity in column.curves:
        if quantity in EPISODE_WORDS:
            averaged.setdefault(averaging(study_data, options.window), []).append(EPISODE_WORDS[quantity])
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


def _notes_on_random_levels(column: Column) -> list[str]:
    """Return whose lines those of random players are, if they differ between conditions."""
    notes: list[str] = []
    levels = column.reference[column.reference["x"].isna()]
    for quantity, of_quantity in levels.groupby("quantity", sort=False):
        if QUANTITIES[str(quantity)].kind == SHARES and 1 < of_quantity["value"].nunique() <= MOST_LEVELS:
            texts = []
            for level in of_quantity["value"].unique().tolist():
                names = of_quantity["condition"][of_quantity["value"] == level]
                labels = [column.data.study.labels.get(name, name) for name in names]
                texts.append(f"{per_cent(level)} ({'; '.join(labels)})")
            notes.append(f"Random players kill {', '.join(texts)}.")
    return notes


def _has_gaps(curve: Curve) -> bool:
    """Return whether some run lacks a value after all had one."""
    complete = curve.runs.notna().all(axis=1).to_numpy()
    return bool(complete.any() and not complete[complete.argmax() :].all())
