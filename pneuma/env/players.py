"""Two players that anchor every scale: the uniformly random one and the scripted hunter.

A player chooses actions for all worlds at once, from their state; score 0 is the random one's,
score 1 the hunter's.
"""

from __future__ import annotations

import numpy as np

from pneuma.env import rules
from pneuma.env.worlds import Worlds


class RandomPlayer:
    """Chooses every action with equal probability, from the generator it is given."""

    def __init__(self, generator: np.random.Generator) -> None:
        self.generator = generator

    def act(self, worlds: Worlds) -> np.ndarray:
        """Return (N, P) actions."""
        return self.generator.integers(int(worlds.action_space.n), size=worlds.players.shape)


class Hunter:
    """Walks to the nearest living monster and strikes whenever the sword would meet one.

    It lines up on one axis, steps back from a monster that is too close for the sword, and goes
    across for a few steps when something is in the way.
    """

    SIDE_STEPS = 4
    BACK_STEPS = 2

    def __init__(self, worlds: Worlds) -> None:
        self._left_off = np.full((2, *worlds.players.shape), np.nan)  # where the last walk began
        self._detour = np.zeros(worlds.players.shape, np.int64)  # steps left of a way round
        self._way = np.zeros(worlds.players.shape, np.int64)

    def act(self, worlds: Worlds) -> np.ndarray:
        """Return (N, P) actions."""
        if not worlds.monsters.shape[1]:
            return np.full(worlds.players.shape, rules.ATTACK)
        x, y = _offsets(worlds)
        alive = worlds.monsters["hp"][:, None, :] > 0
        nearest = np.where(alive, np.hypot(x, y), np.inf).argmin(axis=-1)[..., None]
        walk = self._walk(
            worlds, np.take_along_axis(x, nearest, -1)[..., 0], np.take_along_axis(y, nearest, -1)[..., 0]
        )
        strike = (_meets_sword(worlds, x, y) & alive).any(axis=-1)
        here = np.stack([worlds.players["x"], worlds.players["y"]])
        self._left_off = np.where(strike | (worlds.players["busy"] > 0), np.nan, here)
        return np.where(strike, rules.ATTACK, walk)

    def _walk(self, worlds: Worlds, dx: np.ndarray, dy: np.ndarray) -> np.ndarray:
        """Return the way to walk to a monster at (dx, dy), or for a while some other way."""
        along_x = np.where(dx > 0, rules.RIGHT, rules.LEFT)
        along_y = np.where(dy > 0, rules.DOWN, rules.UP)
        sideways = np.abs(dx) > np.maximum(np.abs(dy), worlds.player_stats["sword_half_width"][:, rules.UP])
        straight, across = np.where(sideways, along_x, along_y), np.where(sideways, along_y, along_x)

        stand_off = worlds.monster_stats["stand_off"].max(initial=0.0)
        crowded = (np.abs(dx) <= stand_off) & (np.abs(dy) <= stand_off) & (self._detour == 0)
        stopped = (worlds.players["x"] == self._left_off[0]) & (worlds.players["y"] == self._left_off[1])
        again = stopped & (self._detour > 0)  # the way round is closed as well: back
        self._detour = np.maximum(self._detour - 1, 0)
        self._detour[crowded], self._detour[stopped] = self.BACK_STEPS, self.SIDE_STEPS
        self._way = np.where(crowded, (along_y + 2) % 4, self._way)
        self._way = np.where(again, (self._way + 2) % 4, np.where(stopped, across, self._way))
        return np.where(self._detour > 0, self._way, straight)


def _kinds(worlds: Worlds) -> np.ndarray:
    """Return the stats of every monster on its world's level, (N, 1, M)."""
    return np.asarray(worlds.monster_stats[worlds.worlds["level"]][:, None, :])


def _offsets(worlds: Worlds) -> tuple[np.ndarray, np.ndarray]:
    """Return x and y from every player to every monster, each (N, P, M)."""
    monsters, players = worlds.monsters[:, None, :], worlds.players[:, :, None]
    return monsters["x"] - players["x"], monsters["y"] - players["y"]


def _meets_sword(worlds: Worlds, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Tell which monsters a swing begun now would meet, the way the player faces: (N, P, M)."""
    facing = worlds.players["facing"]
    player = np.arange(facing.shape[1])
    stats = _kinds(worlds)
    awake = worlds.monsters["noticed"][:, None, :] > 0
    meets = np.ones(x.shape, bool)
    for offset, axis, side in ((x, "sword_x", "width"), (y, "sword_y", "height")):
        centre = worlds.player_stats[axis][player, facing][..., None]  # (N, P, 1)
        half = worlds.player_stats[f"sword_half_{side}"][player, facing][..., None]
        after = np.where(awake, _come_closer(worlds, offset), offset)
        low, high = np.minimum(offset, after), np.maximum(offset, after)
        body = stats[f"half_{side}"]
        meets &= (low - body < centre + half) & (high + body > centre - half)
    return meets


def _come_closer(worlds: Worlds, offset: np.ndarray) -> np.ndarray:
    """Return where, on one axis, a chasing monster is after two thirds of a swing."""
    stats = _kinds(worlds)
    way = stats["speed"] * worlds.player_stats["swing"].min() * 2 / 3
    closer = np.maximum(np.abs(offset) - way, stats["stand_off"])
    return np.where(np.abs(offset) > stats["stand_off"], np.sign(offset) * closer, offset)
