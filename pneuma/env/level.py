"""What a level is: where the land, the obstacles, the players and the monsters are.

A level is refused if a body would start outside the grid, inside an obstacle or another body, or where no
player can walk to. `load_level.py` finds levels by their names.
"""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass

import numpy as np
from pydantic import AfterValidator
from scipy.ndimage import label, minimum_filter

from pneuma.env import rules
from pneuma.env.fields import EnvConfig
from pneuma.errors import UserError

RANDOM = "random:"
START_CODE = 400
EMPTY, WATER, SNOW, GRASS, SAND, BRIDGE = range(-1, 5)
"""Codes of the ground in shipped and random levels; a user's own level may have others."""

Rounded = AfterValidator(lambda pixels: round(pixels * 1024) / 1024)
"""For lengths from which the rules compute where a body touches a wall. Their sums are then exact: a body
that overlapped the wall by a rounding error could not slide along it."""


@dataclass(frozen=True)
class Level:
    """A level as the rules need it; lengths in pixels, y downwards."""

    name: str
    title: str
    tile: float
    left: float  # of the grid of tiles
    top: float
    ground: np.ndarray  # (rows, columns) codes, for drawing; -1 where there is none
    terrain: np.ndarray  # (rows, columns) uint8: `rules.OPEN`, `SOLID` or `COAST`
    starts: np.ndarray  # (S, 2) places
    monsters: tuple[tuple[str, float, float], ...]  # kind, x and y of each

    @property
    def land(self) -> tuple[float, float, float, float]:
        """Bounding box of the tiles that can be walked on: left, top, right, bottom."""
        rows, columns = np.nonzero(self.terrain != rules.COAST)
        return (
            self.left + columns.min() * self.tile,
            self.top + rows.min() * self.tile,
            self.left + (columns.max() + 1) * self.tile,
            self.top + (rows.max() + 1) * self.tile,
        )

    @property
    def grid(self) -> tuple[float, float, float, float]:
        """The box of all tiles: left, top, right, bottom."""
        rows, columns = self.terrain.shape
        return self.left, self.top, self.left + columns * self.tile, self.top + rows * self.tile


# --- Where bodies may begin ----------------------------------------------------------------------


def refuse_bad_places(level: Level, players: np.ndarray, monsters: np.ndarray, config: EnvConfig) -> None:
    """Refuse a level in which a body would begin beyond the grid, stuck, or where no player can walk to.

    A body that starts inside a wall may never get out. Any player may start at any start place, so each must
    have room for all of them. Monsters that no terrain stops may be anywhere. `players` are (P,)
    `state.PLAYER_STATS`, `monsters` (M,) `state.MONSTER_STATS` in the level's order.
    """
    shapes = np.unique(players[["half_width", "half_height", "body_x", "body_y"]])
    starts = [
        _Body(f"start place {i}", x, y, shape) for i, (x, y) in enumerate(level.starts) for shape in shapes
    ]
    others = [
        _Body(f"monster {i} ({name})", x, y, kind)
        for i, ((name, x, y), kind) in enumerate(zip(level.monsters, monsters, strict=True))
    ]
    bodies = starts + others
    trees = (level.terrain == rules.SOLID) & (config.trees == "wall")
    coast = level.terrain == rules.COAST
    stopped = others if config.terrain_stops == "all" else []
    left, top, right, bottom = level.grid
    for body in bodies:
        if (body.low < (left, top)).any() or (body.high > (right, bottom)).any():
            raise body.refusal(level, "reaches beyond the grid")
    side = 2 * float(max(players["half_width"].max(), players["half_height"].max()))
    lost = first_cut_off(level, ~(trees | coast), side, len(stopped))
    if lost is not None:
        who = [*starts[:: len(shapes)], *others][lost].who
        raise UserError(f"level {level.name}: {who} is walled in or off the land, for a body of {side:g} px")
    for body in starts + stopped:
        _refuse_terrain(level, body, trees | coast)
    low, high = (np.array([getattr(each, edge) for each in bodies]) for edge in ("low", "high"))
    for body in bodies if config.players > 1 else others:
        depth = np.minimum(high, body.high) - np.maximum(low, body.low)
        for index in np.flatnonzero((depth > rules.CONTACT_EPS).all(axis=1)):  # touching is no overlap
            if bodies[index].who != body.who:  # itself, or another player's body at one place
                raise UserError(f"level {level.name}: {body.who} begins inside {bodies[index].who}")


class _Body:
    def __init__(self, who: str, x: float, y: float, stats: np.void) -> None:
        self.who = f"{who} at ({x:g}, {y:g})"
        middle = np.array([x + stats["body_x"], y + stats["body_y"]], np.float64)
        half = np.array([stats["half_width"], stats["half_height"]], np.float64)
        self.low, self.high = middle - half, middle + half

    def refusal(self, level: Level, why: str) -> UserError:
        width, height = self.high - self.low
        return UserError(
            f"level {level.name}: {self.who} has a body of {width:g} x {height:g} px, which {why}"
        )


def _refuse_terrain(level: Level, body: _Body, closed: np.ndarray) -> None:
    corner = (level.left, level.top)
    first = np.floor((body.low - corner) / level.tile).astype(int)
    last = np.ceil((body.high - corner) / level.tile).astype(int)
    under = closed[first[1] : last[1], first[0] : last[0]]
    for row, column in np.argwhere(under).tolist() if under.any() else ():
        place = f"row {first[1] + row + 1}, column {first[0] + column + 1}"
        raise body.refusal(level, f"overlaps the tile in {place}: it would be stuck there")


# --- Walking -------------------------------------------------------------------------------------


def first_cut_off(level: Level, free: np.ndarray, side: float, monsters: int) -> int | None:
    """Return the first place, counting starts, then monsters, that a player cannot walk to from the others.

    A player can walk over free tiles, (rows, columns) bool, where as many lie side by side as the longer side
    of its body needs. The first so many monsters count, as the others may not be there.
    """
    abreast = math.ceil(side / level.tile)
    regions = walkable_regions(free, abreast)
    places = [(x, y) for x, y in level.starts] + [(x, y) for _, x, y in level.monsters[:monsters]]
    near = [_regions_at(regions, abreast, level, x, y) for x, y in places]
    shares = Counter(region for found in near for region in found)
    sizes = np.bincount(regions.ravel())
    home = max(shares, key=lambda region: (shares[region], sizes[region]), default=0)
    return next((index for index, found in enumerate(near) if home not in found), None)


def walkable_regions(free: np.ndarray, abreast: int = 1) -> np.ndarray:
    """Number the regions of free tiles in which a body of `abreast` tiles a side can move, from 1.

    Return the region of a body whose upper left tile is this one, (rows, columns) int32; 0 where none fits.
    """
    fits = minimum_filter(free, abreast, mode="constant", cval=False, origin=-(abreast // 2))
    return np.asarray(label(fits, output=np.int32)[0])


def _regions_at(regions: np.ndarray, abreast: int, level: Level, x: float, y: float) -> set[int]:
    """Return the regions of the bodies that cover the tile at (x, y)."""
    row, column = int((y - level.top) // level.tile), int((x - level.left) // level.tile)
    top, left = max(row - abreast + 1, 0), max(column - abreast + 1, 0)
    return set(regions[top : row + 1, left : column + 1].ravel().tolist()) - {0}
