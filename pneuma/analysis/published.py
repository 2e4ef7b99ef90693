"""A study's published table: its runs in one file, small enough to be kept under version control.

results/published/STUDY.parquet holds a row for each run: what it was, how it ended, its curves on the
study's grid, outcomes, its evaluations whole, and what produced it. The same runs give the same bytes.
Nothing is ever trained from it.

The file's metadata holds the study's title and conditions, and a checksum over all other bytes,
which is compared before anything else is read. STUDY.times.json beside it tells how long the runs trained, on
what machine: the clock has no place in the table.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc

from pneuma.analysis import TRAINING_QUANTITIES, UPDATE_QUANTITIES, WINDOWS
from pneuma.analysis.records import Records, told_seconds
from pneuma.analysis.series import EXTREMES, GRID_POINTS, Stretch, make_grid, peak_curve
from pneuma.errors import UserError
from pneuma.study.documents import Record, fits
from pneuma.study.files import names_in, parse_json, read_json, read_whole
from pneuma.study.store import FINISHED, Status, Store, shipped_tables
from pneuma.study.tables import from_parquet

SCHEMA = 2
PUBLISHED = "published"
"""The tables' folder, in a results folder."""

SUFFIX = ".parquet"
EVALUATIONS = "evaluations"
"""The one record table that is kept."""

NO_SUM = "sha256:" + "0" * 64
"""Stands where the checksum goes."""

_SUM = re.compile(rb"sha256:([0-9a-f]{64})")

PEAKS = "extreme"
SIGNS = "signs"
OUTCOME = "outcome "

SINGLE, WIDE = pa.list_(pa.float32()), pa.list_(pa.float64())
"""Of curves; older tables hold some of them in full width."""
_TEXTS = ("condition", "run_id", "status", "settings", "provenance", SIGNS)
_KINDS = {
    **dict.fromkeys(_TEXTS, (pa.string(),)),
    **dict.fromkeys(("seed", "end"), (pa.int64(),)),
    **dict.fromkeys(UPDATE_QUANTITIES, (SINGLE,)),
    **{f"{name} {own}": (SINGLE, WIDE) for name in TRAINING_QUANTITIES for own in (*WINDOWS, PEAKS)},
}
"""Types that a column may have; all others hold a number a run."""


def published_path(store: Store, study: str) -> Path:
    """Return where a study's published table lies."""
    return store.root / PUBLISHED / f"{study}{SUFFIX}"


def times_path(store: Store, study: str) -> Path:
    """Return where the times of a published study lie."""
    return store.root / PUBLISHED / f"{study}.times.json"


def published_studies(store: Store, shipped: bool = False) -> list[str]:
    """Return the names of the studies that have a published table here; `shipped`, or beside Pneuma."""
    names = [*names_in(store.root / PUBLISHED), *(names_in(shipped_tables()) if shipped else ())]
    return [name.removesuffix(SUFFIX) for name in dict.fromkeys(names) if name.endswith(SUFFIX)]


def read_times(path: Path) -> dict[str, dict[str, Any]]:
    """Return what a file of times tells of each run whose time makes sense; nothing without such a file."""
    told = (read_json(path) or {}).get("runs")
    runs = told.items() if isinstance(told, dict) else ()
    return {name: own for name, own in runs if isinstance(own, dict) and told_seconds(own) is not None}


def read_published(store: Store, study: str) -> PublishedTable:
    """Read a study's published table, here or else beside Pneuma.

    Raises:
        UserError: when it is missing or not what was written.
    """
    path = store.published_path(study)
    try:
        data = read_whole(path)
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror})") from None
    if not is_whole(data):
        raise UserError(
            f"{path}: damaged; take it from version control again, or remove it and publish the study anew"
        )
    try:
        table = from_parquet(data)
        head = parse_json((table.schema.metadata or {}).get(b"pneuma", b""))
        if head.get("schema") != SCHEMA:
            raise ValueError(f"of schema {head.get('schema')}, which this version of Pneuma cannot read")
        _check(head, table)
    except ValueError as error:
        raise UserError(f"{path}: is no published table of a study ({error})") from None
    return PublishedTable(head, table, read_times(path.with_suffix(".times.json")))


class PublishedTable:
    """The runs of a published table.

    Attributes:
        head: what the file's metadata holds.
        budget: the step at which its curves end.
        times: what the file of times beside it tells of each run.
        rows: the table.
        quantities: what it has curves of.
    """

    def __init__(self, head: Mapping[str, Any], table: pa.Table, times: Mapping[str, Any]) -> None:
        self.head = head
        self.budget: int = head["budget"]
        self.times = times
        self.rows = table
        held = {name.removesuffix(f" {head['windows'][0]}") for name in table.column_names}
        self.quantities = tuple(name for name in TRAINING_QUANTITIES if name in held)
        self._places = {run_id: place for place, run_id in enumerate(table["run_id"].to_pylist())}

    @property
    def record(self) -> dict[str, Any]:
        """The study's record, in the form of `pneuma.study.execute.selection_record`."""
        return _record(self.head, self.rows)

    @cached_property
    def finished(self) -> frozenset[str]:
        """The ids of those runs that have numbers."""
        return frozenset(run_id for run_id in self._places if self(run_id).status.finished)

    def __call__(self, run_id: str) -> PublishedRecords:
        """Return what is held of one of the runs."""
        return PublishedRecords(self, run_id, self._places[run_id])


class PublishedRecords(Records):
    """A run of a published table; `budget` is the step at which its curves end."""

    what = "the published table"
    published = True

    def __init__(self, table: PublishedTable, run_id: str, place: int) -> None:
        self._table = table
        self._place = place
        self.run_id = run_id
        self.status = Status(self.cell("status"), self.cell("end") or 0)
        self.budget = table.budget
        self.tables = tuple(table.head["tables"])
        self.windows = tuple(table.head["windows"])
        self.averaged_over = table.head["averaged_over"]

    def cell(self, column: str) -> Any:
        """Return what the run's row has in a column."""
        return self._table.rows[column][self._place].as_py()

    @property
    def quantities(self) -> tuple[str, ...]:
        """What is held, of every run of the table the same."""
        return self._table.quantities

    def has_curve(self, quantity: str, window: str) -> bool:
        """Tell whether it has the curve: rounded tables have one window of most quantities."""
        return _column(quantity, window) in self._table.rows.column_names

    def table(self, name: str) -> pd.DataFrame:
        """Return the run's evaluations, the one table that is kept."""
        return self._evaluations

    @cached_property
    def _evaluations(self) -> pd.DataFrame:
        rows = self._table.rows[EVALUATIONS][self._place].values
        return pa.RecordBatch.from_struct_array(rows).to_pandas(use_threads=False)

    def curve(self, quantity: str, window: str, grid: np.ndarray, slots: int | None) -> np.ndarray:
        """Return a curve, (points,); on another grid than it is kept on, the last value up to each point."""
        kept, own = np.array(self.cell(_column(quantity, window)), float), make_grid(self.budget)
        held = np.concatenate([[np.nan], kept])[np.searchsorted(own, grid, side="right")]
        return np.where(grid <= own[-1], held, np.nan)

    def peaks(self, quantity: str, grid: np.ndarray) -> np.ndarray:
        """Return the extreme update since each point before, (points,)."""
        kept = np.array(self.cell(f"{quantity} {PEAKS}"), float)
        return peak_curve(make_grid(self.budget), kept, grid, EXTREMES[quantity])

    def signs(self) -> dict[str, list[Stretch]]:
        """Return where signs of collapse hold."""
        return unpack_signs(self.cell(SIGNS))

    def kept_outcome(self, name: str) -> float | None:
        """Return an outcome that was taken from curves before they were rounded or left out."""
        return float(self.cell(OUTCOME + name)) if OUTCOME + name in self._table.rows.column_names else None

    def provenance(self) -> dict[str, Any]:
        """Return what produced the run, without when it did."""
        return parse_json(self.cell("provenance"))

    @property
    def times(self) -> Mapping[str, Any]:
        """What the file of times beside the table tells."""
        found: Mapping[str, Any] = self._table.times.get(self.run_id, {})
        return found


def _column(quantity: str, window: str) -> str:
    return quantity if quantity in UPDATE_QUANTITIES else f"{quantity} {window}"


def unpack_signs(text: str) -> dict[str, list[Stretch]]:
    """Return what `pneuma.analysis.publishing.pack_signs` was given.

    Raises:
        ValueError: for a text that it did not make.
    """
    packed = parse_json(text)
    try:
        found: dict[str, list[Stretch]] = {}
        for sign, gaps in packed["signs"].items():
            ends = (np.cumsum(gaps) * packed["unit"]).astype(float).tolist()
            found[sign] = list(zip(ends[::2], ends[1::2], strict=True))
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"signs of collapse that make no sense: {error}") from None
    return found


# --- The checksum, over all other bytes of the file ------------------------------------------------


def with_sum(data: bytes) -> bytes:
    """Put the checksum over a file into the place that is kept for it there."""
    if data.count(NO_SUM.encode()) != 1 or len(_SUM.findall(data)) != 1:
        raise ValueError("the place of the checksum is not the only one of its look")
    return data.replace(NO_SUM.encode(), f"sha256:{hashlib.sha256(data).hexdigest()}".encode())


def is_whole(data: bytes) -> bool:
    """Tell whether a file is what `with_sum` returned, to the bit."""
    sums = _SUM.findall(data)
    blank = _SUM.sub(NO_SUM.encode(), data)
    return len(sums) == 1 and hashlib.sha256(blank).hexdigest() == sums[0].decode()


# --- Whether it is one -----------------------------------------------------------------------------


def _record(head: Mapping[str, Any], table: pa.Table) -> dict[str, Any]:
    names = ("condition", "seed", "run_id", "settings")
    rows = zip(*(table[name].to_pylist() for name in names), strict=True)
    runs = [{"condition": c, "seed": s, "run_id": i, "run": parse_json(run or "")} for c, s, i, run in rows]
    kept = ("study", "title", "figure", "baseline", "same", "budget")
    told = {key: head[key] for key in kept if key in head}
    return {**told, "source": "published", "path": None, "runs": runs}


def _check(head: Mapping[str, Any], table: pa.Table) -> None:
    """Refuse a table, which may be anybody's, that is not what `encode_study` makes.

    Raises:
        ValueError: naming what is amiss.
    """
    windows, budget = head.get("windows") or [], head.get("budget")
    sound = windows and {*windows} <= {*WINDOWS} and isinstance(budget, int) and budget > 0
    if not sound or head.get("tables") not in ([], [EVALUATIONS]):
        raise ValueError("its metadata make no sense")
    if missing := {*_TEXTS, "seed", "end", *head["tables"]} - {*table.column_names}:
        raise ValueError(f"column {min(missing)} is missing")
    rows = table.filter(pa.array([status in FINISHED for status in table["status"].to_pylist()], pa.bool_()))
    for field in table.schema:
        kind = field.type
        if field.name == EVALUATIONS:
            fit = pa.types.is_list(kind) and pa.types.is_struct(kind.value_type)
            fit = fit and kind.value_type.get_field_index("step") >= 0
        else:
            fit = kind in _KINDS.get(field.name, (pa.float64(),))
            if fit and pa.types.is_list(kind):
                fit = {*pc.list_value_length(rows[field.name]).to_pylist()} <= {GRID_POINTS}
        if not fit or rows[field.name].null_count:
            raise ValueError(f"column {field.name} makes no sense")
    if not fits(_record(head, table), Record):
        raise ValueError("its runs make no sense")
    for told, signs in zip(rows["provenance"].to_pylist(), rows[SIGNS].to_pylist(), strict=True):
        parse_json(told)
        unpack_signs(signs)
