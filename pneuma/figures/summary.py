"""The figure of what a study's runs came to: every run, means with intervals, profiles, improvement.

It shows the share of monsters killed at the end, or the return where nobody could be killed or no
evaluations are held.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

from pneuma.analysis.coverage import is_trusted
from pneuma.analysis.curves import curve_names
from pneuma.analysis.estimates import performance_profile
from pneuma.analysis.outcomes import PRIMARY, find_outcome, outcome_values
from pneuma.analysis.run_view import common_step
from pneuma.analysis.summaries import summary_table
from pneuma.analysis.tables import StudyData
from pneuma.figures.captions import headline_of, looks_told
from pneuma.figures.looks import MOST_IN_A_PANEL, condition_looks
from pneuma.figures.panel import per_cent, whole_ticks
from pneuma.figures.sizes import SIZES, Size
from pneuma.figures.style import house_style, save_figure
from pneuma.figures.words import Words

WITHOUT_EVALUATIONS = "final-return"
LONGEST_INCHES = 7.6
"""Of the rows: with what is said around them a figure still fits a page."""
ROW_LINES = 1.6
DOT_SHARE, MOST_BESIDE = 0.012, 0.3
"""How wide a run's dot is, in parts of all values; and how far from its row it lies at most, in rows."""
_STATISTICS = {"mean": ("D", 0.14), "iqm": ("s", -0.14)}
"""Marker of a statistic, and where it lies beside the condition's row."""
_INK = "#222222"


def draw_summary(
    data: StudyData, folder: Path, formats: tuple[str, ...] = ("png", "svg"), *, size: str = "page"
) -> list[Path]:
    """Draw what the runs of every condition came to; return the files written.

    Args:
        data: the study.
        folder: where to write.
        formats: of `FIGURE_FORMATS`.
        size: one of `SIZES`.

    Raises:
        UserError: for more than a slide has room for.
    """
    how = SIZES[size]
    outcome = shown_outcome(data)
    table = summary_table(data)
    own = table[table["outcome"] == outcome]
    with house_style(how.type_points):
        figure = _figure(data, outcome, own, how)
        stem = "-".join([data.figure, "summary", *([] if size == "page" else [size])])
        return save_figure(figure, folder, stem, formats, how.dots_per_inch)


def shown_outcome(data: StudyData) -> str:
    """Return the outcome that is drawn."""
    return PRIMARY if "share_killed" in curve_names(data) else WITHOUT_EVALUATIONS


def _figure(data: StudyData, outcome: str, table: pd.DataFrame, size: Size) -> Figure:
    figure = Figure(figsize=(size.width, size.height or size.width), layout="constrained")
    values = {name: _known(data, name, outcome) for name in data.conditions if data.of_condition(name)}
    pitch = min(ROW_LINES * size.line_inches, LONGEST_INCHES / len(values))
    rows_inches = pitch * len(values) + 0.75
    improved = table[table["statistic"] == "improvement"]
    profiled = len(values) <= MOST_IN_A_PANEL
    panels = [
        rows_inches,
        *([rows_inches] if len(improved) else []),
        *([size.panel_height] if profiled else []),
    ]
    stacked = size.columns == 1
    places = figure.subplots(
        len(panels) if stacked else 1,
        1 if stacked else len(panels),
        squeeze=False,
        height_ratios=panels if stacked else None,
    ).ravel()
    with _dense(pitch / (ROW_LINES * size.line_inches)):
        _draw_runs(places[0], data, values, table, outcome)
        if len(improved):
            _draw_improvement(places[1], data, list(values), improved, labelled=stacked)
    if profiled:
        _draw_profiles(places[-1], data, values, outcome)
    words = Words(headline_of(data, "at the end of training"), "", _caption(data, outcome, values, table))
    entries = {
        "a run": Line2D([], [], color="#777777", marker="o", linestyle="", markersize=3),
        "mean, 95 % interval (Student's t)": Line2D([], [], color=_INK, marker="D", markersize=4),
        "mean of the middle half, 95 % interval (bootstrap)": Line2D(
            [], [], color=_INK, marker="s", markersize=4, markerfacecolor="white"
        ),
    }
    low, high = words.put(figure, size, sum(panels) if stacked else max(panels), entries)
    size.check_room(1 + len(values) // 3, high - low)
    return figure


@contextmanager
def _dense(share: float) -> Iterator[None]:
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


def _known(data: StudyData, condition: str, outcome: str) -> np.ndarray:
    values = outcome_values(data, condition, outcome, common_step(data))
    return values[np.isfinite(values)]


def _draw_runs(
    axes: Axes, data: StudyData, values: dict[str, np.ndarray], table: pd.DataFrame, outcome: str
) -> None:
    looks, mark = condition_looks(data.conditions), mpl.rcParams["lines.markersize"]
    reach = np.ptp(np.concatenate([*values.values(), [0.0]]))
    for row, (condition, runs) in enumerate(values.items()):
        colour, places = looks[condition]["color"], row + _beside(runs, reach)
        faint = 0.7 if len(runs) < 20 else 0.4
        axes.plot(
            runs,
            places,
            "o",
            color=colour,
            markersize=0.5 * mark,
            alpha=faint,
            markeredgewidth=0,
            clip_on=False,  # runs that killed nothing lie on the axis: whole, and above it
            zorder=2.6,
        )
        for statistic, (marker, beside) in _STATISTICS.items():
            found = table[(table["condition"] == condition) & (table["statistic"] == statistic)]
            for one in found.itertuples():
                face = colour if statistic == "mean" else "white"
                _draw_interval(axes, one, row - beside, marker, face)
    _label_rows(axes, [f"{name} (n = {len(runs)})" for name, runs in values.items()])
    known = find_outcome(outcome)
    shares = known.bounds == (0.0, 1.0)
    axes.set(title="Every run", xlabel="Share killed" if shares else "Return of an episode")
    axes.xaxis.set_major_locator(whole_ticks(4))
    if shares:
        axes.set_xlim(0, max(axes.get_xlim()[1], 0.01))
        axes.xaxis.set_major_formatter(FuncFormatter(per_cent))


def _beside(values: np.ndarray, reach: float) -> np.ndarray:
    """Return how far from their row's middle the dots of (runs,) lie: those that are alike, apart."""
    beside = np.zeros(len(values))
    near = np.round(values / (DOT_SHARE * reach or 1.0))
    for place in np.unique(near):
        alike = np.flatnonzero(near == place)
        step = min(0.09, 2 * MOST_BESIDE / len(alike))
        beside[alike] = step * (np.arange(len(alike)) - (len(alike) - 1) / 2)
    return beside


def _draw_improvement(
    axes: Axes, data: StudyData, shown: Sequence[str], table: pd.DataFrame, labelled: bool
) -> None:
    looks = condition_looks(data.conditions)
    for one in table.itertuples():
        sure = np.isfinite(float(one.low))  # type: ignore[arg-type]
        face = looks[str(one.condition)]["color"] if sure else "white"
        _draw_interval(axes, one, shown.index(str(one.condition)), "o", face)
    axes.axvline(0.5, color="#666666", linewidth=0.9, zorder=1.2)
    axes.set(xlim=(0, 1), title="Against the baseline", xlabel="Probability of being better")
    _label_rows(axes, shown if labelled else [""] * len(shown))


def _draw_interval(axes: Axes, row: object, place: float, marker: str, face: str) -> None:
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


def _label_rows(axes: Axes, labels: Sequence[str]) -> None:
    axes.set_yticks(range(len(labels)), labels, fontsize=mpl.rcParams["ytick.labelsize"])
    axes.set_ylim(len(labels) - 0.4, -0.6)  # the first on top
    axes.tick_params(axis="y", length=0)
    axes.grid(axis="y", visible=False)


def _draw_profiles(axes: Axes, data: StudyData, values: dict[str, np.ndarray], outcome: str) -> None:
    """Draw the share of runs above every level: whoever's line is higher is better at that level."""
    pooled = np.concatenate(list(values.values()))
    if not len(pooled):
        return
    shares = find_outcome(outcome).bounds == (0.0, 1.0)
    levels = np.linspace(0 if shares else pooled.min(), pooled.max(), 201)
    looks = condition_looks(data.conditions)
    for condition, runs in values.items():
        if len(runs):
            look = {**looks[condition], "marker": ""}
            axes.step(levels, performance_profile(runs, levels), where="post", **look)
    axes.set(title="Runs above a level", xlabel="Share killed" if shares else "Return of an episode")
    axes.set(ylabel="Share of runs", ylim=(0, 1.02))
    axes.xaxis.set_major_locator(whole_ticks(4))
    axes.yaxis.set_major_formatter(FuncFormatter(per_cent))
    if shares:
        axes.xaxis.set_major_formatter(FuncFormatter(per_cent))


def _caption(data: StudyData, outcome: str, values: dict[str, np.ndarray], table: pd.DataFrame) -> list[str]:
    known_outcome = find_outcome(outcome)
    shown = known_outcome.words
    words = [f"{', '.join(data.environments)}. {shown[:1].upper()}{shown[1:]}."]
    words += looks_told(data)
    if len(values) <= MOST_IN_A_PANEL:
        words.append("Runs above a level: in the colours of the rows.")
    step = common_step(data)
    if step is not None:
        words.append(f"All as they stood at {step:,} steps, the most that all runs were to reach.")
    if data.record.get("baseline") in data.conditions and len(data.conditions) > 1:
        baseline = data.record["baseline"]
        words.append(
            f"Against the baseline: the probability that a run is better than one of {baseline}, a tie being "
            "half of it, with 95 % intervals (bootstrap); hollow where no resample differs: there is none."
        )
    absent = [name for name in data.conditions if name not in values]
    if absent:
        words.append(f"Not run: {', '.join(absent)}.")
    for name, known in values.items():
        total = len(data.of_condition(name))
        if len(known) < total:
            words.append(
                f"{total - len(known)} of {total} runs of {name} have no value, and count nowhere here."
            )
    if known_outcome.bounds == (0.0, 1.0) and (table["low"] < 0).any():
        words.append("What of an interval lies below 0 % is cut off.")
    counts = [len(known) for known in values.values()]
    if any(0 < count < 3 for count in counts):
        words.append("Of fewer than three runs there is no bootstrap interval, of one none at all.")
    if any(count >= 3 and not is_trusted("bootstrap", count) for count in counts):
        words.append("Of so few runs bootstrap intervals cover less often than they say.")
    return words
