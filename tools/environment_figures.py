"""The counterparts of the thesis's Figs. 2.1, 5.1, 5.2 and 6.1, drawn from this environment."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyArrowPatch

from pneuma.env.fields import EnvConfig
from pneuma.env.players import Hunter
from pneuma.env.render import Renderer
from pneuma.env.watch import smooth
from pneuma.env.worlds import Worlds
from pneuma.figures.origin import origin_text
from pneuma.figures.style import GREY, house_style, save_figure

STATES = {"s₁\npost office": (0.0, 0.0), "s₂\nletters": (1.5, 1.1), "s₃\nhome": (3.0, 0.0)}
MOVES = (
    ("s₁\npost office", "s₂\nletters", "0", (0.52, 0.72)),
    ("s₂\nletters", "s₃\nhome", "+1: letters delivered", (2.32, 0.72)),
    ("s₁\npost office", "s₃\nhome", "−1: fired", (1.32, -0.28)),
)
RADIUS = 0.33
FRAMES_PER_STEP = 4
"""Moments of a step among which the picture of a fight is chosen."""


def draw_mailman(folder: Path) -> list[Path]:
    """Draw Fig. 2.1: the mailman's decision process, its best route in bold."""
    with house_style():
        figure = Figure(figsize=(4.2, 2.1))
        axes = figure.add_axes((0, 0, 1, 1))
        axes.set(xlim=(-0.5, 3.5), ylim=(-0.55, 1.6), aspect="equal")
        axes.axis("off")
        for name, place in STATES.items():
            axes.add_patch(
                Circle(place, RADIUS, facecolor="white", edgecolor="black", linewidth=1.2, zorder=2)
            )
            axes.text(*place, name, ha="center", va="center", fontsize=7, zorder=3)
        for start, end, label, place in MOVES:
            best = "s₂\nletters" in (start, end)
            axes.add_patch(
                FancyArrowPatch(
                    STATES[start], STATES[end], arrowstyle="-|>", mutation_scale=11, shrinkA=29, shrinkB=29,
                    color="C0" if best else GREY, linewidth=2.0 if best else 1.0, zorder=1,
                )
            )  # fmt: skip
            axes.text(*place, label, fontsize=7, ha="right" if label == "0" else "left")
        axes.text(1.5, 0.4, "optimal policy", fontsize=7, ha="center", color="C0")
        return save_figure(figure, folder, "fig-2-1", ("png",), origin_text("the mailman's day"))


def draw_level(folder: Path) -> list[Path]:
    """Draw Fig. 6.1: the whole level, with its start places and monsters."""
    worlds = level_worlds()
    level = worlds.level
    renderer = Renderer(worlds, "map", panel=False)
    image = renderer.frame(0)
    shown = renderer.extent
    with house_style():
        figure = Figure(figsize=(5.2, 4.7), layout="constrained")
        axes = figure.subplots()
        axes.imshow(image, extent=(shown.left, shown.right, shown.bottom, shown.top), interpolation="none")
        axes.plot(
            *level.starts.T, "*", color="#FFD400", markeredgecolor="black", markersize=9, label="start places"
        )
        axes.set(xlabel="x (pixels)", ylabel="y (pixels)", title=level.title)
        axes.grid(visible=False)
        axes.legend(loc="lower right", frameon=True, facecolor="white")
        return save_figure(figure, folder, "fig-6-1", ("png",), origin_text(level.title), colours=0)


def draw_screens(folder: Path) -> list[Path]:
    """Draw Figs. 5.1 and 5.2: the view that follows a player in two scenes."""
    paths = []
    for stem, worlds in (("fig-5-1", level_worlds()), ("fig-5-2", fight_worlds())):
        frame: np.ndarray = Renderer(worlds, "follow").frame(0)
        with house_style():
            figure = Figure(figsize=(frame.shape[1] / 200, frame.shape[0] / 200))
            axes = figure.add_axes((0, 0, 1, 1))
            axes.imshow(frame, interpolation="none")
            axes.axis("off")
            paths += save_figure(
                figure, folder, stem, ("png",), origin_text("the view of a player"), colours=0
            )
    return paths


# --- What they show ------------------------------------------------------------------------------


def level_worlds(start: int = 0, config: EnvConfig | None = None) -> Worlds:
    """Return the shipped level at the start of an episode."""
    worlds = Worlds(1, config)
    worlds.seed([0])
    worlds.reset(starts=np.array([start], np.int64))
    return worlds


def fight_worlds() -> Worlds:
    """Return the shipped level during a fight: a monster just hit, and as many awake as possible."""
    best, most = level_worlds(), 0
    for start in range(len(best.level.starts)):
        worlds = level_worlds(start)
        hunter = Hunter(worlds)
        smooth(worlds, FRAMES_PER_STEP)
        while worlds.worlds["ending"][0] == 0 and most < 3:
            actions = hunter.act(worlds)
            for _ in range(FRAMES_PER_STEP):
                worlds.step(actions)
                awake = int(((worlds.monsters["noticed"][0] > 0) & (worlds.monsters["hp"][0] > 0)).sum())
                if worlds.events["hits"][0, 0] and awake > most:
                    best, most = copy.deepcopy(worlds), awake
    return best
