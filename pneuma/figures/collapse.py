"""The figure of collapses: every collapsed run's signs around its onset, and how often it comes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, PercentFormatter

from pneuma.analysis import ACTION_QUANTITIES
from pneuma.analysis.collapse import diagnoses, incidence
from pneuma.analysis.run_view import Series, view
from pneuma.analysis.tables import FinishedRun, StudyData
from pneuma.figures.style import condition_look, house_style, save_figure

WIDTH_INCHES, HEIGHT_INCHES = 7.0, 4.6
BAR_INCHES = 0.24

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

    On the left every run that collapsed, its steps counted from its onset; on the right the share of
    each condition's runs that did, with its interval.
    """
    found, shares = diagnoses(data), incidence(data)
    with house_style():
        height = max(HEIGHT_INCHES, 1.6 + BAR_INCHES * len(shares))
        figure = Figure(figsize=(WIDTH_INCHES, height), layout="constrained")
        figure.get_layout_engine().set(rect=(0, 0.54 / height, 1, 1 - 0.87 / height))  # type: ignore[union-attr, call-arg]
        panels = figure.subplot_mosaic(
            [["entropy", "action", "bars"], ["dead_units", "share_killed", "bars"]],
            width_ratios=(1, 1, 0.9),
        )
        collapsed = {row["run_id"]: row for row in found[found["collapsed"]].to_dict("records")}
        for name, title in PANELS.items():
            _draw_panel(panels[name], data, collapsed, name)
            panels[name].set_title(title)
        _draw_bars(panels["bars"], data, shares)
        figure.text(0.01, 1 - 0.2 / height, f"{data.title}: {_headline(shares)}", fontsize=10)
        figure.text(0.01, 0.07 / height, _CAPTION, fontsize=6.2, color="#444444", linespacing=1.4)
        return save_figure(figure, folder, stem, formats)


_CAPTION = (
    "Left: each run that collapsed, by its steps before and after the onset; means over 5 % of the budget, "
    "and\nsingle evaluations. Right: share of each condition's runs that collapsed; lines: 95 % intervals "
    "(Clopper and\nPearson). Hollow: the share that recovered."
)


def _headline(shares: pd.DataFrame) -> str:
    return f"{shares['collapsed'].sum()} of {shares['runs'].sum()} runs collapsed"


def _draw_panel(axes: Axes, data: StudyData, collapsed: dict[str, Any], name: str) -> None:
    axes.axvline(0, color="#333333", linewidth=0.8)
    for run in data.runs:
        if run.run_id not in collapsed:
            continue
        step, values = _series(data, run, name)
        look = condition_look(data.conditions.index(run.condition))
        mark = {"markersize": 2.2} if name == "share_killed" else {"marker": ""}
        shown = {**look, **mark, "linewidth": 1.0, "alpha": 0.75}
        axes.plot(step - collapsed[run.run_id]["onset_step"], values, **shown)
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    if name != "entropy":
        axes.yaxis.set_major_formatter(PercentFormatter(xmax=1, decimals=0, symbol=" %"))
    axes.set_ylim(bottom=0)
    axes.set_xlabel("Steps from onset")
    if not collapsed:
        axes.text(0.5, 0.5, "no run collapsed", transform=axes.transAxes, ha="center", color="#666666")


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


def _draw_bars(axes: Axes, data: StudyData, shares: pd.DataFrame) -> None:
    rows: Sequence[dict[Any, Any]] = shares.to_dict("records")
    for place, row in enumerate(rows):
        colour = condition_look(data.conditions.index(row["condition"]))["color"]
        axes.barh(place, row["share"], height=0.55, color=colour, alpha=0.6)
        again = row["recovered"] / row["runs"] if row["runs"] else 0
        axes.barh(
            place, again, left=row["share"] - again, height=0.55, color="white", edgecolor=colour, linewidth=1
        )
        axes.plot([row["low"], row["high"]], [place, place], color="#222222", linewidth=1.1)
    names = [f"{row['condition']}\n{row['collapsed']} of {row['runs']}" for row in rows]
    axes.set_yticks(range(len(rows)), names, fontsize=7 if len(rows) < 12 else 5)
    axes.set(xlim=(0, 1), ylim=(len(rows) - 0.5, -0.5), xlabel="Share of runs", title="How often")
    axes.xaxis.set_major_formatter(PercentFormatter(xmax=1, decimals=0, symbol=" %"))
    axes.grid(visible=False, axis="y")
