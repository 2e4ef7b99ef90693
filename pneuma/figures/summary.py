"""Summaries of outcomes: every run with means; and differences of conditions.

They show the share of monsters killed at the end, or the return if there are no monsters or no evaluations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from pneuma.analysis.curves import curve_names, random_levels
from pneuma.analysis.intervals import LEAST_RUNS
from pneuma.analysis.outcomes import (
    PRIMARY,
    find_outcome,
    is_foreign,
    is_return,
    outcome_values,
    primary,
)
from pneuma.analysis.study_data import StudyData
from pneuma.analysis.summaries import summary_table
from pneuma.figures import grid, style
from pneuma.figures.grid import LEAST_ROW_INCHES, LONGEST_INCHES, ROW_INCHES, Page, Panel, in_grid
from pneuma.figures.origin import samples_of
from pneuma.figures.style import GREY, INK
from pneuma.figures.words import (
    capital,
    format_counts,
    headline_of,
    label_of,
    merge_notes,
    notes_of,
    styles_of,
)

WITHOUT_EVALUATIONS = "final-return"
DOT_SHARE = 0.012
"""Width of a dot as a share of the axis; runs closer than this lie side by side."""
FAR_FROM_ZERO = 0.5
"""Of a single panel in which all runs kill a larger share, the axis begins near them, so that rows differ."""
ABOVE = 0.2
"""Distance of the mean above, and the interquartile mean below, a condition's row, in rows."""


# --- Every run ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class OutcomeRows:
    """An outcome of the runs of a study, a row for each condition."""

    data: StudyData
    named: str = ""

    @cached_property
    def outcome(self) -> str:
        if self.named:
            return self.named
        if is_foreign(self.data) and self.data.evaluated:
            return primary(self.data)
        return PRIMARY if "share_killed" in curve_names(self.data) else WITHOUT_EVALUATIONS

    @cached_property
    def values(self) -> dict[str, np.ndarray]:
        """The finite outcomes of the runs of each condition that has runs."""
        every = {
            name: outcome_values(self.data, name, self.outcome)
            for name in self.data.conditions
            if self.data.of_condition(name)
        }
        return {name: found[np.isfinite(found)] for name, found in every.items()}

    @cached_property
    def table(self) -> pd.DataFrame:
        table = summary_table(self.data, [self.outcome])
        return table[table["outcome"] == self.outcome]

    @property
    def words(self) -> str:
        return capital(find_outcome(self.outcome).words)

    @property
    def heading(self) -> str:
        return self._parts[0]

    @property
    def detail(self) -> str:
        """What the heading leaves out, as a sentence."""
        return f"{capital(self._parts[1])}." if self._parts[1] else ""

    @property
    def _parts(self) -> tuple[str, str]:
        head, _, detail = self.words.rpartition(", ")
        return (head, detail) if head else (detail, "")

    @property
    def of_killed(self) -> bool:
        """Whether it is a share of monsters, which can be compared with the random player's."""
        return self.outcome.endswith("share-killed")

    @cached_property
    def colours(self) -> dict[str, str]:
        return {name: look["color"] for name, look in styles_of(self.data).items()}

    @property
    def highest(self) -> float:
        return max((float(runs.max()) for runs in self.values.values() if len(runs)), default=0.0)

    def panel(
        self,
        colours: Mapping[str, str],
        short: Mapping[str, str],
        mark: float,
        ends: tuple[float, float],
        title: str,
    ) -> Panel:
        """Return the panel with a row for each name, in its colour.

        `short` has the names that are shown; `ends` are where axes of shares killed begin, and the greatest
        share in any panel.
        """
        names = list(colours)
        measured = "Return of an episode" if is_return(self.outcome) else find_outcome(self.outcome).unit
        labels = [
            label_of(self.data, name, short.get(name, " ")) if name in self.values else "" for name in names
        ]
        return Panel(
            partial(_draw_runs, found=self, colours=colours, mark=mark, ends=ends),
            title,
            "Share killed" if self.of_killed else measured,
            x_ticks=grid.shares if self.of_killed else grid.few,
            rows=[label.strip() or short.get(name, "") for name, label in zip(names, labels, strict=True)],
        )

    @property
    def notes(self) -> list[str]:
        notes = [*notes_of(self.data, is_return(self.outcome)), self.data.ends]
        for name, known in self.values.items():
            total = len(self.data.of_condition(name))
            if not len(known):
                notes.append(f"{name} has no value.")
            elif len(known) < total:
                notes.append(
                    f"{total - len(known)} of {total} runs of {name} have no value, and count nowhere."
                )
        if any(0 < len(known) < LEAST_RUNS for known in self.values.values()):
            notes.append(f"Of fewer than {LEAST_RUNS} runs there is no interval.")
        if any(len(known) >= LEAST_RUNS for known in self.values.values()):
            notes.append("Intervals: Student's t for means, else bootstrap.")
        return notes


def summary_page(studies: StudyData | Mapping[str, StudyData | None], basename: str = "") -> Page:
    """Return what every run of a study came to, in all outcomes that it names.

    Of several worlds, by title, it is the one outcome that the study names, or the usual one.
    """
    columns: Mapping[str, OutcomeRows | None]
    if isinstance(studies, StudyData):
        every = [OutcomeRows(studies, name) for name in studies.study.outcomes or [""]]
        short_titles = {each.heading: each for each in every}
        columns = short_titles if len(short_titles) == len(every) else {each.words: each for each in every}
    else:
        columns = {
            title: OutcomeRows(data, "".join(data.study.outcomes[: len(data.study.outcomes) == 1]))
            if data
            else None
            for title, data in studies.items()
        }
    drawn = {title: found for title, found in columns.items() if found}
    colours: dict[str, str] = {}  # of a condition, in all columns that of the first that has it
    for found in drawn.values():
        colours |= {name: found.colours[name] for name in found.values if name not in colours}
    names = list(colours)
    short, parts = style.short_names(names)
    pitch = min(max(LONGEST_INCHES / len(names), LEAST_ROW_INCHES), ROW_INCHES)
    mark = 0.5 * style.TYPE_POINTS * pitch / ROW_INCHES
    alone = next(iter(drawn.values()))
    top = max((found.highest for found in drawn.values() if found.of_killed), default=0.0)
    lowest = min((float(runs.min()) for runs in alone.values.values() if len(runs)), default=0.0)
    begin = math.floor(20 * lowest) / 20 if len(drawn) == 1 and lowest > FAR_FROM_ZERO else 0.0
    panels = [
        drawn[title].panel(colours, short if drawn[title] is alone else {}, mark, (begin, top), title)
        if title in drawn else grid.no_runs(title)
        for title in columns
    ]  # fmt: skip
    if one_study := isinstance(studies, StudyData):  # the same runs in all panels
        panels = [panels[0], *(replace(panel, rows=[""] * len(names)) for panel in panels[1:])]
    notes = merge_notes(
        {
            title: (found.data, [found.detail if one_study else f"{found.words}.", *found.notes])
            for title, found in drawn.items()
        }
    )
    budgets = {steps for each in drawn.values() for steps in each.data.runs["steps"]}
    shown = f"after {budgets.pop():,} steps" if len(budgets) == 1 else "at the end of training"
    return Page(
        basename or alone.data.basename("summary"),
        [panels],
        max(pitch * len(names) + 0.7, 0.6 * style.PANEL_INCHES),
        headline_of(alone.data, shown)
        if isinstance(studies, StudyData)
        else f"{alone.data.study.title}: {shown}",
        samples_of(*(found.data for found in drawn.values())),
        _marks([*drawn.values()]),
        [*notes, parts and f"Rows: {parts}."],
        [1 if title in drawn else grid.EMPTY_WIDTH for title in columns],
    )


def _draw_runs(
    axes: Axes, found: OutcomeRows, colours: Mapping[str, str], mark: float, ends: tuple[float, float]
) -> None:
    """Draw each run of a condition as a dot, and its means with intervals."""
    reach = float(np.ptp(np.concatenate([*found.values.values(), [0.0]])))
    for condition, runs in found.values.items():
        place, colour = list(colours).index(condition), colours[condition]
        (dots,) = axes.plot(
            runs, place + _beside(runs, reach), "o", color=colour, markersize=0.6 * mark,
            markeredgewidth=0, alpha=0.7 if len(runs) < 20 else 0.4, clip_on=False, zorder=2.6,
        )  # fmt: skip
        dots.set_in_layout(False)  # there may be none
        for row in found.table[found.table["condition"] == condition].to_dict("records"):
            if row["statistic"] == "mean" and len(runs) > 1:
                shown = row if len(runs) >= LEAST_RUNS else {**row, "low": np.nan, "high": np.nan}
                grid.draw_interval(axes, place - ABOVE, shown, markerfacecolor=colour, markersize=mark)
            elif row["statistic"] == "iqm" and len(runs) >= LEAST_RUNS:
                iqm: Any = {"marker": "s", "markerfacecolor": "white", "markersize": mark}
                grid.draw_interval(axes, place + ABOVE, row, **iqm)
    if found.of_killed:
        levels = random_levels(found.data, "share_killed")
        begin, top = ends
        grid.draw_random_player(axes, levels, top, colours, [*colours])
        axes.set_xlim(begin, max(axes.get_xlim()[1], 1.05 * (top - begin) + begin, begin + 0.01))


def _beside(values: np.ndarray, reach: float) -> np.ndarray:
    """Return the vertical offsets of (runs,) dots, so that similar ones do not overlap."""
    beside = np.zeros(len(values))
    near = np.round(values / (DOT_SHARE * reach or 1.0))
    for place in np.unique(near):
        alike = np.flatnonzero(near == place)
        step = min(0.09, 0.6 / len(alike))
        beside[alike] = step * (np.arange(len(alike)) - (len(alike) - 1) / 2)
    return beside


def _marks(drawn: Sequence[OutcomeRows]) -> dict[str, Any]:
    most = max((len(runs) for found in drawn for runs in found.values.values()), default=0)
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


# --- Differences -------------------------------------------------------------------------------------


def comparison_page(data: StudyData, table: pd.DataFrame, basename: str) -> Page:
    """Return differences of means with intervals: a panel per outcome, a row per comparison.

    The table contains the results of `compare_conditions` for several pairs.
    """
    every = dict.fromkeys(table["outcome"])
    finite = {*table["outcome"][np.isfinite(table["difference"])]} or {*every}
    outcomes = [name for name in every if name in finite]
    rows = -(-len(outcomes) // style.COLUMNS)
    columns, panels = -(-len(outcomes) // rows), []
    for place, name in enumerate(outcomes):
        compared = table[table["outcome"] == name].to_dict("records")
        found = find_outcome(name)
        shares = found.bounds == (0.0, 1.0)
        labels = [f"{row['a']} -\n{row['b']} ({_counts(table, row)})" for row in compared]
        draw = partial(_draw_differences, compared=compared)
        label, ticks = ("percentage points", grid.points) if shares else (found.unit, grid.few)
        panels.append(
            Panel(draw, name, label, x_ticks=ticks, rows=[""] * len(labels) if place % columns else labels)
        )
    caption = ["Differences of means of runs, with Welch's 95 % intervals.", *notes_of(data)]
    if lacking := [name for name in every if name not in finite]:
        caption.append(f"Without a finite difference: {', '.join(lacking)}.")
    inches = rows * (2 * ROW_INCHES * table["outcome"].value_counts().max() + 0.7)
    notes, runs = [*caption, data.ends], samples_of(data)
    headline = headline_of(data, "differences")
    return Page(basename, in_grid(panels, columns), inches, headline, runs, caption=notes)


def _draw_differences(axes: Axes, compared: list[dict[Any, Any]]) -> None:
    for place, row in enumerate(compared):
        grid.draw_interval(axes, place, {**row, "value": row["difference"]})
    axes.axvline(0, color=GREY, linewidth=0.9, zorder=1.2)


def _counts(table: pd.DataFrame, row: Mapping[Any, Any]) -> str:
    same = table[(table["a"] == row["a"]) & (table["b"] == row["b"])]
    return f"n = {format_counts(same['seeds_a'])} and {format_counts(same['seeds_b'])}"
