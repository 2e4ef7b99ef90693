"""Summaries of outcomes: every run with means.

They show the share of monsters killed at the end, or the return if there are no monsters or no evaluations.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
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
from pneuma.figures.grid import LEAST_ROW_INCHES, LONGEST_INCHES, ROW_INCHES, Page, Panel
from pneuma.figures.origin import lines_of_runs
from pneuma.figures.style import GREY, INK
from pneuma.figures.words import (
    capital,
    headline_of,
    label_of,
    merge_notes,
    notes_of,
    short_names,
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
    """An outcome of the runs of a study, a row for each condition that has runs."""

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
        trained = [name for name in self.data.conditions if self.data.of_condition(name)]
        return {name: known_values(self.data, name, self.outcome) for name in trained}

    @cached_property
    def table(self) -> pd.DataFrame:
        table = summary_table(self.data, [self.outcome])
        return table[table["outcome"] == self.outcome]

    @property
    def words(self) -> str:
        return capital(find_outcome(self.outcome).words)

    @property
    def heading(self) -> str:
        """The words up to the last comma; `detail` is the rest."""
        return self.words.rpartition(", ")[0] or self.words

    @property
    def detail(self) -> str:
        return capital(self.words.removeprefix(self.heading).removeprefix(", "))

    @property
    def of_killed(self) -> bool:
        """Whether it is a share of monsters, which can be compared with the random player's."""
        return self.outcome.endswith("share-killed")

    @property
    def measured(self) -> str:
        """The words of the axis."""
        measured = "Return of an episode" if is_return(self.outcome) else find_outcome(self.outcome).unit
        return "Share killed" if self.of_killed else measured

    def labels(self, named: Mapping[str, str] | None) -> list[str]:
        """Return the labels of rows: counts of runs, after the names of conditions if there are any."""
        names = {**named, **self.data.study.labels} if named else {}
        return [label_of(self.data, name, names.get(name, " ")).strip() for name in self.values]

    @property
    def all_values(self) -> np.ndarray:
        return np.concatenate([*self.values.values(), []])

    @property
    def notes(self) -> list[str]:
        notes = [*notes_of(self.data, is_return(self.outcome)), self.data.ends]
        for name, known in self.values.items():
            total = len(self.data.of_condition(name))
            if not len(known):
                notes.append(f"{name} has no value.")
            elif len(known) < total:
                lacking = f"{total - len(known)} of {total} runs of {name}"
                notes.append(f"{lacking} have no value, and count nowhere.")
        counts = [len(known) for known in self.values.values()]
        few = any(0 < count < LEAST_RUNS for count in counts)
        notes += [f"Of fewer than {LEAST_RUNS} runs there is no interval."] * few
        enough = any(count >= LEAST_RUNS for count in counts)
        return [*notes, *["Intervals: Student's t for means, else bootstrap."] * enough]


def summary_page(studies: StudyData | Mapping[str, StudyData], basename: str = "") -> Page:
    """Return what every run of a study came to, in all outcomes that it names.

    Of several worlds, by title, it is the one outcome that the study names, or the usual one. Each has a row
    for each condition that has runs there.
    """
    drawn, one_study = _outcomes_of(studies), isinstance(studies, StudyData)
    alone = next(iter(drawn.values()))
    colours: dict[str, str] = {}  # of a condition, in all columns that of the first that has it
    for found in drawn.values():
        looks = styles_of(found.data)
        colours |= {name: looks[name]["color"] for name in found.values if name not in colours}
    named, parts = short_names([found.data for found in drawn.values()], [*colours])
    alike = all(found.values.keys() == colours.keys() for found in drawn.values())
    most = max(len(found.values) for found in drawn.values())
    pitch = min(max(LONGEST_INCHES / most, LEAST_ROW_INCHES), ROW_INCHES)
    killed = [share for found in drawn.values() if found.of_killed for share in found.all_values]
    highest, lowest = max([0.0, *killed]), min(killed, default=0.0)
    least = math.floor(20 * lowest) / 20 if len(drawn) == 1 and lowest > FAR_FROM_ZERO else 0.0

    def panel(title: str, found: OutcomeRows) -> Panel:
        labels = found.labels(named)
        draw = partial(_draw_runs, found=found, colours=colours, pitch=pitch, ends=(least, highest))
        shares = grid.shares if alike else partial(grid.shares, most=3)  # beside names panels are narrow
        ticks = shares if found.of_killed else grid.few
        empty = [""] * (most - len(labels))
        left = Panel(draw, title, found.measured, x_ticks=ticks, rows=[*labels, *empty])
        if found is alone or not alike:
            return left
        # in all panels of one study are the same runs
        beside = [""] * len(labels) if one_study else found.labels(None)
        return replace(left, rows=[*beside, *empty], at_left=left)

    notes = merge_notes(
        {
            title: (found.data, [said and f"{said}.", *found.notes])
            for title, found in drawn.items()
            for said in [found.detail if one_study else found.words]
        }
    )
    budgets = {steps for each in drawn.values() for steps in each.data.runs["steps"]}
    shown = f"after {budgets.pop():,} steps" if len(budgets) == 1 else "at the end of training"
    return Page(
        basename or alone.data.basename("summary"),
        [[panel(*each) for each in drawn.items()]],
        max(pitch * most + 0.7, 0.6 * style.PANEL_INCHES),
        headline_of(alone.data, shown) if one_study else f"{alone.data.study.title}: {shown}",
        lines_of_runs(*(found.data for found in drawn.values())),
        _marks(max(len(runs) for found in drawn.values() for runs in found.values.values())),
        [*notes, parts and f"Rows: {parts}."],
        [1] * len(drawn),
    )


def _outcomes_of(studies: StudyData | Mapping[str, StudyData]) -> Mapping[str, OutcomeRows]:
    """Return what has a panel, by title: the outcomes of a study, or one of it in each of several worlds."""
    if isinstance(studies, StudyData):
        every = [OutcomeRows(studies, name) for name in studies.study.outcomes or [""]]
        short_titles = {each.heading: each for each in every}
        return short_titles if len(short_titles) == len(every) else {each.words: each for each in every}
    return {
        title: OutcomeRows(data, "".join(data.study.outcomes[: len(data.study.outcomes) == 1]))
        for title, data in studies.items()
    }


def _draw_runs(
    axes: Axes, found: OutcomeRows, colours: Mapping[str, str], pitch: float, ends: tuple[float, float]
) -> None:
    """Draw each run of a condition as a dot, and its means with intervals.

    `pitch` is the height of rows in inches; `ends` are where axes of shares killed begin, and the greatest
    share in any panel.
    """
    mark = 0.5 * style.text_points() * pitch / ROW_INCHES
    reach = float(np.ptp([*found.all_values, 0.0]))
    for place, (condition, runs) in enumerate(found.values.items()):
        colour = colours[condition]
        (dots,) = axes.plot(
            runs, place + _beside(runs, reach), "o", color=colour, markersize=0.6 * mark,
            markeredgewidth=0, alpha=0.7 if len(runs) < 20 else 0.4, clip_on=False, zorder=2.6,
        )  # fmt: skip
        dots.set_in_layout(False)  # there may be none
        for row in found.table[found.table["condition"] == condition].to_dict("records"):
            if row["statistic"] == "mean" and len(runs) > 1:
                grid.draw_interval(axes, place - ABOVE, row, markerfacecolor=colour, markersize=mark)
            elif row["statistic"] == "iqm" and len(runs) >= LEAST_RUNS:
                iqm: Any = {"marker": "s", "markerfacecolor": "white", "markersize": mark}
                grid.draw_interval(axes, place + ABOVE, row, **iqm)
    if found.of_killed:
        levels = random_levels(found.data, "share_killed")
        begin, top = ends
        grid.draw_random_player(axes, levels, top, colours, [*found.values])
        axes.set_xlim(begin, max(axes.get_xlim()[1], 1.05 * (top - begin) + begin, begin + 0.01))

    elif found.outcome == "final-return":
        returns = random_returns(found.data)
        if returns is not None and len(returns):
            level = float(returns.iloc[-1])
            axes.axvline(level, label=f"{grid.RANDOM_PLAYER} ({grid.number(level)})", **grid.RANDOM_LOOK)


def _beside(values: np.ndarray, reach: float) -> np.ndarray:
    """Return the vertical offsets of (runs,) dots, so that similar ones do not overlap."""
    beside = np.zeros(len(values))
    near = np.round(values / (DOT_SHARE * reach or 1.0))
    for place in np.unique(near):
        alike = np.flatnonzero(near == place)
        step = min(0.09, 0.6 / len(alike))
        beside[alike] = step * (np.arange(len(alike)) - (len(alike) - 1) / 2)
    return beside


def _marks(most: int) -> dict[str, Any]:
    """Return the legend of panels in which a condition has at most so many runs."""
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
