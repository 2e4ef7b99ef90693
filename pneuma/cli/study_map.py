"""`pneuma study robustness`: does a contrast hold over a study's other factors?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pneuma.cli.figure_files import Formats, read_figures_asked
from pneuma.cli.options import (
    Json,
    Results,
    Selected,
    StudyName,
    WorldName,
    print_json,
    read_path,
    read_settings_options,
    selects,
)
from pneuma.cli.plain_text import plain
from pneuma.cli.study_summary import open_data, records, tell_step
from pneuma.config import Run, read_setting
from pneuma.errors import UserError
from pneuma.study.store import Store
from pneuma.values import as_tuple, shown_level, shown_setting

if TYPE_CHECKING:
    from pneuma.analysis.robustness import Map
    from pneuma.analysis.tables import StudyData

RESULTS = Path("results")
PRIMARY = "final-share-killed"

Contrasted = tuple[str, Any, Any]
"""A setting, its value that is said to do better, and the other."""


@selects
def robustness(
    name: StudyName,
    contrast: Annotated[
        str,
        typer.Option(
            "--contrast",
            metavar="KEY=A:B",
            help="A setting that conditions differ in, its value that is said to do better, and the other: "
            "activation=tanh:relu.",
        ),
    ],
    outcome: Annotated[str, typer.Option("--outcome", metavar="NAME", help="What to compare.")] = PRIMARY,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", parser=read_path, help="Draw the map, and write the figure there."
        ),
    ] = None,
    format: Formats = None,
    selection: Selected = None,
    world: WorldName = None,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Compare two values of a setting in every combination of a study's other factors."""
    formats = read_figures_asked(out, format)
    readings = _read_contrast(contrast)
    data = open_data(Store(results), name, selection, world)
    key, better, worse = _meant(readings, data)
    from pneuma.analysis.robustness import robustness_map
    from pneuma.analysis.run_view import common_step

    found = robustness_map(data, key, better, worse, outcome)
    figures = [] if out is None else _drawn(data, found, out, formats)
    if json:
        return print_json({**_document(found, common_step(data)), "figures": list(map(str, figures))})
    _print_map(found)
    tell_step(data)
    for path in figures:
        print(f"wrote {plain(str(path))}")
    return None


def _read_contrast(text: str) -> list[Contrasted]:
    """Read KEY=A:B, once for every colon that may stand between the two: a value may have colons too.

    It may also be a list, as in betas=0.9,0.9:0.9,0.999.
    """
    key, equals, values = (part.strip() for part in text.partition("="))
    places = [place for place, letter in enumerate(values) if letter == ":"]
    pairs = [(values[:place].strip(), values[place + 1 :].strip()) for place in places]
    pairs = [(better, worse) for better, worse in pairs if better and worse]
    if not (key and equals and pairs):
        raise UserError(f"--contrast {text}: must be KEY=A:B, as in activation=tanh:relu")
    read = [[read_settings_options([f"{key}={value}"])[key] for value in pair] for pair in pairs]
    return [(key, better, worse) for better, worse in read]


def _meant(readings: list[Contrasted], data: StudyData) -> Contrasted:
    """Return the reading both of whose values a study's conditions have; the first where there is none."""

    def had(key: str, value: Any) -> bool:
        try:
            own = as_tuple(read_setting(Run, key, value))
        except UserError:
            return False
        return any(as_tuple(run["run"].get(key)) == own for run in data.record["runs"])

    return next((r for r in readings if had(r[0], r[1]) and had(r[0], r[2])), readings[0])


def _drawn(data: StudyData, found: Map, out: Path, formats: tuple[str, ...]) -> list[Path]:
    from pneuma.figures.maps import draw_robustness
    from pneuma.figures.panels import stem_of

    parts = [found.setting, *map(shown_setting, found.values), *[found.outcome] * (found.outcome != PRIMARY)]
    return draw_robustness(data, [found], out, stem_of(data, *parts), formats)


def _document(found: Map, at_step: int | None) -> dict[str, Any]:
    from pneuma.analysis.robustness import map_table

    return {
        "schema": 1,
        "study": found.study,
        "contrast": {"setting": found.setting, "better": found.values[0], "worse": found.values[1]},
        "outcome": found.outcome,
        "label": found.label,
        "turned": _turned(found),
        "at_step": at_step,
        "cells": records(map_table(found)),
    }


def _turned(found: Map) -> bool:
    """Tell whether differences are turned, so that above 0 is as claimed though less is better."""
    from pneuma.analysis.outcomes import find_outcome

    return find_outcome(found.outcome).better == "lower"


def _print_map(found: Map) -> None:
    from pneuma.analysis.rounding import shown_with_interval

    better, worse = map(shown_setting, found.values)
    outcome = found.outcome + (" (turned, as less is better)" if _turned(found) else "")
    print(f"{plain(found.title)}: {found.setting} {better} against {worse}, {outcome}: {found.label}")
    rows = []
    for cell in found.cells:
        levels = ", ".join(f"{key} {shown_level(level)}" for key, level in cell.levels) or cell.better
        interval = cell.contrast.interval
        effect = shown_with_interval(cell.contrast.effect, interval.low, interval.high)
        rows.append((plain(levels), effect, f"p {cell.p:.3f}  {cell.label}"))
    widths = [max(len(row[column]) for row in rows) for column in (0, 1)]
    for levels, effect, told in rows:
        print(f"  {levels:<{widths[0]}}  {effect:<{widths[1]}}  {told}")
    print("Intervals are each for itself; p and the label are Holm-corrected over the map.")
