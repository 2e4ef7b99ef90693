"""What commands share that write figures: as what kinds of file, and into which folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from pneuma.cli.out_files import check_folder
from pneuma.cli.study_output import check_choice
from pneuma.errors import UserError
from pneuma.figures import FIGURE_FORMATS
from pneuma.study.store import Store

USUAL_FORMATS = ("png", "svg")

Formats = Annotated[
    list[str] | None,
    typer.Option(
        "--format",
        metavar="|".join(FIGURE_FORMATS),
        help="File formats of figures (may be repeated; default: png and svg).",
    ),
]


def read_formats(told: list[str] | None) -> tuple[str, ...]:
    """Return the kinds of file that figures are to be written as.

    Raises:
        UserError: for one that there is not.
    """
    for name in told or ():
        check_choice("--format", name, FIGURE_FORMATS)
    return tuple(told or USUAL_FORMATS)


def read_figures_asked(out: Path | None, told: list[str] | None) -> tuple[str, ...]:
    """Return the kinds of file that figures are to be written as into a folder; none without a folder.

    Raises:
        UserError: for a format that there is not or has no folder, or a folder that cannot be written.
    """
    formats = read_formats(told)
    if out is not None:
        _check_figures_folder(out)
        return formats
    if told:
        raise UserError(f"--format {told[0]}: name a folder for the figure by --out DIR")
    return ()


def draw_files(store: Store, out: Path | None, draw: Callable[[Path], list[Path]]) -> list[Path]:
    """Draw into a folder that a person names, or else into that of the results; return the files written.

    In a results folder, which may be a stranger's, no link is followed.

    Raises:
        UserError: where it cannot be written, before anything is drawn.
    """
    if out is not None:
        _check_figures_folder(out)
        return draw(out)
    store.check_writable()
    target = store.root / "figures"
    with TemporaryDirectory() as folder:
        drawn = draw(Path(folder))
        for path in drawn:
            store.write(target / path.name, path.read_bytes())
    return [target / path.name for path in drawn]


def _check_figures_folder(out: Path) -> None:
    """Refuse a folder that cannot be written, or a figure's name in its place."""
    ending = out.suffix.lower()[1:]
    if ending in FIGURE_FORMATS and not out.is_dir():
        raise UserError(f"--out {out}: is the folder to write figures to; name one, and --format {ending}")
    check_folder("--out", out)
