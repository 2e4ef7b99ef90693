"""A row: the results of one finished run. Figures, tables and tests read nothing else of a run.

    a run's files → `row_builder.py` → cells → `encode_row` → row.arrow in its folder
    row.arrow → `decode_row` → Row

`COLUMN_TYPES` declares the columns. Curves are on 200 points of the run's *own* budget and are rounded when
the row is written, so that a run and its published row are equal. Numbers that need more digits are kept
exact. Single updates and episodes are only exported.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from pneuma.config import Run, as_fields
from pneuma.files import parse_json
from pneuma.store.quantities import QUANTITIES, TRAINING_QUANTITIES, UPDATE_QUANTITIES, WINDOWS
from pneuma.store.series import (
    EXTREMES,
    GRID_POINTS,
    Series,
    Stretch,
    curve_statistic,
    finite_points,
    make_grid,
    unpack_signs,
)
from pneuma.store.tables import from_ipc

# --- The columns ------------------------------------------------------------------------------------

TEXT_CELLS = ("run_id", "config_id", "status", "fields", "provenance", "signs")
INTEGER_CELLS = ("seed", "steps", "end")
POLICY = "policy"
"""The column with the policy's checksum (`Policy.checksum`). It is null for runs that diverged, for learners
whose policy is not a `Policy`, and for imported logs; older tables lack the column."""
EVALUATIONS = "evaluations"
"""The column with a list of structs: the step and the other numbers of each evaluation."""
REQUIRED_CELLS = TEXT_CELLS + INTEGER_CELLS + (EVALUATIONS,)
AVERAGED_OVER, LAST_EPISODES = "averaged over", "episodes last"
STUCK = ("stuck updates", "updates", "stuck spells")
"""Counts of updates without entropy and with one action, of all updates, and of spells of the former."""
PEAK, PEAKS = "peak", "extreme"
"""The extreme of a quantity over all updates, and its curve: the extreme since the previous point."""
CURVE, NUMBER = pa.list_(pa.float32()), pa.float64()


def curve_column(quantity: str, window: str) -> str:
    """Return the name of a curve's column; quantities of updates have no window."""
    return quantity if quantity in UPDATE_QUANTITIES else f"{quantity} {window}"


def _column_types() -> dict[str, pa.DataType]:
    types_by_column = dict.fromkeys(TEXT_CELLS + (POLICY,), pa.string())
    types_by_column |= dict.fromkeys(INTEGER_CELLS + STUCK + (AVERAGED_OVER,), pa.int64())
    types_by_column[LAST_EPISODES] = NUMBER
    for quantity in TRAINING_QUANTITIES:
        for window in WINDOWS:
            types_by_column[curve_column(quantity, window)] = CURVE
        for statistic in QUANTITIES[quantity].exact:
            types_by_column[f"{quantity} {statistic}"] = NUMBER
    for quantity in EXTREMES:
        types_by_column |= {f"{quantity} {PEAKS}": CURVE, f"{quantity} {PEAK}": NUMBER}
    return types_by_column


COLUMN_TYPES = _column_types()
"""The types of all columns that are read, except the evaluations."""

# --- The files --------------------------------------------------------------------------------------


def encode_row(cells: Mapping[str, Any]) -> bytes:
    """Return one row as a file in Arrow's own format, which is read 25 times as fast as Parquet."""
    row_table = pa.table({name: pa.array([cell], COLUMN_TYPES.get(name)) for name, cell in cells.items()})
    buffer = pa.BufferOutputStream()
    with pa.ipc.new_file(buffer, row_table.schema) as writer:
        writer.write_table(row_table)
    return buffer.getvalue().to_pybytes()


def decode_row(encoded_row: bytes) -> Row:
    """Return the row in a run's folder; for anything else any error may be raised."""
    row_table = sound_rows(from_ipc(encoded_row))
    if row_table.num_rows != 1:
        raise ValueError("has not one row")
    return read_row(row_table)


_PATTERNS = {
    "run_id": "[0-9a-f]{16}",
    "config_id": "[0-9a-f]{16}",
    "status": "done|diverged",
    "steps": r"[1-9]\d*",
    POLICY: "[0-9a-f]{16}",
}
"""The forms of cells; only the policy's may be null."""


def sound_rows(table: pa.Table) -> pa.Table:
    """Return the columns of rows that are read.

    Raises:
        ValueError: if one of them is missing, or is not as `encode_row` writes it.
    """
    column_names = []
    for column_name, column_type in zip(table.schema.names, table.schema.types, strict=True):
        if column_name in COLUMN_TYPES and column_type != COLUMN_TYPES[column_name]:
            raise ValueError(f"column {column_name} is invalid")
        if column_name in COLUMN_TYPES or column_name == EVALUATIONS:
            column_names.append(column_name)
    for column_name in REQUIRED_CELLS:
        if column_name not in column_names:
            raise ValueError(f"column {column_name} is missing")
        if table[column_name].null_count:
            raise ValueError(f"column {column_name} is invalid")
    for column_name, pattern in _PATTERNS.items():
        cells = table[column_name].drop_null().to_pylist() if column_name in column_names else []
        if not all(re.fullmatch(pattern, str(cell)) for cell in cells):
            raise ValueError(f"column {column_name} is invalid")
    if not _are_evaluations(table[EVALUATIONS]):
        raise ValueError(f"column {EVALUATIONS} is invalid")
    return table.select(column_names)


def _are_evaluations(column: pa.ChunkedArray) -> bool:
    """Return whether a column has lists of structs of numbers with a finite step, or lists of nothing."""
    if not (pa.types.is_list(column.type) and pa.types.is_struct(column.type.value_type)):
        return bool(column.type == pa.list_(pa.null()))
    types = {field.name: field.type for field in column.type.value_type}
    numbers = {pa.int64(), NUMBER}
    if types.get("step") not in numbers or not set(types.values()) <= {*numbers, pa.null()}:
        return False
    steps = pc.struct_field(pc.list_flatten(column), "step")
    return not steps.null_count and pc.all(pc.is_finite(steps), min_count=0).as_py()


# --- Reading ----------------------------------------------------------------------------------------

_TYPES_BY_DEFAULT = {str: (str,), list: (list,), type(None): (int, float, list)}


@cache
def _field_types() -> dict[str, tuple[type, ...]]:
    """Return the types that the value of a field may have, by those of its default."""
    types_by_field: dict[str, tuple[type, ...]] = {}
    for field_name, default in as_fields(Run()).items():
        types_by_field[field_name] = _TYPES_BY_DEFAULT.get(type(default), (int, float))
    return types_by_field


def _read_fields(fields_text: str) -> dict[str, Any]:
    """Read a configuration, with each field of a type that it may have."""
    fields, types_by_field = parse_json(fields_text), _field_types()
    for field_name, value in fields.items():
        is_sound = value is None or isinstance(value, types_by_field.get(field_name, (str, int, float, list)))
        if isinstance(value, list) and any(isinstance(element, list | dict) for element in value):
            is_sound = False
        if not is_sound:
            raise ValueError(f"{field_name} = {json.dumps(value)[:40]}")
    return fields


def read_row(table: pa.Table, row_index: int = 0, published: bool = False) -> Row:
    """Return a row of a table of `sound_rows`; for an invalid one any error may be raised."""
    cells = {column_name: table[column_name][row_index].as_py() for column_name in TEXT_CELLS + INTEGER_CELLS}
    return Row(
        table.replace_schema_metadata(None),
        row_index,
        published,
        run_id=cells["run_id"],
        config_id=cells["config_id"],
        seed=cells["seed"],
        budget=cells["steps"],
        end=cells["end"],
        status=cells["status"],
        fields=_read_fields(cells["fields"]),
        provenance=parse_json(cells["provenance"]),
        signs=unpack_signs(cells["signs"], last_step=max(cells["end"], cells["steps"])),
    )


def in_one_table(rows: Sequence[Row]) -> list[Row]:
    """Return rows, each in a table of its own, in one table, which takes a third of their memory."""
    tables = [row.shared_table for row in rows]
    table = pa.concat_tables(tables, promote_options="permissive").combine_chunks()
    return [replace(row, shared_table=table, row_index=row_index) for row_index, row in enumerate(rows)]


@dataclass(frozen=True, eq=False)
class Row:
    """One finished run, done or diverged.

    Attributes:
        shared_table: a table that has its cells in the row `row_index`.
        published: whether it is in a published table.
        config_id: the id of its configuration, without seed and steps.
        budget: agent steps that were planned.
        end: agent steps trained, to the end of the last update: at least the budget, unless it diverged.
        status: 'done' or 'diverged'.
        fields: its configuration, which may be untrusted.
        provenance: what produced it, and how long that took.
        signs: where each recorded sign of collapse holds.
    """

    shared_table: pa.Table = field(repr=False)
    row_index: int = field(repr=False)
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

    @property
    def table(self) -> pa.Table:
        """All its cells, as a table of one row."""
        return self.shared_table.slice(self.row_index, 1)

    def _scalar(self, column: str) -> pa.Scalar:
        return self.shared_table[column][self.row_index]

    def cell(self, column: str) -> Any:
        return self._scalar(column).as_py() if self._has(column) else None

    @property
    def averaged_over(self) -> int | None:
        """Episodes over which returns were averaged when they were logged; None if they were not."""
        return self.cell(AVERAGED_OVER)

    @property
    def policy(self) -> str | None:
        """The checksum of its policy; None if it has none, or its table is older."""
        checksum: str | None = self.cell(POLICY)
        return checksum

    @property
    def origin(self) -> str:
        """A description of where it was read, for messages."""
        if self.averaged_over:
            return "a study of imported logs"
        return "the published table" if self.published else "the results folder"

    @property
    def update_steps(self) -> int | None:
        """Agent steps of one update; None if its fields lack them."""
        horizon, slots = self.fields.get("horizon"), self.fields.get("slots")
        if not horizon or not slots:
            return None
        steps: int = horizon * slots * self.fields.get("players", 1)
        return steps

    @property
    def wall_seconds(self) -> float | None:
        """Seconds of training, without loading and compiling if these were timed; None if unknown."""
        seconds = self.provenance.get("training_seconds", self.provenance.get("wall_seconds"))
        return float(seconds) if isinstance(seconds, int | float) and seconds > 0 else None

    def _has(self, column: str) -> bool:
        """Return whether the cell has a value."""
        is_column = self.shared_table.schema.get_field_index(column) >= 0
        return is_column and bool(self._scalar(column).is_valid)

    # --- Curves and their statistics ---------------------------------------------------------------

    @cached_property
    def grid(self) -> np.ndarray:
        """The steps of the points of its curves, (points,)."""
        return make_grid(self.budget)

    @cached_property
    def quantities(self) -> tuple[str, ...]:
        return tuple(quantity for quantity in TRAINING_QUANTITIES if self.windows_of(quantity))

    def windows_of(self, quantity: str) -> tuple[str, ...]:
        """Return the windows in which it has a curve, the default first; quantities of updates have any."""
        return tuple(window for window in WINDOWS if self._has(curve_column(quantity, window)))

    @property
    def windows(self) -> tuple[str, ...]:
        return self.windows_of("return") or WINDOWS[:1]

    def curve(self, quantity: str, window: str = "") -> np.ndarray:
        """Return a curve on the row's own grid, (points,); NaN where it has no value."""
        windows = [window] if window else self.windows_of(quantity)
        return self._points(curve_column(quantity, windows[0]) if windows else "")

    def _points(self, column: str) -> np.ndarray:
        if self._has(column):
            points = self._scalar(column).values
            if len(points) == GRID_POINTS:
                return points.to_numpy(zero_copy_only=False).astype(float)
        return np.full(GRID_POINTS, np.nan)

    def curve_points(self, quantity: str) -> Series:
        """Return the points of a curve that have a value; empty if there is no such curve."""
        return finite_points(self.grid, self.curve(quantity))

    def statistic(self, quantity: str, statistic_name: str) -> float:
        """Return a `curve_statistic` of a quantity or its `PEAK`, NaN if it has no value.

        It is exact where that is kept. Older tables lack some: then it is that of the rounded curve.
        """
        exact_value = self.cell(f"{quantity} {statistic_name}")
        if exact_value is not None and not math.isnan(exact_value):
            return float(exact_value)
        if statistic_name == PEAK:
            return float(EXTREMES[quantity].reduce(self._points(f"{quantity} {PEAKS}")))
        step, values = self.curve_points(quantity)
        return curve_statistic(statistic_name, step, values, self.budget)

    # --- Evaluations -------------------------------------------------------------------------------

    @cached_property
    def evaluations_table(self) -> pa.Table:
        """The columns of its evaluations that have a value."""
        evaluations = self._scalar(EVALUATIONS).values
        if not pa.types.is_struct(evaluations.type):
            return pa.table({})
        table = pa.Table.from_struct_array(evaluations)
        column_names = [name for name in table.column_names if table[name].null_count < len(table)]
        return table.select(column_names)

    @cached_property
    def _evaluations(self) -> dict[str, np.ndarray]:
        """The columns that `evaluations` has returned before."""
        return {}

    def evaluations(self, column: str) -> np.ndarray:
        """Return a column of its evaluations, in their order; empty if it has no such column."""
        if column not in self._evaluations:
            values = np.empty(0)
            if column in self.evaluations_table.column_names:
                values = self.evaluations_table[column].to_numpy().astype(float)
            values.setflags(write=False)  # it is returned again
            self._evaluations[column] = values
        return self._evaluations[column]

    def evaluation_points(self, column: str) -> Series:
        """Return a column's finite values with their steps; empty if it has no such column."""
        values = self.evaluations(column)
        return finite_points(self.evaluations("step")[: len(values)], values)

    def same_numbers(self, other_row: Row) -> bool:
        """Return whether two rows of one run agree in every single number and evaluation that both have.

        Curves are not compared: tables published earlier keep more of their digits.
        """
        numbers = [name for name, column_type in COLUMN_TYPES.items() if column_type == NUMBER]
        for column in numbers:
            # of a number that one of them lacks, the difference is NaN
            if (
                self._has(column)
                and other_row._has(column)
                and abs(self.cell(column) - other_row.cell(column)) > 0
            ):
                return False
        columns = set(self.evaluations_table.column_names) & set(other_row.evaluations_table.column_names)
        for column in columns:
            if column.endswith("score"):  # it is scaled by the random player, who has been measured again
                continue
            if not np.array_equal(self.evaluations(column), other_row.evaluations(column), equal_nan=True):
                return False
        return True
