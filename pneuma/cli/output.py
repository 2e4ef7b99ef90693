"""Output of commands: lines, tables and JSON on standard output, and files."""

from __future__ import annotations

import io
import shlex
import shutil
import sys
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from json import dumps
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from pneuma.errors import UserError, nearest_name, plain, print_aside
from pneuma.figures import FIGURE_FORMATS
from pneuma.files import MADE_BY, read_whole, write_whole
from pneuma.study.spec import read_head, shipped_names
from pneuma.study.store import Store

if TYPE_CHECKING:
    import pandas as pd

WIDEST = 10_000
"""Characters per line if the output is no terminal, so that tables are not folded."""


# --- For people -----------------------------------------------------------------------------------


def say(text: str, aside: bool = False, quiet: bool = False) -> None:
    """Print a line for the user; with `aside` on standard error, so that standard output is one document.

    A closed standard error does not stop a command.
    """
    if aside and not quiet:
        print_aside(text)
    elif not quiet:
        print(plain(text))


class Progress:
    """Says on standard error how far a long computation is, every few seconds.

    Args:
        what: is counted.
    """

    EVERY_SECONDS = 2.0

    def __init__(self, what: str) -> None:
        self._what = what
        self._next = time.monotonic() + self.EVERY_SECONDS

    def __call__(self, done: int, of: int) -> None:
        if time.monotonic() >= self._next and done < of:
            self._next = time.monotonic() + self.EVERY_SECONDS
            print_aside(f"{done} of {of} {self._what}")


def command(*words: object) -> str:
    return plain(shlex.join(["pneuma", *map(str, words)]))


def tallied(words: Iterable[str]) -> str:
    """Return how often there is each word: 3 done, 1 crashed."""
    return ", ".join(f"{count} {word}" for word, count in Counter(words).items())


def print_table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table of text, which may be untrusted, folded to the terminal's width."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False, header_style="", show_header=any(heads))
    for head in heads:
        table.add_column(plain(head), overflow="fold")
    for row in rows:
        table.add_row(*(Text(plain(str(cell))) for cell in row))
    drawn = io.StringIO()
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else WIDEST
    Console(file=drawn, width=width, color_system=None, highlight=False).print(table)
    print("\n".join(line.rstrip() for line in drawn.getvalue().splitlines()))


# --- Results in any form --------------------------------------------------------------------------

OUTPUT_FORMATS = ("table", "markdown", "latex", "csv", "json")


@dataclass(frozen=True)
class Result:
    """What a command found, for `print_result`.

    Attributes:
        table: for people, with cells as text.
        document: for programs.
        numbers: the table as CSV, with whole numbers; `table` if None.
        title: the line above the table on a terminal.
        notes: what must be known to read the table; on standard error where the output is a table alone.
        legend: what the columns mean, below the table on a terminal.
    """

    table: pd.DataFrame
    document: Mapping[str, Any]
    numbers: pd.DataFrame | None = None
    title: str = ""
    notes: Sequence[str] = ()
    legend: str = ""


def print_result(result: Result, form: str) -> None:
    """Print a result in one of `OUTPUT_FORMATS`."""
    if form == "json":
        return print_json(result.document)
    people = form == "table"
    above = [*filter(None, [result.title] * people), *filter(None, result.notes)]
    for line in above:
        say(line, aside=not people)
    if people:
        print("\n" * bool(above), end="")
        print_table([*result.table], result.table.to_numpy())
        return print(f"\n{result.legend}") if result.legend else None
    from pneuma.analysis.export import encode_frame

    frame = result.table if form != "csv" or result.numbers is None else result.numbers
    return print("\n".join(map(plain, encode_frame(frame, form).decode().split("\n"))), end="")


# --- For programs ---------------------------------------------------------------------------------


def print_json(document: Mapping[str, Any]) -> None:
    """Print a command's JSON document; data classes and tables become objects, NaN becomes null."""
    from pydantic_core import to_jsonable_python

    whole = to_jsonable_python({"schema": 1, **document}, inf_nan_mode="null", fallback=_as_plain)
    print(dumps(whole, indent=2, allow_nan=False))


def _as_plain(value: Any) -> Any:
    return rows_of(value) if hasattr(value, "to_dict") else value.item()


def rows_of(table: pd.DataFrame) -> list[dict[Any, Any]]:
    """Return a table's rows, with None for missing values."""
    return table.astype(object).where(table.notna(), None).to_dict("records")


def print_rows(many: str, rows: Sequence[Mapping[str, Any]], json: bool) -> None:
    if json:
        return print_json({many: rows})
    return print_table([*rows[0]], [[_shown(value) for value in row.values()] for row in rows])


def _shown(value: object) -> str:
    return f"{value:,.4g}" if isinstance(value, float) else str(value)


def print_listed(kind: str, many: str, folder: Path, json: bool) -> None:
    rows = []
    for name in shipped_names(folder):
        head = read_head(name, folder)
        rows.append({kind: name, **{key: head.get(key, "") for key in ("title", "section", "figure")}})
    return print_rows(many, rows, json)


# --- Files ----------------------------------------------------------------------------------------


def check_file(out: Path, endings: Collection[str], force: bool = True) -> None:
    """Refuse an output file before any work is done.

    It must have one of the endings and be no folder, and no link. Without `force` it may replace only what a
    command like it has made.
    """
    if out.suffix.lower() not in endings:
        hint = nearest_name(out.suffix, endings) if out.suffix else ""
        raise UserError(f"--out {out}: must end in {' or '.join(endings)}{hint}")
    if out.is_dir():
        raise UserError(f"--out {out}: is a folder; name a file")
    if out.is_symlink():
        raise UserError(f"--out {out}: is a link; name the file itself")
    if not force and out.is_file() and MADE_BY.encode() not in read_whole(out):
        raise UserError(f"--out {out}: is there already and not made by Pneuma; --force replaces it")


def write_file(out: Path, data: bytes) -> None:
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_whole(out, data)
    except OSError as error:
        raise UserError(f"--out {out}: cannot be written ({error.strerror})") from None


# --- Figures --------------------------------------------------------------------------------------


def read_formats(asked: Sequence[str] | None, out: Path | None, lacking: str = "") -> tuple[str, ...]:
    """Return the formats of figures; refuse a file given as their folder.

    Args:
        asked: the formats, if the user gave some.
        out: the folder.
        lacking: the option without which nothing is drawn, if it was not given.
    """
    if lacking and (asked or out):
        raise UserError(f"{'--format' if asked else '--out'}: goes with {lacking}")
    if out is not None and out.suffix[1:] in FIGURE_FORMATS and not out.is_dir():
        raise UserError(f"--out {out}: is the folder of figures; name one, and --format {out.suffix[1:]}")
    return tuple(asked or ("png", "svg"))


def draw_files(store: Store, out: Path | None, draw: Callable[[Path], list[Path]]) -> list[Path]:
    """Write figures into a folder given by the user, or into `figures` of the results.

    In a results folder, which may be untrusted, no link is followed. If drawing fails, nothing is written.

    Args:
        store: the results folder.
        out: where; None for the results.
        draw: draws into a folder that is removed afterwards, and returns its files.
    """
    target, write = (store.root / "figures", store.write) if out is None else (out, write_file)
    with TemporaryDirectory() as folder:
        files = {path.name: path.read_bytes() for path in draw(Path(folder))}
    for name, content in files.items():
        write(target / name, content)
    return [target / name for name in files]


def tell_written(files: Iterable[Path], json: bool = False) -> None:
    if json:
        return print_json({"figures": list(files)})
    for path in files:
        say(f"wrote {path}")
    return None
