"""The third source of a study's data: its published table, small enough to be kept under version control.

results/published/STUDY.parquet holds a row for each run: what it was, how it ended, its curves on the
study's grid in every window, final values, its evaluations whole, and what produced it. The same
runs give the same bytes. Nothing is ever trained from it.

The file's metadata holds the study's title and conditions, and a checksum over all other bytes,
which is compared before anything else is read.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from pneuma.analysis import EPISODE_QUANTITIES, UPDATE_QUANTITIES, WINDOWS
from pneuma.analysis.checksums import is_whole
from pneuma.analysis.packed import unpack_signs
from pneuma.analysis.published_times import read_times
from pneuma.analysis.signs import Stretch
from pneuma.analysis.tables import FinishedRun, told_seconds, told_share
from pneuma.errors import UserError
from pneuma.study.store import Status, Store, read_whole
from pneuma.study.tables import from_parquet

SCHEMA = 2
PUBLISHED = "published"
"""The tables' folder, in a results folder."""

SUFFIX = ".parquet"
NAMING = ("condition", "seed", "run_id", "status")
"""The columns that say which run a row is; all others hold its numbers."""

EVALUATIONS = "evaluations"
"""The one record table that is kept."""

PEAKS = "extreme"
SIGNS = "signs"
OUTCOME = "outcome "


def published_path(store: Store, study: str) -> Path:
    """Return where a study's published table lies."""
    return store.root / PUBLISHED / f"{study}{SUFFIX}"


def published_studies(store: Store) -> list[str]:
    """Return the names of the studies that have a published table."""
    return sorted(path.stem for path in (store.root / PUBLISHED).glob(f"*{SUFFIX}"))


def read_published(store: Store, study: str) -> PublishedRuns:
    """Read a study's published table.

    Raises:
        UserError: when it is missing or not what was written.
    """
    path = published_path(store, study)
    try:
        data = read_whole(path)
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror})") from None
    if not is_whole(data):
        raise UserError(f"{path}: damaged; take it from version control again, or publish the study anew")
    try:
        table = from_parquet(data)
        head = json.loads(table.schema.metadata[b"pneuma"])
        schema = head["schema"]
        runs = PublishedRuns(head, table, read_times(store, study)) if schema == SCHEMA else None
    except (pa.ArrowException, TypeError, KeyError, ValueError):
        raise UserError(f"{path}: is no published table of a study") from None
    if runs is None:
        raise UserError(f"{path}: of schema {schema}, which this version of Pneuma cannot read")
    return runs


class PublishedRuns:
    """The runs of a published table.

    Attributes:
        head: what the file's metadata holds.
        times: what the file of times beside it tells of each run.
    """

    what = "the published table"

    def __init__(self, head: Mapping[str, Any], table: pa.Table, times: Mapping[str, Any]) -> None:
        self.head = head
        self._table = table
        self.times = times
        self._frames: dict[str, pd.DataFrame] = {}
        self._place = {run_id: place for place, run_id in enumerate(table["run_id"].to_pylist())}
        self.tables: tuple[str, ...] = tuple(head["tables"])
        self.windows: tuple[str, ...] = tuple(head["windows"])
        self.averaged_over: int | None = head["averaged_over"]

    @property
    def record(self) -> dict[str, Any]:
        """The study's record, in the form of `pneuma.study.execute.selection_record`."""
        names = ("condition", "seed", "run_id", "settings")
        rows = zip(*(self._table[name].to_pylist() for name in names), strict=True)
        runs = [{"condition": c, "seed": s, "run_id": i, "run": json.loads(run)} for c, s, i, run in rows]
        kept = [*("study", "title", "figure", "baseline", "same", "budget"), *({"adaptive"} & {*self.head})]
        return {**{key: self.head[key] for key in kept}, "source": "published", "path": None, "runs": runs}

    def status(self, run_id: str) -> Status:
        """Return how a run ended; 'planned' where the table does not hold it."""
        if run_id not in self._place:
            return Status("planned")
        return Status(self._cell(run_id, "status"), self._cell(run_id, "end") or 0)

    @property
    def run_ids(self) -> tuple[str, ...]:
        """The runs of the table, each once."""
        return tuple(self._place)

    @cached_property
    def finished(self) -> frozenset[str]:
        """Those of them that have numbers."""
        return frozenset(run_id for run_id in self._place if self.status(run_id).finished)

    @property
    def column_types(self) -> dict[str, pa.DataType]:
        """The columns that runs have their numbers in, in order, and what they hold."""
        return {field.name: field.type for field in self._table.schema if field.name not in NAMING}

    def rounds_as(self, rounding: bool) -> bool:
        """Tell whether curves are rounded, or not, as is asked; older tables tell it by their types alone.

        Of those without a curve of episodes nothing tells it, and either is taken for granted.
        """
        if "rounded" in self.head:
            return bool(self.head["rounded"] == rounding)
        kinds = [kind for name, kind in self.column_types.items() if name.endswith(f" {WINDOWS[0]}")]
        return not kinds or (kinds[0].value_type == pa.float32()) == rounding

    def row(self, run_id: str) -> dict[str, Any]:
        """Return a run's cells in these columns, as they are kept."""
        return {name: self._cell(run_id, name) for name in self.column_types}

    def rows(self, run_ids: Iterable[str], columns: Iterable[str]) -> pa.Table:
        """Return what names and counts these runs, each once, as a table of these columns."""
        places = [self._place[run_id] for run_id in run_ids]
        table = self._table.select([*NAMING, *columns]).take(pa.array(places, pa.int64()))
        return table.replace_schema_metadata()

    @property
    def curve_names(self) -> tuple[str, ...]:
        """The quantities whose curves the table has columns for."""
        names = (*EPISODE_QUANTITIES, *UPDATE_QUANTITIES)
        held = self._table.column_names
        return tuple(name for name in names if {name, f"{name} {self.windows[0]}"} & {*held})

    def quantities(self, run: FinishedRun) -> tuple[str, ...]:
        """Return what is held of a run: of each the same."""
        return self.curve_names

    def table(self, run: FinishedRun, name: str) -> pd.DataFrame:
        """Return a run's evaluations, the one table that is kept; made once."""
        if run.run_id not in self._frames:
            rows = self._table[name][self._place[run.run_id]].as_py()
            fields = self._table.schema.field(name).type.value_type
            kinds = {field.name: field.type.to_pandas_dtype() for field in fields}
            columns = {own: np.array([row[own] for row in rows], kind) for own, kind in kinds.items()}
            self._frames[run.run_id] = pd.DataFrame(columns)
        return self._frames[run.run_id]

    def curve(self, run: FinishedRun, quantity: str, window: str, grid: np.ndarray) -> np.ndarray:
        """Return a run's curve, (points,); the grid is the one that the study was published on."""
        column = quantity if quantity in UPDATE_QUANTITIES else f"{quantity} {window}"
        if column not in self._table.column_names:
            raise UserError(f"{self.what} holds {quantity} by the window {self.windows[0]} alone")
        return np.array(self._cell(run.run_id, column), float)

    def final(self, run: FinishedRun, quantity: str) -> float:
        """Return the mean of a run's last 100 episodes, or its last update's value."""
        return float(self._cell(run.run_id, f"final_{quantity}"))

    def peaks(self, run: FinishedRun, quantity: str, grid: np.ndarray) -> np.ndarray:
        """Return the extreme update since each point before, (points,)."""
        return np.array(self._cell(run.run_id, f"{quantity} {PEAKS}"), float)

    def signs(self, run: FinishedRun) -> dict[str, list[Stretch]]:
        """Return where signs of collapse hold."""
        return unpack_signs(self._cell(run.run_id, SIGNS))

    @property
    def kept_outcomes(self) -> frozenset[str]:
        """The outcomes that were taken from curves before they were rounded or left out."""
        return frozenset(name.removeprefix(OUTCOME) for name in self.column_types if name.startswith(OUTCOME))

    def kept_outcome(self, run: FinishedRun, name: str) -> float | None:
        """Return one of `kept_outcomes`, None for another."""
        if OUTCOME + name not in self._table.column_names:
            return None
        return float(self._cell(run.run_id, OUTCOME + name))

    def wall_seconds(self, run: FinishedRun) -> float | None:
        """Return how long a run trained, where the file of times beside the table tells."""
        return told_seconds(self.times.get(run.run_id, {}))

    def processor_share(self, run: FinishedRun) -> float | None:
        """Return how much of a core it had, where that file tells."""
        return told_share(self.times.get(run.run_id, {}))

    def provenance(self, run: FinishedRun) -> dict[str, Any]:
        """Return what produced a run, without when it did."""
        found: dict[str, Any] = json.loads(self._cell(run.run_id, "provenance"))
        return found

    def _cell(self, run_id: str, column: str) -> Any:
        return self._table[column][self._place[run_id]].as_py()
