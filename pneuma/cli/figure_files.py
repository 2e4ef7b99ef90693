"""The option that all commands share which write figures: as what kinds of file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pneuma.cli.study_output import check_choice, check_folder
from pneuma.errors import UserError
from pneuma.figures import FIGURE_FORMATS

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
        check_folder("--out", out)
        return formats
    if told:
        raise UserError(f"--format {told[0]}: name a folder for the figure by --out DIR")
    return ()
