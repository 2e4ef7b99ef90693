"""Figures of outcomes: a dot for each run with means and their intervals, a row for each condition."""

from __future__ import annotations

import re
from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from pneuma.analysis.curves import curve_names, random_levels, random_returns
from pneuma.analysis.intervals import LEAST_RUNS
from pneuma.analysis.outcomes import PRIMARY, find_outcome, is_foreign, is_return, known_values, primary
from pneuma.analysis.study_data import StudyData
from pneuma.analysis.summaries import summary_table
from pneuma.figures import grid, style
from pneuma.figures.grid import LEAST_ROW_INCHES, LONGEST_INCHES, ROW_INCHES, SHARES, VALUES, Page, Panel
from pneuma.figures.origin import lines_of_runs
from pneuma.figures.style import GREY, INK
from pneuma.figures.words import (
    capital,
    headline_of,
    labels_of,
    looks_of,
    merge_notes,
    notes_of,
    short_names,
    shown_conditions,
)

WITHOUT_EVALUATIONS = "final-return"
DOT_SHARE = 0.012
"""Width of a dot as a share of the axis; runs closer than this lie side by side."""
ABOVE = 0.2
"""Distance of the mean above, and the interquartile mean below, a condition's row, in rows."""


def summary_page(studies: StudyData | Mapping[str, StudyData], basename: str = "") -> Page:
    """Return the figure of a study's outcomes: every run, and means.

    Args:
        studies: a study, whose outcomes are the columns; or its runs in each of several worlds, by the title
            of a column, of the one outcome that it names, or the default one.
        basename: of the files.

    Returns:
        The figure, with a row for each condition that has runs.
    """
    columns: dict[str, tuple[StudyData, str]] = {}
    if isinstance(studies, StudyData):
        datas = [studies]
        names = studies.study.outcomes or [default_outcome(studies)]
        headings = [re.split(r",| \(", _words(name))[0] for name in names]
        for name, heading in zip(names, headings, strict=True):
            columns[heading if headings.count(heading) == 1 else _words(name)] = studies, name
    else:
        datas = [*studies.values()]
        for title, data in studies.items():
            own_outcomes = data.study.outcomes
            columns[title] = data, own_outcomes[0] if len(own_outcomes) == 1 else default_outcome(data)
    first = datas[0]
    rows, looks = shown_conditions(datas), looks_of(datas)
    short, factors = short_names(datas)
    labels = [*labels_of(datas, short).values()]
    pitch = min(max(LONGEST_INCHES / len(rows), LEAST_ROW_INCHES), ROW_INCHES)
    panels: list[Panel] = []
    for title, (data, outcome) in columns.items():
        label = capital(find_outcome(outcome).unit)
        if is_return(outcome):
            label = "Return of an episode"
        elif outcome.endswith("share-killed"):
            label = "Share killed"
        draw = partial(_draw, data=data, outcome=outcome, rows=rows, looks=looks, pitch=pitch)
        panels.append(Panel(draw, title, label, x_kind=_kind(outcome), rows=labels))
    descriptions = {f"{_words(name)}.": None for title, (_, name) in columns.items() if title != _words(name)}
    notes = merge_notes({title: (data, _notes(data, name)) for title, (data, name) in columns.items()})
    notes = [*descriptions, *notes]
    if factors:
        notes.append(f"Rows: {factors}.")
    budgets = {steps for data in datas for steps in data.runs["steps"]}
    time_text = f"after {budgets.pop():,} steps" if len(budgets) == 1 else "at the end of training"
    return Page(
        basename=basename or first.basename("summary"),
        grid=[panels],
        inches=max(pitch * len(rows) + 0.7, 0.6 * style.PANEL_INCHES),
        headline=headline_of(first, time_text) if len(datas) == 1 else f"{first.study.title}: {time_text}",
        runs=lines_of_runs(*datas),
        entries=_legend(max(int(data.runs["condition"].value_counts().max()) for data in datas)),
        caption=notes,
    )


def default_outcome(data: StudyData) -> str:
    """Return the share killed at the end, or a return if there are no monsters or no evaluations."""
    if is_foreign(data) and data.evaluated:
        return primary(data)
    return PRIMARY if "share_killed" in curve_names(data) else WITHOUT_EVALUATIONS


def _kind(outcome: str) -> str:
    return SHARES if find_outcome(outcome).unit == "share" else VALUES


def _words(outcome: str) -> str:
    return capital(find_outcome(outcome).words)


def _notes(data: StudyData, outcome: str) -> list[str]:
    """Return the notes on a column."""
    notes = [*notes_of(data, is_return(outcome)), data.ends]
    counts: list[int] = []
    for name in shown_conditions([data]):
        total, value_count = len(data.of_condition(name)), len(known_values(data, name, outcome))
        counts.append(value_count)
        if value_count < total:
            notes.append(f"{total - value_count} of {total} runs of {name} have no value.")
    if min(counts) < LEAST_RUNS:
        notes.append(f"Of fewer than {LEAST_RUNS} runs there is no interval.")
    if max(counts) >= LEAST_RUNS:
        notes.append("Intervals: Student's t for means, else bootstrap.")
    return notes


def _draw(
    axes: Axes,
    data: StudyData,
    outcome: str,
    rows: list[str],
    looks: Mapping[str, Mapping[str, Any]],
    pitch: float,
) -> None:
    """Draw each run of a condition as a dot, and its means with intervals, in rows of a height in inches."""
    size = 0.5 * style.text_points() * pitch / ROW_INCHES
    values = {name: known_values(data, name, outcome) for name in shown_conditions([data])}
    all_values = np.concatenate([*values.values()])
    table = summary_table(data, [outcome])
    for condition, runs in values.items():
        position, colour = rows.index(condition), looks[condition]["color"]
        (dots,) = axes.plot(
            runs, position + _offsets(runs, float(np.ptp([*all_values, 0.0]))), "o", color=colour,
            markersize=0.6 * size, markeredgewidth=0, alpha=0.5, clip_on=False, zorder=2.6,
        )  # fmt: skip
        dots.set_in_layout(False)  # there may be none
        for row in table[(table["condition"] == condition) & (table["outcome"] == outcome)].to_dict(
            "records"
        ):
            if row["statistic"] == "mean" and len(runs) > 1:
                grid.draw_interval(axes, position - ABOVE, row, "D", colour, size)
            elif row["statistic"] == "iqm" and len(runs) >= LEAST_RUNS:
                grid.draw_interval(axes, position + ABOVE, row, "s", "white", size)
    if len(all_values):
        levels, return_kind = _random_levels(data, outcome), _kind(outcome)
        grid.draw_random_player(
            axes.axvline, levels.values(), (all_values.min(), all_values.max()), return_kind
        )


def _random_levels(data: StudyData, outcome: str) -> dict[str, float]:
    """Return what the random player comes to for each condition, where it was measured."""
    if outcome.endswith("share-killed"):
        return random_levels(data, "share_killed")
    if outcome == "evaluated-return":
        return random_levels(data, "evaluated_return")
    returns = random_returns(data, data.budget)
    if outcome != WITHOUT_EVALUATIONS or returns is None or returns.empty:
        return {}
    return {"": float(returns.iloc[-1])}


def _offsets(values: np.ndarray, reach: float) -> np.ndarray:
    """Return the vertical offsets of (runs,) dots, so that similar ones do not overlap."""
    bins = pd.Series(np.round(values / (DOT_SHARE * reach or 1.0)))
    members = bins.groupby(bins)
    count = members.transform("size")
    steps = np.minimum(0.09, 0.6 / count)
    return np.asarray(steps * (members.cumcount() - (count - 1) / 2))


def _legend(largest_group: int) -> dict[str, Any]:
    """Return the legend of panels in which a condition has at most so many runs."""
    look: Any = {"marker": "D", "color": INK, "markersize": 4}
    entries = {"a run": Line2D([], [], color=GREY, marker="o", linestyle="", markersize=3)}
    if largest_group >= LEAST_RUNS:
        entries["mean, 95 % interval"] = Line2D([], [], **look)
        entries["interquartile mean, 95 % interval"] = Line2D(
            [], [], **{**look, "marker": "s", "markerfacecolor": "white"}
        )
    elif largest_group > 1:
        entries["mean"] = Line2D([], [], linestyle="", **look)
    return entries
