"""What commands write: lines, tables and documents on standard output, and files where a person says."""

from __future__ import annotations

import io
import math
import shlex
import shutil
import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from json import dumps
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import TYPE_CHECKING, Any

from pneuma.errors import UserError, nearest_name, plain, unknown_name
from pneuma.figures import FIGURE_FORMATS
from pneuma.study.files import write_whole
from pneuma.study.store import Store

if TYPE_CHECKING:
    import pandas as pd

WIDEST = 10_000
"""Characters of a line where nobody reads at a terminal: tables are not folded there."""


# --- For people -----------------------------------------------------------------------------------


def say(text: str, aside: bool = False, quiet: bool = False) -> None:
    """Print a line for people; aside is on standard error, where standard output is for a document.

    Nobody need read standard error for a command to go on.
    """
    if quiet:
        return
    try:
        print(text, file=sys.stderr if aside else sys.stdout)
    except OSError:  # nobody reads any more, or the terminal was closed
        if not aside:
            raise


def command(*words: object) -> str:
    """Return a command of Pneuma's, quoted so that it can be typed as it stands."""
    return plain(shlex.join(["pneuma", *map(str, words)]))


def print_table(heads: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Print a table of texts, which may be untrusted, folded where it is wider than the terminal."""
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


# --- For programs ---------------------------------------------------------------------------------


def print_json(document: object) -> None:
    """Print the one JSON document of a command; numbers that JSON has not, as NaN, are null in it."""
    print(dumps(_without_nan(document), indent=2, allow_nan=False))


def _without_nan(value: object) -> object:
    if isinstance(value, Mapping):
        return {key: _without_nan(own) for key, own in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(own) for own in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def records(table: pd.DataFrame) -> list[dict[str, Any]]:
    """Return a table's rows for `print_json`: None for what there is not."""
    known = table.astype(object).where(table.notna(), None)
    return [{str(key): value for key, value in row.items()} for row in known.to_dict("records")]


def print_listed(kind: str, many: str, folder: Path, json: bool) -> None:
    """Print names, titles and sections of shipped files."""
    from pneuma.schema import read_toml

    tables = {path.stem: read_toml(path).data for path in sorted(folder.glob("*.toml"))}
    rows = [
        {kind: name, "title": own["title"], "section": own.get("section", "")}
        for name, own in tables.items()
        if "title" in own
    ]
    if json:
        return print_json({"schema": 1, many: rows})
    return print_table((kind, "title", "thesis section"), [(*row.values(),) for row in rows])


# --- Files ----------------------------------------------------------------------------------------


def check_choice(option: str, value: str, allowed: Iterable[str]) -> None:
    """Refuse a value of an option that is none of those allowed."""
    if value not in allowed:
        raise UserError(f"{option} {value}: " + str(unknown_name("value", value, allowed)))


def check_file(out: Path, endings: Collection[str]) -> None:
    """Refuse a file that cannot be written, or ends otherwise, before any work is done."""
    if out.suffix.lower() not in endings:
        hint = nearest_name(out.suffix, endings) if out.suffix else ""
        raise UserError(f"--out {out}: must end in {' or '.join(endings)}{hint}")
    if out.is_dir():
        raise UserError(f"--out {out}: is a folder; name a file")
    check_folder(f"--out {out}", out.parent)


def check_folder(told: str, folder: Path) -> None:
    """Refuse a folder that cannot be written, or made, before any work is done; make none yet."""
    there = next((path for path in (folder, *folder.resolve().parents) if path.exists()), folder)
    try:
        TemporaryFile(dir=there).close()
    except OSError as error:
        raise UserError(f"{told}: cannot be written ({error.strerror})") from None


def write_file(out: Path, data: bytes) -> None:
    """Write a file whole or not at all, and its folder if need be."""
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        write_whole(out, data)
    except OSError as error:
        raise UserError(f"--out {out}: cannot be written ({error.strerror})") from None


# --- Figures --------------------------------------------------------------------------------------


def read_formats(told: list[str] | None, out: Path | None, always: bool = False) -> tuple[str, ...]:
    """Return the kinds of file that figures are to be written as; none where none is asked for.

    Args:
        told: by --format.
        out: the folder, by --out; refused where it cannot be written.
        always: whether figures are drawn without a folder too.
    """
    for name in told or ():
        check_choice("--format", name, FIGURE_FORMATS)
    if out is None:
        if told and not always:
            raise UserError(f"--format {told[0]}: name a folder for the figure by --out DIR")
        return tuple(told or ("png", "svg")) if always else ()
    ending = out.suffix.lower()[1:]
    if ending in FIGURE_FORMATS and not out.is_dir():
        raise UserError(f"--out {out}: is the folder to write figures to; name one, and --format {ending}")
    check_folder(f"--out {out}", out)
    return tuple(told or ("png", "svg"))


def draw_files(store: Store, out: Path | None, draw: Callable[[Path], list[Path]]) -> list[Path]:
    """Write what is drawn into a folder that a person names, or else into `figures` of the results.

    In a results folder, which may be untrusted, no link is followed. Where drawing fails, nothing is written.

    Args:
        store: the results folder.
        out: where; None for the results.
        draw: draws into a folder that is removed afterwards, and returns its files.
    """
    if out is None:
        check_folder(f"--results {store.root}", store.root)
    target = out or store.root / "figures"
    with TemporaryDirectory() as folder:
        files = {path.name: path.read_bytes() for path in draw(Path(folder))}
    for name, content in files.items():
        if out is None:
            store.write(target / name, content)
        else:
            write_file(target / name, content)
    return [target / name for name in files]


def tell_written(files: Iterable[Path], json: bool = False) -> None:
    """Say which figures were written."""
    if json:
        return print_json({"schema": 1, "figures": list(map(str, files))})
    for path in files:
        print(f"wrote {plain(str(path))}")
    return None
