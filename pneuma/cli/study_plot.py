"""`pneuma study plot`: figures of studies, and an index of how each came about."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pneuma.analysis import BAND_NAMES, CURVE_QUANTITIES, WINDOWS
from pneuma.cli.figure_files import Formats, draw_files, read_formats
from pneuma.cli.options import (
    Json,
    NamedWorld,
    Results,
    Selected,
    print_json,
    read_path,
    selecting_words,
    selects,
)
from pneuma.cli.plain_text import plain
from pneuma.cli.study_output import check_choice, tell_left_out
from pneuma.cli.study_records import each_study, known_studies, nothing_yet, study_record
from pneuma.errors import UserError
from pneuma.figures import FIGURE_KINDS, FIGURE_LAYOUTS, FIGURE_SIZES
from pneuma.study.store import Store

if TYPE_CHECKING:
    from pneuma.analysis.tables import StudyData

RESULTS = Path("results")
EVERY_QUANTITY, ACTIONS = "all", "actions"


@dataclass(frozen=True)
class _Looks:
    """How figures are asked to look."""

    figure: str
    quantities: tuple[str, ...]
    band: str | None
    window: str | None
    layout: str
    size: str
    formats: tuple[str, ...]

    def check(self, beside: str | None) -> None:
        """Refuse what no figure can look like."""
        check_choice("--figure", self.figure, FIGURE_KINDS)
        check_choice("--layout", self.layout, FIGURE_LAYOUTS)
        check_choice("--size", self.size, FIGURE_SIZES)
        check_choice("--band", self.band or BAND_NAMES[0], BAND_NAMES)
        check_choice("--window", self.window or WINDOWS[0], WINDOWS)
        for quantity in self.quantities:
            check_choice("--quantity", quantity, (*CURVE_QUANTITIES, ACTIONS, EVERY_QUANTITY))
        layout = self.layout if self.layout != FIGURE_LAYOUTS[0] else None
        of_curves = {"quantity": self.quantities, "band": self.band, "window": self.window, "beside": beside}
        for option, value in {**of_curves, "layout": layout}.items():
            if value and self.figure == "summary":
                raise UserError(f"--{option}: is of --figure curves; a summary has one look")


@selects
def plot(
    names: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME]…", help="Studies; left out: all that were run.")
    ] = None,
    figure: Annotated[
        str,
        typer.Option(
            "--figure",
            metavar="|".join(FIGURE_KINDS),
            help="Curves over steps, or a summary: every run's end with intervals, profiles, improvement.",
        ),
    ] = FIGURE_KINDS[0],
    quantity: Annotated[
        list[str] | None,
        typer.Option(
            "--quantity",
            metavar="NAME",
            help="A curve to draw, such as entropy; actions, or all (may be repeated; default: share_killed "
            "and return).",
        ),
    ] = None,
    band: Annotated[
        str | None,
        typer.Option(
            "--band",
            metavar="|".join(BAND_NAMES),
            help="What the band shows (default: ci; minmax with --layout thesis).",
        ),
    ] = None,
    layout: Annotated[
        str, typer.Option("--layout", metavar="|".join(FIGURE_LAYOUTS), help="Whose figure it is like.")
    ] = FIGURE_LAYOUTS[0],
    size: Annotated[
        str, typer.Option("--size", metavar="|".join(FIGURE_SIZES), help="For two columns, one, or a slide.")
    ] = FIGURE_SIZES[0],
    window: Annotated[
        str | None,
        typer.Option("--window", metavar="|".join(WINDOWS), help="Which episodes a point averages."),
    ] = None,
    beside: Annotated[
        str | None,
        typer.Option(
            "--beside", metavar="NAME", help="Another study, or imported logs, whose runs are drawn too."
        ),
    ] = None,
    format: Formats = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", parser=read_path, help="Where to write (default: RESULTS/figures)."
        ),
    ] = None,
    selection: Selected = None,
    world: NamedWorld = None,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Draw a study: curves over its steps, or what its runs came to."""
    looks = _Looks(figure, tuple(quantity or ()), band, window, layout, size, read_formats(format))
    looks.check(beside)
    store = Store(results)
    if not names and (lacking := nothing_yet(store, world)):
        raise UserError(lacking)
    from pneuma.analysis.run_index import open_study
    from pneuma.figures.index import INDEX, encode_index, read_present

    target = out or store.root / "figures"
    owners = {entry["file"]: entry.get("from") for entry in read_present(target)}
    other = open_study(store, study_record(store, beside, None, None)) if beside else None
    chosen = [*selecting_words(selection), *(["--world", world] if world else [])] if selection else []
    entries: list[dict[str, Any]] = []

    def draw_one(name: str, folder: Path) -> None:
        data = open_study(store, study_record(store, name, selection, world))
        tell_left_out(data)
        words = [name, *(["--beside", beside] if beside else []), *chosen]
        entries.extend(_draw_one(data, folder, looks, words, owners, other))

    def draw(folder: Path) -> list[Path]:
        if names:
            for name in names:
                draw_one(name, folder)
        else:
            each_study(known_studies(store, world), lambda name: draw_one(name, folder))
        (folder / INDEX).write_bytes(encode_index([*read_present(target), *entries]))
        return [*(folder / entry["file"] for entry in entries), folder / INDEX]

    paths = [path for path in draw_files(store, out, draw) if path.name != INDEX]
    if json:
        return print_json({"schema": 1, "figures": [str(path) for path in paths]})
    for path in paths:
        print(f"wrote {plain(str(path))}")
    return None


def _draw_one(
    data: StudyData,
    folder: Path,
    looks: _Looks,
    words: list[str],
    owners: dict[str, Any],
    beside: StudyData | None,
) -> list[dict[str, Any]]:
    """Draw a study into files that are no other's; return what the index tells of them.

    Args:
        data: the study.
        folder: where.
        looks: of the figure.
        words: of the command, what names and selects the study.
        owners: which study each file shows that is there already.
        beside: whose runs are drawn too.
    """
    from pneuma.figures.curves import draw_study, file_stem, settle
    from pneuma.figures.index import index_entries
    from pneuma.figures.summary import draw_summary, shown_outcome, summary_stem

    drawn: dict[str, Any] = {"figure": looks.figure, "size": looks.size}
    if looks.figure == "curves":
        quantities = _quantities(data, looks.quantities)
        settled = settle(
            data, looks.band, looks.window, quantities=quantities, layout=looks.layout, size=looks.size
        )
        drawn |= asdict(settled)
    while True:
        stem = (
            summary_stem(data, looks.size)
            if looks.figure == "summary"
            else file_stem(data, settled, beside.study if beside else None)
        )
        own = f"study {data.study}"
        if all(owners.setdefault(f"{stem}.{form}", own) == own for form in looks.formats):
            break
        data.figure += f"-{data.study}"
    if looks.figure == "summary":
        paths = draw_summary(data, folder, looks.formats, size=looks.size)
        drawn["outcome"] = shown_outcome(data)
    else:
        paths = draw_study(data, folder, formats=looks.formats, beside=beside, **asdict(settled))
    command = ["pneuma", "study", "plot", *words, *_options(drawn, looks.formats)]
    return index_entries(paths, shlex.join(command), data, drawn)


def _options(drawn: Mapping[str, Any], formats: tuple[str, ...]) -> list[str]:
    """Return the options that draw a figure again as it was drawn."""
    singles = [key for key in ("figure", "layout", "size", "band", "window") if key in drawn]
    options = [word for key in singles for word in (f"--{key}", drawn[key])]
    options += [word for quantity in drawn.get("quantities", ()) for word in ("--quantity", quantity)]
    return options + [word for form in formats for word in ("--format", form)]


def _quantities(data: StudyData, names: tuple[str, ...]) -> list[str]:
    """Return the quantities that a person asks for, all and actions spelled out."""
    from pneuma.analysis.curves import curve_names

    actions = [name for name in CURVE_QUANTITIES if name.startswith("action_")]
    stand_for = {EVERY_QUANTITY: curve_names(data), ACTIONS: actions}
    return [quantity for name in names for quantity in stand_for.get(name, [name])]
