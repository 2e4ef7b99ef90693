"""Characters: what players and monsters are made of, read from `data/characters.toml`.

Turns the file's seconds and pixels a second into the ticks and pixels a tick that the rules use.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from pneuma.env import state
from pneuma.env.level import Level

TICKS_PER_SECOND = 60
TICKS_PER_STEP = 8
"""Godot RL Agents repeats every action for this many ticks."""

DATA = Path(__file__).parent / "data"


@cache
def shipped_characters() -> dict[str, Any]:
    """Read the character file that comes with the package: {"players": …, "monsters": …}."""
    with open(DATA / "characters.toml", "rb") as file:
        return tomllib.load(file)


def monster_codes() -> dict[int, str]:
    """Return which entity code of a level's layer stands for which kind of monster."""
    return {kind["code"]: name for name, kind in shipped_characters()["monsters"].items()}


def player_stats(classes: tuple[str, ...]) -> np.ndarray:
    """Return the stats of each player's class, shape (P,), dtype `state.PLAYER_STATS`."""
    stats = np.zeros(len(classes), state.PLAYER_STATS)
    for row, name in zip(stats, classes, strict=True):
        _fill_player(row, shipped_characters()["players"][name])
    return stats


def monster_stats(level: Level, players: np.ndarray) -> np.ndarray:
    """Return the stats and home of each monster of a level, shape (M,), dtype `state.MONSTER_STATS`."""
    stats = np.zeros(len(level.monsters), state.MONSTER_STATS)
    for row, (kind, x, y) in zip(stats, level.monsters, strict=True):
        _fill_monster(row, shipped_characters()["monsters"][kind])
        row["home_x"], row["home_y"] = x, y
        row["reach"] = _reach(row, players)
    return stats


def margin(players: np.ndarray, monsters: np.ndarray) -> float:
    """Return how far from its centre, on either axis, any body can reach within one tick."""
    knock = players["knock_speed"].max()
    reach = [max(row["half_width"], row["half_height"]) + row["speed"] for row in players]
    reach += [max(row["half_width"], row["half_height"]) + max(row["speed"], knock) for row in monsters]
    return float(max(reach))


def _ticks(seconds: float) -> int:
    return round(seconds * TICKS_PER_SECOND)


def _fill_player(row: Any, character: Mapping[str, Any]) -> None:
    row["hp"] = character["hp"]
    row["speed"] = character["speed"] / TICKS_PER_SECOND
    row["half_width"], row["half_height"] = (side / 2 for side in character["body"])
    row["damage"] = character["damage"]
    row["swing"] = _ticks(character["swing"])
    row["knock_ticks"] = _ticks(character["knock_back_time"])
    row["knock_speed"] = character["knock_back"] / TICKS_PER_SECOND
    width, height = (side / 2 for side in character["sword"])
    reach = character["sword_reach"]
    row["sword_x"] = [0, -reach["left"], 0, reach["right"]]
    row["sword_y"] = [reach["down"], 0, -reach["up"], 0]
    row["sword_half_width"] = [height, width, height, width]
    row["sword_half_height"] = [width, height, width, height]


def _fill_monster(row: Any, character: Mapping[str, Any]) -> None:
    for name in ("hp", "notice", "attack", "stand_off", "damage", "xp", "heal"):
        row[name] = character[name]
    row["speed"] = character["speed"] / TICKS_PER_SECOND
    row["half_width"], row["half_height"] = (side / 2 for side in character["body"])
    row["hp_scale"], row["distance_scale"] = 1 / character["hp"], 1 / character["notice"]
    row["bite_ticks"] = _ticks(character["bite_time"])


def _reach(monster: Any, players: np.ndarray) -> float:
    """Return a distance to a player's body beyond which a resting monster meets nothing in a step.

    The furthest that it senses or that a sword reaches it, and as far as a player walks.
    """
    sword_x = np.abs(players["sword_x"]) + players["sword_half_width"]
    sword_y = np.abs(players["sword_y"]) + players["sword_half_height"]
    sword = np.hypot(sword_x + monster["half_width"], sword_y + monster["half_height"]).max()
    walk = players["speed"].max() * TICKS_PER_STEP
    return float(max(monster["notice"], monster["attack"], sword) + walk + 1.0)
