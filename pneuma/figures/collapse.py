"""The figure of collapses: the signs of each collapsed run around its onset, and the incidence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.collections import LineCollection

from pneuma.analysis.collapse import diagnoses, incidence
from pneuma.analysis.frames import RunView, StudyData, common_step, figure_basename, view
from pneuma.analysis.outcomes import is_foreign
from pneuma.errors import UserError
from pneuma.figures import grid, style
from pneuma.figures.grid import LONGEST_INCHES, Page, Panel, in_grid
from pneuma.figures.origin import samples_of
from pneuma.figures.style import GREY, INK
from pneuma.figures.words import headline_of, notes_of, styles_of
from pneuma.study.quantities import ACTION_QUANTITIES
from pneuma.study.series import LEAST_ENTROPY, LOSS, MOST_OF_ONE, NO_ENTROPY, Series

PANELS_INCHES, BAR_INCHES = 3.5, 0.24
"""Heights in inches: of panels as usual, and of a condition's row."""
MOST_ROWS = 24
"""With more conditions than this, only those with a collapse are shown."""

PANELS = {
    "entropy": ("Entropy (nats)", float(np.log(5)), LEAST_ENTROPY),
    "action": ("Most used action", 1.0, MOST_OF_ONE),
    "dead_units": ("Dead units", 1.0, None),
    "share_killed": ("Monsters killed", 0.01, None),
    "return": ("Return", 0.0, None),
}
"""Title; least upper end of the axis; level beyond which a policy has one action."""

Colours = Mapping[str, str]


def collapse_page(data: StudyData, found: pd.DataFrame | None = None) -> Page:
    """Return the figure of a study's collapses.

    On the left are the curves of every run that collapsed, with steps counted from the onset. On the right is
    the share of each condition's runs that collapsed, with its interval. `found` are the `diagnoses`.
    """
    found = diagnoses(data) if found is None else found
    shares = incidence(data, found)
    known = shares[shares["runs"] > 0]
    if known.empty:
        raise UserError(
            f"study {data.study}: no run has evaluations or an entropy, in which a collapse shows"
        )
    shown = known if len(known) <= MOST_ROWS else known[known["collapsed"] > 0]
    onsets = {row["run_id"]: row["onset_step"] for row in found[found["collapsed"]].to_dict("records")}
    by_return = is_foreign(data) or found["signs"].str.contains(LOSS).any()  # else it decides nothing
    colours = {name: look["color"] for name, look in styles_of(data).items()}
    falls = [_falls(data, name, onsets, colours) for name in PANELS if name != "return" or by_return]
    names, parts = style.short_names(list(shown["condition"]))
    counts: list[dict[Any, Any]] = shown.to_dict("records")
    labels = [f"{names[row['condition']]} ({row['collapsed']} of {row['runs']})" for row in counts]
    bars = Panel(
        partial(_draw_bars, colours=colours, rows=counts),
        "How often",
        "Share of runs",
        x_ticks=_halves,
        rows=labels,
    )
    panels = [panel for panel in falls if panel]
    rows = 2 if len(panels) > 1 else 1
    cells = in_grid(panels, -(-len(panels) // rows)) if panels else [[]]
    usual = PANELS_INCHES if rows > 1 else 0.7 * PANELS_INCHES
    return Page(
        figure_basename(data, "collapse"),
        [[*row, bars] for row in cells],
        max(usual, min(BAR_INCHES * len(shown) + 0.5, LONGEST_INCHES)),
        headline_of(data, f"{known['collapsed'].sum()} of {known['runs'].sum()} runs collapsed"),
        samples_of(data),
        caption=[*_caption(data, found, shares, len(known) - len(shown)), parts and f"Rows: {parts}."],
    )


def _falls(data: StudyData, name: str, onsets: Mapping[str, int], colours: Colours) -> Panel | None:
    """Return one of `PANELS` for the runs that collapsed; None if none has data for it."""
    runs = [run for run in data.runs if run.run_id in onsets]
    falls = [
        (step - onsets[run.run_id], values, colours[run.condition])
        for run in runs
        for step, values in [_series(data, view(data, run), name)]
        if len(step)
    ]
    shares = grid.numbers if name in ("entropy", "return") else grid.shares
    draw = partial(_draw_falls, name=name, falls=falls)
    ticks = partial(grid.steps, most=4)
    return Panel(draw, PANELS[name][0], "Steps from onset", x_ticks=ticks, y_ticks=shares) if falls else None


def _series(data: StudyData, seen: RunView, name: str) -> Series:
    if name == "share_killed" or (name == "return" and is_foreign(data)):
        return seen.evaluations(name)
    if name != "action":
        return seen.curve(name)
    shares = [data.curve(seen.run, action) for action in ACTION_QUANTITIES if action in data.quantities]
    most = np.max(shares, axis=0) if shares else np.full(data.grid.shape, np.nan)
    return data.grid[np.isfinite(most)], most[np.isfinite(most)]


def _draw_falls(axes: Axes, name: str, falls: Sequence[tuple[np.ndarray, np.ndarray, str]]) -> None:
    """Draw one of `PANELS`; `falls` are steps from the onset, values and colour of each run."""
    _, reach, threshold = PANELS[name]
    axes.axvline(0, color=GREY, linewidth=0.8)
    if threshold is not None:
        axes.axhline(threshold, color=GREY, linewidth=0.8, linestyle="--")
    lines, colours = [np.column_stack(fall[:2]) for fall in falls], [fall[2] for fall in falls]
    alpha = 0.8 if len(falls) < 20 else 0.4
    axes.add_collection(LineCollection(lines, colors=colours, linewidths=0.7, alpha=alpha, zorder=2))
    axes.autoscale_view()
    if name == "return":
        axes.axhline(0, color=GREY, linewidth=0.8)
    else:
        top = 1.02 * max(axes.dataLim.y1, reach)
        axes.set_ylim(-grid.BELOW_ZERO * top, top)


def _draw_bars(axes: Axes, colours: Colours, rows: Sequence[Mapping[Any, Any]]) -> None:
    """Draw the share of collapsed runs of each condition; the recovered part is hollow."""
    for place, row in enumerate(rows):
        colour, again = colours[row["condition"]], row["recovered"] / row["runs"]
        axes.barh(place, row["share"], height=0.55, color=colour, alpha=0.6)
        hollow: Any = {"height": 0.55, "color": "white", "edgecolor": colour, "linewidth": 1}
        axes.barh(place, again, left=row["share"] - again, **hollow)
        axes.plot([row["low"], row["high"]], [place, place], color=INK, linewidth=1.1)
        if not row["collapsed"]:
            axes.plot(0, place, marker="o", markersize=3, color=colour, clip_on=False, zorder=4)
    axes.set(xlim=(0, 1))


def _halves(axis: Axis) -> None:
    grid.shares(axis)
    axis.set_ticks((0, 0.5, 1))


def _caption(data: StudyData, found: pd.DataFrame, shares: pd.DataFrame, left_out: int) -> list[str]:
    notes = notes_of(data)
    if blind := shares["unknown"].sum():
        notes.append(f"Left out: {blind} runs without records that a collapse shows in.")
    unseen = found[found["collapsed"].notna() & found["unseen"].str.contains(NO_ENTROPY)]["condition"]
    if len(unseen):
        notes.append(f"Of {', '.join(dict.fromkeys(unseen))} no entropy is recorded: one action is not seen.")
    if any(run.begun for run in data.runs):
        notes.append("Of a fork its parent's best is not known: a fall from that is not seen.")
    if common_step(data):
        notes.append("Budgets differ: each run is looked at over its own.")
    hollow = "; hollow: recovered by the end" * bool(shares["recovered"].sum())
    notes.append("Dashed: beyond it a policy has one action.")
    notes.append(f"Bars: 95 % intervals (Clopper and Pearson){hollow}.")
    if left_out:
        notes.append(f"In {left_out} other conditions no run collapsed.")
    return notes
