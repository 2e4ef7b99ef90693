"""The figure of a study: training return, and beside it the share of monsters killed in evaluation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, PercentFormatter

from pneuma.analysis.curves import BANDS, WINDOWS, Curve, evaluation_curves, training_curves
from pneuma.analysis.tables import load_table
from pneuma.figures.style import COLOURS, DASHES, MARKERS, house_style, save_figure
from pneuma.study.store import Store

WIDTH_INCHES, HEIGHT_INCHES = 7.0, 3.4
LEGEND_COLUMNS = 4


def draw_study(
    store: Store,
    record: Mapping[str, Any],
    folder: Path,
    band: str = "std",
    window: str = WINDOWS[0],
    formats: tuple[str, ...] = ("png", "svg"),
) -> list[Path]:
    """Draw a study's figure from the finished runs of a selection; return the files written.

    Raises:
        UserError: when no run has finished.
    """
    returns = training_curves(load_table(store, record, "episodes"), record, "return", window)
    evaluations = load_table(store, record, "evaluations")
    killed = evaluation_curves(evaluations)
    order = list(dict.fromkeys(run["condition"] for run in record["runs"]))
    with house_style():
        figure = Figure(figsize=(WIDTH_INCHES, HEIGHT_INCHES), layout="constrained")
        left, right = figure.subplots(1, 2)
        _draw_panel(left, returns, order, band)
        _draw_panel(right, killed, order, band, MARKERS)
        level = evaluations["random_share_killed"].mean()
        right.axhline(level, color="#777777", linewidth=0.9, linestyle=(0, (2, 2)), label="random player")
        left.set(title="Return in training", xlabel="Environment steps", ylabel="Return of an episode")
        right.set(title="Monsters killed in evaluation", xlabel="Environment steps", ylabel="Share killed")
        right.set_ylim(0, max(right.get_ylim()[1], 0.01))
        decimals = 0 if right.get_ylim()[1] > 0.05 else 1
        right.yaxis.set_major_formatter(PercentFormatter(xmax=1, decimals=decimals))
        _add_words(figure, right, _headline(record), _caption(record, evaluations, band, window))
        return save_figure(figure, folder, record["figure"], formats)


def _add_words(figure: Figure, axes: Axes, headline: str, caption: str) -> None:
    """Put the headline and a row or more of legend above the panels, and the caption below."""
    lines, labels = axes.get_legend_handles_labels()
    rows = -(-len(labels) // LEGEND_COLUMNS)
    top = 0.92 - 0.065 * rows
    figure.get_layout_engine().set(rect=(0, 0.1, 1, top - 0.1))  # type: ignore[union-attr, call-arg]
    figure.text(0.01, 0.94, headline, fontsize=10)
    figure.legend(
        lines, labels, loc="upper left", bbox_to_anchor=(0.0, 0.94), ncols=LEGEND_COLUMNS, handlelength=3.2
    )
    figure.text(0.01, 0.02, caption, fontsize=6.2, color="#444444", linespacing=1.4)


def _draw_panel(
    axes: Axes, curves: Sequence[Curve], order: Sequence[str], band: str, markers: Sequence[str] = ("",)
) -> None:
    for curve in sorted(curves, key=lambda curve: order.index(curve.condition)):
        place = order.index(curve.condition)
        look: dict[str, Any] = {
            "color": COLOURS[place % len(COLOURS)],
            "linestyle": DASHES[place % len(DASHES)],
            "marker": markers[place % len(markers)],
        }
        low, high = curve.band(band)
        axes.fill_between(curve.step, low, high, color=look["color"], alpha=0.16, linewidth=0)
        label = f"{curve.condition} (n = {len(curve.runs)})"
        axes.plot(curve.step, curve.mean, label=label, markersize=2.8, **look)
    ends = [curve.step[-1] for curve in curves]
    axes.set_xlim(0, max(ends))
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    if np.ptp(axes.get_ylim()) > 5000:
        axes.yaxis.set_major_formatter(EngFormatter(sep=""))


def _headline(record: Mapping[str, Any]) -> str:
    same = [" = ".join(names) for names in record["same"]]
    return record["title"] + (f"   (A/A: {'; '.join(same)} are one configuration)" if same else "")


def _caption(record: Mapping[str, Any], evaluations: pd.DataFrame, band: str, window: str) -> str:
    episodes = {
        WINDOWS[0]: "the episodes that ended in the last 5 % of the budget",
        WINDOWS[1]: "each run's last 100 episodes",
    }[window]
    environment = ", ".join(dict.fromkeys(run["run"]["env"] for run in record["runs"]))
    hunter = evaluations["hunter_share_killed"].mean()
    return (
        f"{environment}. Lines: mean over n runs; bands: {BANDS[band].label}. Return averages {episodes}.\n"
        f"On the scale of the right panel the scripted hunter kills {hunter:.0%}."
    )
