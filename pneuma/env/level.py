"""What a level is: where the land, the obstacles, the players and the monsters are.

A level is refused if a body would start outside the grid, inside terrain that stops it, or where no player
can walk to. `load_level.py` finds levels by their names.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from pydantic import AfterValidator

from pneuma.env import rules
from pneuma.env.fields import EnvConfig
from pneuma.env.tiles import has_free_square, number_regions
from pneuma.errors import UserError

START_CODE = 400
EMPTY, WATER, SNOW, GRASS, SAND, BRIDGE = range(-1, 5)
"""Codes of the ground in shipped and random levels; a user's own level may have others."""

Rounded = AfterValidator(lambda pixels: round(pixels * 1024) / 1024)
"""For lengths from which the rules compute where a body touches a wall. Their sums are then exact: a body
that overlapped the wall by a rounding error could not slide along it."""


class Rectangle(NamedTuple):
    """A part of the plane, in pixels; y points down."""

    left: float
    top: float
    right: float
    bottom: float

    @property
    def width(self) -> float:
        return self.right - self.left

    @property
    def height(self) -> float:
        return self.bottom - self.top


class MonsterPlace(NamedTuple):
    """A monster, by the name of its kind, and where it begins."""

    name: str
    x: float
    y: float


@dataclass(frozen=True)
class Level:
    """A level as the rules need it; lengths in pixels, y downwards."""

    name: str
    title: str
    tile: float
    left: float  # of the grid of tiles
    top: float
    ground: np.ndarray  # (rows, columns) codes, for pictures; -1 where there is none
    terrain: np.ndarray  # (rows, columns) uint8: `rules.OPEN`, `SOLID` or `COAST`
    starts: np.ndarray  # (S, 2) places
    monsters: tuple[MonsterPlace, ...]

    @property
    def land(self) -> Rectangle:
        """The bounding box of the tiles that can be walked on."""
        rows, columns = np.nonzero(self.terrain != rules.COAST)
        return Rectangle(
            left=self.left + columns.min() * self.tile,
            top=self.top + rows.min() * self.tile,
            right=self.left + (columns.max() + 1) * self.tile,
            bottom=self.top + (rows.max() + 1) * self.tile,
        )

    @property
    def grid(self) -> Rectangle:
        """The box of all tiles."""
        rows, columns = self.terrain.shape
        right = self.left + columns * self.tile
        return Rectangle(self.left, self.top, right, self.top + rows * self.tile)


# --- Where bodies may begin ----------------------------------------------------------------------


def refuse_stuck_bodies(
    level: Level, player_stats: np.ndarray, monster_stats: np.ndarray, config: EnvConfig
) -> None:
    """Refuse a level in which a body begins beyond the grid, in terrain that stops it, or walled in.

    A body that starts inside a wall may never get out. Any player may start at any start place. Monsters that
    no terrain stops may be anywhere.

    Args:
        level: what is checked.
        player_stats: (P,) `state.PLAYER_STATS`.
        monster_stats: (M,) `state.MONSTER_STATS`, in the level's order.
        config: which defines what stops bodies.
    """
    stops_players = level.terrain == rules.COAST
    if config.trees == "wall":
        stops_players |= level.terrain == rules.SOLID
    stops_monsters = stops_players
    if config.terrain_stops == "players":
        stops_monsters = np.zeros_like(stops_players)
    for index, (x, y) in enumerate(level.starts.tolist()):
        for body_stats in player_stats:
            _refuse_stuck(level, f"start place {index}", x, y, body_stats, stops_players)
    for index, (monster, body_stats) in enumerate(zip(level.monsters, monster_stats, strict=True)):
        body_name = f"monster {index} ({monster.name})"
        _refuse_stuck(level, body_name, monster.x, monster.y, body_stats, stops_monsters)
    longer_side = 2 * float(max(player_stats["half_width"].max(), player_stats["half_height"].max()))
    _refuse_walled_in(level, ~stops_players, longer_side, with_monsters=config.terrain_stops != "players")


def _refuse_walled_in(level: Level, free: np.ndarray, side: float, with_monsters: bool) -> None:
    """Refuse a place to which nobody can walk from the first start place over free tiles, (rows, columns).

    As many tiles must be free side by side as the longer side of a player's body needs.
    """
    tiles_abreast = math.ceil(side / level.tile)
    regions = number_regions(has_free_square(free, tiles_abreast))  # by the upper left tile of a body
    places = [(f"start place {index}", x, y) for index, (x, y) in enumerate(level.starts.tolist())]
    if with_monsters:
        for index, monster in enumerate(level.monsters):
            places.append((f"monster {index} ({monster.name})", monster.x, monster.y))
    home: set[int] = set()
    for place_name, x, y in places:
        row, column = int((y - level.top) // level.tile), int((x - level.left) // level.tile)
        rows = slice(max(row - tiles_abreast + 1, 0), row + 1)
        columns = slice(max(column - tiles_abreast + 1, 0), column + 1)
        place_regions = set(regions[rows, columns].ravel().tolist()) - {0}
        home = home or place_regions
        if not home & place_regions:
            problem = f"is walled in or off the land, for a body of {side:g} px"
            raise UserError(f"level {level.name}: {place_name} at ({x:g}, {y:g}) {problem}")


def _refuse_stuck(level: Level, body_name: str, x: float, y: float, stats: Any, closed: np.ndarray) -> None:
    columns = _covered_tiles(x + stats["body_x"] - level.left, stats["half_width"], level.tile)
    rows = _covered_tiles(y + stats["body_y"] - level.top, stats["half_height"], level.tile)
    body_place = f"level {level.name}: {body_name} at ({x:g}, {y:g})"
    last_row, last_column = closed.shape[0] - 1, closed.shape[1] - 1
    if min(rows) < 0 or max(rows) > last_row or min(columns) < 0 or max(columns) > last_column:
        grid = level.grid
        extent = f"x from {grid.left:g} to {grid.right:g} and y from {grid.top:g} to {grid.bottom:g}"
        raise UserError(f"{body_place} reaches beyond the level, which has {extent}")
    for row, column in product(rows, columns):
        if closed[row, column]:
            size = f"{2 * stats['half_width']:g} x {2 * stats['half_height']:g}"
            problem = f"is the centre of a body of {size} px, which row {row + 1}, column {column + 1} blocks"
            raise UserError(f"{body_place} {problem}")


def _covered_tiles(middle: float, half: float, tile: float) -> range:
    """Return the columns or rows that a body lies in, without one that it only touches."""
    first = math.floor((middle - half) / tile)
    return range(first, max(math.ceil((middle + half) / tile), first + 1))
