"""Tables as files: how they are written, and the one place where they are read.

    a run's records → `to_parquet` → file → `from_parquet`
    a row (`rows.py`) → file → `from_ipc`
    published rows (`published.py`) → file → `from_parquet`

The size of a table is not limited. `files.stored_file` catches what a damaged file raises.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

INTEGER_COLUMNS = {"slot", "episode", "step", "length", "kills", "episodes", "argmax_starts"}
TEXT_COLUMNS = {"ending", "tag"}


def to_parquet(rows: Iterable[Mapping[str, Any]], columns: Sequence[str]) -> bytes:
    """Return rows as a Parquet file; the same rows give the same bytes."""
    rows = list(rows)
    arrays = []
    for column_name in columns:
        column_values = [row[column_name] for row in rows]
        arrays.append(pa.array(column_values, _column_type(column_name, column_values)))
    buffer = io.BytesIO()
    pq.write_table(pa.table(arrays, names=list(columns)), buffer, compression="zstd")
    return buffer.getvalue()


def _column_type(column_name: str, column_values: Sequence[Any]) -> pa.DataType:
    if column_name in TEXT_COLUMNS:
        return pa.string()
    if column_name in INTEGER_COLUMNS and all(isinstance(value, int) for value in column_values):
        return pa.int64()
    return pa.float64()


def from_parquet(encoded_table: bytes, columns: Sequence[str] | None = None) -> pa.Table:
    """Read a Parquet file, or some of its columns, from memory, in this thread only.

    Arrow's `read_table`, and reading from a Python file, start threads, which may abort a command as it ends.
    """
    return pq.ParquetFile(pa.BufferReader(encoded_table)).read(columns=columns, use_threads=False)


def from_ipc(encoded_table: bytes) -> pa.Table:
    """Read a file in Arrow's own format from memory, in this thread only."""
    options = pa.ipc.IpcReadOptions(use_threads=False)
    table = pa.ipc.open_file(pa.BufferReader(encoded_table), options=options).read_all()
    table.validate(full=True)  # by default Arrow does not check offsets
    return table
