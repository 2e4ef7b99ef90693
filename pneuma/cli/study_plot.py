"""`pneuma study plot`: figures of studies, and an index of how each came about."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pneuma.analysis import BAND_NAMES, CURVE_QUANTITIES, WINDOWS
from pneuma.cli.figure_files import Formats, draw_files, read_formats
from pneuma.cli.options import (
    Conditions,
    EngineName,
    Json,
    NamedWorld,
    Results,
    Seeds,
    Settings,
    Steps,
    StudyPreset,
    print_json,
    read_path,
    read_selection,
)
from pneuma.cli.plain_text import plain
from pneuma.cli.study_output import check_choice, tell_left_out
from pneuma.cli.study_records import each_study, known_studies, nothing_yet, study_record
from pneuma.errors import UserError
from pneuma.figures import FIGURE_KINDS, FIGURE_LAYOUTS, FIGURE_SIZES
from pneuma.study.plan import Selection
from pneuma.study.store import Store, write_whole

if TYPE_CHECKING:
    from pneuma.analysis.tables import StudyData
    from pneuma.figures.curves import Drawing

    DrawOne = Callable[[str, StudyData], list[dict[str, Any]]]

RESULTS = Path("results")
EVERY_QUANTITY = "all"
ACTIONS = "actions"


@dataclass(frozen=True)
class _Looks:
    """How figures are asked to look."""

    kind: str
    quantities: tuple[str, ...]
    band: str | None
    window: str | None
    layout: str
    size: str
    formats: tuple[str, ...]
    beside: str | None = None

    def check(self) -> None:
        """Refuse what no figure can look like."""
        check_choice("--figure", self.kind, FIGURE_KINDS)
        for quantity in self.quantities:
            check_choice("--quantity", quantity, (*CURVE_QUANTITIES, ACTIONS, EVERY_QUANTITY))
        check_choice("--layout", self.layout, FIGURE_LAYOUTS)
        check_choice("--size", self.size, FIGURE_SIZES)
        if self.band is not None:
            check_choice("--band", self.band, BAND_NAMES)
        if self.window is not None:
            check_choice("--window", self.window, WINDOWS)
        of_curves = {
            "--quantity": self.quantities,
            "--band": self.band,
            "--window": self.window,
            "--beside": self.beside,
        }
        given = [option for option, value in of_curves.items() if value]
        if self.kind == "summary" and (given or self.layout != "pneuma"):
            raise UserError(f"{(given or ['--layout'])[0]}: is of --figure curves; a summary has one look")


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
    ] = "curves",
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
    ] = "pneuma",
    size: Annotated[
        str, typer.Option("--size", metavar="|".join(FIGURE_SIZES), help="For two columns, one, or a slide.")
    ] = "page",
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
    preset: StudyPreset = None,
    seeds: Seeds = None,
    steps: Steps = None,
    engine: EngineName = None,
    condition: Conditions = None,
    set_: Settings = None,
    world: NamedWorld = None,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Draw a study: curves over its steps, or what its runs came to."""
    looks = _Looks(figure, tuple(quantity or ()), band, window, layout, size, read_formats(format), beside)
    looks.check()
    selection = read_selection(preset, seeds, steps, engine, condition, set_)
    chosen = _chosen(
        {"--preset": preset, "--seeds": seeds, "--steps": steps, "--engine": engine, "--world": world},
        {"--condition": condition or [], "--set": set_ or []},
    )
    store = Store(results)
    studies = _studies_to_draw(store, names, selection, window, world)
    other = _opened(store, beside) if beside else None
    for _, data in studies:
        tell_left_out(data)
    draw_each = _draw if names else _draw_what_can_be
    target = out or store.root / "figures"
    owners = _owners(target)

    def draw(folder: Path) -> list[dict[str, Any]]:
        return draw_each(
            studies, lambda name, data: _draw_one(name, data, folder, looks, chosen, owners, other)
        )

    paths = _write(store, out, target, draw)
    if json:
        return print_json({"schema": 1, "figures": [str(path) for path in paths]})
    for path in paths:
        print(f"wrote {plain(str(path))}")
    return None


def _chosen(single: dict[str, str | None], repeated: dict[str, list[str]]) -> list[str]:
    """Return the selecting options as they were given, for the index."""
    pairs = [(option, value) for option, value in single.items() if value is not None]
    pairs += [(option, value) for option, values in repeated.items() for value in values]
    return [part for pair in pairs for part in pair]


def _studies_to_draw(
    store: Store,
    names: Sequence[str] | None,
    selection: Selection | None,
    window: str | None,
    world: str | None,
) -> list[tuple[str, StudyData]]:
    """Return studies by the names that a person gave, or all."""
    from pneuma.analysis.run_index import open_study

    def opened(name: str) -> StudyData:
        data = open_study(store, study_record(store, name, selection, world))
        data.checked_window(window)
        return data

    if names:
        studies = [(name, opened(name)) for name in names]
    else:
        if lacking := nothing_yet(store, world):
            raise UserError(lacking)
        studies = each_study(known_studies(store, world), opened)
    return studies


def _opened(store: Store, name: str) -> StudyData:
    from pneuma.analysis.run_index import open_study

    return open_study(store, study_record(store, name, None, None))


def _owners(folder: Path) -> dict[str, str]:
    """Return whose the figures of a folder are: studies by the names of their files."""
    from pneuma.figures.index import read_index

    return {entry["file"]: str(entry.get("from", "")).removeprefix("study ") for entry in read_index(folder)}


def _draw(studies: Sequence[tuple[str, StudyData]], draw_one: DrawOne) -> list[dict[str, Any]]:
    """Draw studies; return what their folder's index is to tell of them."""
    return [entry for name, data in studies for entry in draw_one(name, data)]


def _draw_what_can_be(studies: Sequence[tuple[str, StudyData]], draw_one: DrawOne) -> list[dict[str, Any]]:
    """Draw studies that nobody named one by one, as `_draw` does; of those that cannot be drawn only say so.

    Raises:
        UserError: where none of several can be drawn: what hinders the first.
    """
    known = dict(studies)
    drawn = each_study(list(known), lambda name: draw_one(name, known[name]))
    return [entry for _, entries in drawn for entry in entries]


def _draw_one(
    name: str,
    data: StudyData,
    folder: Path,
    looks: _Looks,
    chosen: Sequence[str],
    owners: dict[str, str],
    beside: StudyData | None,
) -> list[dict[str, Any]]:
    """Draw a study into files that are no other's, and note that they are its own."""
    from pneuma.figures.index import index_entries

    while any(owners.get(file, data.study) != data.study for file in _files(data, looks)):
        data.figure += f"-{data.study}"
    draw = {"curves": _draw_curves, "summary": _draw_summary}[looks.kind]
    paths, drawn = draw(data, folder, looks, beside)
    owners |= dict.fromkeys((path.name for path in paths), data.study)
    singles = {
        option: drawn[option] for option in ("figure", "layout", "size", "band", "window") if option in drawn
    }
    options = [part for option, value in singles.items() for part in (f"--{option}", value)]
    options += [part for quantity in drawn.get("quantities", ()) for part in ("--quantity", quantity)]
    options += ["--beside", looks.beside] if looks.beside else []
    options += [part for form in looks.formats for part in ("--format", form)]
    command = shlex.join(["pneuma", "study", "plot", name, *options, *chosen])
    return index_entries(paths, command, data, drawn)


def _files(data: StudyData, looks: _Looks) -> list[str]:
    """Return the names of the files that a study's figure would be."""
    from pneuma.figures.curves import file_stem
    from pneuma.figures.summary import summary_stem

    stem = (
        summary_stem(data, looks.size)
        if looks.kind == "summary"
        else file_stem(data, _drawing(data, looks), looks.beside)
    )
    return [f"{stem}.{form}" for form in looks.formats]


def _drawing(data: StudyData, looks: _Looks) -> Drawing:
    from pneuma.figures.curves import settle

    quantities = _quantities(data, looks.quantities)
    return settle(data, looks.band, looks.window, quantities=quantities, layout=looks.layout, size=looks.size)


def _draw_curves(
    data: StudyData, folder: Path, looks: _Looks, beside: StudyData | None
) -> tuple[list[Path], dict[str, Any]]:
    from pneuma.figures.curves import draw_study

    drawing = asdict(_drawing(data, looks))
    paths = draw_study(data, folder, formats=looks.formats, beside=beside, **drawing)
    return paths, {"figure": "curves", **drawing}


def _draw_summary(
    data: StudyData, folder: Path, looks: _Looks, _: StudyData | None
) -> tuple[list[Path], dict[str, Any]]:
    from pneuma.figures.summary import draw_summary, shown_outcome

    drawn = {"figure": "summary", "size": looks.size, "outcome": shown_outcome(data)}
    return draw_summary(data, folder, looks.formats, size=looks.size), drawn


def _quantities(data: StudyData, names: Sequence[str]) -> list[str]:
    """Return the quantities that a person asks for, all and actions spelled out."""
    from pneuma.analysis.curves import curve_names

    held = curve_names(data)
    stand_for = {
        EVERY_QUANTITY: held,
        ACTIONS: [name for name in CURVE_QUANTITIES if name.startswith("action_")],
    }
    return [quantity for name in names for quantity in stand_for.get(name, [name])]


def _write(
    store: Store, out: Path | None, target: Path, draw: Callable[[Path], list[dict[str, Any]]]
) -> list[Path]:
    """Draw into a folder that a person names, or else into that of the results; keep its index."""
    from pneuma.figures.index import INDEX, encode_index, read_index

    entries: list[dict[str, Any]] = []

    def draw_entries(folder: Path) -> list[Path]:
        entries.extend(draw(folder))
        return [folder / entry["file"] for entry in entries]

    paths = draw_files(store, out, draw_entries)
    index = encode_index([*read_index(target), *entries])  # another may have added to it meanwhile
    if out is None:
        store.write(target / INDEX, index)
    else:
        out.mkdir(parents=True, exist_ok=True)
        write_whole(out / INDEX, index)
    return paths
