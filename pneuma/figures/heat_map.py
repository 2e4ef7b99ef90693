"""Figure of two factors: a heat map of the means at each pair of their levels."""

from __future__ import annotations

from functools import partial

import pandas as pd
from matplotlib.axes import Axes

from pneuma.analysis.answer import Answer
from pneuma.analysis.intervals import decimals, number_text
from pneuma.analysis.summaries import words_of
from pneuma.figures import style
from pneuma.figures.grid import Page, Panel
from pneuma.figures.origin import lines_of_runs
from pneuma.figures.words import headline_of

COLOURS = "cividis"
"""A colour map that people who confuse colours can read."""


def heat_map_page(answer: Answer) -> Page:
    """Return the figure of `compare_factors`: a panel for each environment and outcome."""
    a, b = answer.about["a"], answer.about["b"]
    labels = answer.drawing["levels"].set_index(["factor", "level"])["label"]
    panels = []
    for (environment, outcome), means in answer.table.groupby(["environment", "outcome"], sort=False):
        levels_a, levels_b = means["level_a"].unique(), means["level_b"].unique()
        matrix = means.pivot(index="level_a", columns="level_b", values="value").loc[levels_a, levels_b]
        panel = Panel(
            partial(_draw, matrix),
            ": ".join(filter(None, [str(environment), words_of(str(outcome))])),
            rows=[labels[a, level] for level in levels_a],
            columns=[labels[b, level] for level in levels_b],
        )
        panels.append(panel)
    return Page(
        basename=answer.drawing["basename"],
        grid=[panels],
        inches=style.PANEL_INCHES,
        headline=headline_of(answer, "means by two factors"),
        runs=lines_of_runs(answer.drawing["runs"]),
        caption=[f"{note.removesuffix('.')}." for note in answer.notes],
        across=2,
        answer=answer,
    )


def _draw(matrix: pd.DataFrame, axes: Axes) -> None:
    """Draw a matrix of means, the first row at the top, with the number in each cell."""
    values = matrix.to_numpy()
    axes.pcolormesh(values, cmap=COLOURS, shading="nearest")
    middle = (values.min() + values.max()) / 2
    for row, row_values in enumerate(values):
        for column, value in enumerate(row_values):
            colour = "black" if value > middle else "white"
            text = number_text(value, decimals(value))
            axes.text(column, row, text, color=colour, ha="center", va="center")
