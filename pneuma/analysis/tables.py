"""Tidy tables: the records of a study's runs in one frame, a row for each episode, update or evaluation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import pandas as pd

from pneuma.errors import UserError
from pneuma.study.store import Store
from pneuma.study.tables import from_parquet


@dataclass(frozen=True)
class FinishedRun:
    """A run that counts in every statistic, done or diverged.

    Attributes:
        slots: worlds that it collected from.
        budget: agent steps that it was to train.
        end: agent steps that it trained; less than the budget where it diverged.
    """

    condition: str
    seed: int
    run_id: str
    slots: int
    budget: int
    end: int


class StudyData:
    """The finished runs of a study's selection and their records.

    Args:
        store: the results folder.
        record: a selection, as `pneuma.study.execute.selection_record` makes it.

    Raises:
        UserError: when no run of the selection has finished.
    """

    def __init__(self, store: Store, record: Mapping[str, Any]) -> None:
        self._store = store
        self._tables: dict[str, pd.DataFrame] = {}
        self.study: str = record["study"]
        self.title: str = record["title"]
        self.figure: str = record["figure"]
        self.same: list[list[str]] = record["same"]
        self.conditions: list[str] = list(dict.fromkeys(run["condition"] for run in record["runs"]))
        self.environments: list[str] = list(dict.fromkeys(run["run"]["env"] for run in record["runs"]))
        self.runs = [run for run in (self._finished(run) for run in record["runs"]) if run]
        self.left_out = len(record["runs"]) - len(self.runs)
        if not self.runs:
            raise UserError(
                f"no run of this selection of study {self.study} has finished in {store.root}: "
                f"run `pneuma study run {self.study}` with the same options first"
            )

    def _finished(self, run: Mapping[str, Any]) -> FinishedRun | None:
        status = self._store.status(run["run_id"])
        if not status.finished:
            return None
        settings = run["run"]
        return FinishedRun(
            run["condition"], run["seed"], run["run_id"], settings["slots"], settings["steps"], status.step
        )

    @property
    def budget(self) -> int:
        """The largest budget of the runs, in agent steps."""
        return max(run.budget for run in self.runs)

    def of_condition(self, condition: str) -> list[FinishedRun]:
        """Return the finished runs of a condition, in the selection's order."""
        return [run for run in self.runs if run.condition == condition]

    def table(self, name: str) -> pd.DataFrame:
        """Return one of `RECORD_TABLES` for every finished run, in the selection's order.

        Columns are `condition`, `seed`, `run_id` and those of the table (`pneuma.engines.base`).
        """
        if name not in self._tables:
            self._tables[name] = self._load(name)
        return self._tables[name]

    def _load(self, name: str) -> pd.DataFrame:
        frames = []
        for run in self.runs:
            frame = from_parquet(self._store.read_file(run.run_id, f"{name}.parquet")).to_pandas()
            for place, column in enumerate(("condition", "seed", "run_id")):
                frame.insert(place, column, getattr(run, column))
            frames.append(frame)
        return pd.concat(frames, ignore_index=True)
