"""Published tables: the rows of a study's runs in one small file.

rows → `encode_published` → results/published/NAME.parquet → `Published` → Row
"""

from __future__ import annotations

import io
import json
import re
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from pneuma.files import checksum, parse_json, stored_file
from pneuma.store.rows import COLUMN_TYPES, CURVE, Row, read_row, sound_rows
from pneuma.store.tables import from_parquet


def encode_published(
    rows: Sequence[Row], description: Mapping[str, Any], curves: Sequence[str] | None = None
) -> bytes:
    """Return rows as a published table with the curves of some quantities, or all.

    The same rows give the same bytes. `Published.about` gives `description` back.
    """
    table = pa.concat_tables([row.table for row in rows], promote_options="permissive")
    table = _without_folders(table.combine_chunks())
    curve_names, other_names, left_out = [], [], []
    for column_name in table.column_names:
        if COLUMN_TYPES.get(column_name) != CURVE:
            other_names.append(column_name)
        elif curves is None or column_name.partition(" ")[0] in curves:
            curve_names.append(column_name)
        else:
            left_out.append(column_name)
    table = table.drop_columns(left_out)
    metadata = {"pneuma": json.dumps({"schema": SCHEMA, **description}), "pneuma.checksum": _NO_CHECKSUM}
    table = table.cast(pa.schema(map(_as_parquet, table.schema))).replace_schema_metadata(metadata)
    buffer = io.BytesIO()
    pq.write_table(
        table,
        buffer,
        compression="zstd",
        compression_level=19,
        # a dictionary does not help where numbers hardly repeat
        use_dictionary=other_names,
        use_byte_stream_split=[f"{column_name}.list.element" for column_name in curve_names],
    )
    encoded_table = buffer.getvalue()
    return encoded_table.replace(_NO_CHECKSUM, f"sha256:{checksum(encoded_table)}".encode())


_FOLDERS = re.compile(r'(?<=")/(?:[^"/]*/)*(?=[^"/]*")')
"""The folders of an absolute path that is a JSON string."""


def _without_folders(table: pa.Table) -> pa.Table:
    """Return rows whose fields name the user's own files without their folders."""
    column_index = table.column_names.index("fields")
    column = table.schema.field(column_index)
    fields_texts = [_FOLDERS.sub("", fields_text) for fields_text in table["fields"].to_pylist()]
    return table.set_column(column_index, column, pa.array(fields_texts, column.type))


def _as_parquet(column: pa.Field) -> pa.Field:
    """Return a column whose lists name their elements as Parquet does, as in rows from published tables."""
    if not pa.types.is_list(column.type):
        return column
    return column.with_type(pa.list_(pa.field("element", column.type.value_type)))


SCHEMA = 3
_NO_CHECKSUM = b"sha256:" + b"0" * 64
"""Placeholder for the checksum over all other bytes of a published table."""
_CHECKSUM = re.compile(rb"sha256:([0-9a-f]{64})")

INDEX_COLUMNS = ["run_id", "config_id", "seed", "steps", "status", "end"]
_INDEX_SCHEMA = pa.schema([pa.field(name, COLUMN_TYPES[name], nullable=False) for name in INDEX_COLUMNS])


class Published:
    """A published table, which may be untrusted. Its rows are read when the first one is asked for.

    Attributes:
        about: what `encode_published` was given.
        index: `INDEX_COLUMNS` of each run, and `where`, the table's path.
        row_numbers: the number of each run's row, by id.

    Raises:
        UserError: for a file that is damaged, or that `encode_published` did not make.
    """

    def __init__(self, table_path: Path, encoded_table: bytes) -> None:
        self.path = table_path
        self._data = encoded_table
        with stored_file(table_path):
            digests = _CHECKSUM.findall(encoded_table)
            if len(digests) != 1:
                raise ValueError("damaged")
            without_checksum = encoded_table.replace(b"sha256:" + digests[0], _NO_CHECKSUM)
            if digests[0] != checksum(without_checksum).encode():
                raise ValueError("damaged")
            index = from_parquet(encoded_table, INDEX_COLUMNS)
            self.about = parse_json(index.schema.metadata[b"pneuma"])
            if self.about.get("schema") != SCHEMA:
                raise ValueError("of another version of Pneuma")
            where = pa.array([str(table_path)] * len(index))
            self.index = index.cast(_INDEX_SCHEMA).append_column("where", where)
        self.row_numbers = {run_id: number for number, run_id in enumerate(self.index["run_id"].to_pylist())}

    def document(self, column: str, run_id: str) -> dict[str, Any]:
        """Return the fields or the provenance of one of its runs."""
        with stored_file(self.path):
            return parse_json(self._texts[column][self.row_numbers[run_id]].as_py())

    @cached_property
    def _texts(self) -> pa.Table:
        return from_parquet(self._data, ["fields", "provenance"])

    @cached_property
    def _rows(self) -> pa.Table:
        return sound_rows(from_parquet(self._data))

    def row(self, run_id: str) -> Row:
        """Return the row of one of its runs.

        Raises:
            UserError: if the table is invalid.
        """
        with stored_file(self.path):
            return read_row(self._rows, self.row_numbers[run_id], published=True)

    def rows(self) -> dict[str, Row]:
        return {run_id: self.row(run_id) for run_id in self.row_numbers}
