"""Worlds of the kernel and the oracle, set up by hand: a player at `HERE`, bamboos where they are wanted."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .oracle_arrays import Pair
from .oracle_cases import Case, make_worlds
from .oracle_maps import Map

HERE = (512.0, 512.0)
FAR = (832.0, 832.0)
QUIET = "[monsters.bamboo]\nspeed = 0\n"
"""Bamboos that stay where they are."""


def set_up(folder: Path, *monsters: tuple[float, float], characters: str = QUIET, **chosen: object) -> Pair:
    """Set up a world of 16 x 16 tiles of 64 px, the outermost of them coast.

    Players start at `HERE` and, the second, at `FAR`; bamboos are at the places given, even inside of each
    other, where no level may have them.
    """
    homes = [("bamboo", 112.0 + 80.0 * number, 128.0) for number in range(len(monsters))]
    given = {"reward": "godot", "start": "first", "ending_cost": 1.0, **chosen}
    level = Map(starts=(HERE, FAR), monsters=tuple(homes))
    case = Case(given, level, characters, count=1, seed=0, moods=b"", breaks=b"")
    pair = Pair(make_worlds(case, folder / "case"))
    pair.worlds.monsters["x"][0], pair.worlds.monsters["y"][0] = np.array(monsters).T
    pair.take_over()
    return pair


def act(pair: Pair, *actions: int) -> None:
    """Play one step."""
    pair.step(np.array([actions]))


def told(pair: Pair, name: str) -> list[float]:
    """Return a field of the players or their events."""
    events = name in (pair.worlds.events.dtype.names or ())
    return list((pair.worlds.events if events else pair.worlds.players)[name][0].tolist())


def put(pair: Pair, **fields: object) -> None:
    """Write fields of the players by hand: a number for all, or one for each."""
    for name, value in fields.items():
        pair.worlds.players[name][0] = value
    pair.take_over()
