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
from pneuma.figures.captions import headline_of
from pneuma.figures.sizes import SIZES
from pneuma.figures.style import COLOURS, house_style, save_figure
from pneuma.figures.words import Words

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

SIZE = SIZES["page"]
SMALL = 0.85 * SIZE.type_points
"""Type below a panel."""
WORDS_INCHES = 0.6
"""Of a panel, above and below its map."""

LOOKS: dict[str, dict[str, Any]] = {
    "killed": {"color": COLOURS[1], "linestyle": "-", "marker": "x"},
    "drowned": {"color": COLOURS[0], "linestyle": "-", "marker": "o"},
    "cleared": {"color": COLOURS[2], "linestyle": "-", "marker": "*"},
    "time-limit": {"color": COLOURS[3], "linestyle": "-", "marker": "s"},
}
START: dict[str, Any] = {
    "marker": "o",
    "markerfacecolor": "white",
    "markeredgecolor": "black",
    "markeredgewidth": 0.5,
}
WORDS = {
    "killed": "die of bites",
    "drowned": "drown",
    "cleared": "kill every monster",
    "time-limit": "run out of time",
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
    table = endings(found)
    conditions = found.conditions
    columns = _columns(len(conditions))
    rows = -(-len(conditions) // columns)
    words = Words(headline_of(data, "where the policies go"), "", _caption(found))
    with house_style(SIZE.type_points):
        figure = Figure(layout="constrained")
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        backdrop = _Backdrop(found, drawer)
        for axes, condition in zip(panels, conditions, strict=False):
            own = found.episodes[found.episodes["condition"] == condition]
            backdrop.put(axes)
            _draw_episodes(axes, own)
            axes.set_title(condition)
            told = _told(table[table["condition"] == condition], SIZE.characters(SMALL) // columns)
            axes.set_xlabel(told, fontsize=SMALL)
        for axes in panels[len(conditions) :]:
            axes.axis("off")
        panel_inches = SIZE.width / columns * backdrop.height_by_width + WORDS_INCHES
        words.put(figure, SIZE, rows * panel_inches, _entries(found))
        return save_figure(figure, folder, stem, formats, SIZE.dots_per_inch)


def _columns(panels: int) -> int:
    """Return 3, or 2 where that leaves fewer holes."""
    return min(panels, min((3, 2), key=lambda columns: -panels % columns))


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
        axes.plot(row["x"][0], row["y"][0], **START, markersize=2.2, zorder=2.5)
        axes.plot(
            row["x"][-1], row["y"][-1], marker=look["marker"], color=look["color"], markersize=2.6, zorder=3
        )


def _entries(found: StudyTrajectories) -> dict[str, Line2D]:
    """Return the legend: where ways begin, and the endings that there are."""
    drawn = found.episodes["x"].map(len) > 0
    seen = set(found.episodes["ending"][drawn])
    return {"begin": Line2D([], [], markersize=4, linestyle="", **START)} | {
        WORDS[ending]: Line2D([], [], markersize=4, linewidth=1.2, **LOOKS[ending])
        for ending in ENDINGS
        if ending in seen
    }


def _told(table: pd.DataFrame, room: int) -> str:
    """Return what is written below a panel: the shares of endings, and what episodes are like.

    Args:
        table: of one condition.
        room: characters that a line has.
    """
    means = dict(zip(table["outcome"], table["value"], strict=True))
    shares = [f"{share_told(means[name])} {WORDS[name]}" for name in ENDINGS if means.get(name)]
    an_episode = f"{means['steps']:,.0f} steps an episode, {means['kills']:.2g} monsters killed"
    return "\n".join([*textwrap.wrap(", ".join(shares), room), an_episode])


def share_told(share: float) -> str:
    """Return a share in per cent; what is not quite none or all does not look so."""
    if 0 < share < 0.005 or 0.995 < share < 1:
        return "<1 %" if share < 0.5 else ">99 %"
    return f"{100 * share:.0f} %"


def _caption(found: StudyTrajectories) -> list[str]:
    runs = found.episodes.groupby("condition", sort=False)["run_id"].nunique()
    counts = sorted(set(runs))
    of = f"{counts[0]} to {counts[-1]} runs" if len(counts) > 1 else f"{counts[0]} run{'s' * (counts[0] > 1)}"
    return [
        f"{of} a condition, by their policies at the end of training, which draw their actions.",
        f"Lines: {min(KEPT_EPISODES, found.per_run)} episodes of each run; marks: where they end.",
        f"Numbers: means over runs of {found.per_run} episodes each.",
    ]
