"""All verdicts on the thesis's sentences, as a picture and as a page: a row each, a column for each world."""

from __future__ import annotations

import re
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from textwrap import wrap
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes

from pneuma.analysis.claims.words import (
    FAILS,
    HOLDS,
    NOT_TESTED,
    UNDECIDED,
    count_words,
    verdict_table,
)
from pneuma.analysis.export import encode_frame
from pneuma.figures.origin import line_of_runs, origin_text
from pneuma.figures.report import Verdicts
from pneuma.figures.style import COLOURS, GREY, characters, house_style, save_figure
from pneuma.files import write_whole
from pneuma.presets import WORLDS

STEM = "verdicts"
WIDTH_INCHES, EDGE_INCHES, TEXT_INCHES, WORLDS_INCHES, MARK_INCHES = 7.4, 0.03, 0.32, 2.75, 0.13
"""The width; where sections, sentences and worlds begin; and the width of a mark."""
TYPE, SMALL = 6.2, 5.6
"""Points of words and sentences, and of effects."""
SPACING = 1.06
LINE_INCHES = SPACING * 1.1 * TYPE / 72
HEAD_LINES, GAP_LINES = 1.7, 0.5
LOOKS: dict[str, dict[str, Any]] = {
    HOLDS: {"marker": "o", "color": COLOURS[0]},
    FAILS: {"marker": "X", "color": COLOURS[1]},
    UNDECIDED: {"marker": "o", "color": "#555555", "markerfacecolor": "white"},
    NOT_TESTED: {"marker": "_", "color": GREY},
}
"""Verdicts differ in shape too, so that they can be told apart in grey."""


def write_verdicts(claims: Verdicts, folder: Path) -> list[Path]:
    """Draw the verdicts, and write them as a page with whole sentences and the names of claims."""
    table = verdict_table(claims, whole=True)
    table.insert(1, "Claim", [*claims])
    tables = (encode_frame(frame, "markdown").decode() for frame in (count_words(claims), table))
    page = folder / f"{STEM}.md"
    write_whole(page, "\n".join(["# Verdicts\n", *tables]).encode())
    return [*draw_verdicts(claims, folder), page]


# --- The picture ----------------------------------------------------------------------------------


def draw_verdicts(claims: Verdicts, folder: Path) -> list[Path]:
    """Draw the table of verdicts."""
    table = verdict_table(claims)
    worlds = [*table.columns[2:]]
    column = (WIDTH_INCHES - WORLDS_INCHES) / len(worlds)
    rows = [_Row(row, column) for row in table.itertuples(index=False, name=None)]
    height = HEAD_LINES + sum(row.lines for row in rows)
    with house_style(TYPE):
        figure = plt.figure(figsize=(WIDTH_INCHES, height * LINE_INCHES))
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set(xlim=(0, WIDTH_INCHES), ylim=(height, 0))  # inches, and lines of text
        axes.set_axis_off()
        axes.text(EDGE_INCHES, 0.9, "The thesis's sentence, by section", fontweight="bold", va="center")
        for place, world in enumerate(worlds):
            axes.text(WORLDS_INCHES + place * column, 0.9, world, fontweight="bold", va="center")
        top = HEAD_LINES
        for section, group in groupby(rows, key=lambda row: row.section):
            axes.axhline(top, color="#BBBBBB", linewidth=0.5)
            axes.text(EDGE_INCHES, top + GAP_LINES / 2, section, fontweight="bold", va="top")
            for row in group:
                row.draw(axes, top + GAP_LINES / 2)
                top += row.lines
        paths = save_figure(figure, folder, STEM, ("png",), _origin(claims))
        plt.close(figure)
    return paths


class _Row:
    """A row of the table in lines of text."""

    def __init__(self, row: Sequence[str], column: float) -> None:
        self.section, text, *cells = row
        self._column = column
        width = characters(TYPE, WORLDS_INCHES - TEXT_INCHES + MARK_INCHES)
        self._sentence = [line for part in text.split("\n") for line in wrap(part, width)]
        self._cells = [_cell_lines(cell, column) for cell in cells]
        self.lines = max(map(len, (self._sentence, *self._cells))) + GAP_LINES

    def draw(self, axes: Axes, top: float) -> None:
        axes.text(TEXT_INCHES, top, "\n".join(self._sentence), va="top", linespacing=SPACING)
        for place, (word, *effect) in enumerate(self._cells):
            left = WORLDS_INCHES + place * self._column
            if word not in LOOKS:  # not judged there
                continue
            look = LOOKS[word]
            axes.plot(left + 0.04, top + 0.5, markersize=4, markeredgewidth=0.8, clip_on=False, **look)
            axes.text(left + MARK_INCHES, top, word, va="top", color=look["color"], fontweight="bold")
            told = "\n".join(effect)
            axes.text(
                left + MARK_INCHES,
                top + 1,
                told,
                va="top",
                fontsize=SMALL,
                linespacing=SPACING * TYPE / SMALL,
            )


def _cell_lines(cell: str, column: float) -> list[str]:
    """Return a verdict's word, and below it each effect, whose difference begins a line."""
    word, *effects = cell.replace(" to ", "\xa0to\xa0").replace(" %", "\xa0%").split("\n")
    parts = [part for effect in effects for part in re.split("(?<=:) ", effect)]
    lines = [line for part in parts for line in wrap(part, characters(SMALL, column))]
    return [word, *(line.replace("\xa0", " ") for line in lines)]


def _origin(claims: Verdicts) -> str:
    """Return the picture's origin: the runs read of each study in each world, without their seeds."""
    ids: dict[str, list[str]] = {}
    for one in (one for verdicts in claims.values() for one in verdicts.values()):
        ids.setdefault(f"{one.claim.study} in {WORLDS[one.world].title}", []).extend(one.run_ids)
    runs = [line_of_runs(study, "", run_ids, ()) for study, run_ids in ids.items() if run_ids]
    return origin_text("the verdicts on the thesis's sentences", runs)
