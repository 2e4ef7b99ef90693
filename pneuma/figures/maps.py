"""The robustness map: the cells of a crossed study in which a contrast holds, is reversed, or is open."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pneuma.analysis.crossed import HOLDS, OPEN, REVERSED, Map, robustness_map
from pneuma.analysis.frames import StudyData, common_step, step_words
from pneuma.analysis.outcomes import find_outcome
from pneuma.errors import UserError
from pneuma.figures.origin import origin_of
from pneuma.figures.panels import (
    headline_of,
    label_rows,
    notes_of,
    put_texts,
    round_ticks,
    runs_told,
    set_points,
)
from pneuma.figures.style import COLOURS, GREY, INK, house_style, save_figure
from pneuma.values import shown_level, shown_value

ROW_INCHES, AROUND_INCHES = 0.17, 0.75
"""Heights in inches of a row, and of a map's title, ticks and label together."""

LOOKS: dict[str, dict[str, Any]] = {
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
        try:
            found.append(robustness_map(data, *contrast))
        except UserError:
            continue
    return found


def draw_robustness(
    data: StudyData,
    maps: Sequence[Map],
    folder: Path,
    stem: str,
    formats: tuple[str, ...] = ("png", "svg"),
    *,
    command: str = "",
) -> list[Path]:
    columns = min(len(maps), 2)
    rows = -(-len(maps) // columns)
    with house_style():
        figure = Figure(layout="constrained")
        panels = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel()
        for axes, found in zip(panels, maps, strict=False):
            _draw_map(axes, found)
            axes.xaxis.set_major_locator(round_ticks(8 // columns))
        for axes in panels[len(maps) :]:
            axes.remove()
        inches = ROW_INCHES * max(len(found.cells) for found in maps) + AROUND_INCHES
        cells = [label for found in maps for label in found.cells["label"]]
        entries = {
            f"{label} ({cells.count(label)})": Line2D([], [], linestyle="", markersize=4.5, **look)
            for label, look in LOOKS.items()
        }
        headline = headline_of(data, "does the contrast hold elsewhere?")
        put_texts(figure, rows * inches, headline, entries, [*notes_of(data), *_caption(data, maps)])
        return save_figure(figure, folder, stem, formats, origin_of(command, data))


def _draw_map(axes: Axes, found: Map) -> None:
    """Draw one row per cell, named by its levels; the axis names their factors."""
    axes.axvline(0, color=INK, linewidth=0.8)
    rows = found.cells.to_dict("records")
    for place, cell in enumerate(rows):
        look, ends = LOOKS[cell["label"]], [cell["low"], cell["high"]]
        if np.isfinite(ends).all():
            axes.plot(ends, [place, place], color=look["color"], linewidth=1.3)
        axes.plot([cell["value"]], [place], linestyle="", markersize=4.5, **look)
    levels = (", ".join(shown_level(cell[factor]) for factor in found.factors) for cell in rows)
    labels = [named or cell["better"] for named, cell in zip(levels, rows, strict=True)]
    label_rows(axes, labels, ROW_INCHES)
    factors = ", ".join(found.factors)
    axes.text(
        -0.02, 1.03, _read(factors), ha="right", va="bottom", transform=axes.transAxes, fontsize="small"
    )
    label = " less ".join(map(shown_value, found.values))
    if find_outcome(found.outcome).bounds == (0.0, 1.0):
        label += f" ({set_points(axes)})"
    axes.set(title=f"{_read(found.setting)}: {found.label}", xlabel=label)


def contrast_word(found: Map) -> str:
    """Return the contrast of a map as `--contrast` takes it."""
    shown = (
        f"[{shown_value(one)}]" if isinstance(one, list | tuple) else shown_value(one) for one in found.values
    )
    return f"{found.setting}={':'.join(shown)}".replace(", ", ",")


def _read(field: str) -> str:
    return field.replace("_", " ")


def _caption(data: StudyData, maps: Sequence[Map]) -> list[str]:
    outcome = find_outcome(maps[0].outcome)
    turned = " (turned, as less is better)" if outcome.better == "lower" else ""
    runs = runs_told(runs for found in maps for runs in found.runs)
    step = common_step(data)
    return [
        f"Differences of means in {outcome.words}{turned}, {runs} runs an arm, with 95 % intervals.",
        "Filled: other than 0 by relabelings and by Welch's t, at 5 % over each panel (Holm).",
        f"All as they stood at {step:,} steps, {step_words(data)}." if step else "",
    ]
