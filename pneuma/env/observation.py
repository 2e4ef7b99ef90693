"""What a player perceives: the layout, bounds and scales of an observation.

`pneuma/Pneuma-v0` perceives the quantities of the thesis's section 5.1, every monster, nearest
first, each number of order one. The rules write it; this module says what stands where.

    0       x, from -1 at the land's left edge to 1 at its right
    1       y, from -1 at its upper edge to 1 at its lower
    2       HP over full HP
    3       XP over all the level's XP
    4 + 4i  i-th nearest living monster: distance in units of its notice radius,
    5 + 4i  x and
    6 + 4i  y of the unit vector from the player to it,
    7 + 4i  its HP over full HP

The dead come last, as four zeros each.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces

from pneuma.env.level import Level

PLAYER_FEATURES = ("x", "y", "hp", "xp")
MONSTER_FEATURES = ("distance", "direction_x", "direction_y", "hp")


def feature_names(monsters: int) -> list[str]:
    """Name every number of an observation of so many monsters, in order."""
    seen = [f"monster_{i}_{name}" for i in range(monsters) for name in MONSTER_FEATURES]
    return [*PLAYER_FEATURES, *seen]


def observation_space(level: Level, monster_stats: np.ndarray) -> spaces.Box:
    """Return the Box that every observation of a level lies in, shape (4 + 4 M,), float32."""
    left, top, right, bottom = level.land
    furthest = np.hypot(right - left, bottom - top) / monster_stats["notice"].min(initial=np.inf)
    low = np.tile(np.array([0.0, -1.0, -1.0, 0.0]), len(monster_stats))
    high = np.tile(np.array([furthest, 1.0, 1.0, 1.0]), len(monster_stats))
    return spaces.Box(
        np.concatenate([[-1.0, -1.0, 0.0, 0.0], low]).astype(np.float32),
        np.concatenate([[1.0, 1.0, 1.0, 1.0], high]).astype(np.float32),
        dtype=np.float32,
    )


def fill_scales(settings: Any, level: Level, monster_stats: np.ndarray) -> None:
    """Write the scales of an observation into one row of `state.SETTINGS`."""
    left, top, right, bottom = level.land
    settings["middle_x"], settings["middle_y"] = (left + right) / 2, (top + bottom) / 2
    settings["scale_x"], settings["scale_y"] = 2 / (right - left), 2 / (bottom - top)
    settings["xp_scale"] = 1 / max(monster_stats["xp"].sum(), 1.0)
