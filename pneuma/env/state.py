"""The world's state as plain structured arrays: what each holds, and what the rules read and write.

Lengths are pixels, times ticks of 1/60 s, speeds pixels a tick; y points down. N worlds, P players
in each, M monsters in each.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

MAX_PLAYERS = 8

Array = Any
"""A NumPy array, or a row of one, inside a kernel."""

_AREA = [("half_width", "f8"), ("half_height", "f8")]

WORLD = np.dtype(
    [
        ("key", "u8"),  # of the world's random stream
        ("draws", "u8"),  # numbers taken from it so far
        ("steps", "i8"),  # agent steps of this episode
        ("monsters_left", "i4"),
        ("players_left", "i4"),
        ("ending", "i4"),  # RUNNING, or how the episode ended
        ("start", "i4"),  # index of player 0's start place
    ],
    align=True,
)
PLAYER = np.dtype(
    [
        ("x", "f8"),
        ("y", "f8"),
        ("hp", "f8"),
        ("xp", "f8"),
        ("facing", "i4"),
        ("swing", "i4"),  # ticks that the current attack still lasts
        ("kills", "i4"),
    ],
    align=True,
)
MONSTER = np.dtype(
    [
        ("x", "f8"),
        ("y", "f8"),
        ("hp", "f8"),
        ("knock_x", "f8"),  # pixels a tick
        ("knock_y", "f8"),
        ("knocked", "i4"),  # ticks that the knock-back still lasts
        ("noticed", "u1"),  # bit p: player p is inside the notice circle
        ("struck", "u1"),  # bit p: already hit by player p's current swing
        ("bite", "i2", (MAX_PLAYERS,)),  # ticks to the next hit of player p; 0: out of reach
    ],
    align=True,
)
EVENTS = np.dtype(
    [
        ("reward", "f8"),
        ("xp_gained", "f8"),
        ("hp_lost", "f8"),
        ("hp_gained", "f8"),
        ("hits", "i4"),  # blows landed on monsters
        ("kills", "i4"),
        ("notices", "i4"),  # notice circles entered
        ("contacts", "i4"),  # attack circles entered
    ],
    align=True,
)
"""What happened to a player during one step, for rewards computed outside."""

PLAYER_STATS = np.dtype(
    [
        ("hp", "f8"),
        ("speed", "f8"),
        *_AREA,
        ("damage", "f8"),
        ("swing", "i4"),
        ("knock_ticks", "i4"),
        ("knock_speed", "f8"),
        ("sword_x", "f8", (4,)),  # centre of the sword box from the player, by facing
        ("sword_y", "f8", (4,)),
        ("sword_half_width", "f8", (4,)),
        ("sword_half_height", "f8", (4,)),
    ],
    align=True,
)
MONSTER_STATS = np.dtype(
    [
        ("home_x", "f8"),
        ("home_y", "f8"),
        ("hp", "f8"),
        ("speed", "f8"),
        *_AREA,
        ("notice", "f8"),
        ("attack", "f8"),
        ("stand_off", "f8"),  # no approach on an axis nearer than this
        ("damage", "f8"),
        ("bite_ticks", "i4"),
        ("xp", "f8"),  # for the kill
        ("heal", "f8"),
        ("hp_scale", "f8"),  # of observed HP and distances
        ("distance_scale", "f8"),
        ("reach", "f8"),  # beyond this nothing can happen to it within one step
    ],
    align=True,
)
SETTINGS = np.dtype(
    [
        ("left", "f8"),  # of the tile grid
        ("top", "f8"),
        ("tile", "f8"),
        ("cells_per_pixel", "f8"),  # of the finer grid that tells where there is room
        ("ticks", "i4"),  # of one agent step
        ("step_limit", "i8"),
        ("end_on_clear", "i4"),
        ("middle_x", "f8"),  # unit scale of positions: (x - middle) * scale
        ("middle_y", "f8"),
        ("scale_x", "f8"),
        ("scale_y", "f8"),
        ("xp_scale", "f8"),
    ],
    align=True,
)

SCRATCH = np.dtype([("order", "i8"), ("distance", "f8")])


class State(NamedTuple):
    """Every array that the kernels share, in the order in which they take them.

    The first three are the whole state of the worlds; the last three are overwritten by every step.
    """

    worlds: Array  # (N,) WORLD
    players: Array  # (N, P) PLAYER
    monsters: Array  # (N, M) MONSTER
    player_stats: Array  # (P,) PLAYER_STATS
    monster_stats: Array  # (M,) MONSTER_STATS
    settings: Array  # (1,) SETTINGS
    terrain: Array  # (rows, columns) uint8: OPEN, SOLID or COAST
    room: Array  # (2 rows, 2 columns) uint8: whether a body has room, by half tiles
    events: Array  # (N, P) EVENTS
    observations: Array  # (N, P, features) float32
    scratch: Array  # (M,) SCRATCH: room to sort monsters in
