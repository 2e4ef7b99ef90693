"""Saving one world and putting it back, and looking at a state that somebody has written by hand."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from pneuma.env import rules, state
from pneuma.env.characters import FACINGS, fastest

if TYPE_CHECKING:
    from pneuma.env.worlds import Worlds

_SEEN_OR_PAID = (
    "reward", "perceived", "hp_scale", "energy_scale", "distance_scale", "xp_scale", "reach_squared",
)  # fmt: skip
"""Stats that no state depends on."""


@dataclass(frozen=True)
class Snapshot:
    """The whole state of one world: what it needs to go on as it would have.

    Attributes:
        worlds, players, monsters: (1,), (1, P) and (1, M), as in `Worlds`.
        fits: names the levels, characters and stops that it can be put back among.
        returns: (P,) what the episode has paid so far, from a face that counts it.
    """

    worlds: np.ndarray
    players: np.ndarray
    monsters: np.ndarray
    fits: str
    returns: np.ndarray | None = None


def fingerprint(worlds: Worlds) -> str:
    """Return a digest of levels, characters and who may stand where: not of what is seen, paid or allowed."""
    digest = hashlib.sha256(state.LAYOUT_DIGEST.encode())
    for level in worlds.levels:
        digest.update(repr((level.left, level.top, level.tile, level.terrain.shape)).encode())
        digest.update(level.terrain.tobytes() + level.starts.tobytes())
    for name in ("player_stops", "monster_stops", "bodies_block"):
        digest.update(worlds.settings[name].tobytes())
    for stats in (worlds.player_stats, worlds.monster_stats):
        for name in stats.dtype.names or ():
            if name not in _SEEN_OR_PAID:
                digest.update(stats[name].tobytes())
    return digest.hexdigest()


def save_world(worlds: Worlds, world: int, fits: str) -> Snapshot:
    """Return a copy of one world's state; see `Worlds.save`."""
    _check_index(worlds, world)
    if not worlds.worlds["players_left"][world] and worlds.ending(world) == "running":
        raise ValueError(f"no episode has begun in world {world}: reset it first")
    one = slice(world, world + 1)
    return Snapshot(
        worlds.raw[0][one].copy().view(state.WORLD),
        worlds.raw[1][one].copy().view(state.PLAYER),
        worlds.raw[2][one].copy().view(state.MONSTER),
        fits,
    )


def restore_world(worlds: Worlds, world: int, snapshot: Snapshot, fits: str) -> None:
    """Put a saved state into one world; see `Worlds.restore`."""
    _check_index(worlds, world)
    if snapshot.fits != fits or snapshot.worlds["level"].item() >= len(worlds.levels):
        raise ValueError(
            "a state of another number of players, another level, class, weapon or kind of monster, or where "
            "other things stop whoever moves, does not fit this world"
        )
    saved = snapshot.worlds, snapshot.players, snapshot.monsters
    for own, array in zip(worlds.raw, saved, strict=False):
        own[world] = array.view(own.dtype)[0]
    worlds.raw[3][world] = state.NO_EVENTS


def _check_index(worlds: Worlds, world: int) -> None:
    if not 0 <= world < len(worlds):
        raise ValueError(f"world {world}: there are worlds 0 to {len(worlds) - 1}")


def refuse_nowhere(worlds: Worlds) -> None:
    """Refuse bodies that are nowhere on the grid, face nowhere or fly faster than anybody can.

    The rules look no index up twice. Dead monsters may be anywhere. Dead players may not: their masks are
    written as if they lived.

    Raises:
        ValueError: saying which, and what they may be.
    """
    players, monsters = worlds.players, worlds.monsters
    kinds = worlds.monster_stats[worlds.worlds["level"]]
    alive = monsters["hp"] > 0
    _refuse_off_grid(worlds, "players", players, worlds.player_stats)
    _refuse_off_grid(worlds, "monsters", monsters[alive], kinds[alive])
    if players["facing"].min() < 0 or players["facing"].max() >= len(FACINGS):
        raise ValueError("players: facing is none of 0 to 3")
    limit = fastest(worlds.player_stats, kinds)
    flying = monsters[alive & (monsters["knocked"] > 0)]
    for axis in ("knock_x", "knock_y"):
        if not (np.abs(flying[axis]) <= limit + rules.HAIR).all():  # nor NaN
            raise ValueError(f"monsters: {axis} is beyond {limit:g} pixels a tick: nobody is faster")


def _refuse_off_grid(worlds: Worlds, name: str, bodies: np.ndarray, stats: np.ndarray) -> None:
    """Refuse a position, or the middle of a body, that lies on no tile; NaN does on none."""
    left, top, right, bottom = worlds.level.grid
    for across, down in ((0, 0), (stats["body_x"], stats["body_y"])):
        x, y = bodies["x"] + across, bodies["y"] + down
        if not ((left <= x) & (x < right) & (top <= y) & (y < bottom)).all():
            told = f"{left:g} to {right:g}, {top:g} to {bottom:g}"
            raise ValueError(f"{name}: x or y lies off the grid, {told}")
