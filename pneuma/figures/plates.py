"""What `make figures` draws of one published study: curves, what they came to, collapses, maps, tables.

    a published study → its files, and what the index tells of each

The curves stand as the thesis has them too, where it has that figure. Pictures are made small: they are
committed, and drawn anew whenever a study is published.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pneuma.analysis.curves import curve_names
from pneuma.analysis.export import encode_frame
from pneuma.analysis.summaries import summary_table
from pneuma.analysis.tables import StudyData
from pneuma.analysis.trajectories import StudyTrajectories
from pneuma.figures import FIGURE_LAYOUTS
from pneuma.figures.collapse import collapsed_shares, draw_collapse
from pneuma.figures.curves import MOST_CURVES, THESIS_WINDOW, USUAL_QUANTITIES, draw_study, settle
from pneuma.figures.index import index_entries
from pneuma.figures.robustness import draw_robustness, study_maps
from pneuma.figures.shrink import shrink
from pneuma.figures.summary import draw_summary, shown_outcome
from pneuma.figures.trajectories import draw_trajectories

COMMAND = "make figures"
TABLES = "tables"
TABLE_FORMATS = {"latex": ".tex", "markdown": ".md", "csv": ".csv"}

OF_THE_THESIS = "fig-"
CONTRASTED = {
    "optimizer": ("stationary", "non-stationary"),
    "actor-size": ("smallest", "small"),
}
"""Conditions of the thesis's own figure, of studies that have more."""
EVERY = "every condition"

MORE_CURVES = {"gradient-limits": ("grad_norm",), "collapse": ("entropy",)}
"""What else a study is about, beside the share killed and the return."""

BESIDE = {"published-logs": "author-logs"}
"""Imported logs whose runs are drawn with a study's own."""
QUANTITIES_OF_LOGS = ("return", "length", "entropy")

Drawn = Iterator[tuple[dict[str, Any], list[Path]]]
"""How a figure is drawn, and its files."""


def draw_published(
    data: StudyData,
    folder: Path,
    found: StudyTrajectories | None = None,
    logs: StudyData | None = None,
) -> list[dict[str, Any]]:
    """Draw everything of a study and write its tables; return what the index tells of each file.

    Args:
        data: the study.
        folder: where.
        found: its trajectories, where these are published too.
        logs: those of `BESIDE`, where these are.
    """
    entries = []
    for drawing, paths in _figures(data, folder):
        entries += _indexed(data, drawing, paths)
    if logs:
        how = asdict(settle(data, "runs", THESIS_WINDOW, quantities=QUANTITIES_OF_LOGS))
        drawing = {"figure": "curves", **how, "beside": logs.study}
        entries += _indexed(data, drawing, draw_study(data, folder, beside=logs, **how))
    ways = found and found.of_runs(data.runs)  # some may have been published anew
    if ways and len(ways.episodes) and ways.level:
        own = data.of_runs({*ways.episodes["run_id"]})  # a condition may have been renamed since
        drawn = draw_trajectories(own, ways, folder, f"{data.figure}-trajectories")
        entries += _indexed(own, {"figure": "trajectories"}, drawn)
    return [*entries, *_write_tables(data, folder / TABLES)]


def _indexed(data: StudyData, drawing: dict[str, Any], paths: list[Path]) -> list[dict[str, Any]]:
    for path in paths:
        shrink(path)
    return index_entries(paths, COMMAND, data, drawing)


def _write_tables(data: StudyData, folder: Path) -> list[dict[str, Any]]:
    """Write what the study's runs came to, in every format of a table."""
    summary = summary_table(data)
    entries = []
    for form, suffix in TABLE_FORMATS.items():
        path = folder / f"{data.study}{suffix}"
        path.write_bytes(encode_frame(summary, form))
        (entry,) = index_entries([path], COMMAND, data, {"table": "summary", "format": form})
        entries.append({**entry, "file": f"{TABLES}/{path.name}"})
    return entries


def _figures(data: StudyData, folder: Path) -> Drawn:
    """Draw all figures of a study, one after the other."""
    yield from _draw_curves(data, folder)
    yield from _draw_more_curves(data, folder)
    drawing = {"figure": "summary", "size": "page", "outcome": shown_outcome(data)}
    yield drawing, draw_summary(data, folder)
    if len(collapsed_shares(data)):
        yield {"figure": "collapses"}, draw_collapse(data, folder, f"{data.figure}-collapses")
    if maps := study_maps(data):
        contrasts = [found.setting for found in maps]
        stem = f"{data.figure}-map"
        yield {"figure": "map", "contrasts": contrasts}, draw_robustness(data, maps, folder, stem)


def _draw_curves(data: StudyData, folder: Path) -> Drawn:
    """Draw the conditions of the thesis's figure, and all where the study has more."""
    if len(data.conditions) > MOST_CURVES or not set(USUAL_QUANTITIES) & set(curve_names(data)):
        return
    contrasted = [name for name in CONTRASTED.get(data.own_name, ()) if name in data.conditions]
    if contrasted:
        yield from _draw_layouts(data.of_conditions(contrasted), folder)
        every = data.of_conditions(data.conditions)
        every.figure = f"{data.figure}-all"
        yield _told(every), draw_study(every, folder, shown=EVERY)
    else:
        yield from _draw_layouts(data, folder)


def _draw_layouts(data: StudyData, folder: Path) -> Drawn:
    """Draw a study's curves; as the thesis does too, where it has the figure."""
    as_in_thesis = data.figure.startswith(OF_THE_THESIS) and "return" in data.quantities
    for layout in FIGURE_LAYOUTS if as_in_thesis else FIGURE_LAYOUTS[:1]:
        yield _told(data, layout=layout), draw_study(data, folder, layout=layout)


def _draw_more_curves(data: StudyData, folder: Path) -> Drawn:
    for quantity in MORE_CURVES.get(data.own_name, ()):
        if quantity in data.quantities:
            names = (quantity,)
            yield _told(data, quantities=names), draw_study(data, folder, quantities=names)


def _told(
    data: StudyData, *, layout: str = FIGURE_LAYOUTS[0], quantities: Sequence[str] = ()
) -> dict[str, Any]:
    """Return what the index tells of a figure of curves."""
    settled = settle(data, layout=layout, quantities=quantities)
    return {"figure": "curves", "conditions": data.conditions, **asdict(settled)}
