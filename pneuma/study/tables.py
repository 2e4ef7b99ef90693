"""Tables as files: writing them, and the one door at which they are read, with sizes and columns checked.

    a run's records → `to_parquet` → file → `record_table`
    rows (`rows.py`, `published.py`) → file → `from_ipc`, `from_parquet`

A file may be untrusted. What it unpacks to is bounded before it is unpacked, and all that is wrong with it is
a ValueError of one line.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc
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
    abort when it ends. The file may be untrusted: what its pages unpack to is bounded before they are read,
    and so is text, of which a dictionary may repeat a long one, before it is repeated.

    Raises:
        ValueError: for an invalid file, or one that would be too large.
    """
    with _only_value_errors():
        metadata = pq.read_metadata(pa.BufferReader(data))
        names = [metadata.schema.column(place).path for place in range(metadata.num_columns)]
        places = [
            place for place, name in enumerate(names) if not columns or name.partition(".")[0] in columns
        ]
        groups = map(metadata.row_group, range(metadata.num_row_groups))
        chunks = [group.column(place) for group in groups for place in places]
        _refuse_too_much(sum(size for chunk in chunks for size in _page_sizes(data, chunk)))
        texts = {chunk.path_in_schema for chunk in chunks if chunk.physical_type == "BYTE_ARRAY"}
        file = pq.ParquetFile(pa.BufferReader(data), metadata=metadata, read_dictionary=[*texts])
        table = file.read(columns=columns and list(columns), use_threads=False)
        _refuse_too_much(sum(map(_text_bytes, table.columns)))
        table = table.cast(pa.schema(map(_written_out, table.schema), table.schema.metadata))
    return _of_distinct_names(table)


def from_ipc(data: bytes) -> pa.Table:
    """Read a file of one table in Arrow's own format from memory.

    It may be untrusted. One that is compressed is refused, so that its size bounds the table's.

    Raises:
        ValueError: for an invalid file.
    """
    if not data.endswith(b"ARROW1"):
        raise ValueError("is cut off, or no table")
    with _only_value_errors():
        messages = pa.ipc.MessageReader.open_stream(pa.py_buffer(data).slice(len(b"ARROW1\0\0")))
        schema = pa.ipc.read_schema(messages.read_next_message())
        batch = messages.read_next_message()
        if batch.type != "record batch" or _is_compressed(batch.metadata.to_pybytes()):
            raise ValueError("is no plain table")
        table = pa.Table.from_batches([pa.ipc.read_record_batch(batch, schema)])
        table.validate(full=True)
    return _of_distinct_names(table)


@contextmanager
def _only_value_errors() -> Iterator[None]:
    try:
        yield
    except (pa.ArrowException, OSError, MemoryError) as error:
        problem = [*str(error).splitlines(), "damaged"][0]
        raise ValueError(f"is no table that can be read ({problem[:100]})") from None
    except (LookupError, StopIteration, RecursionError):  # of pages and messages that are not as they say
        raise ValueError("is no table that can be read (damaged)") from None


def _of_distinct_names(table: pa.Table) -> pa.Table:
    if len({*table.column_names}) < table.num_columns:
        raise ValueError("has two columns of one name")
    return table


def _refuse_too_much(unpacked: int) -> None:
    if unpacked > LARGEST_BYTES:
        raise ValueError(f"unpacks to more than {LARGEST_BYTES / 2**20:.0f} MB")


def _text_bytes(column: pa.ChunkedArray) -> int:
    """Return how long the text of a column is that was read as a dictionary."""
    if not pa.types.is_dictionary(column.type):
        return 0
    lengths = (pc.binary_length(chunk.dictionary).take(chunk.indices) for chunk in column.chunks)
    return sum(pc.sum(each).as_py() or 0 for each in lengths)


def _written_out(field: pa.Field) -> pa.Field:
    return field.with_type(field.type.value_type) if pa.types.is_dictionary(field.type) else field


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


# --- How large a file says that it is -------------------------------------------------------------------

_PHYSICAL = {"BOOLEAN", "INT32", "INT64", "FLOAT", "DOUBLE", "BYTE_ARRAY"}
_ABOUT = {0: 5, 2: 7}
"""The field of a page's header, by its type, that tells of its values: pages of data and dictionaries."""
_ENCODINGS = {0, 2, 3, 8, 9}
"""Plain, dictionaries, runs and split streams: in others a text may begin with the whole one before."""


def _page_sizes(data: bytes, chunk: Any) -> Iterator[int]:
    """Yield the most bytes that each page of a column unpacks to.

    The page's own header tells it (`PageHeader` of parquet.thrift): the footer may say anything.
    """
    first, dictionary = chunk.data_page_offset, chunk.dictionary_page_offset or 0
    place = dictionary if 0 < dictionary < first else max(first, 0)  # as Arrow has it
    end = place + chunk.total_compressed_size if chunk.num_values else 0
    while place < end:
        header, place = _read_struct(data, place)
        unpacked, packed, about = header[2], header[3], header[_ABOUT[header[1]]]
        known = chunk.physical_type in _PHYSICAL and about[2] in _ENCODINGS
        if not known or min(unpacked, packed, about[1]) < 0:
            raise ValueError("is packed otherwise than tables here")
        place += packed
        yield unpacked + 8 * about[1]


def _read_struct(data: bytes, place: int) -> tuple[dict[int, Any], int]:
    """Read a struct of Thrift's compact protocol: its fields by number, and where it ends."""
    fields: dict[int, Any] = {}
    number = 0
    while kind := data[place]:
        place += 1
        if step := kind >> 4:
            number += step
        else:
            number, place = _read_number(data, place)
        value: Any = None
        match kind & 15:
            case 1 | 2:  # true, false
                pass
            case 3:
                place += 1
            case 4 | 5 | 6:
                value, place = _read_number(data, place)
            case 7:
                place += 8
            case 8:
                length, place = _read_number(data, place, signed=False)
                place += length
            case 12:
                value, place = _read_struct(data, place)
            case _:
                raise ValueError("has a page of an unknown form")
        if number in fields:
            raise ValueError("has a page that says a thing twice")
        fields[number] = value
    return fields, place + 1


def _read_number(data: bytes, place: int, signed: bool = True) -> tuple[int, int]:
    number = shift = 0
    while data[place] & 128:
        number, shift, place = number | (data[place] & 127) << shift, shift + 7, place + 1
    number |= data[place] << shift
    return (number >> 1) ^ -(number & 1) if signed else number, place + 1


def _is_compressed(message: bytes) -> bool:
    """Return whether a record batch, in the header of a message (a flatbuffer), has a field `compression`."""

    def number(place: int, size: int) -> int:
        return int.from_bytes(message[place : place + size], "little")

    def find(table: int, field: int) -> int:
        fields = table - number(table, 4)
        offset = number(fields + 4 + 2 * field, 2) if 4 + 2 * field < number(fields, 2) else 0
        return table + offset if offset else 0

    header = find(number(0, 4), 2)
    return find(header + number(header, 4), 3) > 0
