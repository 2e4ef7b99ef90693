"""The figure of collapses: every collapsed run's signs around its onset, and how often it comes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from pneuma.analysis import ACTION_QUANTITIES
from pneuma.analysis.collapse import DEPTH, FALLEN_TO, SHORTEST, diagnoses, incidence
from pneuma.analysis.frames import FinishedRun, StudyData
from pneuma.analysis.run_view import Series, common_step, view
from pneuma.analysis.signs import LEAST_ENTROPY, MOST_OF_ONE, NO_ENTROPY
from pneuma.errors import UserError
from pneuma.figures.panels import (
    BELOW_ZERO,
    headline_of,
    label_rows,
    notes_of,
    put_texts,
    round_ticks,
    set_shares,
)
from pneuma.figures.style import GREY, INK, condition_looks, house_style, save_figure, short_names

PANELS_INCHES, LONGEST_INCHES, BAR_INCHES = 3.5, 7.6, 0.24
"""Heights of the panels: the usual one, the greatest with which a figure fits a page, and a condition's."""
MOST_ROWS = 24
"""Conditions up to which all are shown; of more, those of which a run collapsed."""

PANELS = {
    "entropy": "Entropy (nats)",
    "action": "Most frequent action",
    "dead_units": "Dead units",
    "share_killed": "Monsters killed",
}
REACH = {"entropy": float(np.log(5)), "action": 1.0, "dead_units": 1.0, "share_killed": 0.01}
"""What axes reach to at least, so that what is nothing from the first is not seen to fall."""
THRESHOLDS = {"entropy": LEAST_ENTROPY, "action": MOST_OF_ONE}
"""Beyond which a policy is down to one action."""

Fall = tuple[FinishedRun, np.ndarray, np.ndarray]
"""A run that collapsed, steps from its onset, (points,), and a quantity's values there."""


def collapsed_shares(data: StudyData) -> pd.DataFrame:
    """Return the `incidence` of conditions some of whose runs collapsed; no rows where none is known to."""
    if "evaluations" not in data.tables:
        return pd.DataFrame()
    shares = incidence(data)
    return shares[shares["collapsed"] > 0]


def draw_collapse(
    data: StudyData, folder: Path, stem: str, formats: tuple[str, ...] = ("png", "svg")
) -> list[Path]:
    """Draw a study's collapses; return the files written.

    On the left, where any run collapsed, every one that did, its steps counted from its onset, in what is
    held of its curves; on the right the share of each condition's runs that did, with its interval. Of many
    conditions those of which none did are left out on the right, and the caption says so.

    Raises:
        UserError: where no run has records that a collapse shows in.
    """
    found, shares = diagnoses(data), incidence(data)
    known = shares[shares["runs"] > 0]
    if known.empty:
        raise UserError(
            f"study {data.study}: no run has evaluations or an entropy, in which a collapse shows"
        )
    shown = known if len(known) <= MOST_ROWS else known[known["collapsed"] > 0]
    onsets = {row["run_id"]: row["onset_step"] for row in found[found["collapsed"]].to_dict("records")}
    held = _held(data, onsets)
    names, parts = short_names(list(shown["condition"]))
    with house_style():
        figure = Figure(layout="constrained")
        mosaic = _mosaic(list(held))
        panels = figure.subplot_mosaic(mosaic, width_ratios=[1.0] * len(mosaic[0]))
        colours = {name: look["color"] for name, look in condition_looks(data.conditions).items()}
        for name, falls in held.items():
            _draw_falls(panels[name], colours, falls, name)
        usual = PANELS_INCHES if len(mosaic) > 1 else 0.7 * PANELS_INCHES
        inches = max(usual, min(BAR_INCHES * len(shown) + 0.5, LONGEST_INCHES))
        _draw_bars(panels["bars"], colours, names, shown, inches)
        headline = f"{known['collapsed'].sum()} of {known['runs'].sum()} runs collapsed"
        caption = [
            *notes_of(data),
            *_caption(data, shares, len(known) - len(shown)),
            parts and f"Rows: {parts}.",
        ]
        put_texts(figure, inches, headline_of(data, headline), caption=caption)
        return save_figure(figure, folder, stem, formats)


def _held(data: StudyData, onsets: Mapping[str, float]) -> dict[str, list[Fall]]:
    """Return the panels of what is held of any run that collapsed, and its runs."""
    runs = [run for run in data.runs if run.run_id in onsets]
    held: dict[str, list[Fall]] = {name: [] for name in PANELS}
    for name, falls in held.items():
        for run in runs:
            step, values = _series(data, run, name)
            falls.append((run, step - onsets[run.run_id], values))
    return {name: falls for name, falls in held.items() if any(len(step) for _, step, _ in falls)}


def _series(data: StudyData, run: FinishedRun, name: str) -> Series:
    seen = view(data, run)
    if name == "share_killed":
        return seen.evaluations(name)
    if name != "action":
        return seen.curve(name)
    shares = [data.curve(run, action) for action in ACTION_QUANTITIES if action in data.quantities]
    most = np.max(shares, axis=0) if shares else np.full(data.grid.shape, np.nan)
    return data.grid[np.isfinite(most)], most[np.isfinite(most)]


def _mosaic(names: Sequence[str]) -> list[Any]:
    """Return where panels lie: up to two below each other, with the bars at their right."""
    if not names:
        return [["bars"]]
    rows = min(len(names), 2)
    columns = -(-len(names) // rows)
    lines = [[*names[row * columns : (row + 1) * columns]] for row in range(rows)]
    return [[*line, *["."] * (columns - len(line)), "bars"] for line in lines]


def _draw_falls(axes: Axes, colours: Mapping[str, str], falls: Sequence[Fall], name: str) -> None:
    axes.axvline(0, color=GREY, linewidth=0.8)
    if name in THRESHOLDS:
        axes.axhline(THRESHOLDS[name], color=GREY, linewidth=0.8, linestyle="--")
    for run, step, values in falls:
        faint = 0.8 if len(falls) < 20 else 0.4
        axes.plot(step, values, color=colours[run.condition], linewidth=0.7, alpha=faint)
    axes.xaxis.set_major_locator(round_ticks(4))
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    top = 1.02 * max(axes.dataLim.y1, REACH[name])
    axes.set_ylim(-BELOW_ZERO * top, top)
    if name != "entropy":
        set_shares(axes)
    axes.set(title=PANELS[name], xlabel="Steps from onset")


def _draw_bars(
    axes: Axes, colours: Mapping[str, str], names: Mapping[str, str], shares: pd.DataFrame, inches: float
) -> None:
    rows: Sequence[dict[Any, Any]] = shares.to_dict("records")
    for place, row in enumerate(rows):
        colour, again = colours[row["condition"]], row["recovered"] / row["runs"]
        axes.barh(place, row["share"], height=0.55, color=colour, alpha=0.6)
        hollow: Any = {"height": 0.55, "color": "white", "edgecolor": colour, "linewidth": 1}
        axes.barh(place, again, left=row["share"] - again, **hollow)
        axes.plot([row["low"], row["high"]], [place, place], color=INK, linewidth=1.1)
        if not row["collapsed"]:
            axes.plot(0, place, marker="o", markersize=3, color=colour, clip_on=False, zorder=4)
    labels = [f"{names[row['condition']]} ({row['collapsed']} of {row['runs']})" for row in rows]
    label_rows(axes, labels, inches / len(rows))
    axes.set(xlim=(0, 1), xlabel="Share of runs", title="How often")
    set_shares(axes, upright=False)
    axes.set_xticks((0, 0.5, 1))


def _caption(data: StudyData, shares: pd.DataFrame, left_out: int) -> list[str]:
    """Return what to mind in this figure: sentences, the gravest first."""
    told = []
    blind = {row["condition"]: row["unknown"] for row in shares.to_dict("records") if row["unknown"]}
    if blind:
        of = ", ".join(f"{count} of {name}" for name, count in blind.items())
        told.append(f"Runs without records that a collapse shows in: {of}.")
    unseen = {run.condition for run in data.runs if NO_ENTROPY not in run.records.signs()}
    if named := ", ".join(name for name in data.conditions if name in unseen and name not in blind):
        told.append(f"Of {named} no entropy is recorded, and only a fall is seen.")
    if any(run.begun for run in data.runs):
        told.append("Of a fork its parent's best is not known: a fall from that is not seen.")
    if common_step(data):
        told.append("Budgets are unlike: each run is looked at over its own.")
    endless = any(data.settings(run).get("xp_scope") != "episode" for run in data.runs)
    sunk = " or at a return below zero after one above," if endless else ""
    told.append(
        f"Collapsed: over {100 * SHORTEST:g} % of the budget down to one action ({LEAST_ENTROPY:g} nats, "
        f"{100 * MOST_OF_ONE:g} % of actions: dashed),{sunk} or twice in a row at {100 * FALLEN_TO:g} % of "
        f"its best at most and {100 * DEPTH:g} points below it."
    )
    told.append("Bars: 95 % intervals (Clopper and Pearson); hollow: recovered by the end.")
    if left_out:
        told.append(f"In {left_out} other conditions no run collapsed.")
    return told
