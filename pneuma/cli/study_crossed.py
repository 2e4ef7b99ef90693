"""`pneuma study effects` and `robustness`: what factors do, and where a contrast holds over them."""

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
from pneuma.cli.plain_text import plain, print_table
from pneuma.cli.study_output import open_data, tell_written
from pneuma.cli.study_summary import records, tell_step
from pneuma.config import Run, read_field
from pneuma.errors import UserError
from pneuma.study.store import Store
from pneuma.values import as_tuple, shown_level, shown_value

if TYPE_CHECKING:
    from pneuma.analysis.crossed import Effects, Map
    from pneuma.analysis.tables import StudyData

RESULTS = Path("results")
PRIMARY = "final-share-killed"


@selects
def effects(
    name: StudyName,
    outcome: Annotated[str, typer.Option("--outcome", metavar="NAME", help="What to look at.")] = PRIMARY,
    selection: Selected = None,
    world: WorldName = None,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Test the main effects and two-way interactions of a crossed study's factors."""
    data = open_data(Store(results), name, selection, world)
    from pneuma.analysis.crossed import effects_table, study_effects
    from pneuma.analysis.run_view import common_step

    found = study_effects(data, outcome)
    if not json:
        _print_effects(found)
        return tell_step(data)
    rows = [
        {**row, "factors": list(own.factors), "levels": [len(found.means[factor]) for factor in own.factors]}
        for row, own in zip(records(effects_table(found)), found.effects, strict=True)
    ]
    document = {"schema": 1, "study": found.study, "outcome": found.outcome, "cells": found.cells}
    runs = {"runs": found.runs, "runs_without_outcome": found.without, "means": found.means}
    return print_json({**document, **runs, "effects": rows, "at_step": common_step(data)})


def _print_effects(found: Effects) -> None:
    from pneuma.analysis.crossed import effects_table
    from pneuma.analysis.outcomes import find_outcome
    from pneuma.analysis.rounding import decimals, shown

    outcome = find_outcome(found.outcome)
    unit = f" ({outcome.unit})" if outcome.unit else ""
    without = f", and {found.without} without it left out" if found.without else ""
    print(f"{plain(found.title)}: {outcome.words}{unit}, {found.runs} runs in {found.cells} cells{without}\n")
    print_table(
        ("effect", "levels", "df", "F", "partial R²", "p", "p (Holm)"),
        (
            (
                row["effect"],
                row["levels"],
                f"{row['df']}, {row['df_error']}",
                "endless" if row["f"] == float("inf") else shown(row["f"], 2),
                shown(row["partial_r2"], 3),
                f"{row['p']:.4f}",
                f"{row['p_holm']:.4f}",
            )
            for row in effects_table(found).to_dict("records")
        ),
    )
    print(f"\nMeans{unit}, each cell counted alike:")
    for factor, means in found.means.items():
        told = ";  ".join(f"{level} {shown(value, decimals(value))}" for level, value in means.items())
        print(f"  {plain(factor)}: {plain(told)}")
    print("\nPartial R²: share of the variance that the other effects leave. Holm: over this table.")


@selects
def robustness(
    name: StudyName,
    contrast: Annotated[
        str,
        typer.Option(
            "--contrast",
            metavar="KEY=A:B",
            help="A field that conditions differ in, its value that is said to do better, and the other: "
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
    """Compare two values of a field in every combination of a study's other factors."""
    formats = read_figures_asked(out, format)
    readings = read_contrast(contrast)
    data = open_data(Store(results), name, selection, world)
    from pneuma.analysis.crossed import map_table, robustness_map
    from pneuma.analysis.outcomes import find_outcome
    from pneuma.analysis.run_view import common_step

    found = robustness_map(data, *_meant(readings, data), outcome)
    files = [] if out is None else _drawn(data, found, out, formats)
    turned = find_outcome(outcome).better == "lower"
    if not json:
        _print_map(found, turned)
        tell_step(data)
        return tell_written(files)
    values = {"setting": found.setting, "better": found.values[0], "worse": found.values[1]}
    document = {"schema": 1, "study": found.study, "contrast": values, "outcome": found.outcome}
    told = {"label": found.label, "turned": turned, "at_step": common_step(data)}
    cells, figures = records(map_table(found)), [str(file) for file in files]
    return print_json({**document, **told, "cells": cells, "figures": figures})


def read_contrast(text: str) -> list[tuple[str, Any, Any]]:
    """Read KEY=A:B, once for every colon that may stand between the two: a value may have colons too.

    It may also be a list, as in betas=0.9,0.9:0.9,0.999.
    """
    key, equals, values = (part.strip() for part in text.partition("="))
    pairs = [(values[:i].strip(), values[i + 1 :].strip()) for i, c in enumerate(values) if c == ":"]
    pairs = [pair for pair in pairs if all(pair)]
    if not (key and equals and pairs):
        raise UserError(f"--contrast {text}: must be KEY=A:B, as in activation=tanh:relu")

    def read(value: str) -> Any:
        return read_settings_options([f"{key}={value}"])[key]

    return [(key, read(better), read(worse)) for better, worse in pairs]


def _meant(readings: list[tuple[str, Any, Any]], data: StudyData) -> tuple[str, Any, Any]:
    """Return the reading both of whose values a study's conditions have; the first where there is none."""

    def had(key: str, value: Any) -> bool:
        try:
            own = as_tuple(read_field(Run, key, value))
        except UserError:
            return False
        return any(as_tuple(run["run"].get(key)) == own for run in data.record["runs"])

    return next((r for r in readings if had(r[0], r[1]) and had(r[0], r[2])), readings[0])


def _drawn(data: StudyData, found: Map, out: Path, formats: tuple[str, ...]) -> list[Path]:
    from pneuma.figures.maps import draw_robustness
    from pneuma.figures.panels import stem_of

    parts = [found.setting, *map(shown_value, found.values), *[found.outcome] * (found.outcome != PRIMARY)]
    return draw_robustness(data, [found], out, stem_of(data, *parts), formats)


def _print_map(found: Map, turned: bool) -> None:
    from pneuma.analysis.outcomes import find_outcome
    from pneuma.analysis.rounding import shown_with_interval

    better, worse = map(shown_value, found.values)
    outcome = found.outcome + (" (turned, as less is better)" if turned else "")
    print(f"{plain(found.title)}: {found.setting} {better} against {worse}, {outcome}: {found.label}")
    unit = find_outcome(found.outcome).unit
    rows = []
    for cell in found.cells:
        levels = ", ".join(f"{key} {shown_level(level)}" for key, level in cell.levels) or cell.better
        interval = cell.contrast.interval
        effect = shown_with_interval(cell.contrast.effect, interval.low, interval.high)
        rows.append((levels, effect, f"{cell.p:.3f}", cell.label))
    print_table(("cell", f"difference{f' ({unit})' if unit else ''}", "p (Holm)", ""), rows)
    print("Intervals are each for itself; p and the label are Holm-corrected over the map.")
