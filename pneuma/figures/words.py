"""What a figure says around its panels: the headline and the legend above, the caption below.

Words take the height that they need; where a figure's height is fixed, its panels take the rest.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.legend_handler import HandlerTuple
from matplotlib.textpath import text_to_path

from pneuma.figures.sizes import Size
from pneuma.figures.style import HOUSE_FONT

_HANDLE, _HANDLE_GAP, _COLUMN_GAP = 3.2, 0.8, 1.4
"""Widths of a legend's entry beside its text, in sizes of type."""
_EDGE = 0.07
"""Inches from the figure's left edge to its words."""
_HEADLINE, _CAPTION = 1.25, 0.78
"""Sizes of type, in that of the figure."""

_EQUALS = "\u00a0=\u00a0"
"""An equals sign at which no line ends."""

Entry = Artist | tuple[Artist, ...]


@dataclass(frozen=True)
class Words:
    """What a figure says around its panels.

    Attributes:
        headline: its first line.
        legend_title: what lines and bands are; '' for none.
        caption: sentences.
    """

    headline: str
    legend_title: str
    caption: Sequence[str]

    def put(
        self, figure: Figure, size: Size, panels_inches: float, entries: Mapping[str, Entry]
    ) -> tuple[float, float]:
        """Put the words and a legend above and below the panels, and give the figure its size.

        Args:
            figure: what is written on.
            size: of the figure.
            panels_inches: height of the panels, where it is free.
            entries: of the legend; of several artists each has its share of the handle.

        Returns:
            From where to where the panels may reach, in inches from below; a constrained layout knows.
        """
        points, line = size.type_points, size.line_inches
        entries = {_wrapped(label, size): artist for label, artist in entries.items()}
        heading = textwrap.wrap(self.headline, size.characters(_HEADLINE * points)) or [""]
        columns = legend_columns(size, list(entries))
        rows = _rows(list(entries), columns) + bool(self.legend_title and entries)
        above = line * (_HEADLINE * len(heading) + 1.02 * rows) + 0.06
        lines = _broken(" ".join(self.caption), size.characters(_CAPTION * points))
        below = len(lines) * _CAPTION * points * 1.4 / 72 + 0.1
        height = size.height or above + panels_inches + below
        figure.set_size_inches(size.width, height)
        if figure.get_layout_engine() is not None:
            rect = (0, below / height, 1, 1 - (above + below) / height)
            figure.get_layout_engine().set(rect=rect)  # type: ignore[union-attr, call-arg]
        edge = _EDGE / size.width
        top = 1 - 0.05 / height
        figure.text(edge, top, "\n".join(heading), fontsize=_HEADLINE * points, va="top")
        if entries:
            under = _HEADLINE * line * len(heading) + 0.4 * points / 72
            self._legend(figure, entries, columns, 1 - under / height)
        figure.text(
            edge,
            0.05 / height,
            "\n".join(lines),
            fontsize=_CAPTION * points,
            color="#444444",
            linespacing=1.35,
            va="bottom",
        )
        return below, height - above

    def _legend(self, figure: Figure, entries: Mapping[str, Entry], columns: int, top: float) -> None:
        handles: list[Any] = list(entries.values())  # matplotlib's own types know of single artists alone
        figure.legend(
            handles,
            list(entries),
            handler_map={tuple: HandlerTuple(ndivide=None, pad=0)},
            loc="upper left",
            bbox_to_anchor=(_EDGE / figure.get_figwidth(), top),
            ncols=columns,
            title=self.legend_title or None,
            alignment="left",
            handlelength=_HANDLE,
            handletextpad=_HANDLE_GAP,
            columnspacing=_COLUMN_GAP,
            labelspacing=0.3,
            borderpad=0.0,
            borderaxespad=0.0,
        )


def counts_told(counts: Iterable[int]) -> str:
    """Return counts as '10', or as '6 to 10' where they differ."""
    known = sorted({*counts})
    return str(known[0]) if len(known) == 1 else f"{known[0]} to {known[-1]}"


def wrap_label(label: str, characters: int) -> list[str]:
    """Break a condition's label into lines; "n = 3" and "non-stationary" stay whole."""
    return _broken(label.replace(" = ", _EQUALS), characters, break_on_hyphens=False)


def _broken(text: str, characters: int, break_on_hyphens: bool = True) -> list[str]:
    """Break a text into lines, but not between a number and its per cent."""
    lines = textwrap.wrap(text.replace(" %", "\u00a0%"), characters, break_on_hyphens=break_on_hyphens)
    return [line.replace("\u00a0", " ") for line in lines]


def legend_columns(size: Size, labels: Sequence[str]) -> int:
    """Return the number of columns that need fewest rows, each as wide as its longest label."""
    for rows in range(1, len(labels) + 1):
        columns = -(-len(labels) // rows)
        filled = np.array_split(np.asarray(labels, object), columns)  # as matplotlib fills them
        widths = [max(_entry_points(str(label), size) for label in column) for column in filled]
        if sum(widths) <= _room_points(size):
            return columns
    return 1


def _rows(labels: Sequence[str], columns: int) -> int:
    """Return the lines that a legend takes; only where it has one column are there labels of several."""
    return sum(label.count("\n") + 1 for label in labels) if columns == 1 else -(-len(labels) // columns)


def _wrapped(label: str, size: Size) -> str:
    """Return a legend's label, broken into lines where it is wider than the figure."""
    for characters in range(len(label), 9, -1):
        lines = "\n".join(wrap_label(label, characters))
        if _entry_points(lines, size) <= _room_points(size):
            return lines
    return label


def _room_points(size: Size) -> float:
    return (size.width - 0.1) * 72


def _entry_points(label: str, size: Size) -> float:
    """Return how wide an entry of a legend is, with the gap to the next."""
    font = FontProperties(family=HOUSE_FONT, size=size.type_points)
    widths = [text_to_path.get_text_width_height_descent(line, font, False)[0] for line in label.split("\n")]
    return float(max(widths)) + (_HANDLE + _HANDLE_GAP + _COLUMN_GAP) * size.type_points
