"""The figure of a robustness map: a small panel for each combination of levels, a mark for each cell."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pneuma.analysis.outcomes import find_outcome
from pneuma.analysis.robustness import HOLDS, OPEN, REVERSED, Cell, Map, robustness_map
from pneuma.analysis.tables import StudyData
from pneuma.errors import UserError
from pneuma.figures.style import COLOURS, house_style, save_figure
from pneuma.values import shown_setting

WIDTH_INCHES, ROW_INCHES, WORDS_INCHES = 7.0, 0.24, 1.15
PANEL_INCHES = 0.55
"""Height of a panel's own title and axis."""

LOOKS: dict[str, dict[str, Any]] = {
    HOLDS: {"marker": "o", "color": COLOURS[0], "markerfacecolor": COLOURS[0]},
    REVERSED: {"marker": "s", "color": COLOURS[1], "markerfacecolor": COLOURS[1]},
    OPEN: {"marker": "o", "color": "#777777", "markerfacecolor": "white"},
}
"""Filled where decided, square where reversed: told apart in grey too."""


MAPS: dict[str, tuple[tuple[str, Any, Any], ...]] = {
    "robustness": (
        ("betas", [0.9, 0.9], [0.9, 0.999]),
        ("activation", "tanh", "relu"),
        ("actor", [128], [256]),
        ("clip_range", 0.1, 0.2),
    )
}
"""Contrasts of the thesis that a study maps: a setting, the value said to do better, and the other."""


def study_maps(data: StudyData) -> list[Map]:
    """Return every map that a study is for; one whose conditions were not run is left out."""
    found = []
    for contrast in MAPS.get(data.own_name, ()):
        try:
            found.append(robustness_map(data, *contrast))
        except UserError:
            continue
    return found


def draw_robustness(
    found: Map, folder: Path, stem: str, formats: tuple[str, ...] = ("png", "svg")
) -> list[Path]:
    """Draw a map; return the files written.

    The first factor's levels are the rows of a panel; the second's are columns of panels, and those of
    all others are rows of panels.
    """
    names = list(found.factors)
    rows = found.factors[names[0]] if names else (None,)
    columns = found.factors[names[1]] if len(names) > 1 else (None,)
    lower = list(product(*(found.factors[name] for name in names[2:])))
    with house_style():
        height = WORDS_INCHES + len(lower) * (PANEL_INCHES + ROW_INCHES * len(rows))
        figure = Figure(figsize=(WIDTH_INCHES, height), layout="constrained")
        panels = figure.subplots(len(lower), len(columns), sharex=True, sharey=True, squeeze=False)
        for (i, below), (j, column) in product(enumerate(lower), enumerate(columns)):
            levels = dict(zip(names[1:], (column, *below), strict=False))
            own = [cell for cell in found.cells if levels.items() <= dict(cell.levels).items()]
            _draw_panel(panels[i, j], own, names[0] if names else "", rows, levels)
        _add_words(figure, found, panels[-1])
        return save_figure(figure, folder, stem, formats)


def _draw_panel(
    axes: Axes, cells: Sequence[Cell], factor: str, rows: Sequence[Any], levels: dict[str, Any]
) -> None:
    axes.axvline(0, color="#333333", linewidth=0.8)
    for cell in cells:
        place = rows.index(dict(cell.levels).get(factor))
        look, effect = LOOKS[cell.label], cell.contrast
        ends = [effect.interval.low, effect.interval.high]
        if np.isfinite(ends).all():
            axes.plot(ends, [place, place], color=look["color"], linewidth=1.4)
        axes.plot([effect.effect], [place], linestyle="", markersize=5, **look)
    axes.set_title(", ".join(f"{key} {shown_setting(value)}" for key, value in levels.items()), fontsize=7.5)
    axes.set_yticks(range(len(rows)), [shown_setting(row) for row in rows])
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
    if axes.get_subplotspec().is_first_col():  # type: ignore[union-attr]
        axes.set_ylabel(factor, fontsize=7.5)


def _add_words(figure: Figure, found: Map, bottom: Sequence[Axes]) -> None:
    """Put the headline and the legend above the panels, and the caption below."""
    height = figure.get_size_inches()[1]
    edges = (0, 0.46 / height, 1, 1 - 1.04 / height)
    figure.get_layout_engine().set(rect=edges)  # type: ignore[union-attr, call-arg]
    better, worse = map(shown_setting, found.values)
    headline = f"{found.title}: {found.setting} {better} against {worse}"
    figure.text(0.01, 1 - 0.2 / height, f"{headline}: {found.label}", fontsize=10)
    counts = {label: sum(cell.label == label for cell in found.cells) for label in LOOKS}
    marks = [
        figure.axes[0].plot([], [], linestyle="", markersize=5, label=f"{label} ({counts[label]})", **look)[0]
        for label, look in LOOKS.items()
    ]
    figure.legend(handles=marks, loc="upper left", bbox_to_anchor=(0, 1 - 0.2 / height), ncols=len(marks))
    for axes in bottom:
        axes.set_xlabel(f"{better} less {worse}", fontsize=7.5)
    figure.text(0.01, 0.07 / height, _caption(found), fontsize=6.2, color="#444444", linespacing=1.4)


def _caption(found: Map) -> str:
    seeds = sorted({runs for cell in found.cells for runs in cell.contrast.seeds})
    runs = str(seeds[0]) if len(seeds) == 1 else f"{seeds[0]} to {seeds[-1]}"
    turned = " (turned, less is better)" if find_outcome(found.outcome).better == "lower" else ""
    return (
        f"Marks: difference of means of {found.outcome}{turned}, {runs} runs an arm; lines: 95 % intervals, "
        "each for itself.\nFilled marks differ from 0 by Welch's t, at 5 % over all cells (Holm)."
    )
