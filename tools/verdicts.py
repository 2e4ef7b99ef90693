"""All verdicts on the thesis's sentences as a forest plot: a row for each, a panel for each world.

An interval is drawn as a multiple of its margin, and so that the side on the right is what the sentence says.
Its colour is that of its own outcome: a sentence may hold by one outcome and be undecided by another.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from textwrap import wrap
from typing import Any

import matplotlib.pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pneuma.analysis.claims.verdicts import (
    DESCRIBED,
    FAILS,
    HOLDS,
    NOT_TESTED,
    UNDECIDED,
    ClaimContrast,
    Verdict,
)
from pneuma.analysis.claims.words import ByClaim, compared_text, letter, sentence_rows, worlds_of
from pneuma.figures.origin import line_of_runs, origin_text
from pneuma.figures.style import GREY, characters, house_style, save_figure
from pneuma.presets import WORLDS

STEM = "verdicts"
WIDTH_INCHES, SENTENCES_INCHES, TEXT_INCHES = 7.4, 3.4, 0.3
"""The width, that of the column of sentences, and where they begin."""
HEAD_INCHES, FOOT_INCHES = 0.25, 0.78
TYPE = 5.8
LINE_INCHES = 1.16 * TYPE / 72
MOST_LINES, GAP_LINES = 3, 0.28
"""Of a sentence, which is shortened; and between rows."""
MOST_MARGINS = 8.0
"""Intervals are cut there, with an arrow."""
BESIDE_ARROW = 0.7 * MOST_MARGINS
"""Where a mark stands that lies further out."""
AXIS_LABEL = "difference in margins"
TICKS = {-5: "−5", -1: "−1", 0: "0", 1: "1", 5: "5"}
LOOKS: dict[str, dict[str, Any]] = {
    HOLDS: {"marker": "o", "color": "C0"},
    FAILS: {"marker": "X", "color": "C1"},
    UNDECIDED: {"marker": "o", "color": "#555555", "markerfacecolor": "white"},
    DESCRIBED: {"marker": "D", "color": GREY, "markerfacecolor": "white"},
    NOT_TESTED: {"marker": "_", "color": GREY},
}
"""Verdicts differ in shape too, so that they can be told apart in grey."""


@dataclass(frozen=True)
class Row:
    """A row of the figure: its text, its verdicts in each world, and its place in lines."""

    section: str
    sentence: list[str]
    compared: str
    is_apart: bool  # what is compared has a line of its own
    verdicts: Mapping[str, Sequence[Verdict]]
    top: float

    @property
    def bottom(self) -> float:
        intervals = [sum(len(_drawn(verdict)) for verdict in verdicts) for verdicts in self.verdicts.values()]
        lines = max(2, len(self.sentence) + self.is_apart, 0.7 * max(intervals))
        return self.top + lines + GAP_LINES


def draw_verdicts(claims: ByClaim, folder: Path) -> list[Path]:
    """Draw the verdicts on one page."""
    worlds, rows = worlds_of(claims), _rows(claims)
    lines = rows[-1].bottom
    height = HEAD_INCHES + lines * LINE_INCHES + FOOT_INCHES
    bottom, share = FOOT_INCHES / height, lines * LINE_INCHES / height
    panel = (WIDTH_INCHES - SENTENCES_INCHES) / len(worlds)
    with house_style({"font.size": TYPE, "lines.linewidth": 0.2 * TYPE, "lines.markersize": 0.5 * TYPE}):
        figure = plt.figure(figsize=(WIDTH_INCHES, height))
        sentences = figure.add_axes((0, bottom, SENTENCES_INCHES / WIDTH_INCHES, share))
        sentences.set(xlim=(0, SENTENCES_INCHES), ylim=(lines, 0))
        _draw_sentences(sentences, rows)
        for place, (world, name) in enumerate(worlds.items()):
            left = (SENTENCES_INCHES + place * panel) / WIDTH_INCHES
            axes = figure.add_axes((left, bottom, 0.9 * panel / WIDTH_INCHES, share))
            axes.set_title(name, fontsize=TYPE)
            axes.set_xlabel(AXIS_LABEL, fontsize=TYPE, labelpad=2)
            _draw_scale(axes, lines)
            for row in rows:
                if world in row.verdicts:
                    _draw_verdicts(axes, row, row.verdicts[world])
        words = _drawn_words(claims)
        _draw_legend(figure, words)
        paths = save_figure(figure, folder, STEM, ("png",), _origin(claims))
        plt.close(figure)
    return paths


def _drawn_words(claims: ByClaim) -> set[str]:
    """Return the words whose marks are in the figure."""
    words: set[str] = set()
    for by_world in claims.values():
        for verdict in by_world.values():
            words.update(contrast.verdict for contrast in _drawn(verdict))
            if verdict.verdict == NOT_TESTED:
                words.add(NOT_TESTED)
    return words


def _rows(claims: ByClaim) -> list[Row]:
    width = characters(TYPE, SENTENCES_INCHES - TEXT_INCHES + 0.15)
    rows: list[Row] = []
    for sentence_row in sentence_rows(claims):
        sentence, compared = sentence_row.heading, compared_text(sentence_row.claim)
        top = rows[-1].bottom if rows else 0.0
        while len(wrap(sentence, width)) > MOST_LINES and ". " in sentence:
            sentence = sentence.rpartition(". ")[0] + "."
        wrapped = wrap(sentence, width, max_lines=MOST_LINES, placeholder=" …")
        is_apart = len(wrapped) == 1 or len(f"{wrapped[-1]}  {compared}") > width
        rows.append(Row(sentence_row.claim.section, wrapped, compared, is_apart, sentence_row.verdicts, top))
    return rows


def _draw_sentences(axes: Axes, rows: list[Row]) -> None:
    """Write each section once, and of each row the sentence and what is compared."""
    axes.set_axis_off()
    drawn = ""
    for row in rows:
        top = row.top + GAP_LINES / 2
        if row.section != drawn:
            axes.axhline(row.top, color="#BBBBBB", linewidth=0.5)
            axes.text(0.03, top, row.section, fontweight="bold", va="top")
            drawn = row.section
        for line, text in enumerate(row.sentence):
            last = axes.text(TEXT_INCHES, top + line, text, va="top")
        left, line = TEXT_INCHES, len(row.sentence)
        if not row.is_apart:
            right = axes.transData.inverted().transform(last.get_window_extent())[1, 0]
            left, line = right + 0.1, line - 1
        axes.text(left, top + line, row.compared, va="top", color=GREY)


def _draw_scale(axes: Axes, lines: float) -> None:
    """Draw what all rows share: zero, and the range within which a difference is too small to count."""
    axes.set_xscale("symlog", linthresh=1.0, linscale=1.0)  # linear within the margin
    axes.set(xlim=(-MOST_MARGINS, MOST_MARGINS), ylim=(lines, 0))
    axes.set_xticks([*TICKS], labels=[*TICKS.values()])
    axes.minorticks_off()
    axes.set_yticks([])
    axes.tick_params(length=2, pad=1.5)
    axes.spines["left"].set_visible(False)
    axes.axvspan(-1, 1, color="#E8E8E8", zorder=0, linewidth=0)
    axes.axvline(0, color="#999999", linewidth=0.6, zorder=1)


def _draw_verdicts(axes: Axes, row: Row, verdicts: Sequence[Verdict]) -> None:
    """Draw intervals below each other, each as its own outcome decides, and the letters of labels."""
    middle = (row.top + row.bottom) / 2
    drawn = [(verdict, contrast) for verdict in verdicts for contrast in _drawn(verdict)]
    if all(verdict.verdict == NOT_TESTED for verdict in verdicts):
        axes.plot(0, middle, markersize=4, **LOOKS[NOT_TESTED])
    for line, (_, contrast) in enumerate(drawn, start=1):
        look = LOOKS[contrast.verdict]
        height = row.top + (row.bottom - row.top) * line / (len(drawn) + 1)
        low, centre, high = _in_margins(contrast)
        axes.plot([low, high], [height, height], color=look["color"], linewidth=1.0, zorder=2)
        axes.plot(centre, height, markersize=3.2, markeredgewidth=0.7, zorder=3, clip_on=False, **look)
        for end in {low, high} & {-MOST_MARGINS, MOST_MARGINS}:
            arrow = "<" if end < 0 else ">"
            axes.plot(
                end, height, arrow, markersize=2.6, markeredgewidth=0, color=look["color"], clip_on=False
            )
    where = axes.get_yaxis_transform()  # a share of the width, and a line
    letters = "\n".join(dict.fromkeys(map(letter, verdicts)))
    axes.text(1.02, middle, letters, transform=where, va="center", ha="left", color=GREY)


def _drawn(verdict: Verdict) -> list[ClaimContrast]:
    """Return the contrasts of a verdict that are drawn: those with an effect and a margin."""
    if verdict.verdict == NOT_TESTED:
        return []
    return [
        contrast
        for contrast in verdict.deciding
        if math.isfinite(contrast.contrast.effect) and _scale(contrast)
    ]


def _in_margins(row: ClaimContrast) -> tuple[float, float, float]:
    """Return the low end, the effect and the high end in margins, positive as the sentence says."""
    scale = _scale(row)
    numbers = [row.contrast.simultaneous.low, row.contrast.effect, row.contrast.simultaneous.high]
    low, centre, high = (
        min(max(number, -MOST_MARGINS), MOST_MARGINS)
        for number in sorted(number / scale for number in numbers)
    )
    centre = min(max(centre, -BESIDE_ARROW), BESIDE_ARROW)
    return low, centre, high


def _scale(row: ClaimContrast) -> float:
    """Return the margin, negative if the sentence says less; 0 without a margin."""
    margin = row.claim.margin_of(row.world, row.outcome) or 0.0
    return -margin if row.direction == "less" else margin


def _draw_legend(figure: Figure, words: set[str]) -> None:
    marks = [
        Line2D([], [], linestyle="none", markersize=4, markeredgewidth=0.8, label=name, **look)
        for name, look in LOOKS.items()
        if name in words
    ]
    figure.legend(handles=marks, loc="lower left", ncols=4, bbox_to_anchor=(0.0, 0.0), fontsize=TYPE)
    text = (
        "To the right as the sentence says; grey: too small to count. “Little to no effect” and “similar”\n"
        "hold within the grey. The colour is that of an outcome alone: the sentence's verdict stands in the\n"
        "table. Beyond ±1 the axis is compressed; an arrow: the interval goes on. A mark alone has no\n"
        "interval. p: preregistered; a: amended; 3: same runs as list 3; d: descriptive; *: changed."
    )
    figure.text(0.99, 0.01, text, ha="right", va="bottom", color=GREY, linespacing=1.25)


def _origin(claims: ByClaim) -> str:
    """Return the picture's origin: the runs read of each study in each world, without their seeds."""
    ids: dict[str, list[str]] = {}
    for judged in claims.values():
        for verdict in judged.values():
            study = f"{verdict.claim.study} in {WORLDS[verdict.world].title}"
            ids.setdefault(study, []).extend(verdict.run_ids)
    runs = [line_of_runs(study, "", run_ids, ()) for study, run_ids in ids.items() if run_ids]
    return origin_text("the verdicts on the thesis's sentences", runs)
