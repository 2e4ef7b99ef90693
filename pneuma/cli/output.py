"""What commands print, for people and programs, and the files that they write."""

from __future__ import annotations

import ctypes
import math
import os
import re
import shlex
import shutil
import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from dataclasses import dataclass
from itertools import chain, zip_longest
from json import dumps
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

from rich.cells import cell_len

from pneuma.errors import UserError, nearest_name, plain, print_aside
from pneuma.figures import FIGURE_FORMATS
from pneuma.files import MADE_BY, write_whole
from pneuma.store.store import Store
from pneuma.study.shipped import read_head, shipped_names

if TYPE_CHECKING:
    import pandas as pd

    from pneuma.answers.answer import Answer
    from pneuma.figures.grid import Page
    from pneuma.figures.style import Look


# --- For people -----------------------------------------------------------------------------------


def say(text: str, quiet: bool = False) -> None:
    """Print a line on standard error, so that standard output is the result's alone.

    A closed standard error does not stop a command.
    """
    if not quiet:
        print_aside(text)


def command(*words: object) -> str:
    return plain(shlex.join(["pneuma", *map(str, words)]))


def tallied(words: Iterable[str]) -> str:
    """Return how often there is each word: 3 done, 1 crashed."""
    return ", ".join(f"{count} {word}" for word, count in Counter(words).items())


@contextmanager
def kept_for_the_result() -> Iterator[None]:
    """Let what is printed meanwhile, by anybody's code in any language, go to standard error.

    Standard output is then one document, of the result that is printed afterwards.
    """
    with ExitStack() as finally_, redirect_stdout(sys.stderr):
        with suppress(OSError):  # one that is closed has nothing to keep
            kept = os.dup(1)
            finally_.callback(os.close, kept)
            finally_.callback(os.dup2, kept, 1)
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

OUTPUT_FORMATS = ("table", "markdown", "latex", "csv", "json")
COLUMN_GAP = "  "
_WORD = re.compile(r"\[[^\]]*\]|\S+")
"""A word of a cell; an interval in brackets is one."""


class Table(NamedTuple):
    """A table for people; without heads if these are empty."""

    heads: Sequence[str]
    rows: Iterable[Sequence[object]]


@dataclass(frozen=True)
class Result:
    """What a command found, which `print_result` prints."""

    document: Mapping[str, Any]  # for programs
    shown: Iterable[str | Table] = ()  # for people; computed only for them if it is a generator
    title: str = ""  # the line above all that, for people
    notes: Sequence[str] = ()
    """What must be known to read the rest: for people below the title, else on standard error."""
    table: pd.DataFrame | Sequence[Mapping[str, Any]] | None = None
    """For pages and papers, with cells as text; or rows with equal keys."""
    numbers: pd.DataFrame | Sequence[Mapping[str, Any]] | None = None
    """The table as CSV, with whole numbers, likewise; `table` if None."""
    code: int = 0
    file: bytes = b""  # for `--out -`, in place of all else


def print_result(result: Result, form: str) -> None:
    """Print a result in one of `OUTPUT_FORMATS`."""
    if result.file:
        sys.stdout.buffer.write(result.file)
        return
    people = form == "table"
    for line in filter(None, [result.title] * people):
        print(plain(line))
    for note in filter(None, result.notes):
        print(plain(note)) if people else say(note)
    if people:
        for each in result.shown:
            if isinstance(each, Table):
                _print_table(each)
            else:
                print(plain(each))
    elif form == "json":
        from pydantic_core import to_jsonable_python

        document = {"schema": 1, **result.document}  # of objects and tables too; NaN becomes null
        whole = to_jsonable_python(document, inf_nan_mode="null", fallback=_as_plain)
        print(dumps(whole, indent=2, allow_nan=False))
    else:
        import pandas as pd

        from pneuma.analysis.export import encode_frame

        found = result.table if form != "csv" or result.numbers is None else result.numbers
        assert found is not None, "a command without a table has no --format"
        text = encode_frame(pd.DataFrame(found), form).decode()
        print("\n".join(map(plain, text.split("\n"))), end="")


def _print_table(table: Table) -> None:
    """Print a table of text, which may be untrusted; in a narrow terminal cells are folded between words."""
    rows = [[plain(_shown(cell)) for cell in row] for row in table.rows]
    lines = [[*map(plain, table.heads)], *rows] if any(table.heads) else rows
    room = math.inf
    if sys.stdout.isatty():
        room = shutil.get_terminal_size().columns - len(COLUMN_GAP) * (len(lines[0]) - 1)
    widths = _column_widths(lines, room)
    for line in lines:
        cells = [_folded(cell, width) for cell, width in zip(line, widths, strict=True)]
        for texts in zip_longest(*cells, fillvalue=""):
            padded = (
                text + " " * (width - cell_len(text)) for text, width in zip(texts, widths, strict=True)
            )
            print(COLUMN_GAP.join(padded).rstrip())


def _column_widths(lines: Sequence[Sequence[str]], room: float) -> list[int]:
    """Return the widths of columns; the widest ones are narrowed to fit, though no word is broken."""
    widths, least = [], []
    for column in zip(*lines, strict=True):
        widths.append(max(map(cell_len, column)))
        words = chain.from_iterable(_WORD.findall(cell) for cell in column)
        least.append(max(map(cell_len, words), default=0))
    while sum(widths) > room:
        wider = [place for place, width in enumerate(widths) if width > least[place]]
        if not wider:
            break
        widest = max(wider, key=widths.__getitem__)
        widths[widest] -= 1
    return widths


def _folded(cell: str, width: int) -> list[str]:
    """Return the lines of a cell in a column of a width, broken between words."""
    if cell_len(cell) <= width:
        return [cell]
    lines = [""]
    for word in _WORD.findall(cell):
        longer = f"{lines[-1]} {word}".lstrip()
        if cell_len(longer) <= width:
            lines[-1] = longer
        else:
            lines.append(word)
    return [line for line in lines if line]


def _shown(cell: object) -> str:
    unknown = cell is None or cell != cell
    return "–" if unknown else f"{cell:,.4g}" if isinstance(cell, float) else str(cell)


def frame_table(frame: pd.DataFrame) -> Table:
    return Table([*frame], frame.to_numpy())


def answer_result(answer: Answer) -> Result:
    """Return an answer as a command prints it."""
    shown: list[str | Table] = []
    for cells in answer.cells:
        shown += ["", frame_table(cells)]
    if answer.legend:
        shown += ["", *answer.legend]
    return Result(answer.document, shown, answer.title, answer.notes, answer.cells[0], answer.table)


def rows_result(many: str, rows: Sequence[Mapping[str, Any]]) -> Result:
    """Return rows with equal keys, which the document calls `many`."""
    table = Table([*rows[0]] if rows else (), [[*row.values()] for row in rows])
    return Result({many: rows}, [table], table=rows)


def listed_result(kind: str, many: str, folder: Path) -> Result:
    """Return the files of a folder of studies or searches."""
    rows = []
    for name in shipped_names(folder):
        head = read_head(name, folder)
        rows.append({kind: name, **{key: head.get(key, "") for key in ("title", "section", "figure")}})
    return rows_result(many, rows)


def _as_plain(value: Any) -> Any:
    return rows_of(value) if hasattr(value, "to_dict") else value.item()


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
        raise UserError(f"--out {out}: must end in {' or '.join(endings)}{hint}")
    if out.is_dir():
        raise UserError(f"--out {out}: is a folder; name a file")
    if out.is_symlink():
        raise UserError(f"--out {out}: is a link; name the file itself")
    if not force and out.is_file() and MADE_BY.encode() not in out.read_bytes():
        raise UserError(f"--out {out}: is there already and not made by Pneuma; --force replaces it")


def write_file(out: Path, data: bytes) -> None:
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_whole(out, data)
    except (FileExistsError, NotADirectoryError):
        raise UserError(f"--out {out}: {out.parent} is not a folder") from None
    except OSError as error:
        raise UserError(f"--out {out}: cannot be written ({error.strerror})") from None


# --- Figures --------------------------------------------------------------------------------------


def read_formats(asked: Sequence[str] | None, out: Path | None) -> tuple[str, ...]:
    """Return the formats of figures; that of a file which `--out` names."""
    if out is None or not names_figure(out):
        if out and out.suffix[1:].isalpha() and not out.is_dir():
            known = ", ".join(f".{form}" for form in FIGURE_FORMATS)
            raise UserError(f"--out {out}: a figure's file ends in {known}; a folder's name has no ending")
        return tuple(asked or ("png", "svg"))
    if asked:
        raise UserError(f"--format: --out {out} has its format by its name")
    return (out.suffix[1:],)


def names_figure(out: Path) -> bool:
    """Return whether `--out` is the file of a figure, and not the folder of all."""
    return out.suffix[1:] in FIGURE_FORMATS and not out.is_dir()


def draw_files(
    store: Store,
    out: Path | None,
    formats: Sequence[str],
    pages: Iterable[Page],
    look: Look | None = None,
) -> list[Path]:
    """Write figures as `keep_files` does."""
    from pneuma.figures.grid import DEFAULT_LOOK, save_page

    def draw(folder: Path) -> Iterator[Path]:
        for page in pages:
            yield from save_page(page, folder, formats, look or DEFAULT_LOOK)

    return keep_files(store, out, draw)


def keep_files(store: Store, out: Path | None, draw: Callable[[Path], Iterable[Path]]) -> list[Path]:
    """Write the figures that a function draws into a folder; return their files.

    They go into a file or folder given by the user, or into `figures` of the results, which may be untrusted:
    there no link is followed. If drawing fails, nothing is written.
    """
    with TemporaryDirectory() as temporary:
        drawn = {path.name: path.read_bytes() for path in [*draw(Path(temporary))]}
    folder, write = (store.root / "figures", store.write) if out is None else (out, write_file)
    paths = [folder / name for name in drawn]
    if out and names_figure(out):
        paths = [out] * bool(drawn)
        if len(drawn) > 1:
            raise UserError(f"--out {out}: is one file, and these are {len(drawn)} figures; name a folder")
    for path, content in zip(paths, drawn.values(), strict=True):
        write(path, content)
    return paths


def nothing_yet(store: Store) -> str:
    """Say that no run is stored or published in a results folder; empty if there is one."""
    known = store.runs() or store.published(shipped=False)
    run = "run `pneuma study run activation` first"
    return "" if known else f"no study was run or published in {store.root} yet: {run}"


def wrote(files: Iterable[Path]) -> list[str]:
    return [f"wrote {path}" for path in files]
