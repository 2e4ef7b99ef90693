"""What commands print: untrusted texts made safe, tables, and commands to be typed."""

from __future__ import annotations

import io
import shlex
import shutil
import sys
from collections.abc import Iterable, Sequence

from pneuma.errors import plain

__all__ = ["command", "plain", "print_table"]

WIDEST = 10_000
"""Characters of a line where nobody reads at a terminal: tables are not folded there."""


def command(*words: object) -> str:
    """Return a command of Pneuma's, quoted so that it can be typed as it stands."""
    return plain(shlex.join(["pneuma", *map(str, words)]))


def print_table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table of texts, folded where it is wider than the terminal."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, header_style="")
    for head in heads:
        table.add_column(plain(head), overflow="fold")
    for row in rows:
        table.add_row(*(Text(plain(str(cell))) for cell in row))
    drawn = io.StringIO()
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else WIDEST
    Console(file=drawn, width=width, color_system=None, highlight=False).print(table)
    print("\n".join(line.rstrip() for line in drawn.getvalue().splitlines()))
