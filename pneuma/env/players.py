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
        self._way = np.zeros(worlds.players.shape, _WAY)

    def act(self, worlds: Worlds) -> np.ndarray:
        """Return (N, P) actions; those of players who are busy do not matter."""
        actions = np.full(worlds.players.shape, rules.ATTACK)
        for world_index, world_row in enumerate(worlds.worlds):
            if world_row["steps"] == 0:
                self._way[world_index] = 0
            if world_row["ending"] == rules.RUNNING and world_row["monsters_left"]:
                for player_index in range(actions.shape[1]):
                    actions[world_index, player_index] = self._choose(worlds, world_index, player_index)
        return actions

    def _choose(self, worlds: Worlds, world_index: int, player_index: int) -> int:
        """Return a player's action in a world where monsters live."""
        player, detour = worlds.players[world_index, player_index], self._way[world_index, player_index]
        has_walked, detour["walks"] = bool(detour["walks"]), False
        if player["busy"] >= TICKS_PER_STEP or player["hp"] <= 0:
            return rules.ATTACK
        monsters = worlds.monsters[world_index]
        living = np.flatnonzero(monsters["hp"] > 0)
        offsets = np.stack([monsters["x"][living] - player["x"], monsters["y"][living] - player["y"]])
        monster_stats = worlds.monster_stats[worlds.worlds["level"][world_index], living]
        hits = _hits(worlds.player_stats["sword"][player_index], offsets, monster_stats)
        if hits[player["facing"]].any():
            return rules.ATTACK
        # A monster that a turn would hit is nearer than all others.
        distances = np.sqrt((offsets * offsets).sum(axis=0))
        nearest = (~hits.any(axis=0) + distances / FARTHEST).argmin()
        ahead, aside = _directions(*offsets[:, nearest])
        if hits[aside, nearest] and not hits[ahead, nearest]:
            ahead, aside = aside, ahead
        if has_walked and (detour["x"], detour["y"]) == (player["x"], player["y"]):  # something stopped it
            if detour["steps"] > 0:
                aside = (detour["facing"] + 1) % 4  # round to the right
            detour["facing"] = aside
            # Each player's detours have another length, so that two do not block each other for ever.
            detour["steps"] = self.SIDE_STEPS * (1 + player_index)
        else:
            detour["steps"] = max(detour["steps"] - 1, 0)
        detour["walks"], detour["x"], detour["y"] = True, player["x"], player["y"]
        if detour["steps"] > 0:
            return int(detour["facing"])
        return ahead


_WAY = np.dtype([("walks", "?"), ("x", "f8"), ("y", "f8"), ("steps", "i8"), ("facing", "i8")])
"""Whether a player walked in its last step, and from where; how long its detour lasts, and where to."""


def _hits(sword: np.void, offsets: np.ndarray, monster_stats: np.ndarray) -> np.ndarray:
    """Return which monsters, at offsets from the player, an attack would hit by the way it faces: (4, M)."""
    is_hit = np.ones((4, len(monster_stats)), bool)
    for offset, axis, side in zip(offsets, ("x", "y"), ("half_width", "half_height"), strict=True):
        distance = np.abs(offset + monster_stats[f"body_{axis}"] - sword[axis][:, None])
        is_hit &= distance < sword[side][:, None] + monster_stats[side]
    return is_hit


def _directions(offset_x: float, offset_y: float) -> tuple[int, int]:
    """Return the direction along the longer way to an offset, and the one along the shorter."""
    along_x = rules.RIGHT if offset_x > 0 else rules.LEFT
    along_y = rules.DOWN if offset_y > 0 else rules.UP
    if abs(offset_x) > abs(offset_y):
        return along_x, along_y
    return along_y, along_x
