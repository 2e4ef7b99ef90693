"""Two players to compare with: a random one, whose score is 0, and a scripted hunter on paths of `ways.py`.

A player chooses actions for all worlds at once, from their state.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pneuma.env import rules
from pneuma.env.characters import TICKS_PER_STEP
from pneuma.env.ways import Body, Plan, Ways, spot
from pneuma.env.worlds import Worlds

FARTHEST = 1e6
"""A distance beyond all paths, so that monsters that cannot be reached come last."""


class RandomPlayer:
    """Chooses actions uniformly at random, with the generator that it is given."""

    def __init__(self, generator: np.random.Generator) -> None:
        self.generator = generator

    def act(self, worlds: Worlds) -> np.ndarray:
        """Return (N, P) actions."""
        return self.generator.integers(int(worlds.action_space.n), size=worlds.players.shape)


class Hunter:
    """Walks to the nearest living monster and attacks when the sword would hit one.

    Far from a monster it follows a path over the level's tiles (`Ways`). Close to it, it turns to where its
    sword hits. If something stops it, it goes another way for a few steps. It knows the whole state, not only
    what a player observes.
    """

    SIDE_STEPS = 4
    NEAR_PIXELS = 128.0
    """Path length in pixels below which monsters are approached in a straight line."""

    def __init__(self, worlds: Worlds) -> None:
        self._left_off = np.full((2, *worlds.players.shape), np.nan)  # where the last walk began
        self._detour = np.zeros(worlds.players.shape, np.int64)  # steps left of a way round
        self._way = np.zeros(worlds.players.shape, np.int64)
        self._seen = np.full((2, *worlds.monsters.shape), np.nan)  # where awake monsters last were
        self._plans: dict[tuple[int, int], Plan] = {}
        stops, sea = int(worlds.settings["player_stops"][0]), worlds.config.coast == "deadly"
        bodies = [Body(*body) for body in worlds.player_stats[[*Body._fields]].tolist()]
        ways = {body: Ways(worlds.levels, body, stops, sea) for body in set(bodies)}
        self._ways = [ways[body] for body in bodies]

    def act(self, worlds: Worlds) -> np.ndarray:
        """Return (N, P) actions."""
        self._begin_again(worlds.worlds["steps"] == 0)
        alive = worlds.monsters["hp"][:, None, :] > 0
        free = (worlds.players["busy"] < TICKS_PER_STEP) & (worlds.players["hp"] > 0) & alive.any(axis=-1)
        free &= (worlds.worlds["ending"] == 0)[:, None]
        actions = self._choose(worlds, alive, free) if free.any() else free
        self._left_off[:, ~free] = np.nan
        awake = worlds.monsters["noticed"] > 0
        for axis, name in enumerate("xy"):
            self._seen[axis] = np.where(awake, worlds.monsters[name], np.nan)
        return np.where(free, actions, rules.ATTACK)

    def _choose(self, worlds: Worlds, alive: np.ndarray, free: np.ndarray) -> np.ndarray:
        """Return actions; those of players who are busy do not matter."""
        monsters, players = worlds.monsters[:, None, :], worlds.players[:, :, None]
        x, y = (monsters[axis] - players[axis] for axis in "xy")  # from player to monster, (N, P, M)
        meets = np.stack([self._meets_sword(worlds, x, y, facing) & alive for facing in range(4)])
        strike = _pick(meets.any(axis=-1), worlds.players["facing"])
        walks = free & ~strike
        on_foot = self._lengths(worlds)
        order = np.where(np.isfinite(on_foot), on_foot, FARTHEST + np.hypot(x, y))
        order = np.where(meets.any(axis=0), order - 2 * FARTHEST, order)  # first those that a turn meets
        nearest = np.where(alive, order, np.inf).argmin(axis=-1)[..., None]
        dx, dy, length = (np.take_along_axis(each, nearest, -1)[..., 0] for each in (x, y, on_foot))
        within_reach = np.take_along_axis(meets, nearest[None], -1)[..., 0]  # (4, N, P)
        straight, across = _ways_towards(dx, dy)
        swap = ~_pick(within_reach, straight) & _pick(within_reach, across)
        way, aside = np.where(swap, across, straight), np.where(swap, straight, across)
        far = (length * worlds.level.tile > self.NEAR_PIXELS) & np.isfinite(length) | self._under_way(worlds)
        for world, player in np.argwhere(far & walks & ~within_reach.any(axis=0)).tolist():
            action = self._follow(worlds, world, player, int(nearest[world, player, 0]))
            if action is not None:
                way[world, player], aside[world, player] = action, (action + 1) % 4  # keep to the right
        walk = self._go_round(worlds, walks, way, aside)
        return np.where(strike | self._drowns(worlds, walk, walks), rules.ATTACK, walk)

    def _go_round(self, worlds: Worlds, walks: np.ndarray, way: np.ndarray, aside: np.ndarray) -> np.ndarray:
        """Return the direction, or another one for a few steps if the player was stopped.

        First aside, then round to the right. Later players go further, so that two do not block each other
        for ever. All arrays are (N, P).
        """
        stopped = (worlds.players["x"] == self._left_off[0]) & (worlds.players["y"] == self._left_off[1])
        stopped |= self._drowns(worlds, np.where(self._detour > 0, self._way, way), walks)
        stopped &= walks
        again = stopped & (self._detour > 0)
        self._way = np.where(again, (self._way + 1) % 4, np.where(stopped, aside, self._way))
        steps = self.SIDE_STEPS * (1 + np.arange(worlds.players.shape[1]))
        self._detour = np.where(stopped, steps, np.maximum(self._detour - walks, 0))
        self._left_off = np.where(walks, [worlds.players["x"], worlds.players["y"]], np.nan)
        return np.where(self._detour > 0, self._way, way)

    def _drowns(self, worlds: Worlds, walk: np.ndarray, walks: np.ndarray) -> np.ndarray:
        """Return whose next step would lead into a deadly sea, (N, P)."""
        drowns = np.zeros(walks.shape, bool)
        for world, player in np.argwhere(walks & (worlds.config.coast == "deadly")).tolist():
            level, place = int(worlds.worlds["level"][world]), _place(worlds, world, player)
            step = self._ways[player].step(level, place, int(walk[world, player]), _reach(worlds, player))
            drowns[world, player] = step is None
        return drowns

    def _begin_again(self, fresh: np.ndarray) -> None:
        if fresh.any():
            self._left_off[:, fresh], self._seen[:, fresh], self._detour[fresh] = np.nan, np.nan, 0
            self._plans = {key: plan for key, plan in self._plans.items() if not fresh[key[0]]}

    def _lengths(self, worlds: Worlds) -> np.ndarray:
        """Return the path length in tiles from each player to each monster, (N, P, M)."""
        level = worlds.worlds["level"].astype(np.int64)
        monsters, (x, y) = worlds.monsters, (worlds.players["x"].T, worlds.players["y"].T)  # (P, N)
        every = [
            ways.lengths(level, monsters["x"], monsters["y"], x[p], y[p]) for p, ways in enumerate(self._ways)
        ]
        return np.stack(every, axis=1)

    def _under_way(self, worlds: Worlds) -> np.ndarray:
        """Return which players are following a plan, which they finish, (N, P)."""
        flags = np.zeros(worlds.players.shape, bool)
        for key, plan in self._plans.items():
            flags[key] = spot(_place(worlds, *key)) in plan
        return flags

    def _follow(self, worlds: Worlds, world: int, player: int, monster: int) -> int | None:
        """Return the next step of the plan, or of a new one if it is finished."""
        prey = worlds.monsters[world, monster]
        place = _place(worlds, world, player)
        plan = self._plans.get((world, player), {})
        if spot(place) not in plan:
            level, goal = int(worlds.worlds["level"][world]), (float(prey["x"]), float(prey["y"]))
            ways, reach = self._ways[player], _reach(worlds, player)
            plan = self._plans[world, player] = ways.plan(level, place, goal, reach)
        return plan.get(spot(place))

    def _meets_sword(self, worlds: Worlds, x: np.ndarray, y: np.ndarray, facing: int) -> np.ndarray:
        """Return which monsters an attack in a direction would hit if it began now: (N, P, M).

        A monster that is awake comes closer meanwhile, on each axis on which nothing stops it.
        """
        stats = _kinds(worlds)
        monsters = worlds.monsters
        awake = monsters["noticed"] > 0
        meets = np.ones(x.shape, bool)
        for i, (offset, axis, side) in enumerate(((x, "x", "width"), (y, "y", "height"))):
            centre = worlds.player_stats[f"sword_{axis}"][:, facing, None]  # (P, 1)
            half = worlds.player_stats[f"sword_half_{side}"][:, facing, None]
            comes = awake & (monsters[axis] != self._seen[i])
            after = np.where(comes[:, None, :], _come_closer(worlds, offset), offset)
            low, high = np.minimum(offset, after), np.maximum(offset, after)
            body, at = stats[f"half_{side}"], stats[f"body_{axis}"]
            meets &= (low + at - body < centre + half) & (high + at + body > centre - half)
        return meets


def _pick(by_facing: Any, facing: np.ndarray) -> np.ndarray:
    """Return the entry of (4, N, P) for each player's facing, (N, P)."""
    return np.asarray(np.take_along_axis(by_facing, facing[None].astype(np.int64), 0)[0])


def _ways_towards(dx: np.ndarray, dy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the directions along the longer and shorter axis towards (dx, dy)."""
    along_x, along_y = np.where(dx > 0, rules.RIGHT, rules.LEFT), np.where(dy > 0, rules.DOWN, rules.UP)
    sideways = np.abs(dx) > np.abs(dy)
    return np.where(sideways, along_x, along_y), np.where(sideways, along_y, along_x)


def _place(worlds: Worlds, world: int, player: int) -> tuple[float, float]:
    row = worlds.players[world, player]
    return float(row["x"]), float(row["y"])


def _reach(worlds: Worlds, player: int) -> float:
    return float(worlds.player_stats["speed"][player]) * TICKS_PER_STEP


def _kinds(worlds: Worlds) -> np.ndarray:
    """Return the stats of each monster in its world's level, (N, 1, M)."""
    return np.asarray(worlds.monster_stats[worlds.worlds["level"]][:, None, :])


def _come_closer(worlds: Worlds, offset: np.ndarray) -> np.ndarray:
    """Return where, on one axis, a chasing monster is after two thirds of an attack."""
    stats = _kinds(worlds)
    way = stats["speed"] * worlds.player_stats["swing"].min() * 2 / 3
    closer = np.maximum(np.abs(offset) - way, stats["stand_off"])
    return np.where(np.abs(offset) > stats["stand_off"], np.sign(offset) * closer, offset)
