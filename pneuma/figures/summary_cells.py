"""What the runs of many crossed conditions came to: a panel for each cell, a row for each condition in it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from pneuma.figures.crossed import factors_of, read_name
from pneuma.figures.sizes import Size
from pneuma.figures.summary_rows import ROW_LINES, Rows, dense, label_rows, row_entries
from pneuma.figures.words import Words, counts_told

ROW_INCHES, TITLE_INCHES, AXIS_INCHES = 0.16, 0.26, 0.45
"""Heights of a condition's row, a panel's title, and the ticks and label below all."""
MOST_COLUMNS, MOST_NARROW = 4, 2
"""Panels side by side at most, and at most in one column of a page."""

Cell = tuple[tuple[str, str], ...]


def draw_cells(shown: Rows, size: Size, words: Words) -> Figure:
    """Draw every cell's rows in a panel of its own, all to one scale.

    The first factor's levels are columns where they are few enough.

    Args:
        shown: rows of conditions whose names have factors.
        size: of the figure.
        words: around the panels; what heads these, and how many runs there are, is added.
    """
    cells: dict[Cell, list[str]] = {}
    for name in shown.values:
        cells.setdefault(read_name(name).levels, []).append(name)
    places = _grid(list(cells), MOST_NARROW if size.columns == 1 else MOST_COLUMNS)
    rows, columns = (1 + max(place[i] for place in places.values()) for i in (0, 1))
    kinds = list(dict.fromkeys(read_name(name).own for name in shown.values))
    height = TITLE_INCHES + ROW_INCHES * len(kinds)
    figure = Figure(layout="constrained")
    panels = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    some = panels[next(iter(places.values()))]
    with dense(ROW_INCHES / (ROW_LINES * size.line_inches)):
        for cell, own in cells.items():
            axes = panels[places[cell]]
            shown.draw(axes, {name: kinds.index(read_name(name).own) for name in own})
            axes.set_title(", ".join(level for _, level in cell), fontsize=size.small_points, weight="normal")
            axes.tick_params(labelsize=size.small_points, length=0)
            axes.grid(axis="y", visible=False)
        label_rows(some, kinds)
    for place in {*np.ndindex(panels.shape)} - {*places.values()}:
        panels[place].set_axis_off()
    for axes in panels[-1]:
        axes.set_xlabel(shown.label, fontsize=size.small_points)
    shown.set_axis(some)
    told = Words(words.headline, words.legend_title, [*words.caption, _told(shown)])
    low, high = told.put(figure, size, rows * height + AXIS_INCHES, row_entries(some))
    size.check_room(rows * len(kinds) // 3, high - low)
    return figure


def _grid(cells: Sequence[Cell], most: int) -> dict[Cell, tuple[int, int]]:
    """Return the row and column of each cell: a column for each level of the first factor, where these fit.

    One that is missing leaves its place free. Where they do not fit, cells follow each other.
    """
    first = list(dict.fromkeys(cell[:1] for cell in cells))
    others = list(dict.fromkeys(cell[1:] for cell in cells))
    if 1 < len(first) <= most:
        return {cell: (others.index(cell[1:]), first.index(cell[:1])) for cell in cells}
    return {cell: divmod(place, most) for place, cell in enumerate(cells)}


def _told(shown: Rows) -> str:
    """Say what heads the panels, and how many runs a row has."""
    runs = counts_told(len(runs) for runs in shown.values.values())
    return f"Panels: {', '.join(factors_of(list(shown.values)))}. Runs of a row: {runs}."
