"""Two players to compare with: a random one, whose score is 0, and a scripted hunter with the paths it walks.

A player chooses actions for all worlds at once, from their state.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from heapq import heappop, heappush
from typing import Any, NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from pneuma.env import rules
from pneuma.env.characters import TICKS_PER_STEP
from pneuma.env.level import Level, walkable_regions
from pneuma.env.worlds import Worlds

NOWHERE = math.inf
MOST_PLACES = 4000
"""Most places that a search visits before it gives up."""
MOST_FIELDS = 6000
"""Most distance fields kept: enough for every tile of the thesis's level."""
FARTHEST = 1e6
"""A distance beyond all paths, so that monsters that cannot be reached come last."""

Place = tuple[float, float]
Spot = tuple[int, int]
Plan = dict[Spot, int]
"""The action at each spot along the way."""


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
    """Path length in tiles below which monsters are approached in a straight line."""

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
        x, y = _offsets(worlds)
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


def _offsets(worlds: Worlds) -> tuple[np.ndarray, np.ndarray]:
    """Return x and y from each player to each monster, each (N, P, M)."""
    monsters, players = worlds.monsters[:, None, :], worlds.players[:, :, None]
    return monsters["x"] - players["x"], monsters["y"] - players["y"]


def _come_closer(worlds: Worlds, offset: np.ndarray) -> np.ndarray:
    """Return where, on one axis, a chasing monster is after two thirds of an attack."""
    stats = _kinds(worlds)
    way = stats["speed"] * worlds.player_stats["swing"].min() * 2 / 3
    closer = np.maximum(np.abs(offset) - way, stats["stand_off"])
    return np.where(np.abs(offset) > stats["stand_off"], np.sign(offset) * closer, offset)


# --- Paths over a level ---------------------------------------------------------------------------
# A step moves a body a fixed distance along one axis, or up to an obstacle. So a body cannot stand at just
# any place, and can miss a gap that is one tile wide. Distances are therefore counted over tiles, and the
# next few steps are searched among the places that steps really reach. Other bodies are ignored: they move.


class Body(NamedTuple):
    """A body's box: half its sides, and its centre relative to its position."""

    half_width: float
    half_height: float
    body_x: float
    body_y: float


def spot(place: Place) -> Spot:
    """Return a key that is equal for places that differ by rounding only."""
    return round(place[0] * 32), round(place[1] * 32)


class Ways:
    """Paths of one body over levels of one shape, computed when needed and cached.

    A cell is the upper left tile of a block of tiles that the body fits into. Lengths are counted from cell
    to cell. All grids have a rim of closed tiles.
    """

    def __init__(self, levels: Sequence[Level], body: Body, stops: int, sea: bool) -> None:
        """Prepare the levels.

        Args:
            levels: levels of equal shape and position, as in a `Worlds`.
            body: the body that moves.
            stops: bit c is set if tiles of code c stop it.
            sea: whether a body drowns at the coast.
        """
        level = levels[0]
        self._halves, self._offset = body[:2], body[2:]
        self._tile = level.tile
        self._abreast = math.ceil(2 * max(self._halves) / level.tile)
        rim = self._abreast
        self._corner = (level.left - rim * level.tile, level.top - rim * level.tile)
        solid = [stops >> each.terrain.astype(np.int64) & 1 > 0 for each in levels]
        closed = [np.pad(each, rim, constant_values=True) for each in solid]
        drowns = [np.pad((each.terrain == rules.COAST) & sea, rim) for each in levels]
        self._shape = closed[0].shape
        # The cells into which the body fits, in the shape of the grid.
        free = [~grid & ~water for grid, water in zip(closed, drowns, strict=True)]
        self._fits = [walkable_regions(grid, rim) > 0 for grid in free]
        self._stops = [(grid.tolist(), grid.T.tolist()) for grid in closed]
        self._drowns = [grid.tolist() if grid.any() else None for grid in drowns]
        self._graphs = [_graph(fits) for fits in self._fits]
        self._fields: dict[tuple[int, int], np.ndarray] = {}  # by level and tile

    def lengths(
        self, level: np.ndarray, to_x: np.ndarray, to_y: np.ndarray, x: np.ndarray, y: np.ndarray
    ) -> np.ndarray:
        """Return the walking distance in tiles to each of M places; infinite if there is no path.

        Args:
            level: (N,) indices of levels.
            to_x: (N, M) where to.
            to_y: (N, M).
            x: (N,) where the body is.
            y: (N,).
        """
        goals = self._tiles(to_x, to_y, 0.0)
        across, down = self._offset
        cells = self._tiles(x + across, y + down, (1 - self._abreast) / 2)
        found = [
            [self._field(level_index, goal)[cell] for goal in row]
            for level_index, row, cell in zip(level.tolist(), goals.tolist(), cells.tolist(), strict=True)
        ]
        return np.array(found).reshape(goals.shape)

    def plan(self, level: int, place: Place, goal: Place, reach: float) -> Plan:
        """Return steps that bring a body two tiles nearer to a goal; empty if there are none.

        Args:
            level: index of the level.
            place: where the body is.
            goal: where it is going.
            reach: how far one step goes.
        """
        tile = int(self._tiles(np.array(goal[0]), np.array(goal[1]), 0.0))
        field = self._field(level, tile)
        first = self._length(field, *place)
        enough = max(first - 2 * self._tile, self._tile)
        came: dict[Spot, tuple[Spot, int]] = {spot(place): (spot(place), -1)}
        best, nearest = spot(place), first
        queue = [(first, first, 0, 0, place)]  # A*: by the whole length, then by the remaining one
        while queue and nearest > enough and len(came) < MOST_PLACES:
            _, length, _, steps, current = heappop(queue)
            if length < nearest:
                best, nearest = spot(current), length
            for action in range(4):
                following = self.step(level, current, action, reach)
                if following is not None and spot(following) not in came:
                    came[spot(following)] = (spot(current), action)
                    left = self._length(field, *following)
                    heappush(queue, (left + (steps + 1) * reach, left, len(came), steps + 1, following))
        return dict(_trace(came, best))

    def step(self, level: int, place: Place, action: int, reach: float) -> Place | None:
        """Return where a step leads by the rules; None if that is the sea."""
        axis = 0 if action in (rules.LEFT, rules.RIGHT) else 1
        way = reach if action in (rules.RIGHT, rules.DOWN) else -reach
        end = self._slide(level, place, axis, way)
        end_place = (end, place[1]) if axis == 0 else (place[0], end)
        return None if self._drowns[level] and self._meets_sea(level, place, end_place) else end_place

    # --- Distances -------------------------------------------------------------------------------

    def _tiles(self, x: np.ndarray, y: np.ndarray, shift: float) -> np.ndarray:
        """Return the index of the tile at each place, moved by `shift` tiles."""
        column = np.floor((x - self._corner[0]) / self._tile + shift).astype(np.int64)
        row = np.floor((y - self._corner[1]) / self._tile + shift).astype(np.int64)
        return np.asarray(row * self._shape[1] + column)

    def _field(self, level: int, tile: int) -> np.ndarray:
        """Return the distance in tiles from each cell to those that cover a tile, (cells,)."""
        if (level, tile) not in self._fields:
            if len(self._fields) >= MOST_FIELDS:
                self._fields.clear()
            abreast, width = range(self._abreast), self._shape[1]
            cover = np.array([tile - i * width - j for i in abreast for j in abreast])
            cover = cover[self._fits[level].ravel()[cover]]
            self._fields[level, tile] = (
                dijkstra(self._graphs[level], indices=cover, unweighted=True, min_only=True)
                if cover.size
                else np.full(self._fits[level].size, NOWHERE)
            )
        return self._fields[level, tile]

    def _length(self, field: np.ndarray, x: float, y: float) -> float:
        """Return the distance in pixels from a place to a field's goal, by the best cell nearby."""
        tile, width, abreast = self._tile, self._shape[1], self._abreast
        across = (x + self._offset[0] - self._corner[0]) / tile
        down = (y + self._offset[1] - self._corner[1]) / tile
        best = NOWHERE
        for row in _cells(down, self._halves[1] / tile, abreast):
            for column in _cells(across, self._halves[0] / tile, abreast):
                aside = abs(across - column - abreast / 2) + abs(down - row - abreast / 2)
                best = min(best, float(field[row * width + column]) + aside)
        return best * tile

    # --- Steps -----------------------------------------------------------------------------------

    def _slide(self, level: int, place: Place, axis: int, way: float) -> float:
        """Return the coordinate after moving along an axis up to the first tile that stops a body."""
        tile, corner = self._tile, self._corner
        lines = self._stops[level][1 - axis]  # lines of tiles that lie across the way
        half, other = self._halves[axis], self._halves[1 - axis]
        offset, aside = self._offset[axis], place[1 - axis] + self._offset[1 - axis] - corner[1 - axis]
        first, last = math.floor((aside - other) / tile), math.ceil((aside + other) / tile)
        start = place[axis] + offset - corner[axis]
        if way > 0:
            for line in range(math.ceil((start + half) / tile), math.ceil((start + way + half) / tile)):
                if True in lines[line][first:last]:
                    return max(place[axis], corner[axis] + line * tile - half - offset)
        else:
            end = math.floor((start + way - half) / tile)
            for line in range(math.floor((start - half) / tile) - 1, end - 1, -1):
                if True in lines[line][first:last]:
                    return min(place[axis], corner[axis] + (line + 1) * tile + half - offset)
        return place[axis] + way

    def _meets_sea(self, level: int, place: Place, end: Place) -> bool:
        """Return whether a body's position reaches a coast tile on a straight move."""
        (left, right), (top, bottom) = (
            sorted(int((point[axis] - self._corner[axis]) / self._tile) for point in (place, end))
            for axis in (0, 1)
        )
        sea = self._drowns[level] or []
        return any(True in line[left : right + 1] for line in sea[top : bottom + 1])


def _graph(fits: np.ndarray) -> csr_array:
    """Return which of the cells that a body fits into are neighbours."""
    cells = np.arange(fits.size).reshape(fits.shape)
    down, along = fits[:-1] & fits[1:], fits[:, :-1] & fits[:, 1:]
    one = np.concatenate([cells[:-1][down], cells[:, :-1][along]])
    other = np.concatenate([cells[1:][down], cells[:, 1:][along]])
    both = np.concatenate([one, other]), np.concatenate([other, one])
    return csr_array((np.ones(len(both[0])), both), shape=(fits.size, fits.size))


def _cells(middle: float, half: float, abreast: int) -> range:
    """Return the lines of cells that a body is in, by its centre and half its size in tiles."""
    first, last = math.floor(middle - half), math.ceil(middle + half) - abreast
    return range(min(first, last), max(first, last) + 1)


def _trace(came: dict[Spot, tuple[Spot, int]], end: Spot) -> Iterator[tuple[Spot, int]]:
    """Yield the spots on the way to an end, from the last but one backwards, with the action at each."""
    place, action = came[end]
    while action >= 0:
        yield place, action
        place, action = came[place]
