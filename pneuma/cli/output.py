"""What commands print, for people and programs, and the files that they write."""

from __future__ import annotations

import ctypes
import math
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from dataclasses import dataclass
from itertools import zip_longest
from json import dumps
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

from rich.cells import cell_len

from pneuma.cli.hints import write_hint
from pneuma.errors import UserError, folded, nearest_name, print_aside, printable, write_hints
from pneuma.figures import FIGURE_FORMATS
from pneuma.files import MADE_BY, write_whole
from pneuma.store.store import Store
from pneuma.study.shipped import read_head, shipped_names

if TYPE_CHECKING:
    import pandas as pd

    from pneuma.analysis.answer import Answer


# --- For people -----------------------------------------------------------------------------------


def say(message: str, quiet: bool = False) -> None:
    """Print a line on standard error, so that standard output is the result's alone.

    A closed standard error does not stop a command.
    """
    if not quiet:
        print_aside(write_hints(message, write_hint))


@contextmanager
def kept_for_the_result() -> Iterator[None]:
    """Let what is printed meanwhile, by anybody's code in any language, go to standard error.

    Standard output is then one document, of the result that is printed afterwards.
    """
    with ExitStack() as finally_, redirect_stdout(sys.stderr):
        with suppress(OSError):  # one that is closed has nothing to keep
            kept_output = os.dup(1)
            finally_.callback(os.close, kept_output)
            finally_.callback(os.dup2, kept_output, 1)
            finally_.callback(_flush)
            _flush()
            os.dup2(2, 1)
        yield


def _flush() -> None:
    """Write what Python and C still hold for standard output."""
    if sys.__stdout__ is not None and not sys.__stdout__.closed:
        sys.__stdout__.flush()
    ctypes.CDLL(None).fflush(None)


# --- Results in any form --------------------------------------------------------------------------

REMOVED_ENDINGS = {
    ".mp4": " (`ffmpeg -i x.gif x.mp4` makes one of it)",
    ".onnx": " (docs/engines.md links to how one is made of it)",
}
"""Of files that an earlier version wrote, and what makes them now."""
OUTPUT_FORMATS = ("table", "markdown", "latex", "csv", "json")
COLUMN_GAP = "  "
UNBREAKABLE_SPACE = "\u00a0"


class Table(NamedTuple):
    """A table for people; without heads if these are empty."""

    heads: Sequence[str]
    rows: Iterable[Sequence[object]]


@dataclass(frozen=True)
class Result:
    """What a command gives, which `print_result` prints.

    Attributes:
        document: for programs.
        lines: lines and tables for people; computed only for them if it is a generator.
        title: the line above all that, for people.
        notes: what must be known to read the rest: for people below the title, else on standard error.
        table: for pages and papers, with cells as text; or rows with equal keys.
        numbers: the table as CSV, with whole numbers; `table` if None.
        code: the exit code.
        file: for `--out -`, in place of all else.
    """

    document: Mapping[str, Any]
    lines: Iterable[str | Table] = ()
    title: str = ""
    notes: Sequence[str] = ()
    table: pd.DataFrame | Sequence[Mapping[str, Any]] | None = None
    numbers: pd.DataFrame | Sequence[Mapping[str, Any]] | None = None
    code: int = 0
    file: bytes = b""


def answer_result(answer: Answer) -> Result:
    """Return an answer as a command prints it."""
    lines: list[str | Table] = []
    for cells in answer.cells:
        if lines or answer.title:
            lines.append("")
        lines.append(frame_table(cells))
    if answer.legend:
        lines += [""] + list(answer.legend)
    return Result(answer.document, lines, answer.title, answer.notes, answer.cells[0], answer.table)


def rows_result(document_key: str, rows: Sequence[Mapping[str, Any]]) -> Result:
    """Return rows with equal keys, which the document calls by a name."""
    heads = list(rows[0]) if rows else []
    return Result({document_key: rows}, [Table(heads, [list(row.values()) for row in rows])], table=rows)


def listed_result(singular: str, plural: str, folder: Path) -> Result:
    """Return the files of a folder of studies or searches."""
    file_rows = []
    for file_name in shipped_names(folder):
        file_head = read_head(file_name, folder)
        file_row = {singular: file_name}
        for key in ("title", "section", "figure"):
            file_row[key] = file_head.get(key, "")
        file_rows.append(file_row)
    return rows_result(plural, sorted(file_rows, key=_place_in_thesis))


def _place_in_thesis(file_row: Mapping[str, str]) -> tuple[bool, list[int], str]:
    """Return where a study stands in a list: the thesis's figures, then its sections, then what it lacks."""
    is_figure = file_row["figure"].startswith("fig-")
    section_numbers = list(map(int, re.findall(r"\d+", file_row["figure" if is_figure else "section"])))
    return not is_figure, section_numbers or [99], file_row["title"]


def print_result(result: Result, output_format: str) -> None:
    """Print a result in one of `OUTPUT_FORMATS`."""
    if result.file:
        sys.stdout.buffer.write(result.file)
        return
    if output_format == "table":
        notes = [write_hints(note, write_hint) for note in result.notes]
        lines: list[str | Table] = [*notes, *result.lines]
        if result.title:
            lines.insert(0, result.title)
        for line in lines:
            if isinstance(line, Table):
                _print_table(line)
            else:
                print(folded(printable(line), sys.stdout))
        return
    for note in result.notes:
        say(note)
    if output_format == "json":
        from pydantic_core import to_jsonable_python

        document = {"schema": 1, **result.document}  # of objects and tables too; NaN becomes null
        jsonable = to_jsonable_python(document, inf_nan_mode="null", fallback=_as_plain)
        print(dumps(jsonable, indent=2, allow_nan=False))
    else:
        import pandas as pd

        from pneuma.analysis.export import encode_frame

        table = result.table
        if output_format == "csv" and result.numbers is not None:
            table = result.numbers
        assert table is not None, "a command without a table has no --format"
        table_text = encode_frame(pd.DataFrame(table), output_format).decode()
        print("\n".join(map(printable, table_text.split("\n"))), end="")


def _print_table(table: Table) -> None:
    """Print a table of text, which may be untrusted; in a narrow terminal cells are folded between words."""
    text_rows = [[_cell_text(cell) for cell in row] for row in table.rows]
    if any(table.heads):
        text_rows.insert(0, [_cell_text(head) for head in table.heads])
    free_width = math.inf
    if sys.stdout.isatty():
        free_width = shutil.get_terminal_size().columns - len(COLUMN_GAP) * (len(text_rows[0]) - 1)
    widths = _column_widths(text_rows, free_width)
    for text_row in text_rows:
        folded_cells = []
        for cell, width in zip(text_row, widths, strict=True):
            is_narrow = cell_len(cell) <= width
            folded_cells.append([cell] if is_narrow else textwrap.wrap(cell, width, break_long_words=False))
        for line_texts in zip_longest(*folded_cells, fillvalue=""):
            padded_texts = [
                text + " " * (width - cell_len(text)) for text, width in zip(line_texts, widths, strict=True)
            ]
            print(COLUMN_GAP.join(padded_texts).rstrip().replace(UNBREAKABLE_SPACE, " "))


def _cell_text(cell: object) -> str:
    """Return a cell as text, with spaces in an interval at which no line is broken."""
    if cell is None or cell != cell:
        return "–"
    cell_text = f"{cell:,.4g}" if isinstance(cell, float) else printable(str(cell))
    return re.sub(r"\[[^]]*]", lambda interval: interval[0].replace(" ", UNBREAKABLE_SPACE), cell_text)


def _column_widths(text_rows: Sequence[Sequence[str]], free_width: float) -> list[int]:
    """Return the widths of columns; the widest ones are narrowed to fit, though no word is broken."""
    widths, least_widths = [], []
    for column in zip(*text_rows, strict=True):
        widths.append(max(map(cell_len, column)))
        least_widths.append(max(map(cell_len, " ".join(column).split(" "))))
    for limit in range(max(widths, default=0), 0, -1):
        if sum(widths) <= free_width:
            break
        widths = [max(least, min(width, limit)) for width, least in zip(widths, least_widths, strict=True)]
    return widths


def frame_table(frame: pd.DataFrame) -> Table:
    return Table(list(map(str, frame)), frame.to_numpy())


def _as_plain(unknown_value: Any) -> Any:
    return rows_of(unknown_value) if hasattr(unknown_value, "to_dict") else unknown_value.item()


def rows_of(table: pd.DataFrame) -> list[dict[Any, Any]]:
    """Return a table's rows, with None for missing values."""
    return table.astype(object).where(table.notna(), None).to_dict("records")


# --- Files ----------------------------------------------------------------------------------------


def check_file(out: Path, endings: Collection[str], force: bool = True) -> None:
    """Refuse an output file before any work is done.

    It must have one of the endings and be no folder, and no link. Without `force` it may replace only what a
    command like it has made.
    """
    if out.suffix.lower() not in endings:
        hint = nearest_name(out.suffix, endings) if out.suffix else ""
        hint = REMOVED_ENDINGS.get(out.suffix.lower(), hint)
        raise UserError(f"--out {out}: must end in {' or '.join(endings)}{hint}")
    if out.is_dir():
        raise UserError(f"--out {out}: is a folder; name a file")
    if out.is_symlink():
        raise UserError(f"--out {out}: is a link; name the file itself")
    if not force and out.is_file() and MADE_BY.encode() not in out.read_bytes():
        raise UserError(f"--out {out}: already exists and was not written by Pneuma; --force replaces it")


def write_file(out: Path, contents: bytes) -> None:
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_whole(out, contents)
    except (FileExistsError, NotADirectoryError):
        raise UserError(f"--out {out}: {out.parent} is not a folder") from None
    except OSError as error:
        raise UserError(f"--out {out}: cannot be written ({error.strerror})") from None


def read_formats(formats: Sequence[str] | None, out: Path | None) -> tuple[str, ...]:
    """Return the formats of figures; that of a file which `--out` names."""
    if out is None or not _names_figure(out):
        if out and out.suffix[1:].isalpha() and not out.is_dir():
            endings = ", ".join(f".{figure_format}" for figure_format in FIGURE_FORMATS)
            raise UserError(
                f"--out {out}: a figure's file must end in {endings}; a folder's name must have no ending"
            )
        return tuple(formats or ("png", "svg"))
    if formats:
        raise UserError(f"leave out --format: {out} names it")
    return (out.suffix[1:],)


def _names_figure(out: Path) -> bool:
    """Return whether `--out` is the file of a figure, and not the folder of all."""
    return out.suffix[1:] in FIGURE_FORMATS and not out.is_dir()


def keep_files(store: Store, out: Path | None, draw: Callable[[Path], Iterable[Path]]) -> list[Path]:
    """Write the figures that a function draws into a folder; return their files.

    They go into a file or folder given by the user, or into `figures` of the results, which may be untrusted:
    there no link is followed. If drawing fails, nothing is written.
    """
    with TemporaryDirectory() as temporary:
        contents = {figure_path.name: figure_path.read_bytes() for figure_path in draw(Path(temporary))}
    folder, write_figure = (store.root / "figures", store.write) if out is None else (out, write_file)
    paths = [folder / file_name for file_name in contents]
    if out and contents and _names_figure(out):
        if len(paths) > 1:
            raise UserError(f"--out {out}: is one file, but there are {len(paths)} figures; name a folder")
        paths = [out]
    for figure_path, content in zip(paths, contents.values(), strict=True):
        write_figure(figure_path, content)
    return paths


def nothing_yet(store: Store) -> str:
    """Return that no run is stored or published in a results folder; empty if there is one."""
    if store.runs() or store.published(shipped=False):
        return ""
    return f"no study was run or published in {store.root} yet: run `pneuma study run activation` first"


def wrote(written_files: Iterable[Path]) -> list[str]:
    return [f"wrote {written_file}" for written_file in written_files]
