"""What a player perceives: layouts, bounds and scales of an observation; `PneumaEnv` says what they mean.

An observation has a few numbers about the player, then a row for each monster perceived, or for each ray. A
layout's own choices are in `pneuma.env.fields.OBSERVATION_FIELDS`. The land of random levels is the whole
grid, so that each sees the same place as the same numbers, whichever are played together.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from pneuma.env.fields import OBSERVATIONS, RANDOM, EnvConfig
from pneuma.env.level import Level, Rectangle

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
    settings: Any,
    player_stats: np.ndarray,
    monster_stats: np.ndarray,
    config: EnvConfig,
    levels: list[Level],
) -> None:
    """Write layout and scales into rows of `state.SETTINGS`, `PLAYER_STATS` and `MONSTER_STATS`."""
    settings["layout"] = OBSERVATIONS.index(config.observation)
    settings["fixed_order"] = config.order == "fixed"
    settings["perceived"] = most_perceived(config, monster_stats.shape[1])
    if config.scale == "unit":
        land = _land(levels)
        settings["middle_x"] = (land.left + land.right) / 2
        settings["middle_y"] = (land.top + land.bottom) / 2
        settings["scale_x"] = 2 / land.width
        settings["scale_y"] = 2 / land.height
        monster_stats["distance_scale"] = 1 / np.sqrt(np.maximum(monster_stats["notice_squared"], 1.0))
    elif config.scale == "map":
        grid = levels[0].grid
        settings["middle_x"] = grid.left
        settings["middle_y"] = grid.top
        settings["scale_x"] = 1 / grid.width
        settings["scale_y"] = 1 / grid.height
        monster_stats["distance_scale"] = 1 / max(grid.width, grid.height)
    else:
        settings["scale_x"] = 1.0
        settings["scale_y"] = 1.0
        monster_stats["distance_scale"] = 1.0
    if config.scale == "raw":
        settings["xp_scale"] = 1.0
        for stats in (player_stats, monster_stats):
            stats["hp_scale"] = 1.0
        player_stats["energy_scale"] = 1.0
        monster_stats["xp_scale"] = 1.0
    else:
        settings["xp_scale"] = 1 / max(_most_by_level(monster_stats["xp"]), 1.0)
        for stats in (player_stats, monster_stats):
            stats["hp_scale"] = 1 / stats["hp"]
        player_stats["energy_scale"] = 1 / np.maximum(player_stats["energy"], 1.0)
        monster_stats["xp_scale"] = 1 / max(monster_stats["xp"].max(initial=0.0), 1.0)
    _fill_rays(settings, monster_stats, config, levels)


def _most_by_level(numbers: np.ndarray) -> float:
    """Return the greatest sum of a level's monsters, for (levels, monsters) numbers."""
    return float(numbers.sum(axis=-1).max(initial=0.0))


def _fill_rays(settings: Any, monster_stats: np.ndarray, config: EnvConfig, levels: list[Level]) -> None:
    """Write the number and directions of rays, and the kinds of monsters they distinguish."""
    mode, _, number = config.perceive.partition(":")
    rays = 0
    if mode == "rays":
        rays = int(number)
    settings["rays"] = rays
    sights = sorted({monster.name for level in levels for monster in level.monsters})
    settings["sights"] = len(sights)
    for level_stats, level in zip(monster_stats, levels, strict=True):
        level_stats["sight"] = [sights.index(monster.name) for monster in level.monsters]
    if monster_stats.size:
        settings["ray_scale"] = monster_stats["distance_scale"].min()
    elif config.scale == "raw":
        settings["ray_scale"] = 1.0
    else:  # as in `map`
        grid = levels[0].grid
        settings["ray_scale"] = 1 / max(grid.width, grid.height)
    angles = 2 * np.pi * np.arange(rays) / max(rays, 1)
    settings["ray_x"][:rays] = np.round(np.cos(angles), 12)  # rounding makes them equal on all machines
    settings["ray_y"][:rays] = np.round(np.sin(angles), 12)


Bounds = tuple[float, float]
"""The least and greatest value of a number in an observation."""
DIRECTION: Bounds = (-1.0, 1.0)
FLAG: Bounds = (0.0, 1.0)


def observation_space(
    settings: Any, player_stats: Any, monster_stats: np.ndarray, config: EnvConfig, levels: list[Level]
) -> spaces.Box:
    """Return the Box, with finite bounds, of a player's observations, float32."""
    diagonal = float(np.hypot(levels[0].grid.width, levels[0].grid.height))
    bounds = _player_bounds(settings, player_stats, monster_stats, config, levels)
    row = _monster_bounds(settings, monster_stats, config, levels, diagonal)
    bounds += row * int(settings["perceived"])
    ray: list[Bounds] = [(0.0, diagonal * settings["ray_scale"])] + [FLAG] * (2 + int(settings["sights"]))
    bounds += ray * int(settings["rays"])
    limits = np.array(bounds)
    low = np.minimum(limits[:, 0], 0.0)  # idle slots see zeros
    high = np.maximum(limits[:, 1], 0.0)
    high = np.where(low == high, low + 1.0, high)  # such as nobody's energy: a space has some room
    return spaces.Box(low.astype(np.float32), high.astype(np.float32), dtype=np.float32)


def _player_bounds(
    settings: Any, player_stats: Any, monster_stats: np.ndarray, config: EnvConfig, levels: list[Level]
) -> list[Bounds]:
    """Return the bounds of what a player observes of itself."""
    position = _position_bounds(settings, _land(levels))
    most_hp = float(player_stats["hp"] + _most_by_level(monster_stats["heal"]))  # by all kills, unhurt
    hp_bounds = (0.0, most_hp * player_stats["hp_scale"])
    if config.observation == "pygame":
        energy = (0.0, player_stats["energy"] * player_stats["energy_scale"])
        bounds = [*position, DIRECTION, DIRECTION, hp_bounds, energy]
    else:
        bounds = [*position, hp_bounds, _xp_bounds(settings, monster_stats, config)]
    if config.observe_facing:
        bounds += [FLAG] * 4
    return bounds


def _xp_bounds(settings: Any, monster_stats: np.ndarray, config: EnvConfig) -> Bounds:
    if config.xp_scope == "forever":
        return -MOST_XP * settings["xp_scale"], MOST_XP * settings["xp_scale"]
    most_xp = _most_by_level(monster_stats["xp"]) + 1.0
    return -config.ending_cost * settings["xp_scale"], most_xp * settings["xp_scale"]


def _monster_bounds(
    settings: Any, monster_stats: np.ndarray, config: EnvConfig, levels: list[Level], diagonal: float
) -> list[Bounds]:
    """Return the bounds of a monster's row."""
    hp_bounds = (0.0, (monster_stats["hp"] * monster_stats["hp_scale"]).max(initial=0.0))
    if config.observation == "godot":
        area = _land(levels)
        if config.terrain_stops == "players":  # monsters follow out over the sea
            area = levels[0].grid
        return [*_position_bounds(settings, area), hp_bounds, DIRECTION, DIRECTION]
    distance = (0.0, diagonal * monster_stats["distance_scale"].max(initial=0.0))
    bounds = [distance, DIRECTION, DIRECTION, hp_bounds]
    if config.observation == "pygame":
        bounds.append((0.0, (monster_stats["xp"] * monster_stats["xp_scale"]).max(initial=0.0)))
    return bounds


def _position_bounds(settings: Any, area: Rectangle) -> list[Bounds]:
    """Return the bounds of x and y as they are observed."""
    low_x = (area.left - settings["middle_x"]) * settings["scale_x"]
    high_x = (area.right - settings["middle_x"]) * settings["scale_x"]
    low_y = (area.top - settings["middle_y"]) * settings["scale_y"]
    high_y = (area.bottom - settings["middle_y"]) * settings["scale_y"]
    return [(low_x, high_x), (low_y, high_y)]


def _land(levels: list[Level]) -> Rectangle:
    """Return the box of the land; for random levels, the whole grid."""
    level = levels[0]  # several are random
    if level.name.startswith(RANDOM):
        return level.grid
    return level.land
