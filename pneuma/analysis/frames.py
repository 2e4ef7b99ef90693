"""A study's data: its finished runs, with their tables and curves, wherever they are stored.

    open_study → StudyData of FinishedRuns; StudyData, run and step → RunView

`open_study` (`pneuma.analysis.run_index`) makes the data. A run's `Records` give access to what is stored. A
`RunView` is the state of a run at a step. It uses only evaluations and curves on the study's grid, which runs
and published tables both have, so that both give the same numbers.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from typing import Any

import numpy as np
import pandas as pd

from pneuma.analysis import RECORD_TABLES, WINDOWS
from pneuma.analysis.published import PublishedRecords
from pneuma.analysis.records import Records, Series
from pneuma.analysis.series import make_grid
from pneuma.errors import UserError, counted, unknown_name
from pneuma.study.spec import VARIANT, list_studies, run_command, world_of
from pneuma.values import shown_settings
from pneuma.worlds import in_world, split_world

SLACK = 1 / 40
"""Budgets that differ by less than this share are equal: half the distance between evaluations."""


@dataclass(frozen=True)
class FinishedRun:
    """A finished run, done or diverged, which counts in every statistic.

    Attributes:
        fields: the run's fields as recorded, which may be untrusted.
        records: its records.
    """

    condition: str
    seed: int
    run_id: str
    fields: Mapping[str, Any] = field(repr=False)
    records: Records = field(compare=False, repr=False)

    @property
    def status(self) -> str:
        """'done' or 'diverged'."""
        return self.records.status.name

    @property
    def slots(self) -> int | None:
        """Players, over all worlds, from which the run collects; None if unknown."""
        slots, players = self.fields["slots"], self.fields.get("players", 1)
        return slots * players if isinstance(slots, int) and isinstance(players, int) else None

    @property
    def budget(self) -> int:
        """Agent steps that the run was to train."""
        steps: int = self.fields["steps"]
        return steps

    @property
    def begun(self) -> int:
        """Agent steps with which the run began: for a fork, those of its parent."""
        return self.fields.get("fork_step") or 0

    @property
    def end(self) -> int:
        """Agent steps trained; fewer than the budget if the run diverged."""
        return self.records.status.step

    def ends_before(self, step: float | None) -> bool:
        """Return whether the run's budget ends before `step`."""
        return step is not None and self.budget * (1 + SLACK) < step


class StudyData:
    """The finished runs of a study's selection, with their records. `open_study` makes it.

    Args:
        index: the records of each run by its id; other runs are ignored.
        record: a selection, as `pneuma.study.execute.selection_record` makes it.
        where: the results folder, for messages.

    Raises:
        UserError: when no run of the selection has finished, or the record's names are no file names:
            a results folder may be untrusted.
    """

    def __init__(self, index: Mapping[str, Records], record: Mapping[str, Any], where: str = "") -> None:
        self.index = index
        self.record = record
        self._where = where
        self.study: str = record["study"]
        self.changed: dict[str, Any] = dict(record.get("selection", {}).get("settings") or {})
        changes = shown_settings(self.changed)
        self.title: str = record["title"] + (f" ({changes})" if changes else "")
        for key in ("study", "figure"):
            if not re.fullmatch(r"(?!\.+$)[^/\\\0]+", record[key]):
                raise UserError(
                    f"the record of a study names its {key} {record[key]!r}, which is no file name"
                )
        name, named_world = split_world(self.study)
        self.world = world_of(record)
        self.own_name, _, self.variant = name.partition(VARIANT)
        self.figure = in_world(record["figure"], named_world)  # each world has its own
        self.picked: list[str] = record.get("picked", [])
        self.same: list[list[str]] = record["same"]
        planned = record["runs"]
        self.conditions: list[str] = list(dict.fromkeys(run["condition"] for run in planned))
        self.environments: list[str] = list(dict.fromkeys(run["run"]["env"] for run in planned))
        self.runs = [
            FinishedRun(run["condition"], run["seed"], run["run_id"], run["run"], index[run["run_id"]])
            for run in planned
            if index[run["run_id"]].status.finished
        ]
        self.left_out = len(planned) - len(self.runs)
        if not self.runs:
            raise UserError(
                f"no finished run of this selection of study {self.study} is in {where}: "
                f"{self.how_to_train} first"
            )

    def __repr__(self) -> str:
        conditions = ", ".join(f"{name} ({len(self.of_condition(name))})" for name in self.conditions)
        missing = f", {self.left_out} not finished" if self.left_out else ""
        return f"StudyData {self.study}: {counted(len(self.runs), 'run')} of {conditions}{missing}"

    def _repr_html_(self) -> str:
        """Return a notebook's view: the number of runs of each condition."""
        rows = [(name, len(self.of_condition(name))) for name in self.conditions]
        table = pd.DataFrame(rows, columns=["condition", "runs"])
        return f"<b>{escape(self.title)}</b>{table.to_html(index=False)}"

    @property
    def how_to_train(self) -> str:
        """How to train the study, if that is known; forks and searches have commands of their own."""
        shipped = self.own_name in list_studies()
        path = None if shipped else self.record.get("path")
        if shipped or path:
            return f"run `{run_command(self.study, path)}` with the same options"
        return "repeat the command that began it"

    @property
    def what(self) -> str:
        """Where the runs are, for messages."""
        here_first = sorted(self.runs, key=lambda run: run.records.published)
        return " with ".join(dict.fromkeys(run.records.what for run in here_first))

    @property
    def published(self) -> list[FinishedRun]:
        """The runs that come from published tables."""
        return [run for run in self.runs if run.records.published]

    def engines(self, condition: str) -> set[str]:
        """Return the engines that trained a condition's runs, as far as known."""
        runs = (run["run"] for run in self.record["runs"] if run["condition"] == condition)
        return {str(run["engine"]) for run in runs if run.get("engine")}

    @cached_property
    def budget(self) -> int:
        """Agent steps at which curves end: the largest budget of the runs and of their published tables."""
        tables = (run.records.budget for run in self.runs if isinstance(run.records, PublishedRecords))
        return self.record.get("budget") or max(*(run.budget for run in self.runs), 0, *tables)

    @cached_property
    def latest_first_evaluation(self) -> float:
        """The step from which every run has an evaluation; 0 if none has any."""
        if "evaluations" not in self.tables:
            return 0.0
        tables = (run.records.table("evaluations") for run in self.runs)
        return max((float(table["step"].iloc[0]) for table in tables if len(table)), default=0.0)

    @cached_property
    def grid(self) -> np.ndarray:
        """The steps of the points of curves, (points,)."""
        return make_grid(self.budget)

    @cached_property
    def windows(self) -> tuple[str, ...]:
        """The windows of `WINDOWS` that all curves have, the usual one first."""
        return tuple(name for name in WINDOWS if all(name in run.records.windows for run in self.runs))

    @cached_property
    def tables(self) -> tuple[str, ...]:
        """The tables of `RECORD_TABLES` that all runs have."""
        return tuple(name for name in RECORD_TABLES if all(name in run.records.tables for run in self.runs))

    @property
    def averaged_over(self) -> int | None:
        """Episodes over which returns were averaged when recorded; None if they were not."""
        return next((episodes for run in self.runs if (episodes := run.records.averaged_over)), None)

    @cached_property
    def quantities(self) -> list[str]:
        """The training curves that some run has, of `TRAINING_QUANTITIES`.

        If some runs come from published tables, these are only the quantities in the tables, because a line
        over some runs of a condition would mislead.
        """
        published = {run.records.quantities for run in self.published}
        some = dict.fromkeys(name for run in self.runs for name in run.records.quantities)
        return [name for name in some if all(name in names for names in published)]

    def of_conditions(self, names: str | Sequence[str]) -> StudyData:
        """Return the study with one or some of its conditions, on the same grid and for the same figure."""
        names = [names] if isinstance(names, str) else names
        for name in names:
            if name not in self.conditions:
                raise unknown_name(f"condition of study {self.study}", name, self.conditions)
        runs = [run for run in self.record["runs"] if run["condition"] in names]
        same = [[name for name in group if name in names] for group in self.same]
        same = [group for group in same if len(group) > 1]
        some = StudyData(
            self.index, {**self.record, "runs": runs, "same": same, "budget": self.budget}, self._where
        )
        some.figure = self.figure
        return some

    def of_condition(self, condition: str) -> list[FinishedRun]:
        """Return a condition's finished runs, in the selection's order."""
        return [run for run in self.runs if run.condition == condition]

    def table(self, name: str) -> pd.DataFrame:
        """Return one of `RECORD_TABLES` for all finished runs, in the selection's order.

        Columns are `condition`, `seed`, `run_id` and those of the table (`pneuma.engines.records`).
        """
        if name not in self.tables:
            known = ", ".join((*self.tables, "curves"))
            raise UserError(f"study {self.study}: {self.what} holds no {name}; there are {known}")
        naming = ["condition", "seed", "run_id"]
        keys = [(run.condition, run.seed, run.run_id) for run in self.runs]
        frame = pd.concat([run.records.table(name) for run in self.runs], keys=keys, names=naming)
        return frame.drop(columns=naming, errors="ignore").reset_index(naming).reset_index(drop=True)

    def curve(self, run: FinishedRun, quantity: str, window: str | None = None) -> np.ndarray:
        """Return a run's training curve on the study's grid, (points,); NaN where it has no value.

        Args:
            run: a finished run; its curve is blank if it lacks the quantity.
            quantity: one of `quantities`.
            window: one of `windows`; default: the first. Quantities of updates have only one.
        """
        window, records = self.checked_window(window), run.records
        if quantity in self.quantities and quantity not in records.quantities:
            return np.full(self.grid.shape, np.nan)
        if quantity not in self.quantities or not records.has_curve(quantity, window):
            known = ", ".join(self.quantities) or "none"
            raise UserError(
                f"study {self.study}: {self.what} holds no {quantity} in the window {window}; "
                f"its curves are: {known}"
            )
        return records.curve(quantity, window, self.grid, run.slots)

    def has_curve(self, quantity: str, window: str) -> bool:
        """Return whether all runs have the curve of a quantity in a window."""
        return all(run.records.has_curve(quantity, window) for run in self.runs)

    def checked_window(self, window: str | None) -> str:
        """Return a window of `windows`; the first if None."""
        if window is None:
            return self.windows[0]
        if window not in self.windows:
            raise unknown_name(f"window of study {self.study}", window, self.windows)
        return window


# --- A run up to a step -----------------------------------------------------------------------------


@dataclass(frozen=True)
class RunView:
    """A run as it stood at a step. A run that diverged has its last recorded values.

    Attributes:
        until: agent steps; the run's budget, or an earlier step.
        since: where means over evaluations begin.
    """

    data: StudyData
    run: FinishedRun
    until: float
    since: float = 0.0

    @property
    def last_step(self) -> float:
        """The last step that counts."""
        return self.until * (1 + SLACK)

    def evaluations(self, column: str) -> Series:
        """Return a column of the evaluations; empty if there is no such column."""
        if "evaluations" not in self.run.records.tables:
            return _NOTHING
        table = self.run.records.table("evaluations")
        if column not in table:
            return _NOTHING
        return self._finite(table["step"].to_numpy(float), table[column].to_numpy(float))

    def curve(self, quantity: str) -> Series:
        """Return the points of a training curve that have a value; empty if there is no such quantity."""
        records, grid = self.run.records, self.data.grid
        if quantity not in records.quantities:
            return _NOTHING
        return self._finite(grid, records.curve(quantity, self.data.windows[0], grid, self.run.slots))

    def peaks(self, quantity: str) -> Series:
        """Return, for each point, the extreme value of an update since the previous point."""
        if quantity not in self.run.records.quantities:
            return _NOTHING
        return self._finite(self.data.grid, self.run.records.peaks(quantity, self.data.grid))

    def _finite(self, step: np.ndarray, values: np.ndarray) -> Series:
        finite = np.isfinite(values) & (step <= self.last_step)
        return step[finite], values[finite]


_NOTHING: Series = np.empty(0), np.empty(0)


def view(data: StudyData, run: FinishedRun, at_step: float | None = None) -> RunView:
    """Return a run as it stood at `at_step`, or at its own budget if that is smaller or no step is given.

    A step is given if runs of different budgets are compared. Each was evaluated at equal parts of its own
    budget, so that their common range begins at the latest of their first evaluations.
    """
    since = 0.0 if at_step is None else data.latest_first_evaluation
    return RunView(data, run, min(run.budget, at_step or run.budget), since)


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


def step_words(data: StudyData) -> str:
    """Describe the common step and the runs that end before it."""
    if not data.averaged_over:
        return "the most that all runs were to reach"
    step = common_step(data)
    short = [f"{run.condition} {run.seed}" for run in data.runs if run.ends_before(step)]
    left_out = f" (left out, as they end before: {', '.join(short)})" if short else ""
    return f"the most that two thirds of the logs reached{left_out}"
