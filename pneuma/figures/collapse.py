"""The figure of collapses: every collapsed run's signs around its onset, and how often it comes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, FuncFormatter

from pneuma.analysis import ACTION_QUANTITIES
from pneuma.analysis.collapse import DEPTH, FALLEN_TO, SHORTEST, diagnoses, incidence
from pneuma.analysis.run_view import Series, common_step, view
from pneuma.analysis.signs import LEAST_ENTROPY, MOST_OF_ONE, NO_ENTROPY
from pneuma.analysis.tables import FinishedRun, StudyData
from pneuma.errors import UserError
from pneuma.figures.captions import absent_told, forks_told, headline_of
from pneuma.figures.crossed import row_names
from pneuma.figures.looks import condition_looks, told_apart
from pneuma.figures.panel import BELOW_ZERO, per_cent, whole_ticks
from pneuma.figures.sizes import SIZES
from pneuma.figures.style import house_style, save_figure
from pneuma.figures.words import Words, wrap_label

SIZE = SIZES["page"]
PANELS_INCHES, LONGEST_INCHES, BAR_INCHES = 3.5, 7.6, 0.24
"""Heights of the panels: the usual one, the greatest with which a figure fits a page, and a condition's."""
FEW_ROWS, MOST_ROWS = 10, 24
"""Conditions up to which their names have the usual size, and up to which all are shown."""
LABEL_CHARACTERS = 32
"""Of a line of a condition's name, so that it leaves room for the panels."""
LEAST_SHOWN = 0.01
"""What the axis of monsters killed reaches to, so that nothing is seen to be nothing."""
WHOLE = {"entropy": float(np.log(5)), "action": 1.0, "dead_units": 1.0}
"""What other axes reach to, so that what has no entropy from the first is not seen to fall."""
THRESHOLDS = {"entropy": LEAST_ENTROPY, "action": MOST_OF_ONE}
"""Beyond which a policy is down to one action."""

Fall = tuple[FinishedRun, np.ndarray, np.ndarray]
"""A run that collapsed, steps from its onset, (points,), and a quantity's values there."""

PANELS = {
    "entropy": "Entropy (nats)",
    "action": "Most frequent action",
    "dead_units": "Dead units",
    "share_killed": "Monsters killed",
}


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
    blind = dict(zip(shares["condition"], shares["unknown"], strict=True))
    shares = shares[shares["runs"] > 0]
    if shares.empty:
        raise UserError(
            f"study {data.study}: no run has evaluations or an entropy, in which a collapse shows"
        )
    shown = shares if len(shares) <= MOST_ROWS else shares[shares["collapsed"] > 0]
    collapsed = {row["run_id"]: row["onset_step"] for row in found[found["collapsed"]].to_dict("records")}
    held = _held(data, collapsed)
    colours = _colours(data, list(shares["condition"][shares["collapsed"] > 0]))
    caption = _caption(data, list(held), shown, len(shares) - len(shown), blind)
    words = Words(headline_of(data, _told(shares)), "", caption)
    with house_style(SIZE.type_points):
        figure = Figure(layout="constrained")
        mosaic = _mosaic(list(held))
        ratios = (*[1] * (len(mosaic[0]) - 1), 0.9)
        panels = figure.subplot_mosaic(mosaic, width_ratios=ratios)
        for name in list(held)[1:]:
            panels[name].sharex(panels[next(iter(held))])
        for name, series in held.items():
            _draw_panel(panels[name], colours, series, name)
            panels[name].set_title(PANELS[name])
        _draw_bars(panels["bars"], colours, shown)
        height = PANELS_INCHES if len(mosaic) > 1 else 0.7 * PANELS_INCHES
        words.put(figure, SIZE, max(height, min(BAR_INCHES * len(shown) + 0.5, LONGEST_INCHES)), {})
        return save_figure(figure, folder, stem, formats, SIZE.dots_per_inch)


def _colours(data: StudyData, collapsed: Sequence[str]) -> dict[str, str]:
    """Return every condition's colour; those of which runs collapsed are told apart by nothing else."""
    looks = condition_looks(data.conditions)
    return {name: look["color"] for name, look in looks.items()} | told_apart(looks, collapsed)


def _held(data: StudyData, collapsed: Mapping[str, float]) -> dict[str, list[Fall]]:
    """Return the panels of what is held of any run that collapsed, and its runs."""
    runs = [run for run in data.runs if run.run_id in collapsed]
    held = {
        name: [_fall(run, _series(data, run, name), collapsed[run.run_id]) for run in runs] for name in PANELS
    }
    return {name: falls for name, falls in held.items() if any(len(step) for _, step, _ in falls)}


def _mosaic(names: Sequence[str]) -> list[Any]:
    """Return where panels lie: up to two below each other, with the bars at their right."""
    if not names:
        return [["bars"]]
    rows = min(len(names), 2)
    columns = -(-len(names) // rows)
    lines = [[*names[row * columns : (row + 1) * columns]] for row in range(rows)]
    return [[*line, *["."] * (columns - len(line)), "bars"] for line in lines]


def _told(shares: pd.DataFrame) -> str:
    return f"{shares['collapsed'].sum()} of {shares['runs'].sum()} runs collapsed"


def _caption(
    data: StudyData, held: Sequence[str], shown: pd.DataFrame, left_out: int, blind: Mapping[str, int]
) -> list[str]:
    left, bars = _left(held), "share of each condition's runs that collapsed"
    dashed = "dashed: " if any(name in held for name in THRESHOLDS) else ""
    hollow = "Hollow: no longer so at the end." * bool(shown["recovered"].any())
    none = f"In {left_out} other conditions no run collapsed." if left_out else ""
    _, rows = row_names(list(shown["condition"]), LABEL_CHARACTERS)
    forked = any(run.begun for run in data.runs)
    mind = ["Of a fork its parent's best is not known: a fall from that is not seen."] if forked else []
    if common_step(data):
        mind.append("Budgets are unlike: each run is looked at over its own.")
    if any(blind.values()):
        told = ", ".join(f"{count} of {name}" for name, count in blind.items() if count)
        mind.append(f"Of some runs nothing is recorded that a collapse shows in: {told}.")
    unseen = {run.condition for run in data.runs if NO_ENTROPY not in run.records.signs()}
    if unseen := {name for name in unseen if len(data.of_condition(name)) > blind[name]}:
        told = ", ".join(name for name in data.conditions if name in unseen)
        none = f"Of {told} no entropy is recorded, and only a fall is seen. {none}"
    return [
        f"{', '.join(data.environments)}. {left}{bars if left else bars.capitalize()}; "
        "lines: 95 % intervals (Clopper and Pearson).",
        f"Collapsed: in most updates over {100 * SHORTEST:g} % of the budget down to one action "
        f"({dashed}{LEAST_ENTROPY:g} nats, {100 * MOST_OF_ONE:g} % of actions), or in two evaluations in a "
        f"row at {100 * FALLEN_TO:g} % of its best at most and {100 * DEPTH:g} points below it.",
        *filter(None, [hollow, rows, none]),
        *forks_told(data),
        *absent_told(data),
        *mind,
    ]


def _left(held: Sequence[str]) -> str:
    """Say what the panels on the left are; '' where there is none."""
    if not held:
        return ""
    smoothed = "means over 5 % of the budget, and " if list(held) != ["share_killed"] else ""
    return (
        "Left: each run that collapsed, in its condition's colour, by its steps before and after the onset; "
        f"{smoothed}single evaluations. Right: "
    )


def _draw_panel(axes: Axes, colours: Mapping[str, str], falls: Sequence[Fall], name: str) -> None:
    axes.axvline(0, color="#999999", linewidth=0.8)
    if name in THRESHOLDS:
        axes.axhline(THRESHOLDS[name], color="#999999", linewidth=0.8, linestyle="--")
    faint = 0.8 if len(falls) < 20 else 0.4
    for run, step, values in falls:
        axes.plot(step, values, color=colours[run.condition], linewidth=0.7, alpha=faint)
    axes.xaxis.set_major_locator(whole_ticks(4))
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    axes.yaxis.set_major_locator(whole_ticks(5))
    if name != "entropy":
        axes.yaxis.set_major_formatter(FuncFormatter(per_cent))
    highest = max(axes.dataLim.y1, LEAST_SHOWN)
    top = 1.02 * max(highest, WHOLE.get(name, 0))  # magic's two actions more have more entropy
    axes.set_ylim(-BELOW_ZERO * top, top)  # what is 0 throughout is still seen
    axes.set_xlabel("Steps from onset")


def _fall(run: FinishedRun, series: Series, onset: float) -> Fall:
    step, values = series
    return run, step - onset, values


def _series(data: StudyData, run: FinishedRun, name: str) -> Series:
    seen = view(data, run)
    if name == "share_killed":
        return seen.evaluations(name)
    if name != "action":
        return seen.curve(name)
    shares = [data.curve(run, action) for action in ACTION_QUANTITIES if action in data.quantities]
    if not shares:
        return np.empty(0), np.empty(0)
    most = np.max(shares, axis=0)  # (points,)
    return data.grid[np.isfinite(most)], most[np.isfinite(most)]


def _draw_bars(axes: Axes, colours: Mapping[str, str], shares: pd.DataFrame) -> None:
    rows: Sequence[dict[Any, Any]] = shares.to_dict("records")
    for place, row in enumerate(rows):
        colour = colours[row["condition"]]
        axes.barh(place, row["share"], height=0.55, color=colour, alpha=0.6)
        again = row["recovered"] / row["runs"] if row["runs"] else 0
        axes.barh(
            place, again, left=row["share"] - again, height=0.55, color="white", edgecolor=colour, linewidth=1
        )
        axes.plot([row["low"], row["high"]], [place, place], color="#222222", linewidth=1.1)
        if not row["collapsed"]:
            axes.plot(0, place, marker="o", markersize=3, color=colour, clip_on=False, zorder=4)
    shown, _ = row_names(list(shares["condition"]), LABEL_CHARACTERS)
    names = [_bar_label(name, row) for name, row in zip(shown, rows, strict=True)]
    points = 72 * LONGEST_INCHES / max(len(rows), 1)
    axes.set_yticks(range(len(rows)), names, fontsize=7 if len(rows) <= FEW_ROWS else min(6.2, 0.8 * points))
    axes.set(xlim=(0, 1), ylim=(len(rows) - 0.5, -0.5), xlabel="Share of runs", title="How often")
    axes.set_xticks((0, 0.5, 1))
    axes.xaxis.set_major_formatter(FuncFormatter(per_cent))
    axes.grid(visible=False, axis="y")


def _bar_label(name: str, row: dict[Any, Any]) -> str:
    """Return a condition, broken where it would take the panels' room, and how many of its runs collapsed."""
    count = f"{row['collapsed']} of {row['runs']}".replace(" ", "\u00a0")
    lines = wrap_label(name, LABEL_CHARACTERS) or [""]
    return "\n".join([*lines[:-1], *wrap_label(f"{lines[-1]}: {count}", LABEL_CHARACTERS)])
