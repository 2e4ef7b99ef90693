"""The pictures of the gallery: worlds, classes, spells, islands, and an agent before and after training.

The agent's episodes are a recording (`studies/scripts/record_play.py`), so that nothing is trained here.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pneuma.env.fields import SPELL_NAMES, make_env_config
from pneuma.env.players import Hunter
from pneuma.env.render import GIF_FACTOR, Renderer
from pneuma.env.rules import RIGHT
from pneuma.env.watch import FRAMES_PER_STEP, encode_gif, episode_frames, smooth
from pneuma.env.worlds import Worlds
from pneuma.figures.origin import origin_text
from pneuma.figures.style import house_style, save_figure
from pneuma.presets import WORLDS
from pneuma.study.shipped import shipped_tables
from tools.environment_figures import level_worlds

RECORDING = "played.json"
DOTS = 200
"""Dots an inch: every pixel of a frame is one dot."""
GAP, LINE, PLOT, HEIGHT = 24, 36, 300, 280
"""Dots between panels, of a line above them, of a plot below them, and of a scene's height."""
CLASSES = ("base", "tank", "mage", "warrior")
REWARDS = {
    "text": "all XP minus the share of HP left",
    "godot": "circles entered; at a kill, all XP",
    "arena": "XP gained minus HP lost",
}
ISLANDS = ("random:train:17", "random:test:17")
HUNTED, SHOWN = 120, 130
"""Steps that the hunter plays in each world, and that the moving picture of the agent lasts."""


def draw_gallery(folder: Path) -> list[Path]:
    episodes = json.loads((shipped_tables() / RECORDING).read_bytes())["episodes"]
    with house_style():
        pages = {
            "worlds": _worlds(),
            "classes": _classes(),
            "spells": _spells(),
            "islands": _islands(),
            "training": _training(episodes),
        }
        paths = [
            path
            for name, page in pages.items()
            for path in save_figure(page, folder, f"gallery-{name}", ("png",), origin_text(name), colours=0)
        ]
    return [*paths, _move(episodes[-1], folder / "play.gif")]


def _page(frames: Mapping[str, np.ndarray], below: int = 0) -> tuple[Figure, list[Axes]]:
    """Return a figure of frames side by side, dot by dot, under their titles."""
    height, above = max(map(len, frames.values())), LINE * (1 + max(title.count("\n") for title in frames))
    width = sum(frame.shape[1] + GAP for frame in frames.values()) - GAP
    page, panels, left = Figure(figsize=(width / DOTS, (above + height + below) / DOTS), dpi=DOTS), [], 0
    for title, frame in frames.items():
        panels.append(_panel(page, left, below + height - len(frame), *frame.shape[1::-1]))
        panels[-1].imshow(frame, interpolation="none", aspect="auto")
        panels[-1].set_title(title)
        panels[-1].axis("off")
        left += frame.shape[1] + GAP
    return page, panels


def _panel(page: Figure, left: int, bottom: int, width: int, height: int) -> Axes:
    """Add a panel at a place in dots."""
    across, up = page.get_size_inches() * DOTS
    return page.add_axes((left / across, bottom / up, width / across, height / up))


# --- The world -----------------------------------------------------------------------------------


def _worlds() -> Figure:
    """Show the hunter in each world, and what its steps are paid."""
    frames, rewards = {}, []
    for name, world in WORLDS.items():
        worlds = level_worlds(config=make_env_config({}, world.env))
        hunter, paid = Hunter(worlds), []
        renderer = Renderer(worlds, "follow", panel=False, zoom=GIF_FACTOR)
        for _ in range(HUNTED):
            worlds.step(hunter.act(worlds))
            event = worlds.events[0, 0]
            paid.append(float(event["reward"]))
            if event["hits"] > event["kills"]:  # the dead do not show
                frames[f"{name}\n{REWARDS[name]}"] = renderer.frame()
        rewards.append(paid)
    page, panels = _page(frames, PLOT)
    for panel, paid in zip(panels, rewards, strict=True):
        left = round(panel.get_position().x0 * page.get_figwidth() * DOTS)
        axes = _panel(page, left + 80, 100, 375, PLOT - 130)
        axes.plot(range(1, HUNTED + 1), paid, color="C0")
        axes.set(xlabel="step", ylabel="reward", xlim=(0, HUNTED))
    return page


def _classes() -> Figure:
    """Show one blow of each class."""
    worlds = level_worlds(config=make_env_config({"players": len(CLASSES), "classes": CLASSES}))
    _put_ahead(worlds, np.arange(len(CLASSES)), 66.0)
    titles = [
        f"{name}\n{stats['hp']:.0f} HP, {stats['sword']['damage']:.0f} a blow"
        for name, stats in zip(CLASSES, worlds.player_stats, strict=True)
    ]
    return _page(dict(zip(titles, _acted(worlds, "attack", 340), strict=True)))[0]


def _spells() -> Figure:
    """Show the two spells."""
    frames = {}
    for name in SPELL_NAMES:
        worlds = level_worlds(config=make_env_config({"classes": "mage", "magic": True}))
        _put_ahead(worlds, np.zeros(3, np.int64), np.array([120.0, 200.0, 280.0]))
        worlds.players["hp"] = 30.0
        (frames[name],) = _acted(worlds, name, 480, ahead=110)
    return _page(frames)[0]


def _islands() -> Figure:
    islands = {name: level_worlds(config=make_env_config({"level": name})) for name in ISLANDS}
    return _page({name: Renderer(worlds, panel=False).frame() for name, worlds in islands.items()})[0]


def _put_ahead(worlds: Worlds, players: np.ndarray, away: np.ndarray | float) -> None:
    """Turn all players to the right, and put a monster so many pixels ahead of each that is named."""
    worlds.players["facing"] = RIGHT
    worlds.monsters["x"][0, : len(players)] = worlds.players["x"][0, players] + away
    worlds.monsters["y"][0, : len(players)] = worlds.players["y"][0, players]
    worlds.observe()


def _acted(worlds: Worlds, action: str, width: int, ahead: int = 0) -> list[np.ndarray]:
    """Return what is around each player, or more ahead of it, in the middle of an action."""
    renderer = Renderer(worlds, "follow", panel=False)
    smooth(worlds, 4)
    for _ in range(3):  # 6 ticks
        worlds.step(np.full(worlds.players.shape, worlds.action_names.index(action)))
    frames = [renderer.frame(0, player) for player in range(worlds.players.shape[1])]
    top, left = (len(frames[0]) - HEIGHT) // 2, (frames[0].shape[1] - width) // 2 + ahead
    return [frame[top : top + HEIGHT, left : left + width] for frame in frames]


# --- An agent ------------------------------------------------------------------------------------


def _training(episodes: Sequence[Mapping[str, Any]]) -> Figure:
    """Show on the map where agents went, and where they killed."""
    frames, paths, killed = {}, [], []
    for episode in episodes:
        worlds, act = replay(episode)
        renderer = Renderer(worlds, panel=False)
        frame, shown = renderer.frame(), renderer.extent
        corner, scale = np.array([shown.left, shown.top]), frame.shape[1] / shown.width
        path = []
        while worlds.worlds["ending"][0] == 0 and worlds.worlds["monsters_left"][0] > 0:
            path.append([worlds.players["x"][0, 0], worlds.players["y"][0, 0]])
            worlds.step(act(worlds))
        dead = worlds.monsters[0][worlds.monsters["hp"][0] <= 0]
        paths.append((np.array(path) - corner) * scale)
        killed.append((np.stack([dead["x"], dead["y"]], axis=1) - corner) * scale)
        fate = "dead after" if worlds.ending(0) == "killed" else "in"
        killed_of = f"{len(dead)} of {worlds.monsters.size} killed, {fate} {len(path)} steps"
        frames[f"after {episode['steps']:,} steps of training\n{killed_of}"] = frame
    page, panels = _page(frames)
    for axes, way, places in zip(panels, paths, killed, strict=True):
        axes.set(autoscale_on=False)
        axes.plot(*way.T, color="black", linewidth=2.4)
        axes.plot(*way.T, color="white", linewidth=1.4)
        axes.plot(*places.T, "X", color="#e8503f", markeredgecolor="black", markersize=9)
    return page


def replay(episode: Mapping[str, Any]) -> tuple[Worlds, Callable[[Worlds], np.ndarray]]:
    """Return the world of a recorded episode, and who plays it again."""
    worlds = Worlds(1, make_env_config({}, episode["env"]))
    worlds.seed([episode["seed"]])
    worlds.reset()
    actions = map(int, episode["actions"])
    return worlds, lambda shown: np.full(shown.players.shape, next(actions))


def _move(episode: Mapping[str, Any], path: Path) -> Path:
    """Write the first steps of an episode as a moving picture."""
    worlds, act = replay(episode)
    renderer = Renderer(worlds, "follow", zoom=GIF_FACTOR)
    first_frames = islice(episode_frames(worlds, act, renderer), SHOWN * FRAMES_PER_STEP + 1)
    path.write_bytes(encode_gif(first_frames))
    return path
