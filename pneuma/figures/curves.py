"""The figure of a study: training return, and beside it the share of monsters killed in evaluation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, PercentFormatter

from pneuma.analysis.curves import BANDS, WINDOWS, Curve, evaluation_curves, training_curves
from pneuma.analysis.tables import load_table
from pneuma.figures.style import COLOURS, DASHES, house_style, save_figure
from pneuma.study.store import Store

WIDTH_INCHES, HEIGHT_INCHES = 7.0, 3.1


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
    killed = evaluation_curves(load_table(store, record, "evaluations"))
    order = list(dict.fromkeys(run["condition"] for run in record["runs"]))
    with house_style():
        figure = Figure(figsize=(WIDTH_INCHES, HEIGHT_INCHES), layout="constrained")
        left, right = figure.subplots(1, 2)
        _draw_panel(left, returns, order, band)
        _draw_panel(right, killed, order, band, marker="o")
        left.set(title="Return in training", xlabel="Environment steps", ylabel="Return of an episode")
        right.set(title="Monsters killed in evaluation", xlabel="Environment steps", ylabel="Share killed")
        right.set_ylim(bottom=0)
        right.yaxis.set_major_formatter(PercentFormatter(xmax=1, decimals=None))
        _add_legend(figure, left)
        figure.suptitle(_headline(record), fontsize=10, x=0.01, ha="left")
        figure.supxlabel(_caption(record, band, window), fontsize=6.5, color="#444444", x=0.01, ha="left")
        return save_figure(figure, folder, record["figure"], formats)


def _draw_panel(
    axes: Axes, curves: Sequence[Curve], order: Sequence[str], band: str, marker: str = ""
) -> None:
    for curve in sorted(curves, key=lambda curve: order.index(curve.condition)):
        place = order.index(curve.condition)
        look = {"color": COLOURS[place % len(COLOURS)], "linestyle": DASHES[place % len(DASHES)]}
        low, high = curve.band(band)
        axes.fill_between(curve.step, low, high, color=look["color"], alpha=0.16, linewidth=0)
        label = f"{curve.condition} (n = {len(curve.runs)})"
        axes.plot(curve.step, curve.mean, label=label, marker=marker, markersize=2.6, **look)  # type: ignore[arg-type]
    ends = [curve.step[-1] for curve in curves]
    axes.set_xlim(0, max(ends))
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    if np.ptp(axes.get_ylim()) > 5000:
        axes.yaxis.set_major_formatter(EngFormatter(sep=""))


def _add_legend(figure: Figure, axes: Axes) -> None:
    lines, labels = axes.get_legend_handles_labels()
    figure.legend(lines, labels, loc="outside lower center", ncols=min(len(labels), 4), handlelength=3.2)


def _headline(record: Mapping[str, Any]) -> str:
    same = [" = ".join(names) for names in record["same"]]
    return record["title"] + (f"   (A/A: {'; '.join(same)} are one configuration)" if same else "")


def _caption(record: Mapping[str, Any], band: str, window: str) -> str:
    episodes = {
        WINDOWS[0]: "episodes that ended in the last 5 % of the budget",
        WINDOWS[1]: "the last 100 episodes of each run",
    }[window]
    environment = ", ".join(dict.fromkeys(run["run"]["env"] for run in record["runs"]))
    return f"Mean over runs, band {BANDS[band].label}; return: {episodes}. {environment}"
