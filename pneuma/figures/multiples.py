"""Small multiples: a panel for each condition, where these are too many for one.

They are placed by hand: a layout engine would take longer over fifty of them than all else does.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator

from pneuma.analysis.curves import Curve
from pneuma.analysis.references import reference_levels, shared_levels
from pneuma.analysis.run_view import common_step
from pneuma.analysis.tables import StudyData
from pneuma.figures.crossed import factors_of, parts_of, read_name
from pneuma.figures.looks import condition_looks
from pneuma.figures.panel import (
    as_drawn,
    draw_common_step,
    draw_curve,
    draw_references,
    highest_point,
    label_of,
    set_axes,
    shorten_thousands,
    whole_ticks,
)
from pneuma.figures.quantities import look_of
from pneuma.figures.sizes import Size
from pneuma.figures.words import Entry, Words, wrap_label

LINE = 0.75
"""Width of a condition's mean, in that of a larger panel's."""
MORE_ROWS = 2
"""So many at most, if panels then leave no hole."""
LONGEST_INCHES = 7.6
"""Of a block of panels: with what is said around it a figure fits a page, unless they are too many."""
LEAST_PANEL_INCHES = 0.22
"""Of a panel below its name."""
MOST_OTHERS = 24
"""Panels up to which all other means stand behind each; of more they would be a grey blur."""
OTHERS_COLOUR = "#C4C4C4"
NAME_LINES = 2
"""For which there is room above a panel."""
TITLE_PAD = 2.0
"""Points between a panel and its name."""
NEAR_EDGE = 0.97
"""Of a panel's width: a last number there ends with it, lest it touch the next panel's 0."""
BASELINE_COLOUR = "#222222"


@dataclass(frozen=True)
class _Block:
    """The place of one quantity's panels: all lengths in inches, from below.

    Attributes:
        rows, columns: of panels.
        top: where its own title begins.
        height: of it, with its title and its axis' label.
        gap: of it, left free below for another block.
    """

    rows: int
    columns: int
    top: float
    height: float
    gap: float


def draw_multiples(
    data: StudyData, curves: dict[str, list[Curve]], band: str, size: Size, words: Words
) -> Figure:
    """Draw each quantity as a block of small panels, one to a condition."""
    figure = Figure(figsize=(size.width, size.height or size.width))
    count = max(len(group) for group in curves.values())
    rows, columns = _grid(count, size.small_columns)
    entries = _entries(data, curves)
    gap = size.line_inches if len(curves) > 1 else 0.0
    around = 4 * size.line_inches + gap  # the block's title, ticks and label
    labels = [label_of(data, curve) for group in curves.values() for curve in group]
    lines = max(_heading(label, size, columns).count("\n") + 1 for label in labels)
    least = rows * (LEAST_PANEL_INCHES + _title_inches(lines, size))
    wanted = max(min(rows * size.small_height, LONGEST_INCHES), least) + around
    told = _told_levels(labels, size, columns)
    words = replace(words, caption=[*words.caption, *filter(None, [told])])
    low, high = words.put(figure, size, len(curves) * wanted, entries)
    size.check_room(len(curves) * rows, high - low - around * len(curves))
    height = (high - low) / len(curves)
    for place, (name, group) in enumerate(curves.items()):
        block = _Block(rows, columns, high - place * height, height, gap)
        _draw_block(figure, data, name, group, band, block, size)
    return figure


def _grid(count: int, most: int) -> tuple[int, int]:
    """Return rows and columns of a number of panels, at most so many columns: without holes if that may be.

    Nine are three rows of three, not five and four; what leaves a hole anyway takes the fewest rows.
    """
    fewest = -(-count // most)
    for rows in range(fewest, fewest + MORE_ROWS + 1):
        if count % rows == 0:
            return rows, count // rows
    return fewest, -(-count // fewest)


def _small(look: Mapping[str, Any]) -> dict[str, Any]:
    """Return a condition's look in a panel of its own: its colour alone, for the title says which it is."""
    return {**look, "linestyle": "-", "marker": "", "linewidth": LINE * mpl.rcParams["lines.linewidth"]}


def _entries(data: StudyData, curves: Mapping[str, Sequence[Curve]]) -> dict[str, Entry]:
    """Return what the legend holds: the lines that every panel has."""
    looks = condition_looks(data.conditions).values()
    colours = list(dict.fromkeys(look["color"] for look in looks))[:3]
    entries: dict[str, Entry] = {
        "the panel's condition": tuple(Line2D([], [], color=colour) for colour in colours),
    }
    if max(len(group) for group in curves.values()) <= MOST_OTHERS:
        entries["the others"] = Line2D([], [], color=OTHERS_COLOUR)
    if data.record.get("baseline") in data.conditions:
        words = f"{data.record['baseline']} (baseline)"
        entries[words] = Line2D([], [], color=BASELINE_COLOUR, linestyle="--", linewidth=1)
    scratch = Figure().subplots()
    for name, group in curves.items():
        for levels in reference_levels(data, name).values():
            draw_references(scratch, levels, highest_point(group))
    handles, labels = scratch.get_legend_handles_labels()
    return {**entries, **dict(zip(labels, handles, strict=True))}


def _draw_block(
    figure: Figure, data: StudyData, name: str, curves: Sequence[Curve], band: str, block: _Block, size: Size
) -> None:
    look, levels = look_of(name, data.averaged_over), reference_levels(data, name)
    shared = shared_levels(data, name)  # one line in all panels, not each condition's sample of it
    curves = as_drawn(look, curves)
    line, (width, height) = size.line_inches, figure.get_size_inches()
    figure.text(
        0.07 / width, (block.top - 0.3 * line) / height, look.title, weight="bold", size="large", va="top"
    )
    headings = [_heading(label_of(data, curve), size, block.columns) for curve in curves]
    panels = _place_panels(figure, headings, block, size)
    looks = condition_looks(data.conditions)
    for axes, curve, heading in zip(panels, curves, headings, strict=True):
        _draw_others(axes, curves, curve, data.record.get("baseline"))
        draw_curve(axes, curve, band, _small(looks[curve.condition]))
        draw_references(axes, shared or levels.get(curve.condition, {}), highest_point(curves))
        draw_common_step(axes, common_step(data))
        set_axes(axes, look, data.budget, curves)
        axes.set_title(heading, fontsize=size.small_points, weight="normal", pad=TITLE_PAD, linespacing=1.05)
        axes.tick_params(labelsize=size.small_points, length=2, pad=1.5)
    _align(panels, block.columns, look.log)
    bottom = (block.top - block.height + block.gap) / height
    figure.text(0.5, bottom + 0.25 * line / height, "Environment steps", ha="center")
    middle = (block.top - (block.height - block.gap) / 2) / height
    figure.text(0.03 / width, middle, look.label, rotation=90, va="center")


def _place_panels(figure: Figure, headings: Sequence[str], block: _Block, size: Size) -> list[Axes]:
    """Return a panel below each heading, with room for the longest of these."""
    line = size.line_inches
    left, above = 3.6 * line, 1.5 * line  # ticks and label; title
    below = 2.3 * line + block.gap  # ticks and label
    width, height = figure.get_size_inches()
    cell = (width - left - 0.1) / block.columns, (block.height - above - below) / block.rows
    lines = max(heading.count("\n") for heading in headings) + 1
    gap, title = 0.14 * cell[0], _title_inches(lines, size)
    return [
        figure.add_axes(
            (
                (left + (place % block.columns) * cell[0]) / width,
                (block.top - above - (place // block.columns + 1) * cell[1]) / height,
                (cell[0] - gap) / width,
                (cell[1] - title) / height,
            )
        )
        for place in range(len(headings))
    ]


def _draw_others(axes: Axes, curves: Sequence[Curve], own: Curve, baseline: str | None) -> None:
    """Draw the other conditions' means behind, and the baseline's in front of them."""
    thin = 0.4 * mpl.rcParams["lines.linewidth"]
    others = [curve for curve in curves if curve.condition not in (own.condition, baseline)]
    if others and len(curves) <= MOST_OTHERS:  # as one line with gaps
        step = np.concatenate([np.append(curve.step, np.nan) for curve in others])
        mean = np.concatenate([np.append(curve.mean, np.nan) for curve in others])
        axes.plot(step, mean, color=OTHERS_COLOUR, linewidth=thin, zorder=1.1)
    for curve in curves:
        if curve.condition == baseline != own.condition:
            axes.plot(
                curve.step, curve.mean, color=BASELINE_COLOUR, linewidth=2 * thin, linestyle="--", zorder=1.3
            )


def _title_inches(lines: int, size: Size) -> float:
    """Return how much of a row the names above its panels take."""
    return (1.25 * lines * size.small_points + 2 * TITLE_PAD) / 72


def _characters(size: Size, columns: int) -> int:
    """Return how many characters a panel's name has room for in one line."""
    return int(size.width * 72 / columns * 0.85 / (0.56 * size.small_points))


def _told_levels(labels: Iterable[str], size: Size, columns: int) -> str:
    """Name the factors whose levels alone head the panels, where their names have no room there."""
    names = [label.partition(" (")[0] for label in labels if _is_long(label, size, columns)]
    return f"Panels: {parts_of(names)}." if factors_of(names) else ""


def _is_long(label: str, size: Size, columns: int) -> bool:
    return len(wrap_label(label, _characters(size, columns))) > NAME_LINES


def _heading(label: str, size: Size, columns: int) -> str:
    """Return a panel's condition in lines; where these are too many, the levels of its factors alone."""
    characters = _characters(size, columns)
    lines = wrap_label(label, characters)
    if _is_long(label, size, columns):
        name, count, runs = label.partition(" (")
        lines = wrap_label(read_name(name).short + count + runs, characters)
    return "\n".join(lines)


def _align(panels: Sequence[Axes], columns: int, log: bool) -> None:
    """Give all panels the same axes with few ticks, and labels at the left and below alone."""
    low = min(axes.get_ylim()[0] for axes in panels)
    high = max(axes.get_ylim()[1] for axes in panels)
    right = panels[0].get_xlim()[1]
    steps = np.asarray(whole_ticks(3).tick_values(0, right))
    for place, axes in enumerate(panels):
        axes.set_ylim(low, high)
        axes.xaxis.set_major_locator(FixedLocator(steps[steps <= right].tolist()))
        if not log:
            shorten_thousands(axes)
            ticks = np.asarray(whole_ticks(4).tick_values(low, high))
            axes.yaxis.set_major_locator(FixedLocator(ticks[(ticks >= low) & (ticks <= high)].tolist()))
        lowest = place + columns >= len(panels)
        axes.tick_params(labelleft=place % columns == 0, labelbottom=lowest)
        if lowest and steps[steps <= right][-1] > NEAR_EDGE * right:
            axes.get_xticklabels()[-1].set_horizontalalignment("right")
