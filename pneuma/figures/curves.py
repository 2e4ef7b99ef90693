"""The figure of a study: training return, and beside it the share of monsters killed in evaluation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter, PercentFormatter

from pneuma.analysis import WINDOWS
from pneuma.analysis.curves import BANDS, Curve, evaluation_curves, training_curves
from pneuma.analysis.tables import StudyData
from pneuma.figures.style import condition_look, house_style, save_figure

WIDTH_INCHES, HEIGHT_INCHES = 7.0, 3.4
LEGEND_COLUMNS = 4
LEGEND_ROW_INCHES = 0.22


def draw_study(
    data: StudyData,
    folder: Path,
    band: str = "std",
    window: str | None = None,
    formats: tuple[str, ...] = ("png", "svg"),
) -> list[Path]:
    """Draw a study's figure from its finished runs; return the files written.

    Args:
        data: the study; without evaluations, as imported logs are, its return alone is drawn.
        folder: where to write.
        band: one of `BANDS`.
        window: one of the study's windows, the usual one when left out.
        formats: of `FIGURE_FORMATS`.

    Raises:
        UserError: for a window that the study's data does not have, or data without returns.
    """
    window = data.checked_window(window)
    returns = training_curves(data, "return", window)
    evaluations = data.table("evaluations") if "evaluations" in data.tables else None
    with house_style():
        rows = -(-(len(data.conditions) + 1) // LEGEND_COLUMNS)
        height = HEIGHT_INCHES + LEGEND_ROW_INCHES * (rows - 1)
        figure = Figure(figsize=(WIDTH_INCHES, height), layout="constrained")
        panels = figure.subplots(1, 1 if evaluations is None else 2, squeeze=False)[0]
        _draw_returns(panels[0], data, returns, band)
        if evaluations is not None:
            _draw_killed(panels[1], data, evaluations, band)
        _add_words(figure, panels[-1], _headline(data), _caption(data, evaluations, band, window))
        return save_figure(figure, folder, data.figure, formats)


def _draw_returns(axes: Axes, data: StudyData, curves: Sequence[Curve], band: str) -> None:
    _draw_panel(axes, data, curves, band)
    averaged = data.averaged_over
    axes.set(
        title="Return in training",
        xlabel="Environment steps",
        ylabel=f"Return, mean of {averaged} episodes" if averaged else "Return of an episode",
    )


def _draw_killed(axes: Axes, data: StudyData, evaluations: pd.DataFrame, band: str) -> None:
    _draw_panel(axes, data, evaluation_curves(data), band, marked=True)
    if len(evaluations):
        level = evaluations["random_share_killed"].mean()
        axes.axhline(level, color="#777777", linewidth=0.9, linestyle=(0, (2, 2)), label="random player")
    axes.set(title="Monsters killed in evaluation", xlabel="Environment steps", ylabel="Share killed")
    axes.set_ylim(0, max(axes.get_ylim()[1], 0.01))
    axes.yaxis.set_major_formatter(PercentFormatter(xmax=1, decimals=None))


def _add_words(figure: Figure, axes: Axes, headline: str, caption: str) -> None:
    """Put the headline and a row or more of legend above the panels, and the caption below."""
    lines, labels = axes.get_legend_handles_labels()
    rows = -(-len(labels) // LEGEND_COLUMNS)
    height = figure.get_size_inches()[1]
    top, bottom = 1 - (0.27 + LEGEND_ROW_INCHES * rows) / height, 0.34 / height
    figure.get_layout_engine().set(rect=(0, bottom, 1, top - bottom))  # type: ignore[union-attr, call-arg]
    figure.text(0.01, 1 - 0.2 / height, headline, fontsize=10)
    figure.legend(
        lines,
        labels,
        loc="upper left",
        bbox_to_anchor=(0.0, 1 - 0.2 / height),
        ncols=LEGEND_COLUMNS,
        handlelength=3.2,
    )
    figure.text(0.01, 0.07 / height, caption, fontsize=6.2, color="#444444", linespacing=1.4)


def _draw_panel(
    axes: Axes, data: StudyData, curves: Sequence[Curve], band: str, marked: bool = False
) -> None:
    for curve in curves:
        look = condition_look(data.conditions.index(curve.condition))
        low, high = curve.band(band)
        axes.fill_between(curve.step, low, high, color=look["color"], alpha=0.16, linewidth=0)
        at_end = int(curve.count[-1]) if len(curve.count) else 0
        runs = data.of_condition(curve.condition)
        longest = max(run.budget for run in runs)
        whole = all(run.status == "done" and run.end >= longest for run in runs)
        fewer = "" if whole else f", {at_end} at the end"  # other conditions may go further
        label = f"{curve.condition} (n = {len(curve.runs)}{fewer})"
        look["marker"] = look["marker"] if marked else ""
        of_all = np.where(curve.count == len(curve.runs), curve.mean, np.nan)
        (line,) = axes.plot(curve.step, of_all, label=label, markersize=2.8, clip_on=False, **look)
        line.set_in_layout(False)  # it may reach over the edge, and may be empty
        axes.plot(curve.step, curve.mean, alpha=0.35, markersize=2.8, zorder=1.5, **look)
    axes.set_xlim(0, data.budget)
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    if np.ptp(axes.get_ylim()) > 5000:
        axes.yaxis.set_major_formatter(EngFormatter(sep=""))


def _headline(data: StudyData) -> str:
    same = "; ".join(" = ".join(names) for names in data.same)
    return data.title + (f"   (A/A: {same} are one configuration)" if same else "")


def _caption(data: StudyData, evaluations: pd.DataFrame | None, band: str, window: str) -> str:
    words = (
        f"{', '.join(data.environments)}. Lines: mean over n runs, faint where fewer have a value; "
        f"bands: {BANDS[band].label}.\n"
    )
    if data.averaged_over:
        logger = f"averaged over its last {data.averaged_over} episodes by Stable-Baselines3"
        return f"{words}Returns are as they were logged: each run's is already {logger}."
    episodes = {
        WINDOWS[0]: "the episodes of the last 5 % of the budget before each point",
        WINDOWS[1]: "each run's last 100 episodes",
    }[window]
    words += f"Return averages {episodes}."
    if evaluations is not None and len(evaluations):
        hunter = evaluations["hunter_share_killed"].mean()
        words += f" On the right the scripted hunter would be at {hunter:.0%}."
    return words
