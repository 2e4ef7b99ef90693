"""Record tables as Parquet: what an engine's rows become in the store, and back."""

from __future__ import annotations

import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

_WHOLE = {"slot", "learner", "episode", "step", "length", "kills", "episodes", "argmax_starts"}
_TEXT = {"ending"}


def to_parquet(rows: Iterable[Mapping[str, Any]], columns: Sequence[str]) -> bytes:
    """Return rows as a Parquet file; the same rows give the same bytes."""
    rows = list(rows)
    arrays = [pa.array([row[name] for row in rows], _kind(name, rows)) for name in columns]
    sink = io.BytesIO()
    pq.write_table(pa.table(arrays, names=list(columns)), sink, compression="zstd")
    return sink.getvalue()


def from_parquet(data: bytes) -> pa.Table:
    """Read a Parquet file from memory, in this thread alone.

    Arrow's `read_table`, and reading from a file of Python's, start threads whatever they are told, with
    which a command now and then aborts as it ends.
    """
    return pq.ParquetFile(pa.BufferReader(data)).read(use_threads=False)


def _kind(name: str, rows: Sequence[Mapping[str, Any]]) -> pa.DataType:
    if name in _TEXT:
        return pa.string()
    whole = name in _WHOLE and all(isinstance(row[name], int) for row in rows)
    return pa.int64() if whole else pa.float64()
