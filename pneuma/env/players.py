"""Two players to compare with: a random one, whose score is 0, and a scripted hunter.

A player chooses actions for all worlds at once, from their state.
"""

from __future__ import annotations

import numpy as np

from pneuma.env import rules
from pneuma.env.characters import TICKS_PER_STEP
from pneuma.env.worlds import Worlds

FARTHEST = 1e6
"""A distance in pixels beyond all others."""


class RandomPlayer:
    """Chooses actions uniformly at random, with the generator that it is given."""

    def __init__(self, generator: np.random.Generator) -> None:
        self.generator = generator

    def act(self, worlds: Worlds) -> np.ndarray:
        """Return (N, P) actions."""
        return self.generator.integers(int(worlds.action_space.n), size=worlds.players.shape)


class Hunter:
    """Walks straight to the nearest living monster and attacks when the sword would hit one.

    If something stops it, it goes another way for a few steps. It knows the whole state, not only what a
    player observes, but no ways around lakes: on islands a trained agent is the better reference.
    """

    SIDE_STEPS = 4

    def __init__(self, worlds: Worlds) -> None:
        self._last_walk = np.full((2, *worlds.players.shape), np.nan)  # x and y where it began
        self._detour_steps = np.zeros(worlds.players.shape, np.int64)  # that are left of a way round
        self._detour_facing = np.zeros(worlds.players.shape, np.int64)

    def act(self, worlds: Worlds) -> np.ndarray:
        """Return (N, P) actions; those of players who are busy do not matter."""
        fresh = worlds.worlds["steps"] == 0
        self._last_walk[:, fresh] = np.nan
        self._detour_steps[fresh] = 0
        monsters, players = worlds.monsters[:, None, :], worlds.players[:, :, None]
        alive = monsters["hp"] > 0  # (N, 1, M)
        offset_x = monsters["x"] - players["x"]  # from player to monster, (N, P, M)
        offset_y = monsters["y"] - players["y"]
        reached = [_in_reach(worlds, offset_x, offset_y, facing) for facing in range(4)]
        hits = np.stack(reached) & alive  # (4, N, P, M)
        strikes = _pick(np.any(hits, axis=-1), worlds.players["facing"])
        can_act = (worlds.players["busy"] < TICKS_PER_STEP) & (worlds.players["hp"] > 0)
        can_act &= alive.any(axis=-1) & (worlds.worlds["ending"] == 0)[:, None]
        walks = can_act & ~strikes
        ahead, aside = self._towards(offset_x, offset_y, alive, hits)
        return np.where(walks, self._go_round(worlds, walks, ahead, aside), rules.ATTACK)

    def _towards(
        self, offset_x: np.ndarray, offset_y: np.ndarray, alive: np.ndarray, hits: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the direction to the monster that is nearest, and the one to go aside, (N, P) each.

        A monster that a turn would hit is nearer than all others.
        """
        distances = np.where(hits.any(axis=0), 0.0, 1.0) + np.hypot(offset_x, offset_y) / FARTHEST
        nearest = np.where(alive, distances, np.inf).argmin(axis=-1)[..., None]
        offset_x = np.take_along_axis(offset_x, nearest, -1)[..., 0]
        offset_y = np.take_along_axis(offset_y, nearest, -1)[..., 0]
        nearest_hits = np.take_along_axis(hits, nearest[None], -1)[..., 0]  # (4, N, P)
        along_x = np.where(offset_x > 0, rules.RIGHT, rules.LEFT)
        along_y = np.where(offset_y > 0, rules.DOWN, rules.UP)
        sideways = np.abs(offset_x) > np.abs(offset_y)
        longer = np.where(sideways, along_x, along_y)
        shorter = np.where(sideways, along_y, along_x)
        turns = ~_pick(nearest_hits, longer) & _pick(nearest_hits, shorter)
        return np.where(turns, shorter, longer), np.where(turns, longer, shorter)

    def _go_round(
        self, worlds: Worlds, walks: np.ndarray, ahead: np.ndarray, aside: np.ndarray
    ) -> np.ndarray:
        """Return the direction, or another one for a few steps if the player was stopped.

        First aside, then round to the right. Later players go further, so that two do not block each other
        for ever. All arrays are (N, P).
        """
        position = np.stack([worlds.players["x"], worlds.players["y"]])
        stopped = (position == self._last_walk).all(axis=0) & walks
        stopped_again = stopped & (self._detour_steps > 0)
        facing = np.where(stopped, aside, self._detour_facing)
        self._detour_facing = np.where(stopped_again, (self._detour_facing + 1) % 4, facing)
        most_steps = self.SIDE_STEPS * (1 + np.arange(worlds.players.shape[1]))
        fewer_steps = np.maximum(self._detour_steps - walks, 0)
        self._detour_steps = np.where(stopped, most_steps, fewer_steps)
        self._last_walk = np.where(walks, position, np.nan)
        return np.where(self._detour_steps > 0, self._detour_facing, ahead)


def _in_reach(worlds: Worlds, offset_x: np.ndarray, offset_y: np.ndarray, facing: int) -> np.ndarray:
    """Return which monsters an attack in a direction would hit as they stand: (N, P, M)."""
    monster_stats = worlds.monster_stats[worlds.worlds["level"]][:, None, :]  # (N, 1, M)
    meets = np.ones(offset_x.shape, bool)
    for offset, axis, side in ((offset_x, "x", "width"), (offset_y, "y", "height")):
        centre = worlds.player_stats["sword"][axis][:, facing, None]  # (P, 1)
        half = worlds.player_stats["sword"][f"half_{side}"][:, facing, None]
        distance = np.abs(offset + monster_stats[f"body_{axis}"] - centre)
        meets &= distance < half + monster_stats[f"half_{side}"]
    return meets


def _pick(by_facing: np.ndarray, facing: np.ndarray) -> np.ndarray:
    """Return the entry of (4, N, P) for each player's facing, (N, P)."""
    return np.asarray(np.take_along_axis(by_facing, facing[None].astype(np.int64), 0)[0])
