"""What a level is: where the land, the obstacles, the players and the monsters are.

A level is refused if a body would start outside the grid, inside an obstacle or another body, or where no
player can walk to. `load_level.py` finds levels by their names.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from pydantic import AfterValidator
from scipy.ndimage import label, minimum_filter

from pneuma.env import rules
from pneuma.env.fields import EnvConfig
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


def refuse_bad_places(
    level: Level, player_stats: np.ndarray, monster_stats: np.ndarray, config: EnvConfig
) -> None:
    """Refuse a level in which a body would begin beyond the grid, stuck, or where no player can walk to.

    A body that starts inside a wall may never get out. Any player may start at any start place, so each must
    have room for all of them. Monsters that no terrain stops may be anywhere.

    Args:
        level: what is checked.
        player_stats: (P,) `state.PLAYER_STATS`.
        monster_stats: (M,) `state.MONSTER_STATS`, in the level's order.
        config: which defines what stops bodies.
    """
    shapes = np.unique(player_stats[["half_width", "half_height", "body_x", "body_y"]])
    starting = []
    for index, (x, y) in enumerate(level.starts):
        for shape in shapes:
            starting.append(_Body(f"start place {index}", x, y, shape))
    living_bodies = []
    for index, (monster, body_stats) in enumerate(zip(level.monsters, monster_stats, strict=True)):
        living_bodies.append(_Body(f"monster {index} ({monster.name})", monster.x, monster.y, body_stats))
    closed_tiles = level.terrain == rules.COAST
    if config.trees == "wall":
        closed_tiles |= level.terrain == rules.SOLID
    stopped_bodies = living_bodies
    if config.terrain_stops == "players":
        stopped_bodies = []
    _refuse_terrain(level, starting + stopped_bodies, closed_tiles)
    _refuse_terrain(level, living_bodies, np.zeros_like(closed_tiles))  # none is beyond the grid
    longer_side = 2 * float(max(player_stats["half_width"].max(), player_stats["half_height"].max()))
    cut_off = first_cut_off(level, ~closed_tiles, longer_side, len(stopped_bodies))
    if cut_off is not None:
        body = (starting[:: len(shapes)] + living_bodies)[cut_off]
        problem = f"{body.name} is walled in or off the land, for a body of {longer_side:g} px"
        raise UserError(f"level {level.name}: {problem}")
    movers = living_bodies
    if config.players > 1:
        movers = starting + living_bodies
    _refuse_overlaps(level, movers, starting + living_bodies)


class _Body:
    """A body where it begins, as a box."""

    def __init__(self, place_name: str, x: float, y: float, body_stats: np.void) -> None:
        self.name = f"{place_name} at ({x:g}, {y:g})"
        middle = np.array([x + body_stats["body_x"], y + body_stats["body_y"]])
        half = np.array([body_stats["half_width"], body_stats["half_height"]])
        self.low = middle - half
        self.high = middle + half


def _refuse_terrain(level: Level, bodies: Sequence[_Body], closed: np.ndarray) -> None:
    """Refuse bodies on closed tiles, or beyond the grid, around which all is closed."""
    framed_tiles = np.pad(closed, 1, constant_values=True)
    corner = (level.left - level.tile, level.top - level.tile)
    last_tile = np.array(framed_tiles.T.shape) - 1
    for body in bodies:
        first_tile = np.clip(np.floor((body.low - corner) / level.tile), 0, last_tile).astype(int)
        end_tile = np.clip(np.ceil((body.high - corner) / level.tile), 1, last_tile + 1).astype(int)
        stuck_tiles = np.argwhere(framed_tiles[first_tile[1] : end_tile[1], first_tile[0] : end_tile[0]])
        if len(stuck_tiles):
            row, column = stuck_tiles[0] + first_tile[::-1]
            width, height = body.high - body.low
            problem = f"has a body of {width:g} x {height:g} px, stuck in row {row}, column {column}"
            raise UserError(f"level {level.name}: {body.name} {problem}")


def _refuse_overlaps(level: Level, bodies: Sequence[_Body], obstacles: Sequence[_Body]) -> None:
    low = np.array([obstacle.low for obstacle in obstacles])
    high = np.array([obstacle.high for obstacle in obstacles])
    for body in bodies:
        depth = np.minimum(high, body.high) - np.maximum(low, body.low)
        overlapping = (depth > rules.CONTACT_EPS).all(axis=1)  # touching is no overlap
        for obstacle_index in np.flatnonzero(overlapping).tolist():
            obstacle = obstacles[obstacle_index]
            if obstacle.name != body.name:  # itself, or another player's body at one place
                raise UserError(
                    f"level {level.name}: {body.name} starts inside {obstacle.name}; move one of them"
                )


# --- Walking -------------------------------------------------------------------------------------


def first_cut_off(level: Level, free: np.ndarray, side: float, monsters: int) -> int | None:
    """Return the first place that a player cannot walk to from the others; None if there is none.

    A player can walk over free tiles, where as many lie side by side as the longer side of its body needs.

    Args:
        level: whose places are counted: starts, then monsters.
        free: (rows, columns) bool.
        side: the longer side of a player's body, in pixels.
        monsters: how many of the monsters count, from the first on; the others may not be there.
    """
    abreast = math.ceil(side / level.tile)
    regions = walkable_regions(free, abreast)
    positions = level.starts.tolist()
    for monster in level.monsters[:monsters]:
        positions.append((monster.x, monster.y))
    regions_by_place = [_regions_at(regions, abreast, level, x, y) for x, y in positions]
    places_by_region = Counter(region for place_regions in regions_by_place for region in place_regions)
    sizes = np.bincount(regions.ravel())
    home = max(places_by_region, key=lambda region: (places_by_region[region], sizes[region]), default=0)
    for place_index, place_regions in enumerate(regions_by_place):
        if home not in place_regions:
            return place_index
    return None


def walkable_regions(free: np.ndarray, abreast: int = 1) -> np.ndarray:
    """Number the regions of free tiles in which a body of `abreast` tiles a side can move, from 1.

    Return the region of a body whose upper left tile is this one, (rows, columns) int32; 0 where none fits.
    """
    has_room = minimum_filter(free, abreast, mode="constant", cval=False, origin=-(abreast // 2))
    return np.asarray(label(has_room, output=np.int32)[0])


def _regions_at(regions: np.ndarray, abreast: int, level: Level, x: float, y: float) -> set[int]:
    """Return the regions of the bodies that cover the tile at (x, y)."""
    tile_row = int((y - level.top) // level.tile)
    tile_column = int((x - level.left) // level.tile)
    first_row = max(tile_row - abreast + 1, 0)
    first_column = max(tile_column - abreast + 1, 0)
    covering = regions[first_row : tile_row + 1, first_column : tile_column + 1]
    return set(covering.ravel().tolist()) - {0}
