"""Rows of a summary: every run of a condition as a dot, and its means with their intervals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

from pneuma.analysis.outcomes import PRIMARY, find_outcome
from pneuma.analysis.references import shared_levels
from pneuma.analysis.tables import StudyData
from pneuma.figures.looks import condition_looks
from pneuma.figures.panel import draw_references, per_cent, whole_ticks

Values = Mapping[str, np.ndarray]
"""What the runs of each condition came to, (runs,)."""

ROW_LINES = 1.6
"""Of text, from row to row, where there is room."""
DOT_SHARE, MOST_BESIDE = 0.012, 0.3
"""How wide a run's dot is, in parts of all values; and how far from its row it lies at most, in rows."""
_STATISTICS = {"mean": ("D", 0.14), "iqm": ("s", -0.14)}
"""Marker of a statistic, and where it lies beside the condition's row."""
_INK = "#222222"


@contextmanager
def dense(share: float) -> Iterator[None]:
    """Draw rows that are closer than usual in smaller type and with smaller marks.

    Args:
        share: of the usual distance between two rows, up to 1.
    """
    label, mark = mpl.rcParams["ytick.labelsize"], mpl.rcParams["lines.markersize"]
    smaller: Any = {
        "ytick.labelsize": max(min(1.0, 1.4 * share) * label, 4.0),
        "lines.markersize": share * mark,
    }
    with mpl.rc_context(smaller):
        yield


@dataclass(frozen=True)
class Rows:
    """What all rows of a figure share, whichever panel they are in.

    Attributes:
        data: the study.
        outcome: that the values are of.
        values: of every condition that has a row.
        table: the study's summary, of this outcome.
    """

    data: StudyData
    outcome: str
    values: Values
    table: pd.DataFrame

    @cached_property
    def reach(self) -> float:
        """How far all values lie apart, with 0 among them."""
        return float(np.ptp(np.concatenate([*self.values.values(), [0.0]])))

    @cached_property
    def levels(self) -> Mapping[str, float]:
        """What players of known skill come to, where that is the same for all conditions."""
        return shared_levels(self.data, "share_killed") if self.outcome == PRIMARY else {}

    @property
    def label(self) -> str:
        """What the axis of values is called."""
        return "Share killed" if self.are_shares else "Return of an episode"

    @property
    def are_shares(self) -> bool:
        """Whether values are shares, from 0 to 1."""
        return find_outcome(self.outcome).bounds == (0.0, 1.0)

    def draw(self, axes: Axes, places: Mapping[str, float]) -> None:
        """Draw some conditions, and the players' levels that are near; labels are the caller's.

        Args:
            axes: where.
            places: of the conditions to draw, from above.
        """
        looks = condition_looks(self.data.conditions)
        for condition, place in places.items():
            self._draw_row(axes, condition, place, looks[condition]["color"])
        top = max((float(runs.max(initial=0.0)) for runs in self.values.values()), default=0.0)
        draw_references(axes, self.levels, top, upright=True)

    def _draw_row(self, axes: Axes, condition: str, place: float, colour: str) -> None:
        runs = self.values[condition]
        axes.plot(
            runs,
            place + _beside(runs, self.reach),
            "o",
            color=colour,
            markersize=0.5 * mpl.rcParams["lines.markersize"],
            alpha=0.7 if len(runs) < 20 else 0.4,
            markeredgewidth=0,
            clip_on=False,  # runs that killed nothing lie on the axis: whole, and above it
            zorder=2.6,
        )
        own = self.table[self.table["condition"] == condition]
        for statistic, (marker, beside) in _STATISTICS.items():
            for one in own[own["statistic"] == statistic].itertuples():
                draw_interval(axes, one, place - beside, marker, colour if statistic == "mean" else "white")

    def set_axis(self, axes: Axes) -> None:
        """Let the horizontal axis read as the outcome does: shares in per cent, from 0."""
        axes.xaxis.set_major_locator(whole_ticks(4))
        if self.are_shares:
            axes.set_xlim(0, max(axes.get_xlim()[1], 0.01))
            axes.xaxis.set_major_formatter(FuncFormatter(per_cent))


def row_entries(axes: Axes) -> dict[str, Any]:
    """Return what the legend says of a row's marks, and of the players' levels in a panel of rows."""
    handles, labels = axes.get_legend_handles_labels()
    return {
        "a run": Line2D([], [], color="#777777", marker="o", linestyle="", markersize=3),
        "mean, 95 % interval (Student's t)": Line2D([], [], color=_INK, marker="D", markersize=4),
        "mean of the middle half, 95 % interval (bootstrap)": Line2D(
            [], [], color=_INK, marker="s", markersize=4, markerfacecolor="white"
        ),
        **dict(zip(labels, handles, strict=True)),
    }


def draw_interval(axes: Axes, row: object, place: float, marker: str, face: str) -> None:
    """Draw a row of the summary's table: its value in its interval."""
    low, high, value = (float(getattr(row, name)) for name in ("low", "high", "value"))
    mark = mpl.rcParams["lines.markersize"]
    axes.plot([low, high], [place, place], color=_INK, linewidth=0.2 * mark, solid_capstyle="butt")
    axes.plot(
        value,
        place,
        marker,
        color=_INK,
        markersize=0.7 * mark,
        markerfacecolor=face,
        markeredgewidth=0.8,
        clip_on=False,
        zorder=2.7,
    )


def label_rows(axes: Axes, labels: Sequence[str]) -> None:
    """Put labels beside rows, the first on top."""
    axes.set_yticks(range(len(labels)), labels, fontsize=mpl.rcParams["ytick.labelsize"])
    axes.set_ylim(len(labels) - 0.4, -0.6)
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="y", visible=False)


def _beside(values: np.ndarray, reach: float) -> np.ndarray:
    """Return how far from their row's middle the dots of (runs,) lie: those that are alike, apart."""
    beside = np.zeros(len(values))
    near = np.round(values / (DOT_SHARE * reach or 1.0))
    for place in np.unique(near):
        alike = np.flatnonzero(near == place)
        step = min(0.09, 2 * MOST_BESIDE / len(alike))
        beside[alike] = step * (np.arange(len(alike)) - (len(alike) - 1) / 2)
    return beside
