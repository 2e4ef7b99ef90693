"""The figure of trajectories: for each condition the map, with where its policies went and how that ended."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from pneuma.analysis.tables import StudyData
from pneuma.analysis.trajectories import ENDINGS, KEPT_EPISODES, StudyTrajectories, endings
from pneuma.env.render import Renderer
from pneuma.env.watch import level_worlds
from pneuma.errors import UserError
from pneuma.figures.panels import headline_of, put_texts, runs_told
from pneuma.figures.style import COLOURS, SIZES, house_style, save_figure

SHIPPED_LEVEL = "thesis"
"""The one whose map is known without opening files that a stranger may have named."""
SHORE_TILES = 1.5
"""How much of the sea is shown."""
BARE_MARGIN = 0.03
"""What is left around lines without a map, in parts of their extent, for the marks at their ends."""
VEIL = 0.55
"""How much of the map's colours is taken away, so that lines stand out."""
STEEPEST = 4.0
"""How high a panel is at most, as a multiple of its width."""
WORDS_INCHES = 0.6
"""Of a panel, above and below its map."""
SIZE = SIZES["page"]
SMALL = 0.85 * SIZE.type_points
"""Type below a panel."""

LOOKS: dict[str, dict[str, Any]] = {
    "killed": {"color": COLOURS[1], "marker": "x", "label": "die of bites"},
    "drowned": {"color": COLOURS[0], "marker": "o", "label": "drown"},
    "cleared": {"color": COLOURS[2], "marker": "*", "label": "kill every monster"},
    "time-limit": {"color": COLOURS[3], "marker": "s", "label": "run out of time"},
}
START: dict[str, Any] = {
    "marker": "o",
    "markerfacecolor": "white",
    "markeredgecolor": "black",
    "linestyle": "",
}


def draw_trajectories(
    data: StudyData,
    found: StudyTrajectories,
    folder: Path,
    stem: str,
    formats: tuple[str, ...] = ("png",),
    drawer: Renderer | None = None,
) -> list[Path]:
    """Draw where the policies of every condition went; return the files written.

    A line is an episode, coloured by how it ended, with a mark where it did.

    Args:
        data: the study.
        found: its trajectories.
        folder: where.
        stem: the name of the files, without endings.
        formats: their endings.
        drawer: of the level's map, as an episode begins; needed of a level that is not shipped.

    Raises:
        UserError: where they play on several levels, which no one map shows.
    """
    if not found.level:
        raise UserError(f"study {data.study}: its runs play on several levels; no one map shows them")
    table, conditions = endings(found), found.conditions
    columns = min(len(conditions), 3)
    rows = -(-len(conditions) // columns)
    with house_style(SIZE.type_points):
        figure = Figure(layout="constrained")
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        backdrop = _Backdrop(found, drawer)
        for axes, condition in zip(panels, conditions, strict=False):
            backdrop.put(axes)
            _draw_episodes(axes, found.episodes[found.episodes["condition"] == condition])
            told = _told(table[table["condition"] == condition], SIZE.characters(SMALL) // columns)
            axes.set_title(condition)
            axes.set_xlabel(told, fontsize=SMALL)
        for axes in panels[len(conditions) :]:
            axes.remove()
        inches = rows * (SIZE.width / columns * backdrop.height_by_width + WORDS_INCHES)
        headline = headline_of(data, "where the policies go")
        put_texts(figure, SIZE, inches, headline, _entries(found), [_caption(found)])
        return save_figure(figure, folder, stem, formats, SIZE.dots_per_inch)


class _Backdrop:
    """What lies behind the lines: the level's map, or where it is not known nothing but their extent."""

    def __init__(self, found: StudyTrajectories, drawer: Renderer | None) -> None:
        self.image: np.ndarray | None = None
        if drawer is None and found.level == SHIPPED_LEVEL:
            drawer = Renderer(level_worlds(), "map", panel=False)
        if drawer:
            level = drawer.worlds.level
            left, top, right, bottom = level.grid
            self.image = drawer.frame(0)
            self.extent = (left, right, bottom, top)
            left, top, right, bottom = level.land
            margin = SHORE_TILES * level.tile
        else:
            x, y = (np.concatenate(found.episodes[axis].tolist()) for axis in "xy")
            left, top, right, bottom = x.min(), y.min(), x.max(), y.max()
            margin = BARE_MARGIN * max(right - left, bottom - top)
        self.edges = (left - margin, right + margin, bottom + margin, top - margin)

    @property
    def height_by_width(self) -> float:
        """How high a panel is, as a multiple of its width: the map's form, unless that is a mere line."""
        left, right, bottom, top = self.edges
        return float(np.clip((bottom - top) / max(right - left, 1), 1 / STEEPEST, STEEPEST))

    def put(self, axes: Axes) -> None:
        """Put it behind a panel; y points down, as the world's does."""
        if self.image is not None:
            axes.imshow(self.image, extent=self.extent, interpolation="none", alpha=1 - VEIL)
        axes.set(xlim=self.edges[:2], ylim=self.edges[2:], aspect="equal", xticks=[], yticks=[])
        axes.grid(visible=False)
        for side in ("left", "bottom"):
            axes.spines[side].set_visible(False)


def _draw_episodes(axes: Axes, own: pd.DataFrame) -> None:
    for row in own[own["x"].map(len) > 0].to_dict("records"):
        look = LOOKS[row["ending"]]
        axes.plot(row["x"], row["y"], color=look["color"], linewidth=0.6, alpha=0.55)
        axes.plot(row["x"][0], row["y"][0], **START, markersize=2.2, markeredgewidth=0.5, zorder=2.5)
        end = row["x"][-1], row["y"][-1]
        axes.plot(*end, marker=look["marker"], color=look["color"], markersize=2.6, zorder=3)


def _entries(found: StudyTrajectories) -> dict[str, Line2D]:
    """Return the legend: where ways begin, and the endings that there are."""
    seen = set(found.episodes["ending"][found.episodes["x"].map(len) > 0])
    return {"begin": Line2D([], [], markersize=4, **START)} | {
        LOOKS[name]["label"]: Line2D([], [], markersize=4, **LOOKS[name]) for name in ENDINGS if name in seen
    }


def _told(table: pd.DataFrame, room: int) -> str:
    """Return what is written below a panel: the shares of endings, and what episodes are like.

    Args:
        table: of one condition.
        room: characters that a line has.
    """
    means = dict(zip(table["outcome"], table["value"], strict=True))
    shares = [f"{share_told(means[name])} {LOOKS[name]['label']}" for name in ENDINGS if means.get(name)]
    an_episode = f"{means['steps']:,.0f} steps an episode, {means['kills']:.2g} monsters killed"
    return "\n".join([*textwrap.wrap(", ".join(shares), room), an_episode])


def share_told(share: float) -> str:
    """Return a share in per cent; what is not quite none or all does not look so."""
    if 0 < share < 0.005 or 0.995 < share < 1:
        return "<1 %" if share < 0.5 else ">99 %"
    return f"{100 * share:.0f} %"


def _caption(found: StudyTrajectories) -> str:
    runs = runs_told(found.episodes.groupby("condition")["run_id"].nunique())
    lines = min(KEPT_EPISODES, found.per_run)
    return (
        f"Policies at the end of training, which draw their actions; runs of a condition: {runs}. Lines: "
        f"{lines} episodes of each run. Numbers: means over runs of {found.per_run} episodes each."
    )
