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
from pneuma.study.store import Store, write_whole

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
    """Write what is drawn into a folder that a person names, or else into that of the results.

    In a results folder, which may be untrusted, no link is followed.

    Args:
        store: the results folder.
        out: where; None for `figures` there.
        draw: draws into a folder that is removed afterwards, and returns its files.

    Returns:
        The files written; none where drawing fails.

    Raises:
        UserError: where it cannot be written, before anything is drawn.
    """
    if out is not None:
        _check_figures_folder(out)
    else:
        check_folder("--results", store.root)
    target = out or store.root / "figures"
    with TemporaryDirectory() as folder:
        files = {path.name: path.read_bytes() for path in draw(Path(folder))}
    for name, content in files.items():
        if out is None:
            store.write(target / name, content)
        else:
            out.mkdir(parents=True, exist_ok=True)
            write_whole(target / name, content)
    return [target / name for name in files]


def _check_figures_folder(out: Path) -> None:
    """Refuse a folder that cannot be written, or a figure's name in its place."""
    ending = out.suffix.lower()[1:]
    if ending in FIGURE_FORMATS and not out.is_dir():
        raise UserError(f"--out {out}: is the folder to write figures to; name one, and --format {ending}")
    check_folder("--out", out)
