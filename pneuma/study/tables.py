"""Tables of records as Parquet files: writing them, and reading them with their columns checked."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from pneuma.files import LARGEST_BYTES

_WHOLE = {"slot", "episode", "step", "length", "kills", "episodes", "argmax_starts"}
_TEXT = {"ending", "tag"}
_EVERYWHERE = {
    "episodes": ("step", "slot"),
    "metrics": ("step",),
    "evaluations": ("step",),
    "scalars": ("step", "tag", "value", "superseded"),
}
"""Columns that each record table must have."""


def to_parquet(rows: Iterable[Mapping[str, Any]], columns: Sequence[str]) -> bytes:
    """Return rows as a Parquet file; the same rows give the same bytes."""
    rows = list(rows)
    arrays = [pa.array([row[name] for row in rows], _kind(name, rows)) for name in columns]
    sink = io.BytesIO()
    pq.write_table(pa.table(arrays, names=list(columns)), sink, compression="zstd")
    return sink.getvalue()


def from_parquet(data: bytes, columns: Sequence[str] | None = None) -> pa.Table:
    """Read a Parquet file, or some of its columns, from memory, in this thread only.

    Arrow's `read_table`, and reading from a Python file, always start threads, because of which a command may
    abort when it ends. The footer gives the unpacked size, which is checked first.

    Raises:
        ValueError: for an invalid file, or one that would be too large.
    """
    with _only_value_errors():
        file = pq.ParquetFile(pa.BufferReader(data))
        groups = [file.metadata.row_group(place) for place in range(file.metadata.num_row_groups)]
        values = sum(group.column(place).num_values for group in groups for place in range(group.num_columns))
        if max(8 * values, sum(group.total_byte_size for group in groups)) > LARGEST_BYTES:
            raise ValueError(f"unpacks to more than {LARGEST_BYTES / 2**20:.0f} MB")
        table = file.read(columns=columns and list(columns), use_threads=False)
    return _of_distinct_names(table)


def from_ipc(data: bytes) -> pa.Table:
    """Read a file in Arrow's own format from memory; it is not compressed, so its size bounds the table's.

    Raises:
        ValueError: for an invalid file.
    """
    with _only_value_errors():
        table = pa.ipc.open_file(pa.BufferReader(data)).read_all()
        table.validate(full=True)
    return _of_distinct_names(table)


@contextmanager
def _only_value_errors() -> Iterator[None]:
    try:
        yield
    except (pa.ArrowException, OSError, MemoryError) as error:
        problem = [*str(error).splitlines(), "damaged"][0]
        raise ValueError(f"is no table that can be read ({problem[:100]})") from None


def _of_distinct_names(table: pa.Table) -> pa.Table:
    if len({*table.column_names}) < table.num_columns:
        raise ValueError("has two columns of one name")
    return table


def record_table(data: bytes, name: str) -> pa.Table:
    """Read one of a run's record tables and check the names and types of its columns.

    Raises:
        ValueError: for an invalid table.
    """
    table = from_parquet(data)
    for column in _EVERYWHERE.get(name, ()):
        if column not in table.column_names or (column != "value" and table[column].null_count):
            raise ValueError(f"column {column} is missing, or has gaps")
    for field in table.schema:
        if field.name in _TEXT:
            sound = pa.types.is_string(field.type) or pa.types.is_large_string(field.type)
        elif field.name in ("step", "slot"):
            sound = pa.types.is_integer(field.type)
        else:
            sound = pa.types.is_integer(field.type) or pa.types.is_floating(field.type)
            sound = sound or (field.name == "superseded" and pa.types.is_boolean(field.type))
        if not sound:
            raise ValueError(f"column {field.name} is of type {field.type}")
    return table


def _kind(name: str, rows: Sequence[Mapping[str, Any]]) -> pa.DataType:
    if name in _TEXT:
        return pa.string()
    whole = name in _WHOLE and all(isinstance(row[name], int) for row in rows)
    return pa.int64() if whole else pa.float64()
