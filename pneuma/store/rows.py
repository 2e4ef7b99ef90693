"""A row: what one finished run comes to. It is all that figures, tables and tests read of a run.

    a run's files → `row_builder.py` → cells → `encode_row` → row.arrow in its folder
    row.arrow → `decode_row` → Row

Curves are on 200 points of the run's *own* budget and are rounded when the row is written, so that a run and
its published row cannot differ. Numbers that need more digits are kept exact. Updates and episodes themselves
are only exported.
"""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache, cached_property, lru_cache
from typing import Any

import numpy as np
import pyarrow as pa

from pneuma.config import Run, as_fields
from pneuma.files import parse_json
from pneuma.store.quantities import TRAINING_QUANTITIES, UPDATE_QUANTITIES, WINDOWS
from pneuma.store.series import (
    EXTREMES,
    GRID_POINTS,
    STATISTICS,
    Series,
    Stretch,
    known_points,
    make_grid,
    unpack_signs,
)
from pneuma.store.tables import from_ipc

NAMING = ("run_id", "config_id", "status", "fields", "provenance", "signs")
NUMBERS = ("seed", "steps", "end")
CURVE = pa.list_(pa.float32())
EVALUATIONS, PEAKS = "evaluations", "extreme"
AVERAGED_OVER, LAST_EPISODES = "averaged over", "episodes last"
STUCK = ("stuck updates", "updates", "stuck spells")
"""Counts of updates without entropy and with one action, of all updates, and of spells of the former."""

EXACT: dict[str, tuple[str, ...]] = {
    "return": ("last", "best", "height"),
    "length": ("last",),
    "hp": ("last",),
    "entropy": ("last",),
    "grad_norm": ("median",),
    "approx_kl": ("average",),
    "explained_variance": ("early",),
    **{name: ("last",) for name in UPDATE_QUANTITIES if name == "dead_units" or name.startswith("action_")},
}
"""The statistics of curves at a run's end that are kept with all digits."""

# --- The files --------------------------------------------------------------------------------------


def curve_column(quantity: str, window: str) -> str:
    """Return the name of a curve's column; quantities of updates have no window."""
    return quantity if quantity in UPDATE_QUANTITIES else f"{quantity} {window}"


def column_type(name: str) -> pa.DataType | None:
    """Return the type of a column; None for those that are not read, and for the evaluations."""
    first, _, second = name.partition(" ")
    if name in NAMING:
        return pa.string()
    if name in (*NUMBERS, AVERAGED_OVER, *STUCK):
        return pa.int64()
    if first in TRAINING_QUANTITIES and second in ("", *WINDOWS, PEAKS):
        return CURVE
    known = name == LAST_EPISODES or first in EXACT or first in EXTREMES
    return pa.float64() if known else None


def encode_row(cells: Mapping[str, Any]) -> bytes:
    """Return one row as a file in Arrow's own format, which is read 25 times as fast as Parquet."""
    columns = {name: pa.array([cell], column_type(name)) for name, cell in cells.items()}
    columns[EVALUATIONS] = columns.pop(EVALUATIONS)  # the last
    table, sink = pa.table(columns), io.BytesIO()
    with pa.ipc.new_file(sink, table.schema) as writer:
        writer.write_table(table)
    return sink.getvalue()


def decode_row(data: bytes) -> Row:
    """Return the row in a run's folder.

    Raises:
        ValueError: for anything else.
    """
    table = sound_rows(from_ipc(data))
    if table.num_rows != 1:
        raise ValueError("has not one row")
    return read_row(table)


_PATTERNS = {
    "run_id": "[0-9a-f]{16}", "config_id": "[0-9a-f]{16}", "status": "done|diverged", "steps": r"[1-9]\d*",
}  # fmt: skip


def sound_rows(table: pa.Table) -> pa.Table:
    """Return the columns of rows that are read; refuse a table that could not have been written here.

    Raises:
        ValueError: naming what is wrong.
    """
    table = table.select(_known_columns(table.schema.remove_metadata().serialize().to_pybytes()))
    for name in (*NAMING, *NUMBERS, EVALUATIONS):
        cells = table[name].to_pylist() if name in _PATTERNS else ()
        matching = all(re.fullmatch(_PATTERNS[name], str(cell)) for cell in cells)
        if table[name].null_count or not matching:
            raise ValueError(f"column {name} makes no sense")
    return table


@lru_cache
def _known_columns(serialized: bytes) -> list[str]:
    """Return which columns of a schema are read; schemas of a thousand runs are mostly the same."""
    schema = pa.ipc.read_schema(pa.py_buffer(serialized))
    if missing := {*NAMING, *NUMBERS, EVALUATIONS} - {*schema.names}:
        raise ValueError(f"column {min(missing)} is missing")
    for name, kind in zip(schema.names, schema.types, strict=True):
        sound = _are_evaluations(kind) if name == EVALUATIONS else column_type(name) in (None, kind)
        if not sound:
            raise ValueError(f"column {name} makes no sense")
    return [name for name in schema.names if name == EVALUATIONS or column_type(name)]


def _are_evaluations(kind: pa.DataType) -> bool:
    """Return whether a type is a list of structs of numbers, with their step; or a list of nothing."""
    if not pa.types.is_list(kind) or not pa.types.is_struct(kind.value_type):
        return bool(pa.types.is_list(kind) and pa.types.is_null(kind.value_type))
    kinds = {field_.name: field_.type for field_ in kind.value_type}
    numbers = {pa.int64(), pa.float64()}
    return kinds.get("step") in numbers and {*kinds.values()} <= {*numbers, pa.null()}


FORK_TYPES: dict[str, tuple[type, ...]] = {"parent": (str,), "fork_step": (int,)}
"""Fields that published runs may have which an earlier version forked from others: no run has them now."""

# --- Reading ----------------------------------------------------------------------------------------


def _read_fields(text: str) -> dict[str, Any]:
    """Read a configuration, with each known field of a type that it may have."""
    fields, types = parse_json(text), _field_types()
    for key, value in fields.items():
        fits = value is None or isinstance(value, types.get(key, (str, int, float, list)))
        if not fits or (isinstance(value, list) and any(isinstance(part, list | dict) for part in value)):
            raise ValueError(f"{key} = {json.dumps(value)[:40]}")
    return fields


@cache
def _field_types() -> dict[str, tuple[type, ...]]:
    of_default = {str: (str,), list: (list,), type(None): (int, float, list)}
    types = {key: of_default.get(type(usual), (int, float)) for key, usual in as_fields(Run()).items()}
    return {**types, **FORK_TYPES}


_DOCUMENTS = {"fields": _read_fields, "provenance": parse_json, "signs": unpack_signs}


def read_row(table: pa.Table, place: int = 0, published: bool = False) -> Row:
    """Return a row of a table of `sound_rows`.

    Raises:
        ValueError: naming a column that makes no sense.
    """
    row = table.slice(place, 1).replace_schema_metadata(None)
    cells = {name: row[name][0].as_py() for name in (*NAMING, *NUMBERS)}
    for name, read in _DOCUMENTS.items():
        try:
            cells[name] = read(cells[name])
        except ValueError as error:
            raise ValueError(f"column {name} makes no sense ({error})") from None
    return Row(row, published, budget=cells.pop("steps"), **cells)


@dataclass(frozen=True, eq=False)
class Row:
    """One finished run, done or diverged.

    Attributes:
        table: all its cells, as a table of one row.
        published: whether it is of a published table.
        config_id: the id of its configuration, without seed and steps.
        budget: agent steps that it was to train.
        end: agent steps trained; fewer than the budget if it diverged.
        status: 'done' or 'diverged'.
        fields: its configuration, which may be untrusted.
        provenance: what produced it, and how long that took.
        signs: where each recorded sign of collapse holds.
    """

    table: pa.Table = field(repr=False)
    published: bool
    run_id: str
    config_id: str
    seed: int
    budget: int
    end: int
    status: str
    fields: Mapping[str, Any] = field(repr=False)
    provenance: Mapping[str, Any] = field(repr=False)
    signs: Mapping[str, list[Stretch]] = field(repr=False)

    def cell(self, column: str) -> Any:
        return self.table[column][0].as_py() if column in self._columns else None

    @property
    def averaged_over(self) -> int | None:
        """Episodes over which returns were averaged when they were logged; None if they were not."""
        return self.cell(AVERAGED_OVER)

    @property
    def begun(self) -> int:
        """Agent steps with which the run began: for a published fork, those of its parent."""
        return self.fields.get("fork_step") or 0

    @property
    def what(self) -> str:
        """Where it is, for messages."""
        if self.averaged_over:
            return "a study of imported logs"
        return "the published table" if self.published else "the results folder"

    @property
    def update_steps(self) -> int | None:
        """Agent steps of one update; None if its fields do not say."""
        counts = self.fields.get("horizon"), self.fields.get("slots"), self.fields.get("players", 1)
        return math.prod(counts) or None if all(isinstance(count, int) for count in counts) else None

    @cached_property
    def grid(self) -> np.ndarray:
        """The steps of the points of its curves, (points,)."""
        return make_grid(self.budget)

    @cached_property
    def quantities(self) -> tuple[str, ...]:
        return tuple(name for name in TRAINING_QUANTITIES if self.windows_of(name))

    def windows_of(self, quantity: str) -> tuple[str, ...]:
        """Return the windows in which it has a curve, the usual one first; quantities of updates have any."""
        columns = self._columns
        return tuple(window for window in WINDOWS if curve_column(quantity, window) in columns)

    @property
    def windows(self) -> tuple[str, ...]:
        return self.windows_of("return") or WINDOWS[:1]

    @cached_property
    def _columns(self) -> frozenset[str]:
        columns = zip(self.table.column_names, self.table.columns, strict=True)
        return frozenset(name for name, column in columns if column[0].is_valid)

    def curve(self, quantity: str, window: str = "") -> np.ndarray:
        """Return a curve on the row's own grid, (points,); NaN where it has no value."""
        windows = self.windows_of(quantity)
        chosen = window or (windows[0] if windows else "")
        return self._points(curve_column(quantity, chosen))

    def peaks(self, quantity: str) -> np.ndarray:
        """Return the extreme update of one of `EXTREMES` since each previous point, (points,)."""
        return self._points(f"{quantity} {PEAKS}")

    def _points(self, column: str) -> np.ndarray:
        values = self.table[column][0].values if column in self._columns else None
        if values is None or len(values) != GRID_POINTS:
            return np.full(GRID_POINTS, np.nan)
        return values.to_numpy(zero_copy_only=False).astype(float)

    def known_curve(self, quantity: str) -> Series:
        """Return the points of a curve that have a value; empty if there is no such curve."""
        return known_points(self.grid, self.curve(quantity))

    def known_peaks(self, quantity: str) -> Series:
        return known_points(self.grid, self.peaks(quantity))

    def statistic(self, quantity: str, name: str) -> float:
        """Return one of `STATISTICS` of a curve, exact where that is kept; NaN if it has no value."""
        exact = self.exact(quantity, name)
        if not math.isnan(exact):
            return exact
        step, values = self.known_curve(quantity)
        return STATISTICS[name](step, values, self.budget) if len(values) else math.nan

    def exact(self, quantity: str, statistic: str) -> float:
        """Return a statistic of a curve at the run's end, with all digits; NaN if it is not kept."""
        value = self.cell(f"{quantity} {statistic}")
        return math.nan if value is None else float(value)

    @property
    def last_episodes(self) -> float:
        """The number of episodes that the last point of its return averages; infinite if it is not known."""
        value = self.cell(LAST_EPISODES)
        return math.inf if value is None else float(value)

    @cached_property
    def _evaluations(self) -> dict[str, np.ndarray]:
        values = self.table[EVALUATIONS][0].values
        if values is None or pa.types.is_null(values.type):
            return {}
        fields = {values.type.field(i).name: values.field(i) for i in range(values.type.num_fields)}
        known = {name: column for name, column in fields.items() if column.null_count < len(column)}
        return {name: column.to_numpy(zero_copy_only=False) for name, column in known.items()}

    @property
    def evaluation_columns(self) -> tuple[str, ...]:
        return tuple(self._evaluations)

    def evaluations(self, column: str) -> np.ndarray:
        """Return a column of its evaluations, in their order; empty if it has no such column."""
        return self._evaluations.get(column, np.empty(0)).astype(float)

    def known_evaluations(self, column: str) -> Series:
        """Return a column's finite values with their steps; empty if it has no such column."""
        if column not in self._evaluations:
            return np.empty(0), np.empty(0)
        return known_points(self.evaluations("step"), self.evaluations(column))

    def evaluations_table(self) -> pa.Table:
        return pa.table(dict(self._evaluations))

    @property
    def wall_seconds(self) -> float | None:
        """Seconds of training, without loading and compiling if these were timed; None if unknown."""
        seconds = self.provenance.get("training_seconds", self.provenance.get("wall_seconds"))
        return float(seconds) if isinstance(seconds, int | float) and seconds > 0 else None

    @property
    def processor_share(self) -> float | None:
        """Share of a core that the training had; 1 if nothing else ran, None if unknown."""
        share = self.provenance.get("processor_share")
        return float(share) if isinstance(share, int | float) else None

    def same_numbers(self, other: Row) -> bool:
        """Return whether two rows of one run agree in everything that both have, apart from provenance."""
        names = (self._columns & other._columns) - {"provenance", "fields", EVALUATIONS}
        lists = {name for name in names if column_type(name) == CURVE}
        pairs = [(self._points(name), other._points(name)) for name in lists]
        evaluated = {*self._evaluations} & {*other._evaluations}
        pairs += [(self.evaluations(name), other.evaluations(name)) for name in evaluated]
        curves = all(np.array_equal(one, two, equal_nan=True) for one, two in pairs)
        scalars = names - lists  # as text, in which NaN is NaN
        return curves and all(repr(self.cell(name)) == repr(other.cell(name)) for name in scalars)
