"""A study's data: its runs as a table with a row for each, and the curves that they share a grid for.

`open_study` (runs.py) → StudyData; `data.runs.groupby("condition")`, `data.of_condition(name)` → rows
"""

from __future__ import annotations

import shlex
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
from pneuma.errors import UserError, counted, unknown_name
from pneuma.presets import WORLDS
from pneuma.store.quantities import WINDOWS
from pneuma.store.rows import Row
from pneuma.store.series import SLACK, held_curve, make_grid
from pneuma.store.store import FINISHED
from pneuma.study.identity import config_id
from pneuma.study.plan import Plan, Query, query_words
from pneuma.study.spec import LAST, Study
from pneuma.values import settings_name, shown_seeds, shown_settings

NAMING = ("condition", "seed", "run_id")
"""The first columns of tables of records."""


@dataclass(frozen=True, eq=False)
class StudyData:
    """The runs of a study that were asked for.

    Attributes:
        study: in its world and with changed fields; one that lists its runs has no path.
        fields: the fields of each condition, apart from seed and steps.
        runs: a row for each run, seed by seed: condition, seed, run_id, config_id, steps, status, end, and
            `where`, the table that has it, or empty; of finished runs that were read also `row`, a `Row`.
        configurations: the configuration of each condition; empty if the study lists its runs.
        plan: the cells that the runs are of; None if the study lists its runs.
        asked: what the command named of it.
        other_presets: how many finished runs the study's other presets have.
    """

    study: Study
    fields: Mapping[str, Mapping[str, Any]]
    runs: pd.DataFrame
    configurations: Mapping[str, Run] = field(default_factory=dict)
    plan: Plan | None = None
    asked: Query = Query()
    other_presets: Mapping[str, int] = field(default_factory=dict)

    def __repr__(self) -> str:
        counts = self.runs["condition"].value_counts()
        conditions = ", ".join(f"{name} ({counts.get(name, 0)})" for name in self.conditions)
        return f"StudyData {self.label}: {counted(len(self.runs), 'run')} of {conditions}"

    @property
    def finished(self) -> pd.DataFrame:
        """Those of the runs that have finished."""
        return self.runs[self.runs["status"].isin(FINISHED)]

    @property
    def conditions(self) -> list[str]:
        return [*self.fields]

    @property
    def same(self) -> list[list[str]]:
        """Groups of conditions that are one configuration."""
        alike: dict[str, list[str]] = {}
        for name, run in self.configurations.items():
            alike.setdefault(config_id(run), []).append(name)
        return [names for names in alike.values() if len(names) > 1]

    @property
    def world(self) -> str:
        """The study's world; empty if it has a single one."""
        return self.study.world if len(self.study.worlds) > 1 else ""

    @property
    def where(self) -> str:
        """The study with its world and changed fields, for messages."""
        world = f" in {WORLDS[self.world].title}" if self.world else ""
        changed = shown_settings(self.study.settings)
        return f"{self.study.name}{world}" + (f" with {changed}" if changed else "")

    @property
    def label(self) -> str:
        """The study with its world, preset, and what is asked for beside the preset."""
        parts = [self.where]
        query = self.asked if self.plan is None else self.plan.query
        if self.plan is not None:
            parts.append(f"preset {self.plan.preset}")
        if query.conditions:
            parts.append(f"{' and '.join(query.conditions)} alone")
        if query.seeds is not None:
            parts.append(f"seeds {shown_seeds(query.seeds)}")
        if query.steps:
            parts.append(f"{self.steps or query.steps:,} steps")
        return ", ".join(parts)

    @property
    def steps(self) -> int | None:
        """Agent steps of each run; None if they differ."""
        if self.plan is not None:
            amounts = {cell.run.steps for cell in self.plan.cells}
        else:
            amounts = {*self.runs["steps"].tolist()}
        return amounts.pop() if len(amounts) == 1 else None

    def text(self, root: Path) -> str:
        """Return one line on what is shown of a results folder, and on what else there is."""
        finished, planned = self.finished, len(self.runs)
        published = int((finished["where"] != "").sum())
        if self.plan is not None:
            planned = len(self.plan.cells)
        count = f"{len(finished)} of {counted(planned, 'run')}"
        own = {config_id(run) for run in self.configurations.values()}
        older = int((~finished["config_id"].isin(own)).sum()) if own else 0
        origins = []
        if 0 < published < len(finished):
            origins.append(f"{len(finished) - published} trained here, {published} published")
        elif published:
            origins.append("published")
        if older:
            origins.append(f"{older} by another version")
        if origins:
            count += f" ({'; '.join(origins)})"
        text = f"{self.label}: {count}."
        if self.plan is not None and published and len(finished) < planned:
            words = ["pneuma", "study", "run", *query_words(self.plan), "--unpublished"]
            text += f" The others are trained by `{shlex.join(words)}`."
        if self.other_presets:
            others = [f"{name} ({counted(runs, 'run')})" for name, runs in self.other_presets.items()]
            text += f" Also: {', '.join(others)}."
        return text

    @property
    def about(self) -> dict[str, Any]:
        """Which runs of the study a document is about."""
        return {
            "study": self.study.name,
            "world": self.world or None,
            "preset": self.plan.preset if self.plan else None,
            "steps": self.steps,
            "seeds": sorted({*self.runs["seed"].tolist()}),
            "settings": dict(self.study.settings),
        }

    @property
    def narrowed(self) -> list[str]:
        """The preset, conditions, seeds and steps that were asked for, which figures' names contain."""
        asked, words = self.asked, []
        if asked.preset not in (None, LAST):
            words.append(str(asked.preset))
        if len(self.fields) < len(self.study.conditions):
            words += asked.conditions
        if asked.seeds is not None:
            words += ["seeds", *map(str, sorted(asked.seeds))]
        if asked.steps:
            words += ["steps", str(asked.steps)]
        return words

    @property
    def full_title(self) -> str:
        """The title with the world, unless levels or characters in it are others, and with changed fields."""
        own = any(
            is_own_level(str(run.fields.get("level", "")))
            or are_own_characters(str(run.fields.get("characters", "")))
            for run in self.rows
        )
        environments = {str(fields.get("env")) for fields in self.fields.values()}
        worlds = [f" in {each.title}" for each in WORLDS.values() if {each.env} == environments]
        changed = f" ({shown_settings(self.study.settings)})" if self.study.settings else ""
        return self.study.title + ("" if own else "".join(worlds)) + changed

    def basename(self, *parts: str) -> str:
        """Return the name of a figure's files, or of a table, without its ending.

        It contains the world, changed fields, and the preset, conditions, seeds and steps that were asked
        for, so that neither a variant nor a part of a study replaces the study's own figure.
        """
        slug = settings_name(self.study.settings, *filter(None, [*self.narrowed, *parts]))
        return "-".join(filter(None, [self.study.figure, self.world, slug]))

    @property
    def table_name(self) -> str:
        """The name of its published table."""
        return "-".join(filter(None, [self.study.name, self.world, settings_name(self.study.settings)]))

    # --- Rows -----------------------------------------------------------------------------------------

    @cached_property
    def rows(self) -> list[Row]:
        """The rows of the finished runs, in the table's order."""
        return [*self.runs["row"]]

    def of_condition(self, condition: str) -> list[Row]:
        """Return the rows of a condition's finished runs, in the order of their seeds."""
        return self._by_condition.get(condition, [])

    @cached_property
    def _by_condition(self) -> dict[str, list[Row]]:
        return {str(name): [*rows] for name, rows in self.runs.groupby("condition", sort=False)["row"]}

    def renamed(self, names: Mapping[str, str]) -> StudyData:
        """Return the study with its conditions under new names; those that have none are left out."""

        def of(table: Mapping[str, Any]) -> dict[str, Any]:
            return {names[name]: value for name, value in table.items() if name in names}

        study = self.study
        tables = {key: of(getattr(study, key)) for key in ("conditions", "labels", "levels")}
        tables["labels"] |= {name: label for name, label in study.labels.items() if name in names.values()}
        tables["colors"] = {names.get(name, name): colour for name, colour in study.colors.items()}
        baseline = names.get(study.baseline, next(iter(names.values())))
        runs = self.runs[self.runs["condition"].isin(names)]
        return replace(
            self,
            study=study.model_copy(update={**tables, "baseline": baseline}),
            fields=of(self.fields),
            runs=runs.assign(condition=runs["condition"].map(names)),
            configurations=of(self.configurations),
        )

    def of_conditions(self, names: str | Sequence[str]) -> StudyData:
        """Return the study with one or some of its conditions."""
        names = [names] if isinstance(names, str) else names
        for name in names:
            if name not in self.fields:
                raise unknown_name(f"condition of study {self.study.name}", name, self.fields)
        return replace(
            self,
            fields={name: fields for name, fields in self.fields.items() if name in names},
            runs=self.runs[self.runs["condition"].isin(names)],
            configurations={name: run for name, run in self.configurations.items() if name in names},
        )

    @property
    def what(self) -> str:
        """Where the runs are, for messages."""
        return " with ".join(sorted({run.what for run in self.rows}))

    def engines(self, condition: str) -> set[str]:
        return {str(engine) for run in self.of_condition(condition) if (engine := run.fields.get("engine"))}

    @property
    def ends(self) -> str:
        """Where runs end, for notes; empty if all end alike, but for rounding to whole horizons."""
        least, most = self.runs["steps"].min(), self.runs["steps"].max()
        unlike = f"Runs end at {least:,} to {most:,} steps, and each counts at its own end."
        return unlike if most > least * (1 + SLACK) else ""

    @cached_property
    def averaged_over(self) -> int | None:
        """Episodes over which returns were averaged when recorded; None if they were not."""
        return max((episodes for run in self.rows if (episodes := run.averaged_over)), default=None)

    @cached_property
    def evaluated(self) -> bool:
        return all(run.evaluation_columns for run in self.rows)

    @cached_property
    def evaluations(self) -> pd.DataFrame:
        """The evaluations of all runs: condition, seed, run_id, and the columns of the records."""
        tables = [run.evaluations_table() for run in self.rows]
        frame = pa.concat_tables(tables, promote_options="permissive").to_pandas(use_threads=False)
        counts = [table.num_rows for table in tables]
        for place, key in enumerate(NAMING):
            frame.insert(place, key, np.repeat(self.runs[key].to_numpy(), counts))
        return frame

    # --- Curves ---------------------------------------------------------------------------------------

    @property
    def budget(self) -> int:
        """Agent steps at which curves end: the most of any run."""
        return int(self.runs["steps"].max())

    @cached_property
    def grid(self) -> np.ndarray:
        """The steps of the points of curves, (points,)."""
        return make_grid(self.budget)

    @cached_property
    def windows(self) -> tuple[str, ...]:
        """The windows of `WINDOWS` that all returns have, the usual one first."""
        return tuple(name for name in WINDOWS if all(name in run.windows for run in self.rows))

    @cached_property
    def quantities(self) -> list[str]:
        """The training curves that some run has, of `TRAINING_QUANTITIES`.

        If some runs come from published tables, these are only the quantities in the tables, because a line
        over some runs of a condition would mislead.
        """
        published = {run.quantities for run in self.rows if run.published}
        some = dict.fromkeys(name for run in self.rows for name in run.quantities)
        return [name for name in some if all(name in names for names in published)]

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
                f"study {self.study.name}: {self.what} holds no {quantity} in the window {window}; "
                f"its curves are: {known}"
            )
        values = run.curve(quantity, window)
        return values if run.budget == self.budget else held_curve(run.grid, values, self.grid, run.end)

    def has_curve(self, quantity: str, window: str) -> bool:
        return all(window in run.windows_of(quantity) for run in self.rows)

    def checked_window(self, window: str | None) -> str:
        """Return a window of `windows`; the first if None."""
        if window is None:
            return self.windows[0]
        if window not in self.windows:
            raise unknown_name(f"window of study {self.study.name}", window, self.windows)
        return window


def join_studies(one: StudyData, other: StudyData) -> tuple[StudyData, dict[str, tuple[str, str]]]:
    """Return the runs of two studies as one study's, and the two new names of each condition that both have.

    Conditions are called CONDITION, STUDY.
    """
    words = [
        each.full_title if one.study.name == other.study.name else each.study.name for each in (one, other)
    ]
    both = [
        data.renamed({name: f"{name}, {word}" for name in data.conditions})
        for data, word in zip((one, other), words, strict=True)
    ]
    fields = {**both[0].fields, **both[1].fields}
    title = f"{one.study.title}, and {other.study.title}"
    changed = {"title": title, "conditions": fields, "labels": {}, "colors": {}, "settings": {}, "levels": {}}
    study = one.study.model_copy(update=changed)
    runs = pd.concat([each.runs for each in both], ignore_index=True)
    joined = StudyData(study, fields, runs, asked=one.asked)
    shared = [name for name in one.conditions if one.of_condition(name) and other.of_condition(name)]
    return joined, {name: (f"{name}, {words[0]}", f"{name}, {words[1]}") for name in shared}
