"""The robustness map: the cells of a crossed study in which a contrast holds, is reversed, or is open."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from pneuma.analysis.crossed import HOLDS, OPEN, REVERSED, Map, robustness_map
from pneuma.analysis.frames import StudyData, figure_basename, step_note
from pneuma.analysis.outcomes import find_outcome, primary
from pneuma.errors import UserError
from pneuma.figures import grid
from pneuma.figures.grid import Page, Panel, in_grid
from pneuma.figures.origin import samples_of
from pneuma.figures.style import COLOURS, GREY, INK
from pneuma.figures.words import format_counts, headline_of, notes_of
from pneuma.values import shown_level, shown_value

ROW_INCHES, AROUND_INCHES = 0.17, 0.75
"""Heights in inches of a row, and of a map's title, ticks and label together."""

STYLES: dict[str, dict[str, Any]] = {
    HOLDS: {"marker": "o", "color": COLOURS[0], "markerfacecolor": COLOURS[0]},
    REVERSED: {"marker": "s", "color": COLOURS[1], "markerfacecolor": COLOURS[1]},
    OPEN: {"marker": "o", "color": GREY, "markerfacecolor": "white"},
}
"""Markers: filled if decided, a square if reversed, so that they can be told apart in grey."""

MAPS: dict[str, tuple[tuple[str, Any, Any], ...]] = {
    "robustness": (
        ("betas", [0.9, 0.9], [0.9, 0.999]),
        ("activation", "tanh", "relu"),
        ("actor", [128], [256]),
        ("clip_range", 0.1, 0.2),
    )
}
"""Contrasts of the thesis: a field, the value that is said to do better, and the other."""


def study_maps(data: StudyData) -> list[Map]:
    """Return all maps of a study, without those whose conditions were not run."""
    found = []
    for contrast in MAPS.get(data.study, ()):
        with suppress(UserError):
            found.append(robustness_map(data, *contrast))
    return found


def robustness_page(data: StudyData, maps: Sequence[Map]) -> Page:
    """Return the figure of some maps of a study; its name is that of the first."""
    found, *_ = maps
    other = [found.outcome] if found.outcome != primary(data) else []
    basename = figure_basename(data, found.setting, *map(shown_value, found.values), *other)
    columns = min(len(maps), 2)
    ends = np.concatenate([found.cells[["value", "low", "high"]].to_numpy(float).ravel() for found in maps])
    reach = 1.05 * float(np.nanmax(np.abs(ends), initial=0.0))
    panels = in_grid([_panel(found, reach) for found in maps], columns)
    inches = ROW_INCHES * max(len(found.cells) for found in maps) + AROUND_INCHES
    labels = {label for found in maps for label in found.cells["label"]}
    entries = {
        label: Line2D([], [], linestyle="", markersize=4.5, **look)
        for label, look in STYLES.items()
        if label in labels
    }
    headline = headline_of(data, "does the contrast hold elsewhere?")
    caption = [*notes_of(data), *_caption(data, maps)]
    return Page(basename, panels, len(panels) * inches, headline, samples_of(data), entries, caption)


def _panel(found: Map, reach: float) -> Panel:
    """Return a panel with one row per cell, named by its levels; above the rows stand their factors.

    The axis extends `reach` to both sides, so that effects of several maps can be compared.
    """
    cells = found.cells.to_dict("records")
    levels = (", ".join(shown_level(cell[factor]) for factor in found.factors) for cell in cells)
    label = " less ".join(map(shown_level, found.values))
    shares = find_outcome(found.outcome).bounds == (0.0, 1.0)
    return Panel(
        partial(_draw_cells, cells=cells, factors=_readable(", ".join(found.factors)), reach=reach),
        f"{_readable(found.setting)}: {found.label}",
        label + " (percentage points)" * shares,
        x_ticks=grid.points if shares else grid.few,
        rows=[named or cell["better"] for named, cell in zip(levels, cells, strict=True)],
    )


def _draw_cells(axes: Axes, cells: Sequence[dict[Any, Any]], factors: str, reach: float) -> None:
    if reach:
        axes.set_xlim(-reach, reach)
    axes.axvline(0, color=INK, linewidth=0.8)
    for place, cell in enumerate(cells):
        grid.draw_interval(axes, place, cell, markersize=4.5, **STYLES[cell["label"]])
    where: Any = {"ha": "right", "va": "bottom", "transform": axes.transAxes}
    axes.text(-0.02, 1.03, factors, fontsize="small", **where)


def contrast_word(found: Map) -> str:
    """Return the contrast of a map as `--contrast` takes it."""
    shown = (
        f"[{shown_value(one)}]" if isinstance(one, list | tuple) else shown_value(one) for one in found.values
    )
    return f"{found.setting}={':'.join(shown)}".replace(", ", ",")


def _readable(field: str) -> str:
    return field.replace("_", " ")


def _caption(data: StudyData, maps: Sequence[Map]) -> list[str]:
    outcome = find_outcome(maps[0].outcome)
    turned = " (turned, as less is better)" if outcome.better == "lower" else ""
    runs = format_counts(runs for found in maps for runs in found.runs)
    return [
        f"Differences of means in {outcome.words}{turned}, {runs} runs an arm, with 95 % intervals.",
        "Filled: other than 0 by relabelings and by Welch's t, at 5 % over each panel (Holm).",
        step_note(data),
    ]
