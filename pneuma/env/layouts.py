"""What a player perceives: layouts, bounds and scales of an observation; `PneumaEnv` explains them.

An observation has a few numbers about the player, then a row for each monster perceived, or for each ray. A
layout's own choices are in `pneuma.env.fields.OBSERVATION_FIELDS`. The land of random levels is the whole
grid, so that each sees the same place as the same numbers, whichever are played together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from pneuma.env.fields import OBSERVATIONS, RANDOM, EnvConfig
from pneuma.env.level import Level, Rectangle

MAX_XP = 1e9
"""Bound of XP, in points, that is kept through episodes."""


def fill_scales(
    config: EnvConfig, levels: Sequence[Level], settings: Any, players: np.ndarray, monsters: np.ndarray
) -> None:
    """Write layout and scales into `state.SETTINGS`, player stats (P,) and monster stats (levels, M)."""
    settings["layout"] = OBSERVATIONS.index(config.observation)
    settings["fixed_order"] = config.order == "fixed"
    settings["xp_scale"] = 1 / max(_max_by_level(monsters["xp"]), 1.0)
    monsters["xp_scale"] = 1 / max(monsters["xp"].max(initial=0.0), 1.0)
    players["energy_scale"] = 1 / np.maximum(players["energy"], 1.0)
    players["hp_scale"] = 1 / players["hp"]
    monsters["hp_scale"] = 1 / monsters["hp"]
    grid = levels[0].grid
    distance_scale = 1 / max(grid.width, grid.height)
    if config.scale == "unit":
        land = _land(levels[0])
        settings["middle_x"] = (land.left + land.right) / 2
        settings["middle_y"] = (land.top + land.bottom) / 2
        settings["scale_x"] = 2 / land.width
        settings["scale_y"] = 2 / land.height
        monsters["distance_scale"] = 1 / np.sqrt(np.maximum(monsters["notice_squared"], 1.0))
    elif config.scale == "map":
        settings["middle_x"] = grid.left
        settings["middle_y"] = grid.top
        settings["scale_x"] = 1 / grid.width
        settings["scale_y"] = 1 / grid.height
        monsters["distance_scale"] = distance_scale
    else:
        distance_scale = 1.0
        settings["scale_x"] = settings["scale_y"] = settings["xp_scale"] = 1.0
        players["hp_scale"] = players["energy_scale"] = 1.0
        monsters["hp_scale"] = monsters["xp_scale"] = monsters["distance_scale"] = 1.0
    if monsters.size:
        distance_scale = monsters["distance_scale"].min()
    settings["ray_scale"] = distance_scale
    _fill_perceived(config, levels, settings, monsters)


def _fill_perceived(config: EnvConfig, levels: Sequence[Level], settings: Any, monsters: np.ndarray) -> None:
    """Write how many monsters are perceived, or by which rays, and the kinds that these distinguish."""
    perception, _, number = config.perceive.partition(":")
    settings["perceived"] = monsters.shape[1]
    if perception == "nearest":
        settings["perceived"] = min(int(number), settings["perceived"])
    elif perception == "rays":
        settings["perceived"] = 0
        settings["rays"] = rays = int(number)
        angles = 2 * np.pi * np.arange(rays) / rays
        settings["ray_x"][:rays] = np.round(np.cos(angles), 12)  # rounding makes them equal on all machines
        settings["ray_y"][:rays] = np.round(np.sin(angles), 12)
    species = sorted({monster.name for level in levels for monster in level.monsters})
    settings["species_count"] = len(species)
    for level_stats, level in zip(monsters, levels, strict=True):
        level_stats["species"] = [species.index(monster.name) for monster in level.monsters]


def _max_by_level(numbers: np.ndarray) -> float:
    """Return the greatest sum of a level's monsters, for (levels, monsters) numbers."""
    return float(numbers.sum(axis=-1).max(initial=0.0))


Bounds = tuple[float, float]
"""The least and greatest value of a number in an observation."""
DIRECTION: Bounds = (-1.0, 1.0)
FLAG: Bounds = (0.0, 1.0)


def observation_space(
    config: EnvConfig, level: Level, settings: Any, player_stats: Any, monsters: np.ndarray
) -> spaces.Box:
    """Return the Box, with finite bounds, of a player's observations, float32."""
    width, height = level.grid.width, level.grid.height
    diagonal = math.sqrt(width * width + height * height)
    max_hp = player_stats["hp"] + _max_by_level(monsters["heal"])  # by all kills, unhurt
    hp_bounds = (0.0, max_hp * player_stats["hp_scale"])
    min_xp, max_xp = 0.0 - config.ending_cost, _max_by_level(monsters["xp"]) + 1.0
    if config.xp_scope == "forever":
        min_xp, max_xp = -MAX_XP, MAX_XP
    monster_hp = (0.0, (monsters["hp"] * monsters["hp_scale"]).max(initial=0.0))
    monster_xp = (0.0, (monsters["xp"] * monsters["xp_scale"]).max(initial=0.0))
    distance_bounds = (0.0, diagonal * monsters["distance_scale"].max(initial=0.0))
    bounds = _position_bounds(settings, _land(level))
    monster_bounds = [distance_bounds, DIRECTION, DIRECTION, monster_hp]
    if config.observation == "pygame":
        energy_bounds = (0.0, player_stats["energy"] * player_stats["energy_scale"])
        bounds += [DIRECTION, DIRECTION, hp_bounds, energy_bounds]
        monster_bounds.append(monster_xp)
    else:
        bounds += [hp_bounds, (min_xp * settings["xp_scale"], max_xp * settings["xp_scale"])]
    if config.observation == "godot":
        area = _land(level)
        if config.terrain_stops == "players":  # monsters follow out over the sea
            area = level.grid
        monster_bounds = [*_position_bounds(settings, area), monster_hp, DIRECTION, DIRECTION]
    if config.observe_facing:
        bounds += [FLAG] * 4
    ray: list[Bounds] = [(0.0, diagonal * settings["ray_scale"])] + [FLAG] * (
        2 + int(settings["species_count"])
    )
    bounds += monster_bounds * int(settings["perceived"]) + ray * int(settings["rays"])
    limits = np.array(bounds)
    low = np.minimum(limits[:, 0], 0.0)  # idle slots see zeros
    high = np.maximum(limits[:, 1], 0.0)
    high = np.where(low == high, low + 1.0, high)  # such as nobody's energy: a space has some room
    return spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)


def _position_bounds(settings: Any, area: Rectangle) -> list[Bounds]:
    """Return the bounds of x and y as they are observed."""
    low_x = (area.left - settings["middle_x"]) * settings["scale_x"]
    high_x = (area.right - settings["middle_x"]) * settings["scale_x"]
    low_y = (area.top - settings["middle_y"]) * settings["scale_y"]
    high_y = (area.bottom - settings["middle_y"]) * settings["scale_y"]
    return [(low_x, high_x), (low_y, high_y)]


def _land(level: Level) -> Rectangle:
    """Return the box of the land; for random levels, of which several may be played, the whole grid."""
    if level.name.startswith(RANDOM):
        return level.grid
    return level.land
