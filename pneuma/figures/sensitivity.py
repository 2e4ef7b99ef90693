"""Sensitivity: the outcome against each hyperparameter around the base, all others as they are there."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator, PercentFormatter

from pneuma.analysis.intervals import mean_interval
from pneuma.analysis.outcomes import find_outcome, outcome_values
from pneuma.analysis.tables import StudyData
from pneuma.errors import counted
from pneuma.figures.panel import log_ticks
from pneuma.figures.style import COLOURS, house_style, put_caption, save_figure

COLUMNS = 3
PAGE_INCHES = 7.0


def draw_sensitivity(
    data: StudyData, document: Mapping[str, Any], folder: Path, formats: tuple[str, ...]
) -> list[Path]:
    """Draw a search's sensitivity study; return the files written.

    Args:
        data: the study's runs.
        document: what its conditions are, as `pneuma.search.sensitivity.read_points` returns it.
        folder: where to write.
        formats: of `pneuma.figures.FIGURE_FORMATS`.
    """
    panels: dict[str, list[Mapping[str, Any]]] = {point["parameter"]: [] for point in document["points"]}
    for point in document["points"]:
        panels[point["parameter"]].append(point)
    with house_style():
        rows = math.ceil(len(panels) / COLUMNS)
        figure = Figure(figsize=(PAGE_INCHES, 0.9 + 2.0 * rows), layout="constrained")
        places = figure.subplots(rows, COLUMNS, sharey=True, squeeze=False).ravel()
        for axes, (name, points) in zip(places, panels.items(), strict=False):
            _draw_parameter(axes, data, document, name, points)
        for axes in places[len(panels) :]:
            axes.set_visible(False)
        outcome = find_outcome(document["outcome"])
        if outcome.unit == "share":
            places[0].yaxis.set_major_formatter(PercentFormatter(xmax=1))
        figure.supylabel(outcome.words, fontsize=8.5)
        _add_words(figure, data, document)
        return save_figure(figure, folder, data.figure, formats)


def _draw_parameter(
    axes: Axes, data: StudyData, document: Mapping[str, Any], name: str, points: Sequence[Mapping[str, Any]]
) -> None:
    numbers = all(isinstance(point["value"], int | float) for point in points)
    at = [point["value"] if numbers else place for place, point in enumerate(points)]
    values = [outcome_values(data, point["condition"], document["outcome"]) for point in points]
    values = [own[np.isfinite(own)] for own in values]
    means = [own.mean() if len(own) else np.nan for own in values]
    bounds = [mean_interval(own) for own in values]
    for place, own in zip(at, values, strict=True):
        axes.plot([place] * len(own), own, ".", color="#999999", markersize=3)
    low = [mean - bound.low for mean, bound in zip(means, bounds, strict=True)]
    high = [bound.high - mean for mean, bound in zip(means, bounds, strict=True)]
    axes.errorbar(
        at, means, np.nan_to_num([low, high]), color=COLOURS[0], marker="o", markersize=4, capsize=2
    )
    for place, point, mean in zip(at, points, means, strict=True):
        if point["is_base"]:
            axes.plot(place, mean, "D", color=COLOURS[1], markersize=6, zorder=3)
    if name in document["logarithmic"]:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(FixedLocator(log_ticks(min(at), max(at))))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    elif not numbers:
        axes.set_xticks(at, [str(point["value"]) for point in points], fontsize=6.5)
    axes.set_title(name, fontsize=8.5)


def _add_words(figure: Figure, data: StudyData, document: Mapping[str, Any]) -> None:
    seeds = counted(len({run.seed for run in data.runs}), "seed")
    put_caption(
        figure,
        f"Mean and 95 % t interval of {seeds}, every run a dot; diamond: the base {document['base']}; "
        f"{data.budget:,} steps a run{_told_missing(data, document)}",
    )


def _told_missing(data: StudyData, document: Mapping[str, Any]) -> str:
    """Say how many runs count in no mean."""
    outcome, conditions = document["outcome"], {point["condition"] for point in document["points"]}
    without = {
        run.run_id
        for condition in conditions
        for run, value in zip(
            data.of_condition(condition), outcome_values(data, condition, outcome), strict=True
        )
        if not np.isfinite(value)
    }
    told = f"; {counted(data.left_out, 'run')} not finished" if data.left_out else ""
    return told + (f"; {counted(len(without), 'run')} without a finite value, in no mean" if without else "")
