"""A study's data: its finished runs, each with its row, and a run as it stood at a step.

`open_study` (asked.py) → StudyData of Rows; StudyData, run and step → RunView
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from html import escape
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from pneuma.env.fields import are_own_characters, is_own_level
from pneuma.errors import UserError, counted, unknown_name
from pneuma.study.quantities import WINDOWS
from pneuma.study.rows import Row
from pneuma.study.series import SLACK, STATISTICS, Series, held_curve, make_grid
from pneuma.values import settings_name, shown_settings
from pneuma.worlds import WORLDS


@dataclass(frozen=True, eq=False)
class StudyData:
    """The finished runs of a study that were asked for.

    Attributes:
        study: its name.
        title: its title, without world and changed fields.
        figure: the stem of its figure.
        baseline: the condition that others are compared with.
        fields: by condition, its fields without seed and steps.
        runs: the finished runs, seed by seed.
        same: groups of conditions that are one configuration.
        every: all conditions of the study, also those that were not asked for.
        narrowed: conditions and seeds that were asked for, if not all; and steps, if any were.
        world: its world; empty if it has a single one.
        changed: fields that `--set` changed.
        outcomes: those that the study asks about, in place of the usual ones.
        labels: what conditions are called in figures, where not by their names.
        steps: agent steps of each run, as `--steps` takes them; None for a study that lists its runs.
        budget: at which curves end: the largest of the runs.
    """

    study: str
    title: str
    figure: str
    baseline: str
    fields: Mapping[str, Mapping[str, Any]]
    runs: Sequence[Row]
    same: Sequence[Sequence[str]] = ()
    every: Sequence[str] = ()
    narrowed: Sequence[str] = ()
    world: str = ""
    changed: Mapping[str, Any] = field(default_factory=dict)
    outcomes: Sequence[str] = ()
    labels: Mapping[str, str] = field(default_factory=dict)
    steps: int | None = None
    budget: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "budget", self.budget or max(run.budget for run in self.runs))

    def __repr__(self) -> str:
        conditions = ", ".join(f"{name} ({len(self.of_condition(name))})" for name in self.conditions)
        known = f"{self.study} ({self.world})" if self.world else self.study
        known += f", {self.steps:,} steps" if self.steps else ""
        return f"StudyData {known}: {counted(len(self.runs), 'run')} of {conditions}"

    def _repr_html_(self) -> str:
        rows = [(name, len(self.of_condition(name))) for name in self.conditions]
        table = pd.DataFrame(rows, columns=["condition", "runs"])
        return f"<b>{escape(self.full_title)}</b>{table.to_html(index=False)}"

    @property
    def conditions(self) -> list[str]:
        return [*self.fields]

    @property
    def full_title(self) -> str:
        """The title with the world, unless levels or characters in it are others, and with changed fields."""
        own = any(
            is_own_level(str(run.fields.get("level", "")))
            or are_own_characters(str(run.fields.get("characters", "")))
            for run in self.runs
        )
        environments = {str(fields.get("env")) for fields in self.fields.values()}
        worlds = [f" in {each.title}" for each in WORLDS.values() if {each.env} == environments]
        changed = f" ({shown_settings(self.changed)})" if self.changed else ""
        return self.title + ("" if own else "".join(worlds)) + changed

    @property
    def what(self) -> str:
        """Where the runs are, for messages."""
        if self.averaged_over:
            return "a study of imported logs"
        words = {False: "the results folder", True: "the published table"}
        return " with ".join(words[place] for place in sorted({run.published for run in self.runs}))

    def engines(self, condition: str) -> set[str]:
        return {str(engine) for run in self.of_condition(condition) if (engine := run.fields.get("engine"))}

    @cached_property
    def latest_first_evaluation(self) -> float:
        """The step from which every run has an evaluation; 0 if none has any."""
        firsts = (steps[0] for run in self.runs if len(steps := run.evaluations("step")))
        return max(map(float, firsts), default=0.0)

    @cached_property
    def grid(self) -> np.ndarray:
        """The steps of the points of curves, (points,)."""
        return make_grid(self.budget)

    @cached_property
    def windows(self) -> tuple[str, ...]:
        """The windows of `WINDOWS` that all returns have, the usual one first."""
        return tuple(name for name in WINDOWS if all(name in run.windows for run in self.runs))

    @cached_property
    def evaluated(self) -> bool:
        return all(run.evaluation_columns for run in self.runs)

    @property
    def averaged_over(self) -> int | None:
        """Episodes over which returns were averaged when recorded; None if they were not."""
        return max((episodes for run in self.runs if (episodes := run.averaged_over)), default=None)

    @cached_property
    def quantities(self) -> list[str]:
        """The training curves that some run has, of `TRAINING_QUANTITIES`.

        If some runs come from published tables, these are only the quantities in the tables, because a line
        over some runs of a condition would mislead.
        """
        published = {run.quantities for run in self.runs if run.published}
        some = dict.fromkeys(name for run in self.runs for name in run.quantities)
        return [name for name in some if all(name in names for names in published)]

    def of_conditions(self, names: str | Sequence[str]) -> StudyData:
        """Return the study with one or some of its conditions, on the same grid."""
        names = [names] if isinstance(names, str) else names
        for name in names:
            if name not in self.conditions:
                raise unknown_name(f"condition of study {self.study}", name, self.conditions)
        same = [[name for name in group if name in names] for group in self.same]
        return replace(
            self,
            fields={name: self.fields[name] for name in self.fields if name in names},
            runs=[run for run in self.runs if run.condition in names],
            same=[group for group in same if len(group) > 1],
        )

    def of_condition(self, condition: str) -> list[Row]:
        """Return a condition's finished runs, in the order of their seeds."""
        return self._by_condition.get(condition, [])

    @cached_property
    def _by_condition(self) -> dict[str, list[Row]]:
        found: dict[str, list[Row]] = {}
        for run in self.runs:
            found.setdefault(run.condition, []).append(run)
        return found

    @cached_property
    def evaluations(self) -> pd.DataFrame:
        """The evaluations of all runs: condition, seed, run_id, and the columns of the records."""
        tables = [run.evaluations_table() for run in self.runs]
        frame = pa.concat_tables(tables, promote_options="permissive").to_pandas(use_threads=False)
        counts = [table.num_rows for table in tables]
        for place, key in enumerate(("condition", "seed", "run_id")):
            frame.insert(place, key, np.repeat([getattr(run, key) for run in self.runs], counts))
        return frame

    def curve(self, run: Row, quantity: str, window: str | None = None) -> np.ndarray:
        """Return a run's training curve on the study's grid, (points,); NaN where it has no value.

        Args:
            run: a finished run; its curve is blank if it lacks the quantity.
            quantity: one of `quantities`.
            window: one of `windows`; default: the first. Quantities of updates have only one.
        """
        window = self.checked_window(window)
        if quantity in self.quantities and quantity not in run.quantities:
            return np.full(self.grid.shape, np.nan)
        if quantity not in self.quantities or window not in run.windows_of(quantity):
            known = ", ".join(self.quantities) or "none"
            raise UserError(
                f"study {self.study}: {self.what} holds no {quantity} in the window {window}; "
                f"its curves are: {known}"
            )
        values = run.curve(quantity, window)
        return values if run.budget == self.budget else held_curve(run.grid, values, self.grid, run.end)

    def has_curve(self, quantity: str, window: str) -> bool:
        return all(window in run.windows_of(quantity) for run in self.runs)

    def checked_window(self, window: str | None) -> str:
        """Return a window of `windows`; the first if None."""
        if window is None:
            return self.windows[0]
        if window not in self.windows:
            raise unknown_name(f"window of study {self.study}", window, self.windows)
        return window


def figure_basename(data: StudyData, *parts: str) -> str:
    """Return the name of a figure's files, or of a table, without its ending.

    It contains the world, changed fields, and the conditions, seeds and steps that were asked for, so that
    neither a variant nor a part of a study replaces the study's own figure.
    """
    slug = settings_name(data.changed, *filter(None, [*data.narrowed, *parts]))
    return "-".join(filter(None, [data.figure, data.world, slug]))


def table_name(data: StudyData) -> str:
    return "-".join(filter(None, [data.study, data.world, settings_name(data.changed)]))


def join_studies(one: StudyData, other: StudyData) -> tuple[StudyData, dict[str, tuple[str, str]]]:
    """Return the runs of two studies as one study's, and the two new names of each condition that both have.

    Conditions are called CONDITION, STUDY.
    """
    parts = [(data, data.full_title if one.study == other.study else data.study) for data in (one, other)]
    fields = {f"{name}, {word}": data.fields[name] for data, word in parts for name in data.conditions}
    runs = [replace(run, condition=f"{run.condition}, {word}") for data, word in parts for run in data.runs]
    title = f"{one.title}, and {other.title}"
    joined = StudyData(
        one.study, title, one.figure, "", fields, runs, every=[*fields], narrowed=one.narrowed,
        world=one.world, steps=one.steps if one.steps == other.steps else None,
    )  # fmt: skip
    (_, first), (_, second) = parts
    shared = [name for name in one.conditions if one.of_condition(name) and other.of_condition(name)]
    return joined, {name: (f"{name}, {first}", f"{name}, {second}") for name in shared}


# --- A run up to a step -----------------------------------------------------------------------------


@dataclass(frozen=True)
class RunView:
    """A run as it stood at a step. A run that diverged has its last recorded values.

    Attributes:
        until: agent steps; the run's budget, or an earlier step.
        since: where means over evaluations begin.
    """

    run: Row
    until: float
    since: float = 0.0

    @property
    def last_step(self) -> float:
        return self.until * (1 + SLACK)

    def evaluations(self, column: str) -> Series:
        """Return a column of the evaluations; empty if there is no such column."""
        if column not in self.run.evaluation_columns:
            return np.empty(0), np.empty(0)
        return self._finite(self.run.evaluations("step"), self.run.evaluations(column))

    def curve(self, quantity: str) -> Series:
        """Return the points of a training curve that have a value; empty if there is no such quantity."""
        return self._finite(self.run.grid, self.run.curve(quantity))

    def peaks(self, quantity: str) -> Series:
        return self._finite(self.run.grid, self.run.peaks(quantity))

    def statistic(self, quantity: str, name: str) -> float:
        """Return one of `STATISTICS` of a curve, with all digits at the run's end; NaN if it has no value."""
        exact = self.run.exact(quantity, name) if self.until >= self.run.budget else math.nan
        if not math.isnan(exact):
            return exact
        step, values = self.curve(quantity)
        return STATISTICS[name](step, values, self.until) if len(values) else math.nan

    def _finite(self, step: np.ndarray, values: np.ndarray) -> Series:
        finite = np.isfinite(values) & (step <= self.last_step)
        return step[finite], values[finite]


def view(data: StudyData, run: Row, at_step: float | None = None) -> RunView:
    """Return a run as it stood at `at_step`, or at its own budget if that is smaller or no step is given.

    A step is given if runs of different budgets are compared. Each was evaluated at equal parts of its own
    budget, so that their common range begins at the latest of their first evaluations.
    """
    since = 0.0 if at_step is None else data.latest_first_evaluation
    return RunView(run, min(run.budget, at_step or run.budget), since)


def common_step(data: StudyData) -> int | None:
    """Return the largest step that all runs were to reach; None if all budgets are equal.

    Budgets that differ only by rounding to whole horizons, by less than half the distance between
    evaluations, count as equal. A diverged run counts with its budget and its last values. Imported logs do
    not contain their budget, so for them it is the step that two thirds of them reached.
    """
    budgets = sorted((run.budget for run in data.runs), reverse=True)
    if budgets[0] <= budgets[-1] * (1 + SLACK):
        return None
    return budgets[math.ceil(len(budgets) * 2 / 3) - 1 if data.averaged_over else -1]


def step_note(data: StudyData) -> str:
    """Say at which step runs are compared and which ones end before it; empty if all budgets are equal."""
    if (step := common_step(data)) is None:
        return ""
    reached = "two thirds of the logs reached" if data.averaged_over else "all runs were to reach"
    short = [f"{run.condition} {run.seed}" for run in data.runs if run.ends_before(step)]
    left_out = f" (left out, as they end before: {', '.join(short)})" if short else ""
    return f"Budgets differ: runs are compared at step {step:,}, the most that {reached}{left_out}."
