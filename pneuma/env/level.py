"""Levels: where the land, the obstacles, the players and the monsters are.

A level's name is one of

    thesis              a level that comes with the package, as a folder of CSV tables
    path/to/folder      a user's own folder; see `level_folder.py`
    random:train:17     an island drawn from a number; see `random_level.py`

Whatever its source, a level is refused in which a body would begin beyond the grid, in what stops it, in
another body, or where a player cannot walk to it.
"""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import label

from pneuma.config import EnvConfig
from pneuma.env import rules
from pneuma.env.level_folder import FOLDER_FILES, START, folder_files, read_folder
from pneuma.errors import UserError, unknown_name

LEVELS = Path(__file__).parent / "data" / "levels"
RANDOM = "random:"


@dataclass(frozen=True)
class Level:
    """A level as the rules need it; lengths in pixels, y downwards.

    Attributes:
        name: what the level was loaded as.
        title: what to call it.
        tile: side of a tile.
        left: x of the grid's left edge.
        top: y of the grid's upper edge.
        ground: (rows, columns) codes of the ground, for drawing; -1 where there is none.
        terrain: (rows, columns) uint8: `rules.OPEN`, `SOLID` or `COAST`.
        starts: (S, 2) start places.
        monsters: kind, x and y of each.
    """

    name: str
    title: str
    tile: float
    left: float
    top: float
    ground: np.ndarray
    terrain: np.ndarray
    starts: np.ndarray
    monsters: tuple[tuple[str, float, float], ...]

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


def load_level(name: str, monster_codes: dict[int, str]) -> Level:
    """Load a level by its name.

    Args:
        name: as above.
        monster_codes: which code is which kind.

    Raises:
        UserError: naming the file, the row and the column of what is wrong.
    """
    if name.startswith(RANDOM):
        from pneuma.env.random_level import parse_name, random_level  # builds on this module

        return random_level(*parse_name(name), monster_codes)
    path = _level_path(name)
    header, ground, blocked, entities = read_folder(path, monster_codes)
    terrain = np.where(blocked, rules.SOLID, rules.OPEN)
    terrain[np.isin(ground, header.coast)] = rules.COAST
    rows, columns = ground.shape
    column, row = header.origin or (columns / 2, rows / 2)
    return Level(
        name=str(path) if name.startswith("~") else name,
        title=header.title,
        tile=header.tile,
        left=-column * header.tile,
        top=-row * header.tile,
        ground=ground,
        terrain=terrain.astype(np.uint8),
        starts=np.array([(x, y) for kind, x, y in entities if kind == START], np.float64),
        monsters=tuple(entity for entity in entities if entity[0] != START),
    )


def level_files(name: str) -> list[Path]:
    """Return the user's own files that a level depends on; none for shipped and random levels.

    Raises:
        UserError: when there is no such level.
    """
    if name.startswith(RANDOM) or name in _shipped():
        return []
    return folder_files(_level_path(name))


def _shipped() -> list[str]:
    return sorted(path.name for path in LEVELS.iterdir() if path.is_dir())


def _level_path(name: str) -> Path:
    """Return the folder that a name other than `random:…` stands for."""
    if name in _shipped():
        return LEVELS / name
    path = Path(os.path.expanduser(name))
    if path.is_dir() and not folder_files(path):
        raise UserError(f"level {name!r}: the folder holds none of {', '.join(FOLDER_FILES)}")
    if path.is_dir():
        return path
    forms = f"{RANDOM}train:N, {RANDOM}test:N, or the path of a folder of layers"
    raise UserError(f"{unknown_name('level', name, _shipped())}, {forms}")


def room_for_bodies(level: Level, margin: float) -> np.ndarray:
    """Return where a body cannot meet anything: (2 rows, 2 columns) uint8 over half tiles.

    A cell has room when every tile within `margin` pixels of it is open. The rules look here first:
    most moves need no closer look.
    """
    rows, columns = level.terrain.shape
    closed = np.pad(level.terrain != rules.OPEN, 1, constant_values=True)
    before = np.zeros((rows + 3, columns + 3), np.int32)  # closed tiles above and left of a corner
    before[1:, 1:] = closed.cumsum(axis=0, dtype=np.int32).cumsum(axis=1, dtype=np.int32)
    top, bottom = _tiles_near(rows, level.tile, margin)
    left, right = _tiles_near(columns, level.tile, margin)
    met = (before[bottom] - before[top])[:, right] - (before[bottom] - before[top])[:, left]
    return (met == 0).astype(np.uint8)


def _tiles_near(count: int, tile: float, margin: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the slice, in a grid padded by one, of the tiles within `margin` of each half tile."""
    edges = np.arange(2 * count + 1) * (tile / 2)
    first = np.maximum((edges[:-1] - margin) // tile, -1)
    last = np.minimum((edges[1:] + margin) // tile, count)
    return first.astype(np.int64) + 1, last.astype(np.int64) + 2


# --- Where bodies may begin ----------------------------------------------------------------------


def refuse_bad_places(level: Level, players: np.ndarray, monsters: np.ndarray, config: EnvConfig) -> None:
    """Refuse a level in which a body would begin beyond the grid, stuck, or where no player can walk to.

    The rules look up tiles unchecked, and who begins inside a wall may never get out. Players take turns
    at the start places, so each must hold everybody. Monsters that no terrain stops may be anywhere.

    Args:
        level: the level.
        players: (P,) `state.PLAYER_STATS`.
        monsters: (M,) `state.MONSTER_STATS`, in the level's order.
        config: says what stops whom.

    Raises:
        UserError: naming the start place or the monster.
    """
    shapes = np.unique(players[["half_width", "half_height", "body_x", "body_y"]])
    starts = [
        _Body(f"start place {i}", x, y, shape) for i, (x, y) in enumerate(level.starts) for shape in shapes
    ]
    others = [
        _Body(f"monster {i} ({name})", x, y, kind)
        for i, ((name, x, y), kind) in enumerate(zip(level.monsters, monsters, strict=True))
    ]
    trees = (rules.SOLID,) if config.trees == "wall" else ()
    coast = (rules.COAST,) if config.coast == "wall" else ()
    stopped = others if config.terrain_stops == "all" else []
    _refuse_off_the_grid(level, starts + others)
    open_tiles = ~np.isin(level.terrain, (*trees, rules.COAST))  # who could walk into a deadly sea drowns
    width, height = 2 * float(players["half_width"].max()), 2 * float(players["half_height"].max())
    lost = first_cut_off(level, open_tiles, max(width, height), len(stopped))
    if lost is not None:
        who = [*starts[:: len(shapes)], *others][lost].told
        size = f"{width:g} x {height:g} px"
        raise UserError(f"level {level.name}: {who} is walled in or off the land, for a body of {size}")
    _refuse_terrain(level, starts, trees + coast)
    _refuse_terrain(level, stopped, (*trees, rules.COAST))
    if config.bodies == "block":
        _refuse_overlaps(level, starts if config.players > 1 else [], starts)
        _refuse_overlaps(level, others, others + starts)


class _Body:
    """A body box at the place where it begins."""

    def __init__(self, who: str, x: float, y: float, stats: np.void) -> None:
        self.told = f"{who} at ({x:g}, {y:g})"
        self.half = float(stats["half_width"]), float(stats["half_height"])
        self.x, self.y = x + float(stats["body_x"]), y + float(stats["body_y"])

    def refusal(self, level: Level, why: str) -> UserError:
        size = f"{2 * self.half[0]:g} x {2 * self.half[1]:g} px"
        return UserError(f"level {level.name}: {self.told} has a body of {size}, which {why}")


def _refuse_off_the_grid(level: Level, bodies: Sequence[_Body]) -> None:
    left, top, right, bottom = level.grid
    for body in bodies:
        inside = left <= body.x - body.half[0] and body.x + body.half[0] <= right
        if not (inside and top <= body.y - body.half[1] and body.y + body.half[1] <= bottom):
            raise body.refusal(level, "reaches beyond the grid")


def _refuse_terrain(level: Level, bodies: Sequence[_Body], stops: Sequence[int]) -> None:
    """Refuse a body that overlaps a tile that stops it; touching one is no overlap."""
    stopping = np.isin(level.terrain, stops)
    for body in bodies:
        rows = _tiles(body.y - level.top, body.half[1], level.tile)
        columns = _tiles(body.x - level.left, body.half[0], level.tile)
        for row, column in np.argwhere(stopping[rows, columns]).tolist():
            place = f"row {rows.start + row + 1}, column {columns.start + column + 1}"
            raise body.refusal(level, f"overlaps the tile in {place}: it would be stuck there")


def _tiles(middle: float, half: float, tile: float) -> slice:
    """Return the rows or columns that a body lies on."""
    return slice(math.floor((middle - half) / tile), math.ceil((middle + half) / tile))


def _refuse_overlaps(level: Level, bodies: Sequence[_Body], others: Sequence[_Body]) -> None:
    """Refuse bodies that overlap any of the others; touching is no overlap."""
    middles = np.array([(other.x, other.y) for other in others])
    halves = np.array([other.half for other in others])
    for body in bodies:
        near = np.abs(middles - (body.x, body.y)) < halves + body.half - rules.HAIR
        for index in np.flatnonzero(near.all(axis=1)).tolist():
            if others[index].told != body.told:  # not itself, nor another player's body at one place
                raise UserError(f"level {level.name}: {body.told} begins inside {others[index].told}")


# --- Walking -------------------------------------------------------------------------------------


def first_cut_off(level: Level, free: np.ndarray, side: float, monsters: int) -> int | None:
    """Return the first place, counting starts, then monsters, that a player cannot walk to from the others.

    A player walks where it fits: over free tiles side by side, as many abreast as its body needs.

    Args:
        level: the level.
        free: (rows, columns) bool, the tiles that a player may walk on.
        side: the longer side of a player's body.
        monsters: how many monsters, from the first on, must be walked to.
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
    """Number the regions in which a body of so many tiles a side can move about, from 1.

    Args:
        free: (rows, columns) bool, the tiles that do not stop a body.
        abreast: side of the body, in tiles.

    Returns:
        (rows - abreast + 1, columns - abreast + 1) int32: the region of a body whose upper left
        tile is this one; 0 where it does not fit.
    """
    rows, columns = (side - abreast + 1 for side in free.shape)
    fits = np.ones((max(rows, 0), max(columns, 0)), np.bool_)
    for down, along in np.ndindex(abreast, abreast):
        fits &= free[down : down + rows, along : along + columns]
    return np.asarray(label(fits, output=np.int32)[0])


def _regions_at(regions: np.ndarray, abreast: int, level: Level, x: float, y: float) -> set[int]:
    """Return the regions of the bodies that cover the tile at (x, y)."""
    row, column = int((y - level.top) // level.tile), int((x - level.left) // level.tile)
    top, left = max(row - abreast + 1, 0), max(column - abreast + 1, 0)
    return set(regions[top : row + 1, left : column + 1].ravel().tolist()) - {0}
