"""Figures of shares over all runs: performance profiles, and runs in one action."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from pneuma.analysis.answer import Answer
from pneuma.figures import grid, style
from pneuma.figures.grid import Page, Panel
from pneuma.figures.origin import lines_of_runs
from pneuma.figures.words import headline_of, looks_of
from pneuma.store.quantities import SHARES

OPACITY = 0.2


def profile_page(answer: Answer) -> Page:
    """Return the figure of performance profiles (Agarwal et al. 2021): the share of runs above each score."""
    profile_table, looks = answer.table, looks_of(answer.drawing)

    def draw(axes: Axes) -> None:
        _draw_lines(axes, profile_table, looks, marker="")
        axes.set(xlim=(profile_table["x"].min(), profile_table["x"].max()), ylim=(0, 1 + grid.BELOW_ZERO))

    panel = Panel(draw, x="Score", y="Share of runs above it", y_kind=SHARES)
    return _page(answer, "performance profiles", [panel], answer.notes)


def one_action_page(answer: Answer) -> Page:
    """Return the figure of a study's conditions: a curve of survival, and updates in one action."""
    looks = looks_of(answer.drawing)

    def draw_survival(axes: Axes) -> None:
        step_look = {"drawstyle": "steps-post", "markevery": [-1]}
        _draw_lines(axes, answer.tables["staying"], looks, step="post", **step_look)
        axes.set(
            xlim=(0, answer.drawing["runs"]["steps"].max()), ylim=(-grid.BELOW_ZERO, 1 + grid.BELOW_ZERO)
        )

    def draw_times(axes: Axes) -> None:
        _draw_lines(axes, answer.tables["updates"], looks)
        axes.set(ylim=(-grid.BELOW_ZERO, max(axes.get_ylim()[1], 0.01)))

    survival = ("Not yet staying in one action", "Environment steps", "Share of runs")
    times = ("Training in one action", "Fifth of training", "Share of updates")
    panels = [Panel(draw_survival, *survival, y_kind=SHARES), Panel(draw_times, *times, y_kind=SHARES)]
    caption = list(answer.notes)
    caption.insert(1, "Left: after Kaplan and Meier. Right: means over runs.")
    return _page(answer, "runs in one action", panels, caption)


def _draw_lines(
    axes: Axes,
    share_table: pd.DataFrame,
    looks: Mapping[str, Mapping[str, Any]],
    step: Any = None,
    **line_look: Any,
) -> None:
    """Draw the share of each condition over x, in a band from low to high."""
    for condition, frame in share_table.groupby("condition", sort=False):
        look = {**looks[str(condition)], **line_look}
        grid.draw_band(axes, frame, (0, 1), color=look["color"], alpha=OPACITY, step=step)
        axes.plot(frame["x"], frame["share"], clip_on=False, **look)


def _page(answer: Answer, subject: str, panels: list[Panel], caption: Sequence[str]) -> Page:
    return Page(
        basename=answer.drawing["basename"],
        grid=[panels],
        inches=style.PANEL_INCHES,
        headline=headline_of(answer, subject),
        runs=lines_of_runs(answer.drawing["runs"]),
        entries={"95 % interval": Patch(color=style.INK, alpha=OPACITY, linewidth=0)},
        caption=caption,
        answer=answer,
    )
