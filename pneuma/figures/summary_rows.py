"""Rows of a summary: every run of a condition as a dot, and its means with their intervals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
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


def draw_rows(
    axes: Axes,
    data: StudyData,
    values: Values,
    table: pd.DataFrame,
    reach: float,
    places: Mapping[str, float] | None = None,
) -> None:
    """Draw conditions one below the other; their labels are the caller's.

    Args:
        axes: where.
        data: the study, of which the conditions may be some.
        values: of the conditions to draw.
        table: rows of the study's summary, of one outcome.
        reach: from the least to the greatest of all values that share the axis.
        places: of each condition, from above; where left out, one after the other.
    """
    looks, mark = condition_looks(data.conditions), mpl.rcParams["lines.markersize"]
    for count, (condition, runs) in enumerate(values.items()):
        place = count if places is None else places[condition]
        colour = looks[condition]["color"]
        axes.plot(
            runs,
            place + _beside(runs, reach),
            "o",
            color=colour,
            markersize=0.5 * mark,
            alpha=0.7 if len(runs) < 20 else 0.4,
            markeredgewidth=0,
            clip_on=False,  # runs that killed nothing lie on the axis: whole, and above it
            zorder=2.6,
        )
        for statistic, (marker, beside) in _STATISTICS.items():
            found = table[(table["condition"] == condition) & (table["statistic"] == statistic)]
            for one in found.itertuples():
                draw_interval(axes, one, place - beside, marker, colour if statistic == "mean" else "white")


def draw_levels(axes: Axes, data: StudyData, outcome: str, top: float) -> None:
    """Draw what players of known skill come to, where that is the same for all conditions, and near.

    Args:
        axes: of rows.
        data: the study.
        outcome: that the rows are of.
        top: the greatest value of them.
    """
    if outcome == PRIMARY:
        draw_references(axes, shared_levels(data, "share_killed"), top, upright=True)


def reach_of(values: Values) -> float:
    """Return how far all values lie apart, with 0 among them."""
    return float(np.ptp(np.concatenate([*values.values(), [0.0]])))


def greatest(values: Values) -> float:
    """Return the greatest of all values, which is 0 at least."""
    return max((float(runs.max(initial=0.0)) for runs in values.values()), default=0.0)


def set_values_axis(axes: Axes, outcome: str) -> None:
    """Let the horizontal axis read as an outcome does: shares in per cent, from 0."""
    axes.xaxis.set_major_locator(whole_ticks(4))
    if find_outcome(outcome).bounds == (0.0, 1.0):
        axes.set_xlim(0, max(axes.get_xlim()[1], 0.01))
        axes.xaxis.set_major_formatter(FuncFormatter(per_cent))


def values_label(outcome: str) -> str:
    """Return what the axis of an outcome is called."""
    return "Share killed" if find_outcome(outcome).bounds == (0.0, 1.0) else "Return of an episode"


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
