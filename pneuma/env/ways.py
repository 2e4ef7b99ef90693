"""Paths of a body over a level: how far it is, and the steps that lead there."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from pneuma.env import rules
from pneuma.env.level import Level, walkable_regions

NOWHERE = math.inf
MOST_PLACES = 4000
"""Most places that a search visits before it gives up."""
MOST_FIELDS = 6000
"""Most distance fields kept: enough for every tile of the thesis's level."""

Place = tuple[float, float]
Spot = tuple[int, int]
Plan = dict[Spot, int]
"""The action at each spot along the way."""

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
        """Prepare levels of equal shape and position for a body, which may drown in the sea.

        Bit c of `stops` is set if tiles of code c stop it.
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
        """Return the walking distance in tiles to each of (N, M) places; infinite if there is no path.

        The body is at x and y, (N,), in levels by their indices, (N,).
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
        """Return steps of `reach` pixels that bring a body two tiles nearer to a goal; empty if none do."""
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
