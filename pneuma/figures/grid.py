"""The grammar of figures: panels in a grid, between a headline with a legend, and a caption.

    panels (lines with bands, rows of marks) → Page → save_page → files with their origin

Every figure of runs is a `Page`: `curves_page`, `summary_page` and others return one. How axes are formatted,
where labels stand and what has which size is decided here. A study's words are in `words.py`.
"""

from __future__ import annotations

import math
import textwrap
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.legend import Legend
from matplotlib.ticker import EngFormatter, FuncFormatter, MaxNLocator, NullFormatter, NullLocator

from pneuma.analysis.answer import Answer
from pneuma.errors import Hint, UserError, counted
from pneuma.figures import style
from pneuma.figures.origin import origin_text
from pneuma.figures.style import CAPTION, GREY, INK, LINE_INCHES, WIDTH, Look, characters, clean, text_points
from pneuma.store.quantities import POWERS, SHARES, VALUES
from pneuma.values import per_cent

FAR = 2.0
"""The random player's level is not drawn where it is this many times what is drawn away from that."""
BELOW_ZERO = 0.02
"""How far an axis of shares extends below 0 and above 1, so that points at the ends are seen."""
CAPTION_LINES = 5
LETTERS_OF_HANDLE = 8
"""How wide a sign in a legend is, with the space around it, in letters."""
LONGEST_LABEL = 40
"""Most letters in a line of a row's label."""
AXIS_INCHES = 0.4
"""Width of the labels of an upright axis with values."""
EDGE_INCHES, PAD_INCHES = 0.07, 3 / 72
"""The distance of all texts from the left edge, and matplotlib's padding around panels."""
NARROW = 2.0
"""Inches of a panel in which the labels of three ticks fit, and no more."""
LONG_AXIS = 5000
"""An axis longer than this has numbers with a k."""
SINGLE_BAND = 6.0
"""Width in points of a band at a single point."""
RANDOM_PLAYER = "random player"
RANDOM_LOOK: Any = {"color": GREY, "linestyle": (0, (1, 2)), "linewidth": 0.9, "zorder": 1.2}
ROW_INCHES, LEAST_ROW_INCHES, LONGEST_INCHES = 0.28, 0.1, 7.6
"""Heights in inches: of a row, default and least, and of all rows that fit a page."""
LEAST_PANEL_HEIGHT = 1.25
"""In inches, with title and labels; in a lower panel labels of axes overlap."""
DEFAULT_LOOK = Look()


# --- Pages -------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Panel:
    """One panel, with its labels and what its axes have.

    Attributes:
        draw: draws into its axes, and sets their limits.
        x_kind, y_kind: `VALUES`, `SHARES` or `POWERS`.
        rows: labels of rows, the first at the top; None if the upright axis has values.
        columns: labels of columns; None if the other axis has values.
    """

    draw: Callable[[Axes], object]
    title: str = ""
    x: str = ""
    y: str = ""
    x_kind: str = VALUES
    y_kind: str = VALUES
    rows: Sequence[str] | None = None
    columns: Sequence[str] | None = None


@dataclass(frozen=True)
class Page:
    """A figure: all that is in it, and the runs that it shows.

    Attributes:
        basename: of its files, without an ending.
        grid: panels, row by row. A title, label or row that its neighbour has too is written once.
        inches: height of a row of panels with their axes.
        runs: lines of its origin, from `lines_of_runs`.
        entries: artists of the legend that are not in panels, by their labels.
        caption: notes, the most important first.
        across: most panels side by side on a page of the default width. Columns that do not fit go below
            the others.
        answer: what it shows, if that is an answer.
    """

    basename: str
    grid: Sequence[Sequence[Panel | None]]
    inches: float
    headline: str
    runs: Sequence[str]
    entries: Mapping[str, Any] = field(default_factory=dict)
    caption: Sequence[str] = ()
    across: int = 4
    answer: Answer | None = None


def save_page(
    page: Page,
    folder: Path,
    formats: Sequence[str] = ("png", "svg"),
    look: Look = DEFAULT_LOOK,
) -> list[Path]:
    """Draw a figure, and write it in each of some `FIGURE_FORMATS`; return the files.

    Raises:
        UserError: when `look` has no such style sheet, or too little height for panels.
    """
    origin = origin_text(page.headline, page.runs)
    with style.house_style(sheet=look.sheet):
        figure = _draw(page, look)
        return style.save_figure(figure, folder, page.basename, formats, origin)


def _draw(page: Page, look: Look) -> Figure:
    figure = Figure(layout="constrained")
    panels = _arrange(page, look.width)
    across = len(panels[0])
    axes_grid: Any = figure.subplots(len(panels), across, squeeze=False)
    width = look.width / across - AXIS_INCHES
    if panels[0][0] and panels[0][0].rows:
        longest = min(max(map(len, panels[0][0].rows)), LONGEST_LABEL)
        width = (look.width - longest * text_points() / 160) / across
    x_labels = {panel.x for row in panels for panel in row if panel}
    shared_label = x_labels.pop() if across > 1 and len(x_labels) == 1 else ""

    def at(row: int, column: int) -> Panel | None:
        if min(row, column) < 0 or row >= len(panels):
            return None
        return panels[row][column]

    for row, column in np.ndindex(axes_grid.shape):
        panel, axes = panels[row][column], axes_grid[row, column]
        if panel is None:
            axes.remove()
            continue
        left_panel, above, below = at(row, column - 1), at(row - 1, column), at(row + 1, column)
        if left_panel and left_panel.y == panel.y:
            panel = replace(panel, y="")
        if left_panel and panel.rows and left_panel.rows == panel.rows:
            panel = replace(panel, rows=[""] * len(panel.rows))
        if above and above.title == panel.title:
            panel = replace(panel, title="")
        if shared_label or (below and below.x == panel.x):
            panel = replace(panel, x="")
        fill(axes, panel, width, (page.inches - 0.5) / max(len(panel.rows or ()), 1))
    return _put_texts(figure, page, look, shared_label)


def _arrange(page: Page, width: float) -> list[list[Panel | None]]:
    """Return the panels with as many columns as fit a width, and the next ones below them."""
    columns = [list(column) for column in zip(*page.grid, strict=True)]
    block_count = math.ceil(len(columns) / max(1, int(page.across * width / WIDTH)))
    across = math.ceil(len(columns) / block_count)
    rows: list[list[Panel | None]] = []
    for first_column in range(0, len(columns), across):
        block = columns[first_column : first_column + across]
        for row in range(len(page.grid)):
            panels = [column[row] for column in block]
            rows.append(panels + [None] * (across - len(panels)))
    return rows


def fill(axes: Axes, panel: Panel, width: float, row_inches: float = ROW_INCHES) -> None:
    """Draw a panel into axes, of a width in inches and a height of rows."""
    panel.draw(axes)
    if panel.columns is None:
        _format_axis(axes.xaxis, panel.x_kind, 3 if width < NARROW else 5)
    else:
        letters = characters(text_points(), width / len(panel.columns))
        axes.set_xticks(
            range(len(panel.columns)), [textwrap.fill(clean(label), letters) for label in panel.columns]
        )
        axes.tick_params(axis="x", length=0)
        axes.grid(visible=False)
    if panel.rows is None:
        _format_axis(axes.yaxis, panel.y_kind, 6)
    else:
        label_rows(axes, panel.rows, row_inches)
    title_points = FontProperties(size=mpl.rcParams["axes.titlesize"]).get_size_in_points()
    title = textwrap.fill(panel.title, characters(1.2 * title_points, width))  # bold letters are wider
    axes.set_title(title)
    axes.xaxis.set_label_text(panel.x)
    axes.yaxis.set_label_text(panel.y)


def _format_axis(axis: Axis, axis_kind: str, most_ticks: int) -> None:
    """Set the scale of an axis, and at most so many ticks at round numbers."""
    if axis_kind == POWERS:
        set_scale = axis.axes.set_xscale if axis is axis.axes.xaxis else axis.axes.set_yscale
        set_scale("log", nonpositive="clip")
        low, high = axis.get_view_interval()
        if high < 10 * low:  # within a decade, powers of ten would label one tick or none
            axis.set_major_locator(MaxNLocator(4))
            axis.set_minor_locator(NullLocator())
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.set_minor_formatter(NullFormatter())
    elif axis_kind == SHARES:
        axis.set_major_locator(MaxNLocator(most_ticks, steps=[1, 2, 2.5, 5, 10]))
        axis.set_major_formatter(FuncFormatter(lambda share, _: per_cent(share) if share >= 0 else ""))
    else:
        axis.set_major_locator(MaxNLocator(most_ticks, steps=[1, 2, 5, 10]))
        if np.ptp(axis.get_view_interval()) > LONG_AXIS:
            axis.set_major_formatter(EngFormatter(sep=""))


def _put_texts(figure: Figure, page: Page, look: Look, x_label: str) -> Figure:
    """Put headline and legend above the panels and the caption below, and set the figure's size.

    Args:
        figure: with panels.
        page: has the texts.
        look: may replace or leave out some.
        x_label: of all panels together, if they have the same.

    Raises:
        UserError: for too little height.
    """
    headline, caption = page.headline, " ".join(filter(None, page.caption))
    if look.plain:
        headline = caption = ""
    if look.title is not None:
        headline = look.title
    type_points, left_edge = text_points(), EDGE_INCHES / look.width
    line_inches = type_points * LINE_INCHES
    line_letters = characters(type_points, look.width)
    heading = textwrap.wrap(headline, characters(1.2 * type_points, look.width))
    artists: dict[str, Any] = {}
    for label, artist in _legend_entries(figure, page.entries).items():
        artists[textwrap.fill(label, line_letters - LETTERS_OF_HANDLE)] = artist
    legend, legend_inches = None, 0.0
    if artists:
        legend = _add_legend(figure, artists, look.width - 2 * EDGE_INCHES)
        legend_inches = legend.get_window_extent().height / figure.dpi
    caption_lines = textwrap.wrap(
        caption, characters(CAPTION * type_points, look.width), max_lines=CAPTION_LINES, placeholder=" …"
    )
    inches_above = line_inches * 1.2 * len(heading) + legend_inches + 0.15
    inches_below = line_inches * (CAPTION * len(caption_lines) + bool(x_label)) + 0.08
    rows_of_panels = figure.axes[0].get_gridspec().nrows  # type: ignore[union-attr]
    height = look.height or inches_above + page.inches * rows_of_panels + inches_below
    least_height = inches_above + inches_below + LEAST_PANEL_HEIGHT * rows_of_panels
    if height < least_height:
        advice = [] if look.plain else ["; ", Hint("plain"), " leaves out headline and caption"]
        panel_text = counted(len(figure.axes), "panel")
        least_amount = f": at least {math.ceil(10 * least_height) / 10:.1f} inches for {panel_text}"
        raise UserError(Hint("height", f"{height:g}"), least_amount, *advice)
    figure.set_size_inches(look.width, height)
    engine: Any = figure.get_layout_engine()
    panels_left = (EDGE_INCHES - PAD_INCHES) / look.width
    panels_height = 1 - (inches_above + inches_below) / height
    engine.set(rect=(panels_left, inches_below / height, 1 - panels_left, panels_height))
    figure.text(
        0.5,
        (inches_below - line_inches) / height,
        x_label,
        va="bottom",
        ha="center",
        gid=style.X_LABEL,
        fontsize=mpl.rcParams["axes.labelsize"],
    )
    figure.text(left_edge, 1 - 0.05 / height, "\n".join(heading), fontsize=1.2 * type_points, va="top")
    if legend:
        legend.set_bbox_to_anchor((left_edge, 1 - (1.2 * line_inches * len(heading) + 0.05) / height))
    figure.text(
        left_edge, 0.05 / height, "\n".join(caption_lines), fontsize=CAPTION * type_points, color="#444444",
        linespacing=1.35, va="bottom",
    )  # fmt: skip
    return figure


def _add_legend(figure: Figure, artists: Mapping[str, Any], width: float) -> Legend:
    """Add a legend in as many columns as fit a width in inches; if only one does, in small print."""
    small_print = {"fontsize": CAPTION * text_points(), "handlelength": 1.5, "columnspacing": 1.0}
    looks: list[tuple[int, dict[str, Any]]] = []
    for columns in range(len(artists), min(len(artists), 2) - 1, -1):
        looks.append((columns, {}))
    for columns in range(len(artists), 0, -1):
        looks.append((columns, small_print))
    while True:
        columns, look = looks.pop(0)
        legend = figure.legend(
            artists.values(), artists.keys(), loc="upper left", ncols=columns, alignment="left",
            labelspacing=0.3, borderpad=0, borderaxespad=0, **look,
        )  # fmt: skip
        if not looks or legend.get_window_extent().width <= width * figure.dpi:
            return legend
        legend.remove()


def _legend_entries(figure: Figure, page_entries: Mapping[str, Any]) -> dict[str, Any]:
    """Return one artist for each label in panels, then the page's own, and the random player's level last."""
    entries: dict[str, Any] = {}
    for axes in figure.axes:
        for artist, label in zip(*axes.get_legend_handles_labels(), strict=True):
            entries[label] = artist
    entries.update(page_entries)
    level_labels = [label for label in entries if label.startswith(RANDOM_PLAYER)]
    for label in level_labels:
        artist = entries.pop(label)
        if len(level_labels) > 1:  # panels have several levels
            label = RANDOM_PLAYER
        entries[label] = artist
    return entries


# --- What is in panels -------------------------------------------------------------------------------


def draw_random_player(
    draw_line: Callable[..., object], levels: Collection[float], reach: tuple[float, float], unit: str
) -> None:
    """Draw the random player's levels as grey lines.

    Args:
        draw_line: `axhline` or `axvline` of the panel.
        levels: of its conditions.
        reach: the least and greatest value that is drawn. A level far from these gets no line, because it
            would flatten everything else.
        unit: `SHARES` or `VALUES`.
    """
    low, high = reach
    for level in {*levels}:
        label = RANDOM_PLAYER
        if len({*levels}) == 1:
            level_text = per_cent(level) if unit == SHARES else number(level)
            label += f" ({level_text})"
        if max(level - high, low - level) <= FAR * (high - low) or low == high:
            draw_line(level, label=label, **RANDOM_LOOK)


def draw_band(axes: Axes, frame: pd.DataFrame, bounds: tuple[float, float], **look: Any) -> None:
    """Draw the band of a frame of x, low and high within bounds, if it has one; at a single point a bar."""
    low, high = frame["low"].clip(*bounds), frame["high"].clip(*bounds)
    if low.notna().sum() == 1:
        colour, opacity = look["color"], look["alpha"]
        axes.vlines(frame["x"], low, high, colour, linewidth=SINGLE_BAND, alpha=opacity, clip_on=False)
    elif low.notna().any():
        axes.fill_between(frame["x"], low, high, linewidth=0, **look)


def draw_interval(
    axes: Axes, position: float, row: Mapping[Any, Any], marker: str, colour: str, size: float
) -> None:
    """Draw a row's `value` as a marker, and the interval from `low` to `high` if it has one."""
    value, low, high = row["value"], row["low"], row["high"]
    axes.errorbar(
        value, position, xerr=[[value - low], [high - value]], marker=marker, markerfacecolor=colour,
        markersize=size, color=INK, markeredgewidth=0.8, linewidth=0.25 * size, zorder=2.7, clip_on=False,
    )  # fmt: skip


def label_rows(axes: Axes, labels: Sequence[str], inches: float) -> None:
    """Label rows, the first at the top, in type that fits their height in inches; long labels are wrapped."""
    wrapped: list[str] = []
    for label in labels:
        wrapped.append(textwrap.fill(clean(label), LONGEST_LABEL))
    most_lines = max((label.count("\n") + 1 for label in wrapped), default=1)
    type_points = FontProperties(size=mpl.rcParams["ytick.labelsize"]).get_size_in_points()
    axes.set_yticks(range(len(labels)), wrapped, fontsize=min(type_points, 0.85 * 72 * inches / most_lines))
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="y", visible=False)


def number(value: float) -> str:
    """Return a number with the minus of axes."""
    return f"{value:.3g}".replace("-", "−")
