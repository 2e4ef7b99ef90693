"""What a player perceives: layouts, bounds and scales of an observation; `PneumaEnv` tells what they mean.

An observation has a few numbers about the player, then a row for each monster perceived, or for each ray. A
layout's own choices are in `pneuma.env.fields.OBSERVATION_FIELDS`. The land of random levels is the whole
grid, so that each sees the same place as the same numbers, whichever are played together.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from pneuma.env.fields import OBSERVATIONS, EnvConfig
from pneuma.env.level import RANDOM, Level

LAYOUT_THESIS, LAYOUT_PYGAME, LAYOUT_GODOT = range(len(OBSERVATIONS))
MOST_XP = 1e9
"""Bound of XP, in points, that is kept through episodes."""


def most_perceived(config: EnvConfig, monsters: int) -> int:
    """Return the most rows of monsters in an observation, on levels with so many."""
    mode, _, number = config.perceive.partition(":")
    if mode == "rays":
        return 0
    if mode == "nearest":
        return min(int(number), monsters)
    return monsters


def fill_scales(
    settings: Any, players: np.ndarray, monsters: np.ndarray, config: EnvConfig, levels: list[Level]
) -> None:
    """Write layout and scales into rows of `state.SETTINGS`, `PLAYER_STATS` and `MONSTER_STATS`."""
    settings["layout"] = OBSERVATIONS.index(config.observation)
    settings["fixed_order"] = config.order == "fixed"
    settings["perceived"] = most_perceived(config, monsters.shape[1])
    raw = config.scale == "raw"
    if config.scale == "unit":
        left, top, right, bottom = _land(levels)
        settings["middle_x"], settings["middle_y"] = (left + right) / 2, (top + bottom) / 2
        settings["scale_x"], settings["scale_y"] = 2 / (right - left), 2 / (bottom - top)
        monsters["distance_scale"] = 1 / np.sqrt(np.maximum(monsters["notice_squared"], 1.0))
    elif config.scale == "map":
        left, top, right, bottom = levels[0].grid
        settings["middle_x"], settings["middle_y"] = left, top
        settings["scale_x"], settings["scale_y"] = 1 / (right - left), 1 / (bottom - top)
        monsters["distance_scale"] = 1 / max(right - left, bottom - top)
    else:
        settings["scale_x"] = settings["scale_y"] = monsters["distance_scale"] = 1.0
    _fill_rays(settings, monsters, config, levels)
    settings["xp_scale"] = 1.0 if raw else 1 / max(monsters["xp"].sum(axis=-1).max(initial=0.0), 1.0)
    players["hp_scale"] = 1.0 if raw else 1 / players["hp"]
    players["energy_scale"] = 1.0 if raw else 1 / np.maximum(players["energy"], 1.0)
    monsters["hp_scale"] = 1.0 if raw else 1 / monsters["hp"]
    monsters["xp_scale"] = 1.0 if raw else 1 / max(monsters["xp"].max(initial=0.0), 1.0)


def _fill_rays(settings: Any, monsters: np.ndarray, config: EnvConfig, levels: list[Level]) -> None:
    """Write the number and directions of rays, and the kinds of monsters they distinguish."""
    what, _, count = config.perceive.partition(":")
    settings["rays"] = rays = int(count) if what == "rays" else 0
    sights = sorted({kind for level in levels for kind, _, _ in level.monsters})
    settings["sights"] = len(sights)
    for monster, level in zip(monsters, levels, strict=True):
        monster["sight"] = [sights.index(kind) for kind, _, _ in level.monsters]
    left, top, right, bottom = levels[0].grid
    without_monsters = 1.0 if config.scale == "raw" else 1 / max(right - left, bottom - top)  # as `map`
    settings["ray_scale"] = monsters["distance_scale"].min() if monsters.size else without_monsters
    angles = 2 * np.pi * np.arange(rays) / max(rays, 1)
    settings["ray_x"][:rays] = np.round(np.cos(angles), 12)  # rounding makes them equal on all machines
    settings["ray_y"][:rays] = np.round(np.sin(angles), 12)


def observation_space(
    settings: Any, player: Any, monsters: np.ndarray, config: EnvConfig, levels: list[Level]
) -> spaces.Box:
    """Return the Box, with finite bounds, of a player's observations, float32."""
    edges = levels[0].grid
    left, top, right, bottom = _land(levels)
    diagonal = float(np.hypot(edges[2] - edges[0], edges[3] - edges[1]))
    forever = config.xp_scope == "forever"
    worth = float(monsters["xp"].sum(axis=-1).max(initial=0.0)) + 1.0
    most = (MOST_XP if forever else worth) * settings["xp_scale"]
    x, y = _scaled(settings, "x", left, right), _scaled(settings, "y", top, bottom)
    most_hp = float(player["hp"] + monsters["heal"].sum(axis=-1).max(initial=0.0))  # by all kills, unhurt
    hp = (0.0, most_hp * player["hp_scale"])
    xp = (-most if forever else -config.ending_cost * settings["xp_scale"], most)
    energy, way, flag = (0.0, player["energy"] * player["energy_scale"]), (-1.0, 1.0), (0.0, 1.0)
    own = [x, y, way, way, hp, energy] if config.observation == "pygame" else [x, y, hp, xp]
    own += [flag] * (4 * config.observe_facing)
    distance = (0.0, diagonal * monsters["distance_scale"].max(initial=0.0))
    its_hp = (0.0, (monsters["hp"] * monsters["hp_scale"]).max(initial=0.0))
    its_xp = (0.0, (monsters["xp"] * monsters["xp_scale"]).max(initial=0.0))
    if config.terrain_stops == "players":  # monsters follow out over the sea
        x, y = _scaled(settings, "x", edges[0], edges[2]), _scaled(settings, "y", edges[1], edges[3])
    rows: dict[str, list[Any]] = {
        "thesis": [distance, way, way, its_hp],
        "pygame": [distance, way, way, its_hp, its_xp],
        "godot": [x, y, its_hp, way, way],
    }
    row = rows[config.observation]
    ray: list[Any] = [(0.0, diagonal * settings["ray_scale"])] + [flag] * (2 + int(settings["sights"]))
    limits = np.array(own + row * int(settings["perceived"]) + ray * int(settings["rays"]))
    low, high = np.minimum(limits[:, 0], 0.0), np.maximum(limits[:, 1], 0.0)  # idle slots see zeros
    high = np.where(low == high, low + 1.0, high)  # such as nobody's energy: a space has some room
    return spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)


def _scaled(settings: Any, axis: str, *places: float) -> tuple[float, ...]:
    return tuple((place - settings[f"middle_{axis}"]) * settings[f"scale_{axis}"] for place in places)


def _land(levels: list[Level]) -> tuple[float, float, float, float]:
    """Return the box of the land: left, top, right, bottom; for random levels, the whole grid."""
    level = levels[0]  # several are random
    return level.grid if level.name.startswith(RANDOM) else level.land
