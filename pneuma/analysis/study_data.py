"""A study's data: its runs as a table with a row for each, and the curves that they share a grid for.

`open_study` (runs.py) → StudyData; its `runs.groupby("condition")`, `of_condition(condition)` → rows
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from pneuma.config import Run
from pneuma.env.fields import are_own_characters, is_own_level
from pneuma.errors import Hint, Message, UserError, counted, unknown_name
from pneuma.presets import WORLDS
from pneuma.seeds import format_seeds
from pneuma.store.quantities import WINDOWS
from pneuma.store.rows import Row
from pneuma.store.series import held_curve, make_grid
from pneuma.store.store import FINISHED
from pneuma.study.identity import config_id
from pneuma.study.plan import Plan, Query
from pneuma.study.spec import LAST, Study, named_condition
from pneuma.values import format_settings, settings_name

RUN_KEY_COLUMNS = ("condition", "seed", "run_id")
"""The first columns of tables of records."""


@dataclass(frozen=True)
class StudyCall(Hint):
    """A call about a study that a message recommends; `field` is the function of `pneuma.api`.

    Attributes:
        value: the study's name or file.
        plan: its query names the runs; None if the study lists its runs.
        results: the results folder; None for the default.
        unpublished: whether runs are left out that are finished in a published table.
    """

    plan: Plan | None = None
    results: Path | None = None
    unpublished: bool = False

    def __str__(self) -> str:
        arguments = [repr(self.value)]
        if self.plan is not None:
            query, study = self.plan.query, self.plan.study
            keyword_arguments = {
                "preset": self.plan.preset,
                "world": study.world,
                "settings": dict(study.settings),
                "conditions": query.conditions,
                "seeds": query.seeds,
                "steps": query.steps,
            }
            arguments += [f"{name}={value!r}" for name, value in keyword_arguments.items() if value]
        return f"{self.field}({', '.join(arguments)})"


@dataclass(frozen=True, eq=False)
class StudyData:
    """The runs of a query on a study.

    Attributes:
        study: in its world and with changed fields; one that lists its runs has no path.
        fields: the fields of each condition, apart from seed and steps.
        runs: a row for each run, seed by seed: condition, seed, run_id, config_id, steps, status, end, and
            `where`, the table that has it, or empty; of finished runs that were read also `row`, a `Row`.
        configurations: the configuration of each condition; empty if the study lists its runs.
        plan: the cells that the runs are of; None if the study lists its runs.
        query: as the user gave it.
        other_presets: how many finished runs the study's other presets have.
    """

    study: Study
    fields: Mapping[str, Mapping[str, Any]]
    runs: pd.DataFrame
    configurations: Mapping[str, Run] = field(default_factory=dict)
    plan: Plan | None = None
    query: Query = Query()
    other_presets: Mapping[str, int] = field(default_factory=dict)

    def __repr__(self) -> str:
        run_counts = self.runs["condition"].value_counts()
        conditions = ", ".join(
            f"{condition} ({run_counts.get(condition, 0)})" for condition in self.conditions
        )
        return f"StudyData {self.label}: {counted(len(self.runs), 'run')} of {conditions}"

    @property
    def finished(self) -> pd.DataFrame:
        """Those of the runs that have finished."""
        return self.runs[self.runs["status"].isin(FINISHED)]

    @property
    def conditions(self) -> list[str]:
        return list(self.fields)

    @property
    def environments(self) -> list[str]:
        """The ids of the environments of its conditions."""
        return list(dict.fromkeys(str(fields.get("env")) for fields in self.fields.values()))

    @property
    def duplicates(self) -> list[list[str]]:
        """Groups of conditions that are one configuration."""
        conditions_by_id: dict[str, list[str]] = {}
        for condition, run in self.configurations.items():
            conditions_by_id.setdefault(config_id(run), []).append(condition)
        return [same_conditions for same_conditions in conditions_by_id.values() if len(same_conditions) > 1]

    @property
    def world(self) -> str:
        """The study's world; empty if it has a single one."""
        return self.study.world if len(self.study.worlds) > 1 else ""

    @property
    def steps(self) -> int | None:
        """Agent steps of each run; None if they differ."""
        step_counts = set(self.runs["steps"].tolist())
        if self.plan is not None:
            step_counts = {cell.run.steps for cell in self.plan.cells}
        return step_counts.pop() if len(step_counts) == 1 else None

    # --- In words -------------------------------------------------------------------------------------

    def labelled(self, name: str, factor: str = "") -> str:
        """Return the study's label of a condition, or of a factor's level, or else the name itself."""
        return self.study.labels.get(name) or self.study.labels.get(f"{factor}={name}", name)

    def with_labels(self, cells: pd.DataFrame) -> pd.DataFrame:
        """Return a table for people whose conditions are called by the study's labels for them."""
        if "condition" not in cells:
            return cells
        return cells.assign(condition=[self.labelled(name) for name in cells["condition"]])

    @property
    def description(self) -> str:
        """The study with its world and changed fields."""
        description = self.study.name
        if self.world:
            description += f" in {WORLDS[self.world].title}"
        if self.study.settings:
            description += f" with {format_settings(self.study.settings)}"
        return description

    @property
    def label(self) -> str:
        """The study with its world, preset, and the query's choices that differ from the preset."""
        phrases = [self.description]
        query = self.query
        if self.plan is not None:
            query = self.plan.query
            phrases.append(f"preset {self.plan.preset}")
        if query.conditions:
            phrases.append(f"{' and '.join(query.conditions)} alone")
        if query.seeds is not None:
            phrases.append(f"seeds {format_seeds(query.seeds)}")
        if query.steps:
            phrases.append(f"{query.steps:,} steps")
        return ", ".join(phrases)

    @property
    def coverage(self) -> Message:
        """A message: how many of the runs have finished, where they are from, and what other presets have."""
        finished_runs, planned_count = self.finished, len(self.runs)
        if self.plan is not None:
            planned_count = len(self.plan.cells)
        finished_count = len(finished_runs)
        published_count = int((finished_runs["where"] != "").sum())
        origins = []
        if 0 < published_count < finished_count:
            origins.append(f"{finished_count - published_count} trained here, {published_count} published")
        elif published_count:
            origins.append("published")
        if self.configurations:
            present_ids = {config_id(run) for run in self.configurations.values()}
            older_count = int((~finished_runs["config_id"].isin(present_ids)).sum())
            if older_count:
                origins.append(f"{older_count} by an earlier version")
        coverage_text = f"{self.label}: {finished_count} of {counted(planned_count, 'run')}"
        if origins:
            coverage_text += f" ({'; '.join(origins)})"
        message_parts: list[str | Hint] = [f"{coverage_text}."]
        if self.plan is not None and published_count and finished_count < planned_count:
            message_parts += [" The others are trained by `", self.call("run_study", unpublished=True), "`."]
        if self.other_presets:
            preset_texts = [
                f"{preset} ({counted(run_count, 'run')})" for preset, run_count in self.other_presets.items()
            ]
            message_parts.append(f" Also: {', '.join(preset_texts)}.")
        return Message(*message_parts)

    def call(self, function: str, results: Path | None = None, unpublished: bool = False) -> StudyCall:
        """Return a call of a function of `pneuma.api` about these runs."""
        study_name = self.study.file
        return StudyCall(function, study_name, self.plan, results, unpublished)

    @property
    def about(self) -> dict[str, Any]:
        """Which runs of the study a document is about."""
        return {
            "study": self.study.name,
            "world": self.world or None,
            "preset": self.plan.preset if self.plan else None,
            "steps": self.steps,
            "seeds": sorted(set(self.runs["seed"].tolist())),
            "settings": dict(self.study.settings),
        }

    @property
    def full_title(self) -> str:
        """The title with the world, unless its level or characters were changed, and with changed fields."""
        title = self.study.title
        if not any(_has_own_world(run) for run in self.rows):
            for world in WORLDS.values():
                if self.environments == [world.env]:
                    title += f" in {world.title}"
        if self.study.settings:
            title += f" ({format_settings(self.study.settings)})"
        return title

    def basename(self, *suffixes: str) -> str:
        """Return the name of a figure's files, without its ending.

        It contains the world, changed fields, and the query's preset, conditions, seeds and steps, so that
        neither a variant nor a part of a study replaces the study's own figure.
        """
        query, name_words = self.query, []
        if query.preset not in (None, LAST):
            name_words.append(str(query.preset))
        if len(self.fields) < len(self.study.conditions):
            name_words += query.conditions
        if query.seeds is not None:
            name_words += ["seeds", *map(str, sorted(query.seeds))]
        if query.steps:
            name_words += ["steps", str(query.steps)]
        name_words += filter(None, suffixes)
        settings_text = settings_name(self.study.settings, *name_words)
        return "-".join(filter(None, [self.study.figure, self.world, settings_text]))

    @property
    def table_name(self) -> str:
        """The name of its published table."""
        name_parts = [self.study.name, self.world, settings_name(self.study.settings)]
        return "-".join(filter(None, name_parts))

    @property
    def origin(self) -> str:
        """Where the runs are, for messages."""
        return " with ".join(sorted({run.origin for run in self.rows}))

    # --- Rows -----------------------------------------------------------------------------------------

    @cached_property
    def rows(self) -> list[Row]:
        """The rows of the finished runs, in the table's order."""
        return list(self.runs["row"])

    def of_condition(self, condition: str) -> list[Row]:
        """Return the rows of a condition's finished runs, in the order of their seeds."""
        return self._rows_by_condition.get(condition, [])

    @cached_property
    def _rows_by_condition(self) -> dict[str, list[Row]]:
        rows_by_condition: dict[str, list[Row]] = {}
        for condition, row in zip(self.runs["condition"], self.runs["row"], strict=True):
            rows_by_condition.setdefault(condition, []).append(row)
        return rows_by_condition

    def renamed(self, new_names: Mapping[str, str]) -> StudyData:
        """Return the study with new names of conditions; a condition without one is left out."""

        def with_new_keys(by_condition: Mapping[str, Any]) -> dict[str, Any]:
            return {
                new_names[condition]: value
                for condition, value in by_condition.items()
                if condition in new_names
            }

        study, first_name = self.study, next(iter(new_names.values()))
        study_updates = {
            "conditions": with_new_keys(study.conditions),
            "levels": with_new_keys(study.levels),
            "labels": {**with_new_keys(study.labels), **study.labels},
            "colors": {**study.colors, **with_new_keys(study.colors)},
            "baseline": new_names.get(study.baseline, first_name),
        }
        runs = self.runs[self.runs["condition"].isin(new_names)]
        return replace(
            self,
            study=study.model_copy(update=study_updates),
            fields=with_new_keys(self.fields),
            runs=runs.assign(condition=runs["condition"].map(new_names)),
            configurations=with_new_keys(self.configurations),
        )

    def of_conditions(self, selected: Sequence[str]) -> StudyData:
        """Return the study with some of its conditions."""
        selected = [named_condition(condition, self.study.levels) for condition in selected]
        for condition in selected:
            if condition not in self.fields:
                raise unknown_name(f"condition of study {self.study.name}", condition, self.fields)
        return replace(
            self,
            fields={condition: fields for condition, fields in self.fields.items() if condition in selected},
            runs=self.runs[self.runs["condition"].isin(selected)],
            configurations={
                condition: run for condition, run in self.configurations.items() if condition in selected
            },
        )

    def engines(self, condition: str) -> set[str]:
        return {str(run.fields.get("engine") or "") for run in self.of_condition(condition)} - {""}

    @cached_property
    def averaged_over(self) -> int | None:
        """Episodes over which returns were averaged when recorded; None if they were not."""
        return max((run.averaged_over or 0 for run in self.rows), default=0) or None

    @cached_property
    def evaluated(self) -> bool:
        return all(run.evaluations_table.num_columns for run in self.rows)

    @cached_property
    def evaluations(self) -> pd.DataFrame:
        """The evaluations of all runs: condition, seed, run_id, and the columns of the records."""
        run_tables = [run.evaluations_table for run in self.rows]
        frame = pa.concat_tables(run_tables, promote_options="permissive").to_pandas(use_threads=False)
        row_counts = [run_table.num_rows for run_table in run_tables]
        for position, column in enumerate(RUN_KEY_COLUMNS):
            frame.insert(position, column, np.repeat(self.runs[column].to_numpy(), row_counts))
        return frame

    # --- Curves ---------------------------------------------------------------------------------------

    @cached_property
    def budget(self) -> int:
        """Agent steps at which curves end: the most of any run."""
        return int(self.runs["steps"].max())

    @cached_property
    def grid(self) -> np.ndarray:
        """The steps of the points of curves, (points,)."""
        return make_grid(self.budget)

    @cached_property
    def windows(self) -> tuple[str, ...]:
        """The windows of `WINDOWS` that all returns have, the default one first."""
        return tuple(window for window in WINDOWS if all(window in run.windows for run in self.rows))

    @cached_property
    def quantities(self) -> list[str]:
        """The training curves that some run has, of `TRAINING_QUANTITIES`.

        If some runs come from published tables, these are only the quantities in the tables, because a line
        over some runs of a condition would mislead.
        """
        quantity_names = list(dict.fromkeys(quantity for run in self.rows for quantity in run.quantities))
        for run in self.rows:
            if run.published:
                quantity_names = [quantity for quantity in quantity_names if quantity in run.quantities]
        return quantity_names

    def curve(self, run: Row, quantity: str, window: str | None = None) -> np.ndarray:
        """Return a run's training curve on the study's grid, (points,); NaN where it has no value.

        Args:
            run: a finished run; its curve is blank if it lacks the quantity.
            quantity: one of `quantities`.
            window: one of `windows`; default: the first. Quantities of updates have only one.
        """
        window = self.checked_window(window)
        if quantity in run.quantities and window not in run.windows_of(quantity):
            raise UserError(
                f"study {self.study.name}: {self.origin} holds no {quantity} in the window {window}; "
                f"its curves are: {', '.join(self.quantities)}"
            )
        curve_values = run.curve(quantity, window)
        if run.budget == self.budget:
            return curve_values
        return held_curve(run.grid, curve_values, self.grid, run.end)

    def checked_window(self, window: str | None) -> str:
        """Return a window of `windows`; the first if None."""
        if window is None:
            return self.windows[0]
        if window not in self.windows:
            raise unknown_name(f"window of study {self.study.name}", window, self.windows)
        return window


def _has_own_world(run: Row) -> bool:
    level, characters = run.fields.get("level", ""), run.fields.get("characters", "")
    return is_own_level(str(level)) or are_own_characters(str(characters))
