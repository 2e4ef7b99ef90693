"""The first source of a study's data: the runs of a results folder, every episode and update of them."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pandas as pd

from pneuma.analysis import ACTION_QUANTITIES, EPISODE_QUANTITIES, RECORD_TABLES, UPDATE_QUANTITIES, WINDOWS
from pneuma.analysis.signs import Stretch, update_signs
from pneuma.analysis.tables import FinishedRun, told_seconds
from pneuma.analysis.windows import EXTREMES, TRAILING_EPISODES, episode_curve, peak_curve, update_curve
from pneuma.study.store import Status, Store
from pneuma.study.tables import from_parquet


class RunRecords:
    """The records of a results folder's runs, read when asked for and then kept."""

    what = "the results folder"
    tables = RECORD_TABLES
    windows = WINDOWS
    averaged_over = None

    def __init__(self, store: Store) -> None:
        self._store = store
        self._frames: dict[tuple[str, str], pd.DataFrame] = {}

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
        key = (run.run_id, name)
        if key not in self._frames:
            data = self._store.read_file(run.run_id, f"{name}.parquet")
            self._frames[key] = from_parquet(data).to_pandas()
        return self._frames[key]

    def curve(self, run: FinishedRun, quantity: str, window: str, grid: np.ndarray) -> np.ndarray:
        """Return a run's windowed mean on the grid, (points,), blank until every slot has finished one."""
        if quantity in UPDATE_QUANTITIES:
            updates = self.table(run, "metrics")
            return update_curve(_column(updates, "step"), _column(updates, quantity), grid, run.end)
        episodes = self._episodes(run)
        begins = episodes.groupby("slot")["step"].min()
        return episode_curve(
            _column(episodes, "step"),
            _column(episodes, quantity),
            grid,
            trailing=window == "trailing-100",
            from_step=begins.max() if len(begins) == run.slots else np.inf,
            end=run.end,
        )

    def final(self, run: FinishedRun, quantity: str) -> float:
        """Return the mean of the last 100 episodes that ended, or the last update's value."""
        if quantity in UPDATE_QUANTITIES:
            last = _column(self.table(run, "metrics"), quantity)[-1:]
        else:
            last = _column(self._episodes(run), quantity)[-TRAILING_EPISODES:]
        return float(last.mean()) if len(last) else float("nan")

    def peaks(self, run: FinishedRun, quantity: str, grid: np.ndarray) -> np.ndarray:
        """Return the extreme update since each point before, (points,)."""
        updates = self.table(run, "metrics")
        return peak_curve(_column(updates, "step"), _column(updates, quantity), grid, EXTREMES[quantity])

    def signs(self, run: FinishedRun) -> dict[str, list[Stretch]]:
        """Return where every sign that updates tell of holds."""
        updates = self.table(run, "metrics")
        columns = {name: _column(updates, name) for name in ("entropy", "dead_units", *ACTION_QUANTITIES)}
        return update_signs(_column(updates, "step"), columns, len(ACTION_QUANTITIES))

    def kept_outcome(self, run: FinishedRun, name: str) -> float | None:
        """Return none: all are taken from the records."""
        return None

    def wall_seconds(self, run: FinishedRun) -> float | None:
        """Return what the run's provenance tells."""
        return told_seconds(self.provenance(run))

    def provenance(self, run: FinishedRun) -> dict[str, Any]:
        """Return what produced a run.

        Raises:
            UserError: when its file is missing or damaged.
        """
        found: dict[str, Any] = json.loads(self._store.read_file(run.run_id, "provenance.json"))
        return found

    def _episodes(self, run: FinishedRun) -> pd.DataFrame:
        return self.table(run, "episodes").sort_values("step", kind="stable")


def _column(frame: pd.DataFrame, name: str) -> np.ndarray:
    return frame[name].to_numpy(float)
