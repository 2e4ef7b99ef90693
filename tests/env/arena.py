"""Bare levels and worlds set by hand, so that every expected value is a short sum; the oracle plays along.

The arena is 20 x 20 tiles of 64 px around the origin: the grid spans -640 … 640 on both axes. Its
outermost ring is coast, so the land spans -576 … 576. One tile, column 14 and row 10, is an
obstacle: x from 256 to 320, y from 0 to 64. A bamboo, or one of each kind, lives in every corner.

A player's body reaches 25 px to the left of its place, 22 to the right, 22 up and 26 down; a bamboo's
12 px to either side, 23 up and 27 down. So the two touch where the bamboo is 34 px to the right of the
player, 37 to the left, or 49 above or below. Facing right the sword strikes a bamboo that is between -13 and
90 px to the right and between -49 and 52 px below; its hilt is at (54, 14).
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np

from pneuma.env import rules
from pneuma.env.fields import ENVIRONMENTS, make_env_config
from pneuma.env.worlds import Worlds

from .oracle import Pair as Place
from .oracle_arrays import Pair
from .oracle_cases import Map

THESIS, GODOT, ARENA = ENVIRONMENTS
DOWN, LEFT, UP, RIGHT, ATTACK = rules.DOWN, rules.LEFT, rules.UP, rules.RIGHT, rules.ATTACK
FLAME, HEAL = rules.FLAME, rules.HEAL

CORNERS = [*itertools.product((-540.0, 540.0), repeat=2)]
EMPTY = Map(20, 20, origin=(10, 10), starts=((0.0, 0.0),))
FIELD = replace(EMPTY, monsters=tuple(("bamboo", x, y) for x, y in CORNERS))
KINDS = ("bamboo", "spirit", "raccoon", "squid")
ZOO = replace(EMPTY, monsters=tuple((name, x, y) for name, (x, y) in zip(KINDS, CORNERS, strict=True)))


def characters_file(folder: Path, text: str) -> str:
    """Write a file of characters and return its path."""
    path = folder / "mine.toml"
    path.write_text(text)
    return str(path)


def begin(count: int, seed: int = 0, env_id: str = THESIS, **settings: object) -> Worlds:
    """Return worlds seeded seed, seed + 1, … at the beginning of an episode."""
    worlds = Worlds(count, make_env_config(settings, env_id))
    worlds.seed(range(seed, seed + count))
    worlds.reset()
    return worlds


def stage(
    level: str,
    *monsters: Place,
    facing: int = RIGHT,
    ticks: int = 8,
    still: bool = False,
    env_id: str = THESIS,
    **settings: object,
) -> Pair:
    """Set up one world by hand, with players at the origin.

    `level` is a folder with four monsters, `monsters` the places of the first; the others are at home.
    Monsters that are `still` stay where they are unless knocked back. A step takes `ticks`.
    """
    worlds = Worlds(1, make_env_config({**settings, "level": level}, env_id))
    worlds.settings["ticks"] = ticks
    if still:
        worlds.monster_stats["speed"] = 0.0
    pair = Pair(worlds)
    if monsters:
        x, y = zip(*monsters, strict=True)
        pair.put(monsters=True, x=x, y=y)
    pair.put(facing=facing)
    return pair


def play(worlds: Worlds, *actions: int) -> None:
    """Step every player of every world through the same actions."""
    for action in actions:
        worlds.step(np.full(worlds.players.shape, action, np.int64))
