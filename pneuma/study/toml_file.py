"""Read a person's TOML file and say where in it something stands.

`tomllib` reports no lines for keys, so a small locator finds them again.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pneuma.errors import UserError, nearest_name


@dataclass(frozen=True)
class TomlFile:
    """A parsed file with its text, so that errors can name a line."""

    path: Path
    text: str
    data: dict[str, Any]

    def mistake(self, table: str, key: str, message: str) -> UserError:
        """Build an error that names file, line, table and what is wrong."""
        line = _line_of(self.text, table, key)
        where = f"{self.path}, line {line}" if line else str(self.path)
        return UserError(f"{where}: {f'[{table}] ' if table else ''}{message}")

    def table(self, table: str, key: str) -> dict[str, Any]:
        """Return the sub-table `key` of `table`, empty when there is none, and refuse other values."""
        parent = self.data if not table else self.data[table]
        value = parent.get(key, {})
        if not isinstance(value, dict):
            raise self.mistake(table, key, f"{key} must be a table, not {value!r}")
        return value

    def refuse_unknown(self, table: str, given: Mapping[str, Any], allowed: tuple[str, ...]) -> None:
        """Raise for the first key of a table that is none of `allowed`."""
        for key in given:
            if key not in allowed:
                hint = nearest_name(key, allowed)
                raise self.mistake(table, key, f"unknown key {key!r}{hint}; known are {', '.join(allowed)}")


def read_toml(path: Path) -> TomlFile:
    """Read a TOML file.

    Raises:
        UserError: when it cannot be read or is not TOML, naming the line.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "it is not UTF-8 text"
        raise UserError(f"{path}: cannot be read: {reason}") from None
    try:
        return TomlFile(path, text, tomllib.loads(text))
    except tomllib.TOMLDecodeError as error:
        raise UserError(f"{path}: not TOML: {error}") from None


def _line_of(text: str, table: str, key: str) -> int | None:
    """Return the line, from 1, on which `key` of `table` is set, or on which the table begins."""
    current, table_line = "", None
    wanted = re.compile(rf"""\s*["']?{re.escape(key)}["']?\s*(=|\.)""")
    header = re.compile(r"\s*\[\[?\s*([^\]]+?)\s*\]")
    for number, line in enumerate(text.splitlines(), start=1):
        if match := header.match(line):
            current = re.sub(r"""["'\s]""", "", match[1])
            if current == f"{table}.{key}".strip("."):
                return number
            if current == table:
                table_line = number
        elif current == table and wanted.match(line):
            return number
    return table_line
