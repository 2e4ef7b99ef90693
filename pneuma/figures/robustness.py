"""The figure of robustness maps: a row for each cell, a column for each contrast, a mark where they meet."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

from pneuma.analysis.crossed import (
    CONDITIONAL,
    HOLDS,
    OPEN,
    PARTIAL,
    REVERSED,
    ROBUST,
    UNDECIDED,
    Cell,
    Levels,
    Map,
    robustness_map,
)
from pneuma.analysis.outcomes import find_outcome
from pneuma.analysis.tables import StudyData
from pneuma.errors import UserError
from pneuma.figures.captions import headline_of, step_told
from pneuma.figures.panel import whole_ticks
from pneuma.figures.sizes import SIZES
from pneuma.figures.style import COLOURS, house_style, save_figure
from pneuma.figures.words import Entry, Words, counts_told
from pneuma.values import shown_level, shown_value

SIZE = SIZES["page"]
ROW_INCHES, AROUND_INCHES = 0.19, 0.85
"""Heights of a row, and of a column's title, ticks and label together."""

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
    data: StudyData, maps: Sequence[Map], folder: Path, stem: str, formats: tuple[str, ...] = ("png", "svg")
) -> list[Path]:
    """Draw maps side by side, one or more, of one outcome; return the files written.

    Args:
        data: the study.
        maps: of it; cells that one has and another has not are rows all the same.
        folder: where to write.
        stem: the files' name without its end.
        formats: of `FIGURE_FORMATS`.
    """
    groups = _groups(maps)
    places = _places(groups)
    with house_style(SIZE.type_points):
        figure = Figure(layout="constrained")
        columns = figure.subplots(1, len(maps), sharex=True, sharey=True, squeeze=False)[0]
        for axes, found in zip(columns, maps, strict=True):
            _draw_map(axes, found, places)
            axes.xaxis.set_major_locator(whole_ticks(3 if len(maps) > 1 else 8))
        _label_rows(columns[0], groups, places)
        lines = max(places.values(), default=0) + 1
        words = Words(headline_of(data, _factors_told(maps)), "", _caption(data, maps))
        words.put(figure, SIZE, ROW_INCHES * lines + AROUND_INCHES, _entries(maps))
        return save_figure(figure, folder, stem, formats, SIZE.dots_per_inch)


# --- Rows ------------------------------------------------------------------------------------------

Groups = Mapping[Levels, Sequence[Levels]]
"""The cells of all maps, by their levels of the first factors: all but the last two."""
IN_A_ROW = 2
"""Factors that a row is labelled by; those before them head a group of rows."""


def _groups(maps: Sequence[Map]) -> dict[Levels, list[Levels]]:
    """Return every cell of any map once, ordered by the levels of the first factor, then the next."""
    order = {level: place for found in maps for level, place in _ordered(found)}
    cells = {cell.levels for found in maps for cell in found.cells}
    groups: dict[Levels, list[Levels]] = {}
    for cell in sorted(cells, key=lambda levels: [order[level] for level in levels]):
        groups.setdefault(cell[:-IN_A_ROW], []).append(cell)
    return groups


def _ordered(found: Map) -> Iterator[tuple[tuple[str, Any], int]]:
    for factor, levels in found.factors.items():
        for place, level in enumerate(levels):
            yield (factor, level), place


def _places(groups: Groups) -> dict[Levels, int]:
    """Return the line of each cell, counted from above; a group that has a heading has a line for it."""
    places, line = {}, 0
    for group, cells in groups.items():
        line += bool(group)
        for cell in cells:
            places[cell] = line
            line += 1
    return places


def _label_rows(axes: Axes, groups: Groups, places: Mapping[Levels, int]) -> None:
    ticks = {place: _level_words(cell[-IN_A_ROW:]) for cell, place in places.items()}
    headings = {places[cells[0]] - 1: _told(group) for group, cells in groups.items() if group}
    marked = sorted({**ticks, **headings}.items())
    axes.set_yticks([place for place, _ in marked], [label for _, label in marked])
    axes.set_ylim(max(places.values(), default=0) + 0.6, -0.6)
    for label, (place, _) in zip(axes.get_yticklabels(), marked, strict=True):
        label.set_fontweight("bold" if place in headings else "normal")


def _level_words(levels: Levels) -> str:
    return ", ".join(shown_level(level) for _, level in levels)


def _told(levels: Levels) -> str:
    return ", ".join(f"{_reads(key)} {shown_level(level)}" for key, level in levels)


# --- Columns ---------------------------------------------------------------------------------------


def _draw_map(axes: Axes, found: Map, places: Mapping[Levels, int]) -> None:
    axes.axvline(0, color="#333333", linewidth=0.8)
    for cell in found.cells:
        _draw_cell(axes, cell, places[cell.levels])
    better, worse = map(shown_value, found.values)
    axes.set_title(f"{_reads(found.setting)}:\n{found.label}", fontsize=SIZE.type_points)
    axes.set_xlabel(f"{better}\nless {worse}")
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    if find_outcome(found.outcome).bounds == (0.0, 1.0):
        axes.xaxis.set_major_formatter(FuncFormatter(_points))


def _draw_cell(axes: Axes, cell: Cell, place: int) -> None:
    look, interval = LOOKS[cell.label], cell.contrast.interval
    if np.isfinite([interval.low, interval.high]).all():
        axes.plot([interval.low, interval.high], [place, place], color=look["color"], linewidth=1.3)
    axes.plot([cell.contrast.effect], [place], linestyle="", markersize=4.5, **look)


def _points(share: float, _: Any) -> str:
    """Return a difference of shares in percentage points, with its sign."""
    return f"{100 * share:+.3g}".replace("-", "−") if share else "0"


# --- Words -----------------------------------------------------------------------------------------


MEANINGS = {
    ROBUST: "all cells hold",
    PARTIAL: "some hold, the others are open",
    CONDITIONAL: "some hold, some are reversed",
    REVERSED: "some are reversed, none holds",
    UNDECIDED: "all are open",
}
"""Of a column's label."""


def _reads(setting: str) -> str:
    """Return a setting's name as it is read."""
    return setting.replace("_", " ")


def _factors_told(maps: Sequence[Map]) -> str:
    *first, last = [*map(_reads, maps[0].factors)] or ["nothing else"]
    return "over " + " and ".join(filter(None, [", ".join(first), last]))


def _entries(maps: Sequence[Map]) -> dict[str, Entry]:
    counts = {label: sum(cell.label == label for found in maps for cell in found.cells) for label in LOOKS}
    return {
        f"{label} ({counts[label]})": Line2D([], [], linestyle="", markersize=4.5, **look)
        for label, look in LOOKS.items()
    }


def _caption(data: StudyData, maps: Sequence[Map]) -> list[str]:
    outcome = find_outcome(maps[0].outcome)
    unit = ", in percentage points" if outcome.bounds == (0.0, 1.0) else ""
    turned = ", turned, as less is better" if outcome.better == "lower" else ""
    runs = counts_told(runs for found in maps for cell in found.cells for runs in cell.contrast.seeds)
    rows = [*map(_reads, maps[0].factors)][-IN_A_ROW:]
    labels = {found.label for found in maps}
    meanings = "; ".join(f"{label}: {words}" for label, words in MEANINGS.items() if label in labels)
    return [
        f"{', '.join(data.environments)}. Differences of means in {outcome.words}{unit}{turned}, {runs} runs "
        "an arm; lines: 95 % intervals, each for itself.",
        *step_told(data),
        f"Rows: {', '.join(rows)}." if rows else "",
        "Filled: other than 0 by relabelings and by Welch's t, at 5 % over each column (Holm).",
        f"{meanings[:1].upper()}{meanings[1:]}.",
    ]
