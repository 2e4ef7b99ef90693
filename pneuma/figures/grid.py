"""The grammar of figures: panels in a grid, between a headline with a legend, and a caption.

    panels (lines with bands, rows of marks, cells of a map) → Page → save_page → files with their origin

Every figure of runs is a `Page`: `curves_page`, `summary_page` and others return one.

A study's words (title, notes, labels) are in `words.py`.
"""

from __future__ import annotations

import itertools
import math
import re
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.text import Text
from matplotlib.ticker import EngFormatter, FuncFormatter, MaxNLocator, NullFormatter, NullLocator

from pneuma.errors import UserError, print_aside
from pneuma.figures import style
from pneuma.figures.origin import origin_text
from pneuma.figures.style import CAPTION, GREY, INK, LINE_INCHES, WIDTH, Look, characters, clean, text_points

FAR = 3.0
"""The random player's level this many times above the highest point is not drawn."""
BELOW_ZERO = 0.02
"""How far an axis of shares extends below 0 and above 1, so that points at the ends are seen."""
CAPTION_LINES = 5
LONGEST_LABEL = 40
"""Most letters in a line of a row's label."""
NARROW = 2.5
"""Inches of a panel in which the labels of three ticks fit, and no more."""
LONG_AXIS = 5000
"""An axis longer than this has numbers with a k."""
RANDOM_PLAYER = "random player"
RANDOM_LOOK: Any = {"color": GREY, "linestyle": (0, (1, 2)), "linewidth": 0.9, "zorder": 1.2}
ROW_INCHES, LEAST_ROW_INCHES, LONGEST_INCHES = 0.28, 0.1, 7.6
"""Heights in inches: of a row, usual and least, and of all rows or panels that fit a page."""
LEAST_PANEL_INCHES, LEAST_GAP = 0.8, 0.08
"""Least width of a panel, and space between words of neighbours."""
LEAST_PANEL_HEIGHT = 1.25
"""In inches, with title and labels; in less, the label of an axis lies on others."""
USUAL_LOOK = Look()


# --- Pages -------------------------------------------------------------------------------------------

Ticks = Callable[[Axis], object]


def numbers(axis: Axis) -> None:
    if np.ptp(axis.get_view_interval()) > LONG_AXIS:
        axis.set_major_formatter(EngFormatter(sep=""))


def few(axis: Axis) -> None:
    axis.set_major_locator(round_ticks(4))


def steps(axis: Axis, most: int = 5) -> None:
    """Format an axis of steps, as 500k."""
    axis.set_major_locator(round_ticks(most))
    axis.set_major_formatter(EngFormatter(sep=""))


def shares(axis: Axis, most: int = 5) -> None:
    """Format an axis of shares in per cent."""
    axis.set_major_locator(round_ticks(most, 2.5))
    axis.set_major_formatter(FuncFormatter(lambda share, _: per_cent(share) if share >= 0 else ""))


def powers(axis: Axis) -> None:
    axis.axes.set_yscale("log", nonpositive="clip")
    low, high = axis.get_view_interval()
    if high < 10 * low:  # within a decade, powers of ten would label one tick or none
        axis.set_major_locator(MaxNLocator(4))
        axis.set_minor_locator(NullLocator())
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def round_ticks(most: int, *more: float) -> MaxNLocator:
    """Return a locator of few ticks at round numbers, whose labels do not overlap."""
    return MaxNLocator(most, steps=sorted([1, 2, 5, 10, *more]))


@dataclass(frozen=True, eq=False)
class Panel:
    """One panel, with the labels of its axes, and what formats them.

    Attributes:
        draw: draws into its axes, and sets their limits.
        rows: labels of rows, the first at the top; None if the upright axis has values.
        at_left: what takes its place at the left of a row, as it says what those beside it need not.
    """

    draw: Callable[[Axes], object]
    title: str = ""
    x: str = ""
    y: str = ""
    x_ticks: Ticks = numbers
    y_ticks: Ticks = numbers
    rows: Sequence[str] | None = None
    at_left: Panel | None = None


@dataclass(frozen=True)
class Page:
    """A figure: all that is in it, and the runs that it shows.

    Attributes:
        basename: of its files, without an ending.
        grid: panels, row by row; one that stands in several neighbouring cells fills them all.
        inches: height of all panels with their axes.
        runs: of its origin, as `lines_of_runs` returns them.
        entries: artists of the legend that are in no panel, by their words.
        caption: notes, the most important first.
        widths: of columns, relative to each other.
        spare: whether panels after the first may be left out where there is too little height.
    """

    basename: str
    grid: Sequence[Sequence[Panel | None]]
    inches: float
    headline: str
    runs: Sequence[str]
    entries: Mapping[str, Any] = field(default_factory=dict)
    caption: Sequence[str] = ()
    widths: Sequence[float] | None = None
    spare: bool = False


class TooLowError(UserError):
    """A height that is too little for the panels of a page."""


def in_grid(panels: Sequence[Panel], columns: int) -> list[list[Panel | None]]:
    padded = [*panels, *[None] * (-len(panels) % columns)]
    return [padded[start : start + columns] for start in range(0, len(padded), columns)]


def save_page(
    page: Page,
    folder: Path,
    formats: Sequence[str] = ("png", "svg"),
    look: Look = USUAL_LOOK,
) -> list[Path]:
    """Draw a figure, and write it in each of some `FIGURE_FORMATS`; return the files.

    Raises:
        UserError: when `look` has no such style sheet, or too little height for panels.
    """
    origin = origin_text(page.headline, page.runs)
    page = _looking(page, look)
    across = len(page.grid[0])
    with style.house_style(sheet=look.sheet):
        while page.widths and across > 1 and not _fits(_figure(_below_each_other(page, across), look)):
            across -= 1
        figure = _figure_of_some(_below_each_other(page, across), look)
        return style.save_figure(figure, folder, page.basename, formats, origin)


def _figure_of_some(page: Page, look: Look) -> Figure:
    """Return the figure of a page, without the panels that may be left out and do not fit its height."""
    panels = [panel for row in page.grid for panel in row if panel]
    for count in range(len(panels), 0, -1):
        rows = in_grid(panels[:count], len(page.grid[0]))
        shown = replace(page, grid=rows, inches=page.inches * len(rows) / len(page.grid))
        try:
            figure = _figure(shown if count < len(panels) else page, look)
        except TooLowError:
            if not page.spare or len(rows) == 1:
                raise
            continue
        if count < len(panels):
            print_aside(f"Note: {count} of {len(panels)} panels fit the height; --quantity names another.")
        return figure
    raise AssertionError("a page has a panel")


def _figure(page: Page, look: Look) -> Figure:
    figure = Figure(layout="constrained")
    panels = dict.fromkeys(panel for row in page.grid for panel in row if panel)
    names = {panel: str(number) for number, panel in enumerate(panels)}
    cells: Any = [[names[panel] if panel else "." for panel in row] for row in page.grid]
    grid = figure.subplot_mosaic(cells, width_ratios=page.widths)
    for panel, name in names.items():
        pitch = (page.inches - 0.5) / max(len(panel.rows or ()), 1)
        fill(grid[name], panel, pitch, look.width / len(cells[0]))
    _put_texts(figure, page, _legend_entries(figure.axes, page.entries), look)
    return figure


def _fits(figure: Figure) -> bool:
    """Return whether panels are wide enough, and their titles and labels apart and within the figure."""
    engine: Any = figure.get_layout_engine()
    engine.execute(figure)
    boxes: list[tuple[Axes, Any]] = []
    for axes in figure.axes:
        texts = [each for each in axes.get_children() if isinstance(each, Text)]
        shown = [each for each in (*texts, axes.xaxis.label) if each.get_text()]
        boxes += [(axes, each.get_window_extent()) for each in shown]
    wide = all(axes.bbox.width >= LEAST_PANEL_INCHES * figure.dpi for axes in figure.axes)
    within = all(box.x1 <= figure.bbox.x1 for _, box in boxes)
    apart = [(axes, box.padded(LEAST_GAP * figure.dpi / 2, 0)) for axes, box in boxes]
    pairs = itertools.combinations(apart, 2)
    return wide and within and not any(a != b and one.overlaps(other) for (a, one), (b, other) in pairs)


def _below_each_other(page: Page, across: int) -> Page:
    """Return a page with so many of its columns beside each other, and the next ones below them."""
    columns = [*zip(*page.grid, strict=True)]
    if across == len(columns):
        return page
    blocks = [columns[start : start + across] for start in range(0, len(columns), across)]
    rows = []
    for block in blocks:
        for first, *others in zip(*block, strict=True):
            left = (first.at_left or first) if first else None
            rows.append([left, *others, *[None] * (across - len(block))])
    return replace(page, grid=rows, inches=page.inches * len(blocks), widths=(page.widths or ())[:across])


def _looking(page: Page, look: Look) -> Page:
    """Return a page with the texts that are asked for, and as many panels in a row as its width takes."""
    headline = look.title if look.title is not None else "" if look.plain else page.headline
    page = replace(page, headline=headline, caption=() if look.plain else page.caption)
    panels = [panel for row in page.grid for panel in row if panel]
    if page.widths or len({*panels}) < len(panels):  # columns have a meaning, or a panel spans some
        return page
    before = len(page.grid[0])
    across = min(before, max(1, round(before * look.width / WIDTH)))
    rows = -(-len(panels) // across)
    return replace(page, grid=in_grid(panels, across), inches=page.inches * rows / len(page.grid))


def fill(axes: Axes, panel: Panel, pitch: float, width: float) -> None:
    """Draw a panel into axes, of a width in inches and a height of rows."""
    panel.draw(axes)
    beside_rows = 0.72 if panel.rows else 1.0
    points = FontProperties(size=mpl.rcParams["axes.titlesize"]).get_size_in_points()
    wide = characters(1.2 * points, beside_rows * width)  # bold letters are wider
    title = "\n".join(line for part in panel.title.split("\n") for line in textwrap.wrap(part, wide))
    axes.set(title=title, xlabel=panel.x, ylabel=panel.y)
    panel.x_ticks(axes.xaxis)
    if width < NARROW and panel.x_ticks is steps:
        steps(axes.xaxis, 3)
    if panel.rows is None:
        panel.y_ticks(axes.yaxis)
    else:
        label_rows(axes, panel.rows, pitch)


def _put_texts(figure: Figure, page: Page, entries: Mapping[str, Any], look: Look) -> None:
    """Put the headline and legend above the panels and the caption below, and set the figure's size."""
    points, edge = text_points(), 0.07 / look.width
    line = points * LINE_INCHES
    heading = textwrap.wrap(page.headline, characters(1.2 * points, look.width))
    wide = characters(points, look.width)
    labels = {"\n".join(textwrap.wrap(label, wide - 8)): artist for label, artist in entries.items()}
    longest = max((len(label) for label in labels), default=0)
    # a handle is as wide as 8 letters
    columns = max(1, min(len(labels), wide // (longest + 8)))
    rows = sum(label.count("\n") + 1 for label in labels) if columns == 1 else -(-len(labels) // columns)
    below_lines = textwrap.wrap(
        " ".join(filter(None, page.caption)),
        characters(CAPTION * points, look.width),
        max_lines=CAPTION_LINES,
        placeholder=" …",
    )
    above = line * (1.2 * len(heading) + rows) + 0.1
    below = CAPTION * line * len(below_lines) + 0.08
    height = look.height or above + page.inches + below
    least = above + below + LEAST_PANEL_HEIGHT * len(page.grid)
    if look.height and height < least:
        fix = "" if look.plain else "; --plain has no headline and caption"
        raise TooLowError(f"--height {height:g}: at least {math.ceil(10 * least) / 10:.1f} inches{fix}")
    figure.set_size_inches(look.width, height)
    engine: Any = figure.get_layout_engine()
    engine.set(rect=(0, below / height, 1, 1 - (above + below) / height))
    figure.text(edge, 1 - 0.05 / height, "\n".join(heading), fontsize=1.2 * points, va="top")
    if labels:
        figure.legend(
            labels.values(), labels.keys(), loc="upper left", ncols=columns, alignment="left",
            bbox_to_anchor=(edge, 1 - (1.2 * line * len(heading) + 0.05) / height),
            labelspacing=0.3, borderpad=0, borderaxespad=0,
        )  # fmt: skip
    figure.text(
        edge, 0.05 / height, "\n".join(below_lines), fontsize=CAPTION * points, color="#444444",
        linespacing=1.35, va="bottom",
    )  # fmt: skip


def _legend_entries(axes: Iterable[Axes], more: Mapping[str, Any]) -> dict[str, Any]:
    """Return one artist for each label in some panels, then some more, and the random player's level last."""
    entries = {
        label: artist
        for each in axes
        for artist, label in zip(*each.get_legend_handles_labels(), strict=True)
    }
    entries |= more
    found = [label for label in entries if label.startswith(RANDOM_PLAYER)]
    if artists := [entries.pop(label) for label in found]:  # without its level if panels have several
        entries[found[0] if len(found) == 1 else RANDOM_PLAYER] = artists[0]
    return entries


# --- What is in panels -------------------------------------------------------------------------------


def draw_random_player(
    axes: Axes,
    levels: Mapping[str, float],
    top: float,
    colours: Mapping[str, str],
    rows: Sequence[str] | None = None,
    words: Callable[[float], str] | None = None,
) -> None:
    """Draw the levels of the random player as a grey line, or one for each condition if they differ.

    `words` writes a level, by default a share. With `rows`, the conditions from the top, levels lie across,
    and a condition's line is in its row. A level far above `top`, the highest point that is drawn, gets no
    line: it would flatten everything else.
    """
    look = RANDOM_LOOK
    draw = axes.axhline if rows is None else axes.axvline
    near = {name: at for name, at in levels.items() if name in colours and at <= FAR * max(top, 0.01)}
    if len({*levels.values()}) == 1:
        level = next(iter(levels.values()))
        label = f"{RANDOM_PLAYER} ({(words or per_cent)(level)})"
        axes.plot([], [], label=label if near else f"{label}: above", **look)
        if near:
            draw(level, **look)
        return
    for name, level in near.items():
        axes.plot([], [], label=RANDOM_PLAYER, **look)
        if rows is None:
            draw(level, **{**look, "color": colours[name]})
        else:
            axes.plot([level] * 2, rows.index(name) + np.array([-0.4, 0.4]), **look)


def draw_band(axes: Axes, frame: pd.DataFrame, within: tuple[float, float] | None, **look: Any) -> None:
    """Draw the band of a frame of x, low and high, within limits, if it has one."""
    if frame["low"].notna().any():
        low, high = (frame[end].clip(*within or (None, None)) for end in ("low", "high"))
        axes.fill_between(frame["x"], low, high, linewidth=0, **look)


def draw_interval(axes: Axes, place: float, row: Mapping[Any, Any], **look: Any) -> None:
    """Draw a row's `value` as a marker, and the interval from `low` to `high` if it has one."""
    look = {"marker": "D", "color": INK, "markeredgewidth": 0.8, "markersize": 4, **look}
    axes.plot(
        [row["low"], row["high"]], [place, place], color=look["color"], linewidth=0.25 * look["markersize"]
    )
    (drawn,) = axes.plot([row["value"]], [place], linestyle="", clip_on=False, zorder=2.7, **look)
    drawn.set_in_layout(False)  # it may be of no value


def label_rows(axes: Axes, labels: Sequence[str], inches: float) -> None:
    """Label rows, the first at the top, in type that fits their height in inches; long labels are wrapped."""
    no_break = partial(re.sub, r"\([^()]*\)$", lambda counted: counted[0].replace(" ", "\u00a0"))
    whole = [no_break(clean(label)) for label in labels]
    parts = [[textwrap.fill(line, LONGEST_LABEL) for line in label.split("\n")] for label in whole]
    wrapped = ["\n".join(lines).replace("\u00a0", " ") for lines in parts]
    lines = max((label.count("\n") + 1 for label in wrapped), default=1)
    points = min(float(mpl.rcParams["ytick.labelsize"]), 0.85 * 72 * inches / lines)
    axes.set_yticks(range(len(labels)), wrapped, fontsize=points)
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="y", visible=False)


def number(value: float) -> str:
    """Return a number with the minus of axes."""
    return f"{value:.3g}".replace("-", "−")


def per_cent(share: float) -> str:
    """Return a share in per cent without superfluous decimals."""
    return f"{100 * share:.3g} %"
