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
import pyarrow.compute as pc

from pneuma.config import Run, as_fields
from pneuma.files import parse_json
from pneuma.store.quantities import ACTION_QUANTITIES, TRAINING_QUANTITIES, UPDATE_QUANTITIES, WINDOWS
from pneuma.store.series import (
    EXTREMES,
    GRID_POINTS,
    STATISTICS,
    Series,
    Stretch,
    finite_points,
    make_grid,
    unpack_signs,
)
from pneuma.store.tables import from_ipc

TEXT_CELLS = ("run_id", "config_id", "status", "fields", "provenance", "signs")
INTEGER_CELLS = ("seed", "steps", "end")
EVALUATIONS, PEAKS = "evaluations", "extreme"
REQUIRED_CELLS = (*TEXT_CELLS, *INTEGER_CELLS, EVALUATIONS)
AVERAGED_OVER, LAST_EPISODES = "averaged over", "episodes last"
STUCK = ("stuck updates", "updates", "stuck spells")
"""Counts of updates without entropy and with one action, of all updates, and of spells of the former."""
CURVE = pa.list_(pa.float32())

_LAST_ONLY = ("length", "hp", "entropy", "dead_units", *ACTION_QUANTITIES)
EXACT: dict[str, tuple[str, ...]] = {
    "return": ("last", "best", "height"),
    **dict.fromkeys(_LAST_ONLY, ("last",)),
    "grad_norm": ("median",),
    "approx_kl": ("average",),
    "explained_variance": ("early",),
}
"""The statistics of curves at a run's end that are kept with all digits."""

# --- The files --------------------------------------------------------------------------------------


def curve_column(quantity: str, window: str) -> str:
    """Return the name of a curve's column; quantities of updates have no window."""
    return quantity if quantity in UPDATE_QUANTITIES else f"{quantity} {window}"


def column_type(name: str) -> pa.DataType | None:
    """Return the type of a column; None for those that are not read, and for the evaluations."""
    if name in TEXT_CELLS:
        return pa.string()
    if name in (*INTEGER_CELLS, AVERAGED_OVER, *STUCK):
        return pa.int64()
    quantity, _, suffix = name.partition(" ")
    if quantity in TRAINING_QUANTITIES and suffix in ("", *WINDOWS, PEAKS):
        return CURVE
    if name == LAST_EPISODES or quantity in EXACT or quantity in EXTREMES:
        return pa.float64()
    return None


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
    "run_id": "[0-9a-f]{16}",
    "config_id": "[0-9a-f]{16}",
    "status": "done|diverged",
    "steps": r"[1-9]\d*",
}


def sound_rows(table: pa.Table) -> pa.Table:
    """Return the columns of rows that are read; refuse a table that could not have been written here.

    Raises:
        ValueError: naming what is wrong.
    """
    schema = table.schema.remove_metadata()
    table = table.select(_columns_to_read(schema.serialize().to_pybytes()))
    for name in REQUIRED_CELLS:
        if table[name].null_count:
            raise ValueError(f"column {name} is invalid")
    for name, pattern in _PATTERNS.items():
        if not all(re.fullmatch(pattern, str(cell)) for cell in table[name].to_pylist()):
            raise ValueError(f"column {name} is invalid")
    evaluations = pc.list_flatten(table[EVALUATIONS])
    if pa.types.is_struct(evaluations.type):
        steps = pc.struct_field(evaluations, "step")
        if not pc.all(pc.is_finite(steps)).as_py():
            raise ValueError(f"column {EVALUATIONS} is invalid")
    return table


@lru_cache
def _columns_to_read(serialized_schema: bytes) -> list[str]:
    """Return which columns of a schema are read, and check their types; most runs have the same schema."""
    schema = pa.ipc.read_schema(pa.py_buffer(serialized_schema))
    missing = set(REQUIRED_CELLS) - set(schema.names)
    if missing:
        raise ValueError(f"column {min(missing)} is missing")
    names = []
    for column in schema:
        expected = column_type(column.name)
        if column.name == EVALUATIONS:
            is_sound = _are_evaluations(column.type)
        elif expected is None:
            continue
        else:
            is_sound = column.type == expected
        if not is_sound:
            raise ValueError(f"column {column.name} is invalid")
        names.append(column.name)
    return names


def _are_evaluations(column_type: pa.DataType) -> bool:
    """Return whether a type is a list of structs of numbers, with their step; or a list of nothing."""
    if not pa.types.is_list(column_type):
        return False
    if not pa.types.is_struct(column_type.value_type):
        return bool(pa.types.is_null(column_type.value_type))
    types = {column.name: column.type for column in column_type.value_type}
    if len(types) < column_type.value_type.num_fields:
        return False  # two columns have one name
    numbers = {pa.int64(), pa.float64()}
    return types.get("step") in numbers and set(types.values()) <= {*numbers, pa.null()}


# --- Reading ----------------------------------------------------------------------------------------

FORK_TYPES: dict[str, tuple[type, ...]] = {"parent": (str,), "fork_step": (int,)}
"""Fields that published runs may have which an earlier version forked from others: no run has them now."""
SIMPLE_TYPES = (str, int, float)


def _read_fields(text: str) -> dict[str, Any]:
    """Read a configuration, with each field of a type that it may have."""
    fields, types_by_field = parse_json(text), _field_types()
    for name, value in fields.items():
        types = types_by_field.get(name, (*SIMPLE_TYPES, list))
        is_sound = value is None or isinstance(value, types)
        if isinstance(value, list):
            is_sound = is_sound and not any(isinstance(item, list | dict) for item in value)
        if not is_sound:
            raise ValueError(f"{name} = {json.dumps(value)[:40]}")
    return fields


@cache
def _field_types() -> dict[str, tuple[type, ...]]:
    """Return the types that the value of a field may have, by those of its default."""
    types_by_default = {str: (str,), list: (list,), type(None): (int, float, list)}
    types = {}
    for name, default in as_fields(Run()).items():
        types[name] = types_by_default.get(type(default), (int, float))
    return {**types, **FORK_TYPES}


_DOCUMENTS = {"fields": _read_fields, "provenance": parse_json, "signs": unpack_signs}


def read_row(table: pa.Table, index: int = 0, published: bool = False) -> Row:
    """Return a row of a table of `sound_rows`.

    Raises:
        ValueError: naming a column that is invalid.
    """
    row = table.slice(index, 1).replace_schema_metadata(None)
    cells = {name: row[name][0].as_py() for name in (*TEXT_CELLS, *INTEGER_CELLS)}
    for name, read in _DOCUMENTS.items():
        try:
            cells[name] = read(cells[name])
        except ValueError as error:
            raise ValueError(f"column {name} is invalid ({error})") from None
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
        if self.published:
            return "the published table"
        return "the results folder"

    @property
    def update_steps(self) -> int | None:
        """Agent steps of one update; None if its fields do not say."""
        counts = (self.fields.get("horizon"), self.fields.get("slots"), self.fields.get("players", 1))
        if not all(isinstance(count, int) for count in counts):
            return None
        return math.prod(counts) or None

    @cached_property
    def grid(self) -> np.ndarray:
        """The steps of the points of its curves, (points,)."""
        return make_grid(self.budget)

    @cached_property
    def quantities(self) -> tuple[str, ...]:
        return tuple(name for name in TRAINING_QUANTITIES if self.windows_of(name))

    def windows_of(self, quantity: str) -> tuple[str, ...]:
        """Return the windows in which it has a curve, the default first; quantities of updates have any."""
        return tuple(window for window in WINDOWS if curve_column(quantity, window) in self._columns)

    @property
    def windows(self) -> tuple[str, ...]:
        return self.windows_of("return") or WINDOWS[:1]

    @cached_property
    def _columns(self) -> frozenset[str]:
        """The names of its cells that have a value."""
        columns = zip(self.table.column_names, self.table.columns, strict=True)
        return frozenset(name for name, column in columns if column[0].is_valid)

    def curve(self, quantity: str, window: str = "") -> np.ndarray:
        """Return a curve on the row's own grid, (points,); NaN where it has no value."""
        windows = self.windows_of(quantity)
        if windows and not window:
            window = windows[0]
        return self._points(curve_column(quantity, window))

    def peaks(self, quantity: str) -> np.ndarray:
        """Return the extreme update of one of `EXTREMES` since each previous point, (points,)."""
        return self._points(f"{quantity} {PEAKS}")

    def _points(self, column: str) -> np.ndarray:
        if column in self._columns:
            values = self.table[column][0].values
            if len(values) == GRID_POINTS:
                return values.to_numpy(zero_copy_only=False).astype(float)
        return np.full(GRID_POINTS, np.nan)

    def known_curve(self, quantity: str) -> Series:
        """Return the points of a curve that have a value; empty if there is no such curve."""
        return finite_points(self.grid, self.curve(quantity))

    def known_peaks(self, quantity: str) -> Series:
        return finite_points(self.grid, self.peaks(quantity))

    def statistic(self, quantity: str, name: str) -> float:
        """Return one of `STATISTICS` of a curve, exact where that is kept; NaN if it has no value."""
        exact = self.exact(quantity, name)
        if not math.isnan(exact):
            return exact
        step, values = self.known_curve(quantity)
        if not len(values):
            return math.nan
        return STATISTICS[name](step, values, self.budget)

    def exact(self, quantity: str, statistic: str) -> float:
        """Return a statistic of a curve at the run's end, with all digits; NaN if it is not kept."""
        return self._number(f"{quantity} {statistic}", math.nan)

    @property
    def last_episodes(self) -> float:
        """The number of episodes that the last point of its return averages; infinite if it is not known."""
        return self._number(LAST_EPISODES, math.inf)

    def _number(self, column: str, default: float) -> float:
        value = self.cell(column)
        return default if value is None else float(value)

    @cached_property
    def _evaluations(self) -> dict[str, np.ndarray]:
        """The columns of its evaluations that have a value, by name."""
        evaluations = self.table[EVALUATIONS][0].values
        if evaluations is None or pa.types.is_null(evaluations.type):
            return {}
        columns = {}
        for field_type in evaluations.type:
            column = evaluations.field(field_type.name)
            if column.null_count < len(column):
                columns[field_type.name] = column.to_numpy(zero_copy_only=False)
        return columns

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
        return finite_points(self.evaluations("step"), self.evaluations(column))

    def evaluations_table(self) -> pa.Table:
        return pa.table(dict(self._evaluations))

    @property
    def wall_seconds(self) -> float | None:
        """Seconds of training, without loading and compiling if these were timed; None if unknown."""
        seconds = self.provenance.get("training_seconds", self.provenance.get("wall_seconds"))
        if not isinstance(seconds, int | float) or seconds <= 0:
            return None
        return float(seconds)

    @property
    def processor_share(self) -> float | None:
        """Share of a core that the training had; 1 if nothing else ran, None if unknown."""
        share = self.provenance.get("processor_share")
        return float(share) if isinstance(share, int | float) else None

    def same_numbers(self, other: Row) -> bool:
        """Return whether two rows of one run agree in every single number and evaluation that both have.

        Curves are not compared: tables published earlier keep more of their digits.
        """
        for name in self._columns & other._columns:
            values = [self.cell(name), other.cell(name)]
            are_numbers = all(isinstance(value, float) and not math.isnan(value) for value in values)
            if are_numbers and values[0] != values[1]:
                return False
        for name in self._evaluations.keys() & other._evaluations.keys():
            if name.endswith("score"):  # it is scaled by the random player, who has been measured again
                continue
            if not np.array_equal(self.evaluations(name), other.evaluations(name), equal_nan=True):
                return False
        return True
