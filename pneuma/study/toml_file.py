"""Read a person's TOML file and say where in it something stands.

`tomllib` reports no lines for keys, so a small locator finds them again.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pneuma.errors import UserError, nearest_name

RENAMED = {"settings": "worlds"}
"""Keys of earlier versions, and what they are called now."""

Where = tuple[str, ...]
"""The path of a table in a file: () for the top, ("conditions", "tanh") for [conditions.tanh]."""


@dataclass(frozen=True)
class TomlFile:
    """A parsed file with its text, so that errors can name a line."""

    path: Path
    text: str
    data: dict[str, Any]

    def mistake(self, where: Where, message: str, key: str = "") -> UserError:
        """Build an error that names file, line, table and what is wrong with it or one of its keys."""
        line = _line_of(self.text, (*where, key) if key else where)
        place = f"{self.path}, line {line}" if line else str(self.path)
        table = f"[{'.'.join(where)}] " if where else ""
        return UserError(f"{place}: {table}{message}")

    def table(self, where: Where) -> dict[str, Any]:
        """Return a table, empty when there is none, and refuse another value in its place."""
        value: Any = self.data
        for key in where:
            value = value.get(key, {})
            if not isinstance(value, dict):
                raise self.mistake(where[:-1], f"{key} must be a table, not {shown(value)}", key)
        return dict(value)

    def refuse_unknown(self, where: Where, given: Mapping[str, Any], allowed: tuple[str, ...]) -> None:
        """Raise for the first key of a table that is none of `allowed`."""
        for key in given:
            if key not in allowed:
                hint = nearest_name(key, allowed)
                message = f"unknown key {key!r}{hint}; known are {', '.join(allowed)}"
                if RENAMED.get(key) in allowed:
                    message = f"{key} is called {RENAMED[key]} now"
                raise self.mistake(where, message, key)


def shown(value: object) -> str:
    """Return a value about as it stands in the file."""
    return json.dumps(value, default=str, ensure_ascii=False)


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
    except (ValueError, RecursionError) as error:  # numbers of thousands of digits, brackets without end
        raise UserError(f"{path}: not TOML: {error}") from None


def _line_of(text: str, wanted: Where) -> int | None:
    """Return the line, from 1, where `wanted` is set or begins, or else the closest table around it."""
    best, best_depth = None, 0
    for number, path in _paths(text):
        shared = min(len(path), len(wanted))
        depth = shared if path[:shared] == wanted[:shared] else 0
        if depth > best_depth:
            best, best_depth = number, depth
    return best


def _paths(text: str) -> Iterator[tuple[int, Where]]:
    """Yield the line and full path of every header and key; texts over several lines are passed over."""
    table: Where = ()
    inside = ""  # the quotes of a text that goes on
    for number, line in enumerate(text.splitlines(), start=1):
        opened = inside
        for quotes in ('"""', "'''"):
            if line.count(quotes) % 2 and inside in ("", quotes):
                inside = "" if inside else quotes
        if opened:
            continue
        if line.lstrip().startswith("["):
            table = _nesting(line) or table
            yield number, table
        elif "=" in line and (own := _nesting(f"{line.partition('=')[0]} = 0")):
            yield number, table + own


def _nesting(line: str) -> Where:
    """Return the path of the one key or table that a line of TOML sets."""
    try:
        value: Any = tomllib.loads(line)
    except tomllib.TOMLDecodeError:
        return ()
    path: Where = ()
    while isinstance(value, dict) and value:
        key, value = next(iter(value.items()))
        path += (key,)
    return path
