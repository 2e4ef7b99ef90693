"""The value that every question about a study gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

NO_CELL = "–"
"""A cell of text without a value."""


@dataclass(frozen=True)
class Answer:
    """The answer to a question; the command line, notebooks and the report show its parts in their own form.

    Attributes:
        title: the question in a line.
        about: which runs it concerns, and other facts, for programs.
        tables: its numbers, by their names in a JSON document; the first is the main one.
        cells: tables of text for people; the first also stands in pages and papers.
        notes: messages without which the numbers may mislead.
        legend: lines that explain the cells.
        drawing: what its figure needs beside the tables: further tables and facts, by name.
    """

    title: str
    about: Mapping[str, Any]
    tables: Mapping[str, pd.DataFrame]
    cells: Sequence[pd.DataFrame]
    notes: Sequence[str] = ()
    legend: Sequence[str] = ()
    drawing: Mapping[str, Any] = field(default_factory=dict)

    @property
    def table(self) -> pd.DataFrame:
        """The main table of numbers."""
        return next(iter(self.tables.values()))

    @property
    def document(self) -> dict[str, Any]:
        return {**self.about, **self.tables}

    def __str__(self) -> str:
        answer_lines = [self.title] + list(self.notes)
        for cell_table in self.cells:
            answer_lines.append(cell_table.to_string(index=False))
        return "\n".join(answer_lines + list(self.legend))

    def _repr_html_(self) -> str:
        return self.cells[0].to_html(index=False)
