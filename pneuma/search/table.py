"""A table of a search's file, read so that every mistake in it is told with its line."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from pneuma.config import Run, read_field
from pneuma.errors import UserError, nearest_name
from pneuma.study.toml_file import TomlFile, Where, shown
from pneuma.values import Choice, Reader


@dataclass(frozen=True)
class By:
    """Reads a value by a function that raises ValueError or TypeError."""

    read: Callable[[Any], Any]
    allowed: str


@dataclass(frozen=True)
class Table:
    """A table of a search's file; every mistake in it is told with its line."""

    file: TomlFile
    where: Where

    @property
    def data(self) -> dict[str, Any]:
        """Return what it holds."""
        return self.file.table(self.where)

    def inner(self, *names: str) -> Table:
        """Return a table inside."""
        return Table(self.file, (*self.where, *names))

    def mistake(self, message: str, key: str = "") -> UserError:
        """Build an error that names file, line and table."""
        return self.file.mistake(self.where, message, key)

    def only(self, keys: Sequence[str]) -> Table:
        """Refuse other keys; return the table."""
        self.file.refuse_unknown(self.where, self.data, tuple(keys))
        return self

    def read(self, key: str, reader: Reader | By, usual: Any = ...) -> Any:
        """Return what a reader makes of a key's value; the usual one, if any, where it is left out."""
        value = self.data.get(key, usual)
        if value is ...:
            raise self.mistake(f"the key {key!r} is missing")
        try:
            return reader.read(value)
        except (ValueError, TypeError):
            hint = nearest_name(str(value), reader.names) if isinstance(reader, Choice) else ""
            told = f"{key} = {shown(value)} is not allowed: {reader.allowed}{hint}"
            raise self.mistake(told, key) from None

    def setting(self, key: str, name: str, value: Any) -> Any:
        """Return a value of a key as the field `name` of a run has it."""
        try:
            return read_field(Run, name, value)
        except UserError as error:
            raise self.mistake(str(error), key) from None

    def settings(self, allowed: Sequence[str]) -> dict[str, Any]:
        """Return it as fields of a run."""
        return {key: self.setting(key, key, value) for key, value in self.only(allowed).data.items()}
