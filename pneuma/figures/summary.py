"""The figure of what a study's runs came to: every run, means with intervals, profiles, improvement.

It shows the share of monsters killed at the end, or the return where nobody could be killed or no
evaluations are held.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

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
from pneuma.figures.captions import headline_of
from pneuma.figures.panel import per_cent
from pneuma.figures.sizes import SIZES, Size
from pneuma.figures.style import condition_look, house_style, save_figure
from pneuma.figures.words import Words

WITHOUT_EVALUATIONS = "final-return"
MOST_PROFILES = 8
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
    values = {name: _known(data, name, outcome) for name in data.conditions}
    rows_inches = size.line_inches * 1.6 * len(data.conditions) + 0.75
    improved = table[table["statistic"] == "improvement"]
    profiled = len(data.conditions) <= MOST_PROFILES
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
    _draw_runs(places[0], data, values, table, outcome)
    if len(improved):
        _draw_improvement(places[1], data, improved, labelled=stacked)
    if profiled:
        _draw_profiles(places[-1], data, values, outcome)
    words = Words(headline_of(data), "", _caption(data, outcome, values, profiled))
    entries = {
        "a run": Line2D([], [], color="#777777", marker="o", linestyle="", markersize=3),
        "mean, 95 % interval (Student's t)": Line2D([], [], color=_INK, marker="D", markersize=4),
        "mean of the middle half, 95 % interval (bootstrap)": Line2D(
            [], [], color=_INK, marker="s", markersize=4, markerfacecolor="white"
        ),
    }
    low, high = words.put(figure, size, sum(panels) if stacked else max(panels), entries)
    size.check_room(1 + len(data.conditions) // 3, high - low)
    return figure


def _known(data: StudyData, condition: str, outcome: str) -> np.ndarray:
    values = outcome_values(data, condition, outcome, common_step(data))
    return values[np.isfinite(values)]


def _draw_runs(
    axes: Axes, data: StudyData, values: dict[str, np.ndarray], table: pd.DataFrame, outcome: str
) -> None:
    for row, condition in enumerate(data.conditions):
        runs, colour = values[condition], condition_look(row)["color"]
        places = np.full(len(runs), float(row))
        axes.plot(runs, places, "o", color=colour, markersize=3, alpha=0.7, markeredgewidth=0)
        for statistic, (marker, beside) in _STATISTICS.items():
            found = table[(table["condition"] == condition) & (table["statistic"] == statistic)]
            for one in found.itertuples():
                face = colour if statistic == "mean" else "white"
                _draw_interval(axes, one, row - beside, marker, face)
    labels = [f"{name} (n = {len(values[name])})" for name in data.conditions]
    _label_rows(axes, labels)
    known = find_outcome(outcome)
    shares = known.bounds == (0.0, 1.0)
    axes.set(title="At the end", xlabel="Share killed" if shares else "Return of an episode")
    if shares:
        axes.set_xlim(0, max(axes.get_xlim()[1], 0.01))
        axes.xaxis.set_major_formatter(FuncFormatter(per_cent))


def _draw_improvement(axes: Axes, data: StudyData, table: pd.DataFrame, labelled: bool) -> None:
    for one in table.itertuples():
        row = data.conditions.index(str(one.condition))
        _draw_interval(axes, one, row, "o", condition_look(row)["color"])
    axes.axvline(0.5, color="#666666", linewidth=0.9, zorder=1.2)
    axes.set(xlim=(0, 1), title="Improvement", xlabel="P(better than baseline)")
    _label_rows(axes, data.conditions if labelled else ["" for _ in data.conditions])


def _draw_interval(axes: Axes, row: object, place: float, marker: str, face: str) -> None:
    low, high, value = (float(getattr(row, name)) for name in ("low", "high", "value"))
    axes.plot([low, high], [place, place], color=_INK, linewidth=1.2, solid_capstyle="butt", clip_on=False)
    axes.plot(
        value,
        place,
        marker,
        color=_INK,
        markersize=4.2,
        markerfacecolor=face,
        markeredgewidth=0.8,
        clip_on=False,
    )


def _label_rows(axes: Axes, labels: Sequence[str]) -> None:
    axes.set_yticks(range(len(labels)), labels)
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
    for row, condition in enumerate(data.conditions):
        if len(values[condition]):
            look = {**condition_look(row), "marker": ""}
            axes.step(levels, performance_profile(values[condition], levels), where="post", **look)
    axes.set(title="Profile", xlabel="Share killed" if shares else "Return of an episode")
    axes.set(ylabel="Runs above it", ylim=(0, 1.02))
    axes.yaxis.set_major_formatter(FuncFormatter(per_cent))
    if shares:
        axes.xaxis.set_major_formatter(FuncFormatter(per_cent))


def _caption(data: StudyData, outcome: str, values: dict[str, np.ndarray], profiled: bool) -> list[str]:
    shown = find_outcome(outcome).words
    words = [f"{', '.join(data.environments)}. {shown[:1].upper()}{shown[1:]}."]
    step = common_step(data)
    if step is not None:
        words.append(f"All as they stood at {step:,} steps, the most that all runs were to reach.")
    if data.record.get("baseline") in data.conditions and len(data.conditions) > 1:
        baseline = data.record["baseline"]
        words.append(
            f"Improvement: the probability that a run is better than one of {baseline}, the baseline."
        )
    for name, known in values.items():
        total = len(data.of_condition(name))
        if len(known) < total:
            words.append(
                f"{total - len(known)} of {total} runs of {name} have no value, and count nowhere here."
            )
    counts = [len(known) for known in values.values()]
    if any(0 < count < 3 for count in counts):
        words.append("Of fewer than three runs there is no bootstrap interval, of one none at all.")
    if any(count >= 3 and not is_trusted("bootstrap", count) for count in counts):
        words.append("Of so few runs bootstrap intervals cover less often than they say.")
    if not profiled:
        words.append(f"Of more than {MOST_PROFILES} conditions no profiles are drawn.")
    return words
