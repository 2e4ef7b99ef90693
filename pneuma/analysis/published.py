"""The third source of a study's data: its published table, small enough to be kept under version control.

results/published/STUDY.parquet holds a row for each run: what it was, how it ended, its curves on the
study's grid in every window, final values, its evaluations whole, and what produced it. The same
runs give the same bytes. Nothing is ever trained from it.

The file's metadata holds the study's title and conditions, and a checksum over all other bytes,
which is compared before anything else is read.
"""

from __future__ import annotations

import hashlib
import io
import json
import re
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from pneuma.analysis import EPISODE_QUANTITIES, PEAKED_QUANTITIES, UPDATE_QUANTITIES
from pneuma.analysis.outcomes import outcome, outcomes_of_curves
from pneuma.analysis.packed import pack_signs, rounded, unpack_signs
from pneuma.analysis.published_times import read_times
from pneuma.analysis.signs import Stretch
from pneuma.analysis.tables import FinishedRun, StudyData
from pneuma.errors import UserError
from pneuma.study.store import Status, Store
from pneuma.study.tables import from_parquet

SCHEMA = 2
PUBLISHED = "published"
"""The tables' folder, in a results folder."""

SUFFIX = ".parquet"

KEPT_PROVENANCE = ("python", "packages", "commit", "system", "cpu", "threads", "imported", "damage")
"""What produced a run, without the times at which it did: a run that is trained again publishes the same."""

_EVALUATIONS = "evaluations"
_PEAKS = "extreme"
_SIGNS = "signs"
_OUTCOME = "outcome "
_NO_SUM = "sha256:" + "0" * 64
_SUM = re.compile(rb"sha256:([0-9a-f]{64})")


# --- Writing ---------------------------------------------------------------------------------------


def encode_study(data: StudyData, curves: Collection[str] | None = None, rounding: bool = False) -> bytes:
    """Return the published table of a study; the same runs give the same bytes.

    Runs of the selection that are not finished keep their place, without numbers.

    Args:
        data: the study.
        curves: of which quantities curves are kept; left out: all. Outcomes are kept of all.
        rounding: whether curves are kept to a thousandth of their range.
    """
    finished = {(run.condition, run.run_id): run for run in data.runs}
    selected = data.record["runs"]
    kept = tuple(name for name in data.quantities if curves is None or name in curves)
    kinds = _cell_types(data, kept, rounding)
    cells: dict[str, list[Any]] = {name: [] for name in kinds}
    for told in selected:
        run = finished.get((told["condition"], told["run_id"]))
        own = {"settings": json.dumps(told["run"]), **(_cells(data, run, kept, rounding) if run else {})}
        for name in kinds:
            cells[name].append(own.get(name))
    columns = {
        "condition": pa.array([run["condition"] for run in selected], pa.string()),
        "seed": pa.array([run["seed"] for run in selected], pa.int64()),
        "run_id": pa.array([run["run_id"] for run in selected], pa.string()),
        "status": pa.array([_status(data, finished, run) for run in selected], pa.string()),
        **{name: pa.array(cells[name], kind) for name, kind in kinds.items()},
    }
    head = {"pneuma": json.dumps(_head(data)), "pneuma.checksum": _NO_SUM}
    return _with_sum(_compressed(pa.table(columns, metadata=head)))


def _status(data: StudyData, finished: Mapping[tuple[str, str], FinishedRun], run: Mapping[str, Any]) -> str:
    own = finished.get((run["condition"], run["run_id"]))
    return own.status if own else data.source.status(run["run_id"]).name


def _cell_types(data: StudyData, curves: Collection[str], rounding: bool) -> dict[str, pa.DataType]:
    """Return the type of every column that finished runs have a value in, in the order of columns."""
    kinds = {"end": pa.int64(), "settings": pa.string(), "provenance": pa.string()}
    for quantity in data.quantities:
        kinds[f"final_{quantity}"] = pa.float64()
        if quantity in curves:
            columns = _curve_columns(quantity, data.windows, rounding)
            kinds |= {name: pa.list_(kind) for name, _, kind in columns}
            kinds |= {f"{quantity} {_PEAKS}": pa.list_(pa.float32())} if quantity in PEAKED_QUANTITIES else {}
    kinds |= {_OUTCOME + name: pa.float64() for name in outcomes_of_curves(data)}
    kinds[_SIGNS] = pa.string()
    return kinds | ({_EVALUATIONS: _row_type(data)} if _EVALUATIONS in data.tables else {})


def _cells(data: StudyData, run: FinishedRun, curves: Collection[str], rounding: bool) -> dict[str, Any]:
    """Return what a finished run has in every column: run by run, each table is read once for all of them."""
    cells: dict[str, Any] = {"end": run.end, "provenance": _provenance(data, run)}
    for quantity in data.quantities:
        cells[f"final_{quantity}"] = data.final(run, quantity)
        if quantity not in curves:
            continue
        for name, window, kind in _curve_columns(quantity, data.windows, rounding):
            values = data.curve(run, quantity, window)
            cells[name] = (rounded(values) if rounding else values).astype(kind.to_pandas_dtype())
        if quantity in PEAKED_QUANTITIES:
            values = data.peaks(run, quantity)
            cells[f"{quantity} {_PEAKS}"] = (rounded(values) if rounding else values).astype(np.float32)
    cells |= {_OUTCOME + name: outcome(data, run, name) for name in outcomes_of_curves(data)}
    cells[_SIGNS] = pack_signs(data.source.signs(run))
    if _EVALUATIONS in data.tables:
        cells[_EVALUATIONS] = data.source.table(run, _EVALUATIONS).to_dict("records")
    return cells


def _curve_columns(
    quantity: str, windows: tuple[str, ...], rounding: bool
) -> list[tuple[str, str, pa.DataType]]:
    """Return name, window and type of every column of a quantity's curves; updates have one window.

    Types are wide enough to hold every curve of `pneuma.analysis.windows` exactly, where none is rounded.
    Of small tables' episodes, only returns have the window of the thesis's figures.
    """
    if quantity in UPDATE_QUANTITIES:
        return [(quantity, windows[0], pa.float32())]
    if rounding:
        kept = windows if quantity == "return" else windows[:1]
        return [(f"{quantity} {window}", window, pa.float32()) for window in kept]
    wide = {window: pa.float32() if window == "trailing-100" else pa.float64() for window in windows}
    return [(f"{quantity} {window}", window, kind) for window, kind in wide.items()]


def _compressed(table: pa.Table) -> bytes:
    """Return a table as a Parquet file, small: numbers that hardly repeat are no dictionary's."""
    curves = [field for field in table.schema if pa.types.is_list(field.type) and field.name != _EVALUATIONS]
    single = [f"{field.name}.list.element" for field in curves if field.type.value_type == pa.float32()]
    names = {field.name for field in curves}
    sink = io.BytesIO()
    pq.write_table(
        table,
        sink,
        compression="zstd",
        compression_level=19,
        use_dictionary=[name for name in table.column_names if name not in names],
        use_byte_stream_split=single,
    )
    return sink.getvalue()


def _head(data: StudyData) -> dict[str, Any]:
    return {
        "schema": SCHEMA,
        "study": data.study,
        "title": data.title,
        "figure": data.figure,
        "baseline": data.record.get("baseline"),
        "same": data.same,
        "budget": data.budget,
        "tables": [name for name in data.tables if name == _EVALUATIONS],
        "windows": list(data.windows),
        "averaged_over": data.averaged_over,
    }


def _provenance(data: StudyData, run: FinishedRun) -> str:
    found = data.source.provenance(run)
    kept = {key: found[key] for key in KEPT_PROVENANCE if key in found}
    changed = {words for resume in found.get("resumes", ()) for words in resume["differences"]}
    return json.dumps({**kept, "resumed_elsewhere": sorted(changed)} if changed else kept)


def _row_type(data: StudyData) -> pa.DataType:
    """Return the type of a run's evaluations: a list of rows, whole numbers where all runs have such."""
    kinds: dict[str, list[str]] = {}
    for run in data.runs:
        for name, kind in data.source.table(run, _EVALUATIONS).dtypes.items():
            kinds.setdefault(str(name), []).append(kind.kind)
    whole = {name: set(own) == {"i"} and len(own) == len(data.runs) for name, own in kinds.items()}
    return pa.list_(pa.struct([(name, pa.int64() if whole[name] else pa.float64()) for name in kinds]))


# --- Reading ---------------------------------------------------------------------------------------


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
        data = path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror})") from None
    sums = _SUM.findall(data)
    if len(sums) != 1 or _digest(_SUM.sub(_NO_SUM.encode(), data)) != sums[0].decode():
        raise UserError(f"{path}: damaged; take it from version control again, or publish the study anew")
    try:
        table = from_parquet(data)
        head = json.loads(table.schema.metadata[b"pneuma"])
    except (pa.ArrowException, TypeError, KeyError, ValueError):
        raise UserError(f"{path}: is no published table of a study") from None
    if head["schema"] != SCHEMA:
        raise UserError(f"{path}: of schema {head['schema']}, which this version of Pneuma cannot read")
    return PublishedRuns(head, table, read_times(store, study))


class PublishedRuns:
    """The runs of a published table."""

    what = "the published table"

    def __init__(self, head: Mapping[str, Any], table: pa.Table, times: Mapping[str, float]) -> None:
        self._head = head
        self._table = table
        self._times = times
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
        kept = ("study", "title", "figure", "baseline", "same", "budget")
        return {**{key: self._head[key] for key in kept}, "source": "published", "path": None, "runs": runs}

    def status(self, run_id: str) -> Status:
        """Return how a run ended; 'planned' where the table does not hold it."""
        if run_id not in self._place:
            return Status("planned")
        return Status(self._cell(run_id, "status"), self._cell(run_id, "end") or 0)

    def quantities(self, run: FinishedRun) -> tuple[str, ...]:
        """Return what the table has columns for."""
        names = (*EPISODE_QUANTITIES, *UPDATE_QUANTITIES)
        held = self._table.column_names
        return tuple(name for name in names if {name, f"{name} {self.windows[0]}"} & {*held})

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
        return np.array(self._cell(run.run_id, f"{quantity} {_PEAKS}"), float)

    def signs(self, run: FinishedRun) -> dict[str, list[Stretch]]:
        """Return where signs of collapse hold."""
        return unpack_signs(self._cell(run.run_id, _SIGNS))

    def kept_outcome(self, run: FinishedRun, name: str) -> float | None:
        """Return an outcome that was taken from curves before they were rounded or left out."""
        if _OUTCOME + name not in self._table.column_names:
            return None
        return float(self._cell(run.run_id, _OUTCOME + name))

    def wall_seconds(self, run: FinishedRun) -> float | None:
        """Return how long a run trained, where the file of times beside the table tells."""
        return self._times.get(run.run_id)

    def provenance(self, run: FinishedRun) -> dict[str, Any]:
        """Return what produced a run, without when it did."""
        found: dict[str, Any] = json.loads(self._cell(run.run_id, "provenance"))
        return found

    def _cell(self, run_id: str, column: str) -> Any:
        return self._table[column][self._place[run_id]].as_py()


# --- The checksum ----------------------------------------------------------------------------------


def _with_sum(data: bytes) -> bytes:
    """Put the checksum over a file into the place that is kept for it there."""
    if data.count(_NO_SUM.encode()) != 1 or len(_SUM.findall(data)) != 1:
        raise ValueError("the place of the checksum is not the only one of its look")
    return data.replace(_NO_SUM.encode(), f"sha256:{_digest(data)}".encode())


def _digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()
