"""The figure of what a study's runs came to: every run, means with intervals, profiles, improvement.

It shows the share of monsters killed at the end, or the return where nobody could be killed or no
evaluations are held.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pneuma.analysis.curves import curve_names, shared_levels
from pneuma.analysis.estimates import performance_profile
from pneuma.analysis.frames import StudyData
from pneuma.analysis.outcomes import PRIMARY, find_outcome, have_one_return, is_return, outcome_values
from pneuma.analysis.run_view import common_step, step_words
from pneuma.analysis.summaries import summary_table
from pneuma.figures.panels import (
    FEW_RUNS,
    draw_players,
    headline_of,
    label_of,
    label_rows,
    notes_of,
    put_texts,
    round_ticks,
    set_shares,
    stem_of,
)
from pneuma.figures.style import (
    GREY,
    INK,
    MOST_IN_A_PANEL,
    PANEL_INCHES,
    TYPE_POINTS,
    condition_looks,
    house_style,
    save_figure,
    short_names,
)

WITHOUT_EVALUATIONS = "final-return"
ROW_INCHES, LEAST_ROW_INCHES, LONGEST_INCHES = 0.28, 0.1, 7.6
"""Heights of a condition's row, usual and least, and of all rows, with which a figure fits a page."""
DOT_SHARE = 0.012
"""How wide a run's dot is, in parts of all values: those that are nearer lie side by side."""
ABOVE = 0.2
"""How far above its condition's row a mean lies, and below it an interquartile mean, in rows."""

Values = Mapping[str, np.ndarray]
"""What the runs of each condition came to, (runs,)."""


def draw_summary(data: StudyData, folder: Path, formats: tuple[str, ...] = ("png", "svg")) -> list[Path]:
    """Draw what the runs of every condition came to; return the files written."""
    outcome = shown_outcome(data)
    table = summary_table(data, [outcome])
    table = table[table["outcome"] == outcome]
    values = {name: _known(data, name, outcome) for name in data.conditions if data.of_condition(name)}
    with house_style():
        figure = _draw(data, outcome, values, table)
        return save_figure(figure, folder, stem_of(data, "summary"), formats)


def shown_outcome(data: StudyData) -> str:
    """Return the outcome that is drawn."""
    return PRIMARY if "share_killed" in curve_names(data) else WITHOUT_EVALUATIONS


def _known(data: StudyData, condition: str, outcome: str) -> np.ndarray:
    values = outcome_values(data, condition, outcome, common_step(data))
    return values[np.isfinite(values)]


def _draw(data: StudyData, outcome: str, values: Values, table: pd.DataFrame) -> Figure:
    """Draw the panels side by side."""
    pitch = min(max(LONGEST_INCHES / len(values), LEAST_ROW_INCHES), ROW_INCHES)
    several = [name for name, runs in values.items() if len(runs) >= FEW_RUNS]
    improved = table[(table["statistic"] == "improvement") & table["condition"].isin(several)]
    profiled = len(values) <= MOST_IN_A_PANEL
    figure = Figure(layout="constrained")
    widths = [1.25, *[1] * (bool(len(improved)) + profiled)]
    panels = figure.subplots(1, len(widths), squeeze=False, width_ratios=widths).ravel()
    names, parts = short_names(list(values))
    labels = [label_of(data, name, names[name]) for name in values]
    mark = 0.5 * TYPE_POINTS * min(1, pitch / ROW_INCHES)
    with mpl.rc_context({"lines.markersize": mark}):
        _draw_rows(panels[0], data, outcome, values, table)
        label_rows(panels[0], labels, pitch)
        if len(improved):
            _draw_improvement(panels[1], data, list(values), improved)
            label_rows(panels[1], [""] * len(values), pitch)
        entries = _entries(panels[0], table)
    if profiled:
        _draw_profiles(panels[-1], data, outcome, values)
    caption = [*notes_of(data), *_caption(data, outcome, values, len(improved) > 0)]
    caption.append(parts and f"Rows: {parts}.")
    inches = max(pitch * len(values) + 0.7, PANEL_INCHES * profiled)
    put_texts(figure, inches, headline_of(data, "at the end of training"), entries, caption)
    return figure


def _draw_rows(axes: Axes, data: StudyData, outcome: str, values: Values, table: pd.DataFrame) -> None:
    """Draw every run of a condition as a dot in its row, and its means with their intervals."""
    reach = float(np.ptp(np.concatenate([*values.values(), [0.0]])))
    looks = condition_looks(data.conditions)
    for place, (condition, runs) in enumerate(values.items()):
        colour = looks[condition]["color"]
        (dots,) = axes.plot(
            runs, place + _beside(runs, reach), "o", color=colour, markersize=0.6 * _mark(),
            markeredgewidth=0, alpha=0.7 if len(runs) < 20 else 0.4, clip_on=False, zorder=2.6,
        )  # fmt: skip
        dots.set_in_layout(False)  # there may be none
        enough = len(runs) >= FEW_RUNS
        for row in table[table["condition"] == condition].to_dict("records"):
            if row["statistic"] == "mean" and len(runs) > 1:
                _draw_interval(axes, row, place - ABOVE, "D", colour, enough)
            elif row["statistic"] == "iqm" and enough:
                _draw_interval(axes, row, place + ABOVE, "s", "white")
    if outcome == PRIMARY:
        draw_players(axes, shared_levels(data, "share_killed"), reach, upright=True)
    axes.set(title="Every run", xlabel=_label(outcome))
    axes.xaxis.set_major_locator(round_ticks(4))
    if _are_shares(outcome):
        axes.set_xlim(0, max(axes.get_xlim()[1], 0.01))
        set_shares(axes, upright=False)


def _draw_interval(
    axes: Axes, row: Mapping[Any, Any], place: float, marker: str, face: str, interval: bool = True
) -> None:
    """Draw a row of the summary's table: its value in its interval."""
    if interval:
        axes.plot([row["low"], row["high"]], [place, place], color=INK, linewidth=0.25 * _mark())
    look: Any = {"color": INK, "markerfacecolor": face, "markeredgewidth": 0.8, "markersize": _mark()}
    (mark,) = axes.plot(row["value"], place, marker, clip_on=False, zorder=2.7, **look)
    mark.set_in_layout(False)  # it may be of no value


def _draw_improvement(axes: Axes, data: StudyData, shown: Sequence[str], table: pd.DataFrame) -> None:
    looks = condition_looks(data.conditions)
    for row in table.to_dict("records"):
        colour = looks[row["condition"]]["color"]
        _draw_interval(axes, row, shown.index(row["condition"]), "o", colour)
    axes.axvline(0.5, color=GREY, linewidth=0.9, zorder=1.2)
    axes.set(xlim=(0, 1), title="Against the baseline", xlabel="Probability of being better")
    axes.xaxis.set_major_locator(round_ticks(4))


def _draw_profiles(axes: Axes, data: StudyData, outcome: str, values: Values) -> None:
    """Draw the share of runs above every level: whoever's line is higher is better at that level."""
    pooled = np.concatenate(list(values.values()))
    looks = condition_looks(data.conditions)
    levels = np.linspace(min(0, *pooled) if len(pooled) else 0, max(pooled, default=1), 201)
    for condition, runs in values.items():
        if len(runs):
            profile = performance_profile(runs, levels)
            axes.step(levels, profile, where="post", color=looks[condition]["color"])
    axes.set(title="Runs above a level", xlabel=_label(outcome), ylabel="Share of runs", ylim=(0, 1.02))
    axes.xaxis.set_major_locator(round_ticks(4))
    set_shares(axes)
    if _are_shares(outcome):
        set_shares(axes, upright=False)


def _beside(values: np.ndarray, reach: float) -> np.ndarray:
    """Return how far from their row's middle the dots of (runs,) lie: those that are alike, apart."""
    beside = np.zeros(len(values))
    near = np.round(values / (DOT_SHARE * reach or 1.0))
    for place in np.unique(near):
        alike = np.flatnonzero(near == place)
        step = min(0.09, 0.6 / len(alike))
        beside[alike] = step * (np.arange(len(alike)) - (len(alike) - 1) / 2)
    return beside


def _mark() -> float:
    return float(mpl.rcParams["lines.markersize"])


def _are_shares(outcome: str) -> bool:
    return find_outcome(outcome).bounds == (0.0, 1.0)


def _label(outcome: str) -> str:
    return "Share killed" if _are_shares(outcome) else "Return of an episode"


def _entries(axes: Axes, table: pd.DataFrame) -> dict[str, Any]:
    """Return what the legend says of a row's marks, and of the players' levels."""
    run: Any = {"color": GREY, "marker": "o", "linestyle": "", "markersize": 3}
    iqm: Any = {"color": INK, "marker": "s", "markersize": 4, "markerfacecolor": "white"}
    entries = {"a run": Line2D([], [], **run)}
    entries["mean, 95 % interval"] = Line2D([], [], color=INK, marker="D", markersize=4)
    if (table["statistic"].eq("iqm") & table["runs"].ge(FEW_RUNS)).any():
        entries["interquartile mean, 95 % interval"] = Line2D([], [], **iqm)
    handles, labels = axes.get_legend_handles_labels()
    return {**entries, **dict(zip(labels, handles, strict=True))}


def _caption(data: StudyData, outcome: str, values: Values, improved: bool) -> list[str]:
    """Return what to mind in this summary: sentences, the gravest first."""
    words = find_outcome(outcome).words
    told = [f"{words[:1].upper()}{words[1:]}."]
    if is_return(outcome) and not have_one_return(data):
        told.append("Returns of unlike rewards, or of more players, cannot be compared.")
    if step := common_step(data):
        told.append(f"All as they stood at {step:,} steps, {step_words(data)}.")
    for name, known in values.items():
        total = len(data.of_condition(name))
        if len(known) < total:
            told.append(f"{total - len(known)} of {total} runs of {name} have no value, and count nowhere.")
    if any(len(known) < FEW_RUNS for known in values.values()):
        told.append(f"Of fewer than {FEW_RUNS} runs there is no interval.")
    if any(len(known) >= FEW_RUNS for known in values.values()):
        told.append("Intervals: Student's t for means, else bootstrap.")
    if improved:
        told.append(f"The baseline is {data.record['baseline']}; a tie counts half.")
    return told
