"""The summary figure: final outcomes of all runs, means with intervals, profiles, improvement.

It shows the share of monsters killed at the end, or the return if there are no monsters or no evaluations.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pneuma.analysis.curves import curve_names, random_level
from pneuma.analysis.frames import StudyData, common_step, figure_basename, step_words
from pneuma.analysis.intervals import LEAST_RUNS
from pneuma.analysis.outcomes import (
    PRIMARY,
    find_outcome,
    is_foreign,
    is_return,
    outcome_values,
    primary,
)
from pneuma.analysis.summaries import summary_table
from pneuma.figures import panels, style
from pneuma.figures.origin import origin_of
from pneuma.figures.style import GREY, INK

WITHOUT_EVALUATIONS = "final-return"
ROW_INCHES, LEAST_ROW_INCHES, LONGEST_INCHES = 0.28, 0.1, 7.6
"""Heights in inches: of a condition's row, usual and least, and of all rows that fit a page."""
DOT_SHARE = 0.012
"""Width of a dot as a share of the axis; runs closer than this lie side by side."""
ABOVE = 0.2
"""Distance of the mean above, and the interquartile mean below, a condition's row, in rows."""

Values = Mapping[str, np.ndarray]
"""The outcomes of each condition's runs, (runs,)."""
Colours = Mapping[str, str]


def shown_outcome(data: StudyData) -> str:
    if is_foreign(data) and data.evaluated:
        return primary(data)
    return PRIMARY if "share_killed" in curve_names(data) else WITHOUT_EVALUATIONS


def draw_summary(
    data: StudyData, folder: Path, formats: tuple[str, ...] = ("png", "svg"), *, command: str = ""
) -> list[Path]:
    outcome = shown_outcome(data)
    table = summary_table(data, [outcome])
    table = table[table["outcome"] == outcome]
    values: dict[str, np.ndarray] = {}
    for name in data.conditions:
        if data.of_condition(name):
            found = outcome_values(data, name, outcome, common_step(data))
            values[name] = found[np.isfinite(found)]
    several = [name for name, runs in values.items() if len(runs) >= LEAST_RUNS]
    improved = table[(table["statistic"] == "improvement") & table["condition"].isin(several)]
    profiled = len(values) <= style.MOST_IN_A_PANEL
    pitch = min(max(LONGEST_INCHES / len(values), LEAST_ROW_INCHES), ROW_INCHES)
    names, parts = style.short_names(list(values))
    colours = {name: look["color"] for name, look in panels.looks_of(data).items()}
    with style.house_style():
        mark = 0.5 * style.TYPE_POINTS * pitch / ROW_INCHES
        figure = Figure(layout="constrained")
        widths = [1.25, *[1] * (bool(len(improved)) + profiled)]
        grid = figure.subplots(1, len(widths), squeeze=False, width_ratios=widths).ravel()
        _draw_rows(grid[0], values, table, colours, mark)
        if outcome == PRIMARY:
            highest = max((float(runs.max()) for runs in values.values() if len(runs)), default=0.0)
            level = random_level(data, "share_killed")
            panels.draw_random_player(grid[0], level, highest, upright=True)
            grid[0].set_xlim(0, max(grid[0].get_xlim()[1], 0.01))
        _set_outcome(grid[0], outcome)
        labels = [panels.label_of(data, name, names[name]) for name in values]
        panels.label_rows(grid[0], labels, pitch)
        if len(improved):
            _draw_improvement(grid[1], list(values), improved, colours, mark)
            panels.label_rows(grid[1], [""] * len(values), pitch)
        if profiled:
            _draw_profiles(grid[-1], values, colours)
            _set_outcome(grid[-1], outcome)
        entries = {**_marks(values), **panels.legend_entries(grid[:1])}
        caption = [*_caption(data, outcome, values, len(improved) > 0), parts and f"Rows: {parts}."]
        inches = max(pitch * len(values) + 0.7, style.PANEL_INCHES * profiled)
        step = common_step(data)
        when = f"at {step:,} steps" if step else "at the end of training"
        panels.put_texts(figure, inches, panels.headline_of(data, when), entries, caption)
        stem = figure_basename(data, "summary")
        return style.save_figure(figure, folder, stem, formats, origin_of(command, data))


def draw_comparison(
    data: StudyData, table: pd.DataFrame, folder: Path, stem: str, formats: tuple[str, ...], command: str = ""
) -> list[Path]:
    """Draw differences of means with intervals: a panel per outcome, a row per comparison.

    The table contains the results of `compare_conditions` for several pairs.
    """
    every = dict.fromkeys(table["outcome"])
    finite = {*table["outcome"][np.isfinite(table["difference"])]} or {*every}
    table = table[table["outcome"].isin(finite)]
    outcomes = list(dict.fromkeys(table["outcome"]))
    with style.house_style():
        figure = Figure(layout="constrained")
        panel_rows = -(-len(outcomes) // style.COLUMNS)
        columns = -(-len(outcomes) // panel_rows)
        grid = figure.subplots(panel_rows, columns, squeeze=False).ravel()
        for place, (axes, name) in enumerate(zip(grid, outcomes, strict=False)):
            rows = table[table["outcome"] == name].to_dict("records")
            for number, row in enumerate(rows):
                _draw_interval(axes, {**row, "value": row["difference"]}, number, "D", INK, 4)
            axes.axvline(0, color=GREY, linewidth=0.9, zorder=1.2)
            found = find_outcome(name)
            of_shares = found.bounds == (0.0, 1.0)
            axes.set(title=name, xlabel=panels.set_points(axes) if of_shares else found.unit)
            axes.xaxis.set_major_locator(panels.round_ticks(3))
            labels = [f"{row['a']} -\n{row['b']} ({_counts(table, row)})" for row in rows]
            panels.label_rows(axes, [""] * len(rows) if place % columns else labels, 2 * ROW_INCHES)
        for axes in grid[len(outcomes) :]:
            axes.remove()
        caption = ["Differences of means of runs, with Welch's 95 % intervals.", *panels.notes_of(data)]
        if lacking := [name for name in every if name not in finite]:
            caption.append(f"Without a finite difference: {', '.join(lacking)}.")
        if step := common_step(data):
            caption.append(f"All as they stood at {step:,} steps, {step_words(data)}.")
        inches = panel_rows * (2 * ROW_INCHES * table["outcome"].value_counts().max() + 0.7)
        panels.put_texts(figure, inches, panels.headline_of(data, "differences"), caption=caption)
        return style.save_figure(figure, folder, stem, formats, origin_of(command, data))


def _counts(table: pd.DataFrame, row: Mapping[Any, Any]) -> str:
    same = table[(table["a"] == row["a"]) & (table["b"] == row["b"])]
    return f"n = {panels.runs_told(same['seeds_a'])} and {panels.runs_told(same['seeds_b'])}"


def _set_outcome(axes: Axes, outcome: str) -> None:
    axes.set_xlabel("Share killed" if outcome == PRIMARY else "Return of an episode")
    axes.xaxis.set_major_locator(panels.round_ticks(4))
    if outcome == PRIMARY:
        panels.set_shares(axes, upright=False)


def _draw_rows(axes: Axes, values: Values, table: pd.DataFrame, colours: Colours, mark: float) -> None:
    """Draw each run of a condition as a dot, and its means with intervals."""
    reach = float(np.ptp(np.concatenate([*values.values(), [0.0]])))
    for place, (condition, runs) in enumerate(values.items()):
        (dots,) = axes.plot(
            runs, place + _beside(runs, reach), "o", color=colours[condition], markersize=0.6 * mark,
            markeredgewidth=0, alpha=0.7 if len(runs) < 20 else 0.4, clip_on=False, zorder=2.6,
        )  # fmt: skip
        dots.set_in_layout(False)  # there may be none
        enough = len(runs) >= LEAST_RUNS
        for row in table[table["condition"] == condition].to_dict("records"):
            if row["statistic"] == "mean" and len(runs) > 1:
                _draw_interval(axes, row, place - ABOVE, "D", colours[condition], mark, enough)
            elif row["statistic"] == "iqm" and enough:
                _draw_interval(axes, row, place + ABOVE, "s", "white", mark)
    axes.set_title("Every run")


def _draw_interval(
    axes: Axes, row: Mapping[Any, Any], place: float, marker: str, face: str, mark: float, enough: bool = True
) -> None:
    if enough:
        axes.plot([row["low"], row["high"]], [place, place], color=INK, linewidth=0.25 * mark)
    look: Any = {"color": INK, "markerfacecolor": face, "markeredgewidth": 0.8, "markersize": mark}
    (drawn,) = axes.plot(row["value"], place, marker, clip_on=False, zorder=2.7, **look)
    drawn.set_in_layout(False)  # it may be of no value


def _beside(values: np.ndarray, reach: float) -> np.ndarray:
    """Return the vertical offsets of (runs,) dots, so that similar ones do not overlap."""
    beside = np.zeros(len(values))
    near = np.round(values / (DOT_SHARE * reach or 1.0))
    for place in np.unique(near):
        alike = np.flatnonzero(near == place)
        step = min(0.09, 0.6 / len(alike))
        beside[alike] = step * (np.arange(len(alike)) - (len(alike) - 1) / 2)
    return beside


def _draw_improvement(
    axes: Axes, shown: list[str], table: pd.DataFrame, colours: Colours, mark: float
) -> None:
    """Draw the probability that a run of each condition is better than one of the baseline."""
    for row in table.to_dict("records"):
        name = row["condition"]
        _draw_interval(axes, row, shown.index(name), "o", colours[name], mark)
    axes.axvline(0.5, color=GREY, linewidth=0.9, zorder=1.2)
    axes.set(xlim=(0, 1), title="Against the baseline", xlabel="Probability of being better")
    axes.xaxis.set_major_locator(panels.round_ticks(4))


def _draw_profiles(axes: Axes, values: Values, colours: Colours) -> None:
    """Draw the share of runs above each level; a higher line is better."""
    pooled = np.concatenate(list(values.values()))
    low, high = min([0.0, *pooled]), max(pooled, default=1.0)
    levels = np.linspace(low - 0.05 * (high - low or abs(low)) if low < 0 else low, high, 201)
    for condition, runs in values.items():
        if len(runs):
            above = (runs > levels[:, None]).mean(axis=1)  # as rliable's performance profile: strictly
            axes.step(levels, above, where="post", color=colours[condition])
    axes.set(title="Runs above a level", ylabel="Share of runs", ylim=(0, 1.02))
    panels.set_shares(axes)


def _marks(values: Values) -> dict[str, Any]:
    """Return the legend's words for the marks in a row."""
    most = max(map(len, values.values()), default=0)
    run: Any = {"color": GREY, "marker": "o", "linestyle": "", "markersize": 3}
    iqm: Any = {"color": INK, "marker": "s", "markersize": 4, "markerfacecolor": "white"}
    entries = {"a run": Line2D([], [], **run)}
    if most > 1:
        look: Any = {"color": INK, "marker": "D", "markersize": 4}
        enough = most >= LEAST_RUNS
        entries["mean" + ", 95 % interval" * enough] = Line2D([], [], **look, linestyle="-" if enough else "")
    if most >= LEAST_RUNS:
        entries["interquartile mean, 95 % interval"] = Line2D([], [], **iqm)
    return entries


def _caption(data: StudyData, outcome: str, values: Values, improved: bool) -> list[str]:
    """Return the notes in the caption, the most important first."""
    words = find_outcome(outcome).words
    notes = [*panels.notes_of(data, is_return(outcome)), f"{words[:1].upper()}{words[1:]}."]
    if step := common_step(data):
        notes.append(f"All as they stood at {step:,} steps, {step_words(data)}.")
    for name, known in values.items():
        total = len(data.of_condition(name))
        if len(known) < total:
            notes.append(f"{total - len(known)} of {total} runs of {name} have no value, and count nowhere.")
    if any(len(known) < LEAST_RUNS for known in values.values()):
        notes.append(f"Of fewer than {LEAST_RUNS} runs there is no interval.")
    if any(len(known) >= LEAST_RUNS for known in values.values()):
        notes.append("Intervals: Student's t for means, else bootstrap.")
    if improved:
        notes.append(f"The baseline is {data.baseline}; a tie counts half.")
    return notes
