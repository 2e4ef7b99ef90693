"""A study's data: its finished runs, their tables and their curves, wherever these come from.

`open_study` (`pneuma.analysis.run_index`) makes it; it is what all further steps read. What is held of a run
tells its `Records`.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from pneuma.analysis import RECORD_TABLES, WINDOWS
from pneuma.analysis.records import Records
from pneuma.analysis.windows import make_grid
from pneuma.errors import UserError, unknown_name
from pneuma.study.spec import list_studies, run_command
from pneuma.worlds import in_world, split_world


@dataclass(frozen=True)
class FinishedRun:
    """A run that counts in every statistic, done or diverged.

    Attributes:
        slots: players, over all worlds, that it collected from; None where that is not known.
        budget: agent steps that it was to train.
        end: agent steps that it trained; less than the budget where it diverged.
        records: what is held of it.
        status: 'done' or 'diverged'.
        begun: agent steps with which it began: those of its parent, of a fork.
    """

    condition: str
    seed: int
    run_id: str
    slots: int | None
    budget: int
    end: int
    records: Records = field(compare=False, repr=False)
    status: str = "done"
    begun: int = 0


class StudyData:
    """The finished runs of a study's selection, and their records. `open_study` makes it.

    Args:
        index: what is held of each run of the record, by its id; more besides is passed over.
        record: a selection, as `pneuma.study.execute.selection_record` makes it.
        where: the results folder, for people.

    Raises:
        UserError: when no run of the selection has finished, or the record's names are no file names:
            a results folder may be a stranger's.
    """

    def __init__(self, index: Mapping[str, Records], record: Mapping[str, Any], where: str = "") -> None:
        self.index = index
        self.record = record
        self._where = where
        self.study: str = record["study"]
        self.title: str = record["title"]
        self.figure: str = record["figure"]
        for key in ("study", "figure"):
            if not re.fullmatch(r"(?!\.+$)[^/\\\0]+", record[key]):
                raise UserError(
                    f"the record of a study names its {key} {record[key]!r}, which is no file name"
                )
        self.own_name, self.world = split_world(self.study)
        self.figure = in_world(self.figure, self.world)  # each has figures
        self.same: list[list[str]] = record["same"]
        self.conditions: list[str] = list(dict.fromkeys(run["condition"] for run in record["runs"]))
        self.environments: list[str] = list(dict.fromkeys(run["run"]["env"] for run in record["runs"]))
        self.runs = [run for run in (self._finished(run) for run in record["runs"]) if run]
        self.left_out = len(record["runs"]) - len(self.runs)
        if not self.runs:
            raise UserError(
                f"no run of this selection of study {self.study} has finished in {where}: "
                f"{self.how_to_train} first"
            )

    @property
    def how_to_train(self) -> str:
        """What trains the study, where it is known: forks and searches are none of `study run`'s."""
        is_shipped = self.own_name in list_studies()
        path = None if is_shipped else self.record.get("path")
        if path is None and not is_shipped:
            return "repeat the command that began it"
        return f"run `{run_command(self.study, path)}` with the same options"

    def _finished(self, run: Mapping[str, Any]) -> FinishedRun | None:
        records, fields = self.index[run["run_id"]], run["run"]
        if not records.status.finished:
            return None
        slots, players = fields["slots"], fields.get("players", 1)
        if isinstance(slots, int) and isinstance(players, int):
            slots *= players
        told = run["condition"], run["seed"], run["run_id"], slots, fields["steps"], records.status.step
        return FinishedRun(*told, records, records.status.name, fields.get("fork_step") or 0)

    @property
    def what(self) -> str:
        """Where its runs are, for people."""
        return " with ".join(dict.fromkeys(run.records.what for run in sorted(self.runs, key=_is_published)))

    @property
    def published(self) -> list[FinishedRun]:
        """Those of its runs that are had from published tables."""
        return [run for run in self.runs if _is_published(run)]

    def engines(self, condition: str) -> set[str]:
        """Return which engines trained a condition's runs, as far as it is known."""
        runs = (run["run"] for run in self.record["runs"] if run["condition"] == condition)
        return {str(run["engine"]) for run in runs if run.get("engine")}

    @cached_property
    def budget(self) -> int:
        """The largest budget of the runs, in agent steps; in a published table, of all that it holds."""
        return self.record.get("budget") or max(run.budget for run in self.runs)

    @cached_property
    def latest_first_evaluation(self) -> float:
        """The step from which on every run has been evaluated; 0 where none was."""
        if "evaluations" not in self.tables:
            return 0.0
        tables = (run.records.table("evaluations") for run in self.runs)
        return max((float(table["step"].iloc[0]) for table in tables if len(table)), default=0.0)

    @property
    def grid(self) -> np.ndarray:
        """The steps at which curves have their points, (points,)."""
        return make_grid(self.budget)

    @cached_property
    def windows(self) -> tuple[str, ...]:
        """Those of `WINDOWS` that its curves can be had with, the usual one first."""
        return tuple(name for name in WINDOWS if all(name in run.records.windows for run in self.runs))

    @cached_property
    def tables(self) -> tuple[str, ...]:
        """Those of `RECORD_TABLES` that there are."""
        return tuple(name for name in RECORD_TABLES if all(name in run.records.tables for run in self.runs))

    @property
    def averaged_over(self) -> int | None:
        """Episodes that every return was already averaged over when it was recorded; None for none."""
        return next((own for run in self.runs if (own := run.records.averaged_over)), None)

    @cached_property
    def quantities(self) -> list[str]:
        """What curves some run has, of `EPISODE_QUANTITIES` and `UPDATE_QUANTITIES`.

        Only those that published tables have where runs are had from such: a line over some of a
        condition's runs would mislead.
        """
        held = {run.records.quantities for run in self.published}
        some = dict.fromkeys(name for run in self.runs for name in run.records.quantities)
        return [name for name in some if all(name in own for own in held)]

    @cached_property
    def _settings(self) -> dict[tuple[str, str], Mapping[str, Any]]:
        return {(run["condition"], run["run_id"]): run["run"] for run in self.record["runs"]}

    def settings(self, run: FinishedRun) -> Mapping[str, Any]:
        """Return a run's settings, as its record has them, which may be a stranger's."""
        return self._settings[run.condition, run.run_id]

    def of_conditions(self, names: Sequence[str]) -> StudyData:
        """Return the study with some conditions, or one, alone, on the same grid and for the same figure.

        Raises:
            UserError: for a condition that it has not, or when no run of theirs has finished.
        """
        wanted = [names] if isinstance(names, str) else names
        for name in wanted:
            if name not in self.conditions:
                raise unknown_name(f"condition of study {self.study}", name, self.conditions)
        runs = [run for run in self.record["runs"] if run["condition"] in wanted]
        held = {run["condition"] for run in runs}
        same = [[name for name in group if name in held] for group in self.same]
        same = [group for group in same if len(group) > 1]
        record = {**self.record, "runs": runs, "same": same, "budget": self.budget}
        some = StudyData(self.index, record, self._where)
        some.figure = self.figure
        return some

    def of_condition(self, condition: str) -> list[FinishedRun]:
        """Return the finished runs of a condition, in the selection's order."""
        return [run for run in self.runs if run.condition == condition]

    def table(self, name: str) -> pd.DataFrame:
        """Return one of `RECORD_TABLES` of the finished runs in the selection's order.

        Columns are `condition`, `seed`, `run_id` and those of the table (`pneuma.engines.records`).

        Raises:
            UserError: where there is no such table.
        """
        frames = []
        for run in self.runs:
            frame = self.run_table(run, name)
            for place, column in enumerate(("condition", "seed", "run_id")):
                frame.insert(place, column, getattr(run, column))
            frames.append(frame)
        return pd.concat(frames, ignore_index=True)

    def run_table(self, run: FinishedRun, name: str) -> pd.DataFrame:
        """Return one of `RECORD_TABLES` of one run.

        Raises:
            UserError: where there is no such table.
        """
        if name not in self.tables:
            raise UserError(
                f"study {self.study}: {self.what} holds no {name}; "
                f"there are {', '.join((*self.tables, 'curves'))}"
            )
        return run.records.table(name).copy(deep=False)  # that of all who ask is not to be written on

    def curve(self, run: FinishedRun, quantity: str, window: str | None = None) -> np.ndarray:
        """Return a run's training curve on the study's grid, (points,), NaN where it has no value.

        Args:
            run: one of the finished runs.
            quantity: one of `quantities`; a run that lacks it is blank throughout.
            window: one of `windows`, the first when left out; what updates have has only one.

        Raises:
            UserError: for a quantity or window that there is not.
        """
        self._check(quantity)
        window = self.checked_window(window)
        if quantity not in run.records.quantities:
            return np.full(self.grid.shape, np.nan)
        return run.records.curve(quantity, window, self.grid, run.slots)

    def final(self, run: FinishedRun, quantity: str) -> float:
        """Return the mean of a run's last 100 episodes (of its last update, for what updates have).

        At the run's own end, also where that came early; NaN where there is no value.

        Raises:
            UserError: for a quantity that there is not.
        """
        self._check(quantity)
        return run.records.final(quantity) if quantity in run.records.quantities else float("nan")

    def checked_window(self, window: str | None) -> str:
        """Return a window of `windows`, the first for None.

        Raises:
            UserError: for another.
        """
        if window is None:
            return self.windows[0]
        if window not in WINDOWS:
            raise unknown_name("window", window, WINDOWS)
        if window not in self.windows:
            raise UserError(
                f"window {window} cannot be had of study {self.study}: {self.what} holds returns that "
                f"were averaged over {self.averaged_over} episodes; {', '.join(self.windows)} can"
            )
        return window

    def _check(self, quantity: str) -> None:
        if quantity not in self.quantities:
            held = ", ".join(self.quantities) or "none"
            raise UserError(f"study {self.study}: {self.what} holds no {quantity}; its curves are: {held}")


def _is_published(run: FinishedRun) -> bool:
    return run.records.published


def tell_figures_apart(studies: Sequence[StudyData]) -> None:
    """Give studies whose figures would be files of one name the study's as well."""
    stems = Counter(data.figure for data in studies)
    for data in studies:
        if stems[data.figure] > 1:
            data.figure += f"-{data.study}"
