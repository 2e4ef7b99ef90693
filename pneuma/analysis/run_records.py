"""The first source of a study's data: the runs of a results folder, every episode and update of them."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd

from pneuma.analysis import ACTION_QUANTITIES, EPISODE_QUANTITIES, RECORD_TABLES, UPDATE_QUANTITIES, WINDOWS
from pneuma.analysis.kept import Kept
from pneuma.analysis.signs import Stretch, update_signs
from pneuma.analysis.tables import FinishedRun, told_seconds, told_share
from pneuma.analysis.windows import EXTREMES, TRAILING_EPISODES, episode_curve, peak_curve, update_curve
from pneuma.study.store import Status, Store
from pneuma.study.tables import from_parquet

Columns = Mapping[str, np.ndarray]

ROOM_BYTES = 256_000_000
"""Of the columns of tables that are kept, and of the frames of evaluations as well."""
FRAME_BYTES = 10_000
"""What pandas takes for a small frame beside its numbers."""


class RunRecords:
    """The records of a results folder's runs, read when asked for and then kept while there is room."""

    what = "the results folder"
    tables: tuple[str, ...] = RECORD_TABLES
    windows: tuple[str, ...] = WINDOWS
    averaged_over: int | None = None

    def __init__(self, store: Store) -> None:
        self._store = store
        self._columns: Kept[Columns] = Kept(ROOM_BYTES)
        self._frames: Kept[pd.DataFrame] = Kept(ROOM_BYTES)

    def status(self, run_id: str) -> Status:
        """Return how a run stands in the store."""
        return self._store.status(run_id)

    def quantities(self, run: FinishedRun) -> tuple[str, ...]:
        """Return all there are: every run has every table."""
        return (*EPISODE_QUANTITIES, *UPDATE_QUANTITIES)

    def table(self, run: FinishedRun, name: str) -> pd.DataFrame:
        """Return one of `RECORD_TABLES` of a run.

        Raises:
            UserError: when its file is missing or damaged.
        """
        if name != "evaluations":
            return self._read(run, name)
        return self._frames.get(run.run_id, lambda: self._read(run, name), _frame_bytes)

    def curve(self, run: FinishedRun, quantity: str, window: str, grid: np.ndarray) -> np.ndarray:
        """Return a run's windowed mean on the grid, (points,), blank until every slot has finished one."""
        if quantity in UPDATE_QUANTITIES:
            updates = self.columns(run, "metrics")
            return update_curve(_floats(updates, "step"), _floats(updates, quantity), grid, run.end)
        episodes = self.columns(run, "episodes")
        _, first = np.unique(episodes["slot"], return_index=True)  # of each slot, as episodes are in order
        step = _floats(episodes, "step")
        return episode_curve(
            step,
            _floats(episodes, quantity),
            grid,
            trailing=window == "trailing-100",
            from_step=step[first].max() if len(first) == run.slots else np.inf,
            end=run.end,
        )

    def final(self, run: FinishedRun, quantity: str) -> float:
        """Return the mean of the last 100 episodes that ended, or the last update's value."""
        if quantity in UPDATE_QUANTITIES:
            last = _floats(self.columns(run, "metrics"), quantity)[-1:]
        else:
            last = _floats(self.columns(run, "episodes"), quantity)[-TRAILING_EPISODES:]
        return float(last.mean()) if len(last) else float("nan")

    def peaks(self, run: FinishedRun, quantity: str, grid: np.ndarray) -> np.ndarray:
        """Return the extreme update since each point before, (points,)."""
        updates = self.columns(run, "metrics")
        return peak_curve(_floats(updates, "step"), _floats(updates, quantity), grid, EXTREMES[quantity])

    def signs(self, run: FinishedRun) -> dict[str, list[Stretch]]:
        """Return where every sign that updates tell of holds."""
        updates = self.columns(run, "metrics")
        columns = {name: _floats(updates, name) for name in ("entropy", "dead_units", *ACTION_QUANTITIES)}
        return update_signs(_floats(updates, "step"), columns, len(ACTION_QUANTITIES))

    def kept_outcome(self, run: FinishedRun, name: str) -> float | None:
        """Return none: all are taken from the records."""
        return None

    def wall_seconds(self, run: FinishedRun) -> float | None:
        """Return what the run's provenance tells."""
        return told_seconds(self.provenance(run))

    def processor_share(self, run: FinishedRun) -> float | None:
        """Return what the run's provenance tells."""
        return told_share(self.provenance(run))

    def provenance(self, run: FinishedRun) -> dict[str, Any]:
        """Return what produced a run.

        Raises:
            UserError: when its file is missing or damaged.
        """
        found: dict[str, Any] = json.loads(self._store.read_file(run.run_id, "provenance.json"))
        return found

    def columns(self, run: FinishedRun, name: str) -> Columns:
        """Return the columns of episodes or metrics by name, (rows,) each, rows in the order of their steps.

        Raises:
            UserError: when its file is missing or damaged.
        """
        key = (run.run_id, name)
        return self._columns.get(key, lambda: self._read_columns(run, name), _column_bytes)

    def _read_columns(self, run: FinishedRun, name: str) -> Columns:
        table = from_parquet(self._store.read_file(run.run_id, f"{name}.parquet"))
        own = {key: table[key].to_numpy() for key in table.column_names if key != "ending"}
        order = np.argsort(own["step"], kind="stable")
        return {key: column[order] for key, column in own.items()}

    def _read(self, run: FinishedRun, name: str) -> pd.DataFrame:
        return from_parquet(self._store.read_file(run.run_id, f"{name}.parquet")).to_pandas()


def _floats(columns: Columns, name: str) -> np.ndarray:
    return columns[name].astype(float, copy=False)


def _column_bytes(columns: Columns) -> int:
    return sum(column.nbytes for column in columns.values())


def _frame_bytes(frame: pd.DataFrame) -> int:
    return 8 * frame.size + FRAME_BYTES
