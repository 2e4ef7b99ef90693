"""Figures of outcomes: a dot for each run with means and their intervals, a row for each condition."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from pneuma.analysis.answer import Answer
from pneuma.analysis.intervals import LEAST_RUNS
from pneuma.analysis.outcomes import find_outcome
from pneuma.figures import grid, style
from pneuma.figures.grid import LEAST_ROW_INCHES, LONGEST_INCHES, ROW_INCHES, Page, Panel
from pneuma.figures.origin import lines_of_runs
from pneuma.figures.style import GREY, INK
from pneuma.figures.words import capital, headline_of, looks_of
from pneuma.store.quantities import SHARES, VALUES

DOT_SHARE = 0.012
"""Width of a dot as a share of the axis; runs closer than this lie side by side."""
ABOVE = 0.2
"""Distance of the mean above, and the interquartile mean below, a condition's row, in rows."""


def summary_page(answer: Answer, basename: str = "") -> Page:
    """Return the figure of a study's outcomes: every run, and means, a row for each condition that has runs.

    Args:
        answer: of `show_outcomes`.
        basename: of the files.
    """
    drawing = answer.drawing
    runs, looks = drawing["runs"], looks_of(answer.drawing)
    labels = {condition: looks[condition]["label"] for condition in runs["condition"].unique()}
    row_inches = min(max(LONGEST_INCHES / len(labels), LEAST_ROW_INCHES), ROW_INCHES)
    panels: list[Panel] = []
    for title, environment, outcome in drawing["panels"].to_numpy():
        declared = find_outcome(outcome)
        axis_label, axis_kind = capital(declared.unit), SHARES if declared.unit == "share" else VALUES
        if declared.is_return:
            axis_label = "Return of an episode"
        elif outcome.endswith("share-killed"):
            axis_label = "Share killed"
        conditions = runs["condition"][runs["environment"] == environment].unique()
        draw = partial(_draw, answer, title, axis_kind, conditions, list(labels), looks, row_inches)
        panels.append(Panel(draw, title, axis_label, x_kind=axis_kind, rows=list(labels.values())))
    budgets = runs["steps"].unique()
    time_text = f"after {budgets[0]:,} steps" if len(budgets) == 1 else "at the end of training"
    notes = list(answer.notes)
    if drawing["factors"]:
        notes.append(f"Rows: {drawing['factors']}.")
    return Page(
        basename=basename or drawing["basename"],
        grid=[panels],
        inches=max(row_inches * len(labels) + 0.7, 0.6 * style.PANEL_INCHES),
        headline=headline_of(answer, time_text),
        runs=lines_of_runs(runs),
        entries=_legend(runs.groupby(["environment", "condition"]).size().max()),
        caption=notes,
        answer=answer,
    )


def _draw(
    answer: Answer,
    title: str,
    axis_kind: str,
    conditions: Sequence[str],
    row_conditions: Sequence[str],
    looks: Mapping[str, Mapping[str, Any]],
    row_inches: float,
    axes: Axes,
) -> None:
    """Draw each run of a condition as a dot, and its means with intervals, in rows of a height in inches."""
    size = 0.5 * style.text_points() * row_inches / ROW_INCHES
    summary, runs = (table[table["column"] == title] for table in answer.tables.values())
    for condition in conditions:
        position, colour = row_conditions.index(condition), looks[condition]["color"]
        values = runs["value"][runs["condition"] == condition].to_numpy()
        (dots,) = axes.plot(
            values, position + _offsets(values, float(np.ptp([*runs["value"], 0.0]))), "o", color=colour,
            markersize=0.8 * size, markeredgewidth=0, alpha=0.6, clip_on=False, zorder=2.6,
        )  # fmt: skip
        dots.set_in_layout(False)  # there may be none
        for summary_row in summary[summary["condition"] == condition].to_dict("records"):
            if summary_row["statistic"] == "mean" and len(values) > 1:
                grid.draw_interval(axes, position - ABOVE, summary_row, "D", colour, size)
            elif summary_row["statistic"] == "iqm" and len(values) >= LEAST_RUNS:
                grid.draw_interval(axes, position + ABOVE, summary_row, "s", "white", size)
    if len(runs):
        reference = answer.drawing["reference"]
        levels = reference["value"][reference["column"] == title]
        grid.draw_random_player(
            axes.axvline, set(levels), (runs["value"].min(), runs["value"].max()), axis_kind
        )


def _offsets(run_values: np.ndarray, value_range: float) -> np.ndarray:
    """Return the vertical offsets of (runs,) dots, so that similar ones do not overlap."""
    dot_bins = pd.Series(np.round(run_values / (DOT_SHARE * value_range or 1.0)))
    members = dot_bins.groupby(dot_bins)
    bin_sizes = members.transform("size")
    spacings = np.minimum(0.09, 0.6 / bin_sizes)
    return np.asarray(spacings * (members.cumcount() - (bin_sizes - 1) / 2))


def _legend(largest_group: int) -> dict[str, Any]:
    """Return the legend of panels in which a condition has at most so many runs."""
    look: Any = {"marker": "D", "color": INK, "markersize": 4}
    entries = {"a run": Line2D([], [], color=GREY, marker="o", linestyle="", markersize=3)}
    if largest_group >= LEAST_RUNS:
        entries["mean, 95 % interval"] = Line2D([], [], **look)
        look |= {"marker": "s", "markerfacecolor": "white"}
        entries["interquartile mean, 95 % interval"] = Line2D([], [], **look)
    elif largest_group > 1:
        entries["mean"] = Line2D([], [], linestyle="", **look)
    return entries
