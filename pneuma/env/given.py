"""What is given to the compiled rules by hand: they look no index up twice, so it is looked at before.

Arrays of actions, masks and start places; and a state that somebody has written.
"""

from __future__ import annotations

import numpy as np

from pneuma.env import rules
from pneuma.env.characters import FACINGS, fastest
from pneuma.env.level import Level


def checked(given: np.ndarray, shape: int | tuple[int, ...], kinds: str, what: str) -> np.ndarray:
    """Return what was given as the compiled rules take it: booleans, or int64.

    Raises:
        ValueError: where its shape or kind is another.
    """
    array = np.asarray(given)
    wanted = (shape,) if isinstance(shape, int) else shape
    if array.shape != wanted or array.dtype.kind not in kinds:
        of = "booleans" if kinds == "b" else "whole numbers"
        raise ValueError(f"{what}: must be {of} of shape {wanted}, not {array.dtype} of {array.shape}")
    return np.ascontiguousarray(array, np.bool_ if kinds == "b" else np.int64)


def refuse_nowhere(
    level: Level, players: np.ndarray, player_stats: np.ndarray, monsters: np.ndarray, kinds: np.ndarray
) -> None:
    """Refuse bodies that are nowhere on a level's grid, face nowhere or fly faster than anybody can.

    Dead monsters may be anywhere. Dead players may not: their masks are written as if they lived.

    Args:
        level: the level, or any of several: they share a grid.
        players: (N, P) `state.PLAYER`.
        player_stats: (P,) `state.PLAYER_STATS`.
        monsters: (N, M) `state.MONSTER`.
        kinds: (N, M) `state.MONSTER_STATS`.

    Raises:
        ValueError: saying which, and what they may be.
    """
    alive = monsters["hp"] > 0
    _refuse_off_grid(level, "players", players, player_stats)
    _refuse_off_grid(level, "monsters", monsters[alive], kinds[alive])
    if players["facing"].min() < 0 or players["facing"].max() >= len(FACINGS):
        raise ValueError("players: facing is none of 0 to 3")
    limit = fastest(player_stats, kinds)
    flying = monsters[alive & (monsters["knocked"] > 0)]
    for axis in ("knock_x", "knock_y"):
        if not (np.abs(flying[axis]) <= limit + rules.HAIR).all():  # nor NaN
            raise ValueError(f"monsters: {axis} is beyond {limit:g} pixels a tick: nobody is faster")


def _refuse_off_grid(level: Level, name: str, bodies: np.ndarray, stats: np.ndarray) -> None:
    """Refuse a position, or the middle of a body, that lies on no tile; NaN does on none."""
    left, top, right, bottom = level.grid
    for x, y in (
        (bodies["x"], bodies["y"]),
        (bodies["x"] + stats["body_x"], bodies["y"] + stats["body_y"]),
    ):
        if not ((left <= x) & (x < right) & (top <= y) & (y < bottom)).all():
            raise ValueError(
                f"{name}: x or y lies off the grid, {left:g} to {right:g}, {top:g} to {bottom:g}"
            )
