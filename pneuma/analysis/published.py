"""A study's published table: its runs in one file, small enough to be kept under version control.

results/published/STUDY.parquet contains a row for each run: its fields, status, curves on the study's grid,
outcomes, evaluations, and provenance. The same runs give the same bytes. Nothing is ever trained from it.

The file's metadata contains the study's title and conditions, and a checksum over all other bytes, which is
checked before anything else is read. STUDY.times.json beside it contains the training times, because the
table must not depend on them.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Mapping
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
from pydantic import Field
from typing_extensions import TypedDict

from pneuma.analysis import TRAINING_QUANTITIES, UPDATE_QUANTITIES, WINDOWS
from pneuma.analysis.records import Records, told_seconds
from pneuma.analysis.series import EXTREMES, GRID_POINTS, Stretch, held_curve, make_grid, peak_curve
from pneuma.errors import UserError
from pneuma.files import parse_json, read_json, read_whole
from pneuma.study.documents import Record, fits
from pneuma.study.store import FINISHED, Status, Store
from pneuma.study.tables import from_parquet

TIMES_SUFFIX = ".times.json"


# --- The file ---------------------------------------------------------------------------------------

SINGLE, WIDE = pa.list_(pa.float32()), pa.list_(pa.float64())
NAMING = ("condition", "seed", "run_id", "status", "end", "settings", "provenance")
SIGNS, EVALUATIONS = "signs", "evaluations"
OUTCOME, PEAKS = "outcome", "extreme"
"""'outcome final-return' is an outcome; 'entropy extreme', 'entropy' and 'return budget-5%' are curves."""


OF_RECORD = ("study", "world", "title", "figure", "baseline", "same", "budget")
"""The keys of a study's record in the file's metadata."""


class _Head(TypedDict):
    """The file's metadata beside the `Record`."""

    schema: Literal[2]
    budget: Annotated[int, Field(gt=0)]
    tables: list[Literal["evaluations"]]
    windows: Annotated[list[Literal[WINDOWS]], Field(min_length=1)]  # type: ignore[valid-type]
    averaged_over: int | None


def column_types(column: str) -> tuple[pa.DataType, ...]:
    """Return the types a column may have, that of new tables first; none for columns that are not read."""
    first, _, second = column.partition(" ")
    if column in ("seed", "end"):
        return (pa.int64(),)
    if column in (*NAMING, SIGNS):
        return (pa.string(),)
    if first in TRAINING_QUANTITIES and second in ("", *WINDOWS, PEAKS):
        return (SINGLE, WIDE)  # older tables have wider types
    return (pa.float64(),) if first == OUTCOME else ()


def curve_column(quantity: str, window: str) -> str:
    """Return the name of a curve's column; quantities of updates have no window."""
    return quantity if quantity in UPDATE_QUANTITIES else f"{quantity} {window}"


NO_SUM = "sha256:" + "0" * 64
"""Placeholder for the checksum over all other bytes."""
_SUM = re.compile(rb"sha256:([0-9a-f]{64})")


def with_sum(data: bytes) -> bytes:
    """Fill in the placeholder with the checksum over a file."""
    return data.replace(NO_SUM.encode(), f"sha256:{hashlib.sha256(data).hexdigest()}".encode())


def is_whole(data: bytes) -> bool:
    """Return whether a file has the checksum that `with_sum` gave it."""
    blank = _SUM.sub(NO_SUM.encode(), data)
    return _SUM.findall(data) == [hashlib.sha256(blank).hexdigest().encode()]


# --- Reading ----------------------------------------------------------------------------------------


def read_published(store: Store, study: str) -> PublishedTable:
    """Read a study's published table, from the folder or from those that come with Pneuma.

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
    times = (read_json(path.with_suffix(TIMES_SUFFIX)) or {}).get("runs")
    try:
        rows = from_parquet(data)
        table = PublishedTable(parse_json((rows.schema.metadata or {}).get(b"pneuma", b"")), rows, times)
        _check(table)
    except ValueError as error:
        raise UserError(f"{path}: is no published table of a study ({error})") from None
    return table


class PublishedTable:
    """The runs of a published table.

    Attributes:
        head: the file's metadata.
        rows: the table.
        times: the contents of the file of times, by run.
    """

    def __init__(self, head: Mapping[str, Any], rows: pa.Table, times: object) -> None:
        self.head = head
        self.rows = rows
        self.times = times if isinstance(times, dict) else {}

    @cached_property
    def record(self) -> dict[str, Any]:
        """The study's record, in the form of `pneuma.study.execute.selection_record`."""
        names = ("condition", "seed", "run_id", "settings")
        cells = zip(*(self.rows[name].to_pylist() for name in names), strict=True)
        runs = [
            {"condition": c, "seed": s, "run_id": i, "run": parse_json(run or "")} for c, s, i, run in cells
        ]
        head = {key: value for key, value in self.head.items() if key in OF_RECORD}
        return {**head, "source": "published", "path": None, "runs": runs}

    @cached_property
    def quantities(self) -> tuple[str, ...]:
        """The quantities whose curves the table has."""
        columns, window = {*self.rows.column_names}, self.head["windows"][0]
        return tuple(name for name in TRAINING_QUANTITIES if curve_column(name, window) in columns)

    @cached_property
    def runs(self) -> dict[str, PublishedRecords]:
        """The records of each run, by id."""
        ids = self.rows["run_id"].to_pylist()
        return {run_id: PublishedRecords(self, run_id, place) for place, run_id in enumerate(ids)}

    @cached_property
    def finished(self) -> frozenset[str]:
        """The ids of finished runs."""
        return frozenset(run_id for run_id, records in self.runs.items() if records.status.finished)


class PublishedRecords(Records):
    """The records of a run in a published table."""

    what = "the published table"
    published = True

    def __init__(self, table: PublishedTable, run_id: str, place: int) -> None:
        self._table = table
        self._place = place
        self.run_id = run_id
        self.status = Status(self.cell("status"), self.cell("end") or 0)
        self.budget = table.head["budget"]
        self.tables = tuple(table.head["tables"])
        self.windows = tuple(table.head["windows"])
        self.averaged_over = table.head["averaged_over"]

    @property
    def quantities(self) -> tuple[str, ...]:
        """The quantities whose curves the table has."""
        return self._table.quantities

    def cell(self, column: str) -> Any:
        """Return a cell of the run's row; None if there is no such column."""
        rows = self._table.rows
        return rows[column][self._place].as_py() if column in rows.column_names else None

    def has_curve(self, quantity: str, window: str) -> bool:
        """Return whether the table has the curve; most quantities have a single window."""
        return curve_column(quantity, window) in self._table.rows.column_names

    def table(self, name: str) -> pd.DataFrame:
        """Return the run's evaluations, the only table that is kept."""
        return self._evaluations

    @cached_property
    def _evaluations(self) -> pd.DataFrame:
        rows = self._table.rows[EVALUATIONS][self._place].values
        return pa.RecordBatch.from_struct_array(rows).to_pandas(use_threads=False)

    def curve(self, quantity: str, window: str, grid: np.ndarray, slots: int | None) -> np.ndarray:
        """Return a curve, (points,); on another grid than the table's, the last value before each point."""
        values = np.array(self.cell(curve_column(quantity, window)), float)
        return held_curve(make_grid(self.budget), values, grid, self.budget)

    def peaks(self, quantity: str, grid: np.ndarray) -> np.ndarray:
        """Return the extreme update since each previous point, (points,)."""
        values = np.array(self.cell(f"{quantity} {PEAKS}"), float)
        return peak_curve(make_grid(self.budget), values, grid, EXTREMES[quantity])

    def signs(self) -> dict[str, list[Stretch]]:
        """Return where signs of collapse hold."""
        return unpack_signs(self.cell(SIGNS))

    def stuck(self) -> tuple[int, int, int]:
        """Return nothing: a table has no single updates. Its outcome `stuck-share` may have been kept."""
        return 0, 0, 0

    def kept_outcome(self, name: str) -> float | None:
        """Return an outcome that was measured before curves were rounded or left out."""
        value: float | None = self.cell(f"{OUTCOME} {name}")
        return value

    def provenance(self) -> dict[str, Any]:
        """Return the run's provenance, without times."""
        return parse_json(self.cell("provenance"))

    @property
    def times(self) -> Mapping[str, Any]:
        """The run's entry in the file of times; empty if it is not valid."""
        entry = self._table.times.get(self.run_id)
        return entry if isinstance(entry, dict) and told_seconds(entry) is not None else {}


def _check(table: PublishedTable) -> None:
    """Refuse a table, which may be untrusted, that `encode_study` could not have made.

    Raises:
        ValueError: naming what is wrong.
    """
    head, rows = table.head, table.rows
    if not fits(head, _Head):
        raise ValueError("its metadata make no sense")
    if missing := {*NAMING, SIGNS, *head["tables"]} - {*rows.column_names}:
        raise ValueError(f"column {min(missing)} is missing")
    if not fits(table.record, Record):
        raise ValueError("its runs make no sense")
    rows = rows.filter(pa.array([status in FINISHED for status in rows["status"].to_pylist()], pa.bool_()))
    for name, kind in zip(rows.column_names, rows.schema.types, strict=True):
        types = column_types(name)
        sound = not (types or name == EVALUATIONS) or not rows[name].null_count
        if types:
            sound &= kind in types
        if name == EVALUATIONS:
            sound &= pa.types.is_list(kind) and pa.types.is_struct(kind.value_type)
            sound = sound and kind.value_type.get_field_index("step") >= 0
        if sound and SINGLE in types:
            sound = {*pc.list_value_length(rows[name]).to_pylist()} <= {GRID_POINTS}
        if not sound:
            raise ValueError(f"column {name} makes no sense")
    for provenance, signs in zip(rows["provenance"].to_pylist(), rows[SIGNS].to_pylist(), strict=True):
        parse_json(provenance)
        unpack_signs(signs)


# --- Signs of collapse, in few bytes -----------------------------------------------------------------


def pack_signs(signs: Mapping[str, list[Stretch]]) -> str:
    """Return where signs hold as JSON: a unit of steps, and for each sign gaps and lengths in turn."""
    ends = {sign: [int(end) for stretch in parts for end in stretch] for sign, parts in signs.items()}
    unit = math.gcd(*(end for sign_ends in ends.values() for end in sign_ends)) or 1
    packed = {sign: np.diff(np.array([0, *sign_ends]) // unit).tolist() for sign, sign_ends in ends.items()}
    return json.dumps({"unit": unit, "signs": packed}, separators=(",", ":"))


def unpack_signs(text: str) -> dict[str, list[Stretch]]:
    """Return what `pack_signs` was given."""
    packed = parse_json(text)
    try:
        found: dict[str, list[Stretch]] = {}
        for sign, gaps in packed["signs"].items():
            ends = (np.cumsum(gaps) * packed["unit"]).astype(float).tolist()
            found[sign] = list(zip(ends[::2], ends[1::2], strict=True))
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"signs of collapse that make no sense: {error}") from None
    return found
