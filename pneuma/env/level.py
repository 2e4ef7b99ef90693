"""Levels: where the land, the obstacles, the players and the monsters are.

A level's name is one of

    thesis              a level that comes with the package, as a folder of CSV tables
    path/to/folder      a user's own folder of such tables, as the editor Tiled exports layers
    random:train:17     an island drawn from a number; see `random_level.py`

A folder holds

    obstacles.csv   a code for every tile: -1, or anything else where something stands in the way
    ground.csv      optional: what every tile is made of, for the eye and for the coast; code 0 is water
    objects.csv     a table code,x,y of start places (400) and monsters (390 …), in pixels from the origin
    level.toml      optional: what `Header` lists

A level is refused if a body would start outside the grid, inside an obstacle or another body, or where no
player can walk to.
"""

from __future__ import annotations

import math
import os
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field
from scipy.ndimage import label, minimum_filter

from pneuma.env import rules
from pneuma.env_fields import SHIPPED_LEVELS, EnvConfig, is_own_level
from pneuma.errors import UserError, unknown_name
from pneuma.files import read_text
from pneuma.schema import Table, TomlFile, read_model, read_toml

LEVELS = Path(__file__).parent / "data" / "levels"
RANDOM = "random:"
START_CODE = 400
EMPTY, WATER, SNOW, GRASS, SAND, BRIDGE = range(-1, 5)
"""Codes of the ground in shipped and random levels; a user's own level may have others."""
MAX_SIDE = 1000
LARGEST_LAYER = 16 * 2**20
"""Most bytes of a layer."""
MOST_PLACES = 1000
"""Most start places and monsters together in a level."""
FOLDER_FILES = ("ground.csv", "level.toml", "objects.csv", "obstacles.csv")

Rounded = AfterValidator(lambda pixels: round(pixels * 1024) / 1024)
"""For lengths from which the rules compute where a body touches a wall. Their sums are then exact: a body
that overlapped the wall by a rounding error could not slide along it."""
_Tiles = Annotated[float, Field(ge=-1e6, le=1e6), Rounded]
_GroundCode = Annotated[int, Field(ge=EMPTY, lt=2**28)]


class Header(Table):
    """The contents of `level.toml`."""

    title: Annotated[str, Field(min_length=1)]
    tile: Annotated[float, Field(ge=8, le=4096), Rounded] = 64.0
    """Side of a tile in pixels; players move 5 a tick and look one tile ahead."""
    origin: Annotated[tuple[_Tiles, ...], Field(min_length=2, max_length=2)] | None = None
    """Column and row of the tile whose upper left corner is (0, 0); None: the centre."""
    coast: Annotated[tuple[_GroundCode, ...], Field(max_length=1000)] = (WATER,)
    """Ground codes where the land ends."""


@dataclass(frozen=True)
class Level:
    """A level as the rules need it; lengths in pixels, y downwards."""

    name: str
    title: str
    tile: float
    left: float  # of the grid of tiles
    top: float
    ground: np.ndarray  # (rows, columns) codes, for drawing; -1 where there is none
    terrain: np.ndarray  # (rows, columns) uint8: `rules.OPEN`, `SOLID`, `COAST` or `SLOW`
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


def load_levels(config: EnvConfig, monster_codes: Mapping[int, str]) -> list[Level]:
    """Load a world's level, or `count` consecutive random ones, and mark the slow ground."""
    from pneuma.env.random_level import parse_name  # builds on this module

    names = [config.level]
    if config.random_levels > 1:
        split, first = parse_name(config.level)
        names = [f"{RANDOM}{split}:{first + i}" for i in range(config.random_levels)]
    levels = [load_level(name, monster_codes, config.monsters) for name in names]
    there = {int(code) for level in levels for code in np.unique(level.ground)}
    if (lacking := {*config.slow} - there) and not config.level.startswith(RANDOM):
        raise UserError(f"slow: {config.level} has no ground {sorted(lacking)}; it has {sorted(there)}")
    for level in levels:
        level.terrain[(level.terrain == rules.OPEN) & np.isin(level.ground, config.slow)] = rules.SLOW
    return levels


def load_level(name: str, monster_codes: Mapping[int, str], monsters: str = "bamboo") -> Level:
    """Load a level by its name.

    `monster_codes` has the kind of monster of each code; `monsters` live on random levels.
    """
    if name.startswith(RANDOM):
        from pneuma.env.random_level import parse_name, random_level  # builds on this module

        return random_level(*parse_name(name), monsters)
    folder = _level_path(name)
    path = folder / "level.toml"
    file = read_toml(path) if path.is_file() else TomlFile(path, "", {})
    file.data.setdefault("title", folder.resolve().name or "level")
    header = read_model(Header, file)
    blocked = _read_layer(folder / "obstacles.csv")
    path = folder / "ground.csv"
    ground = _read_layer(path) if path.is_file() else np.full_like(blocked, EMPTY)
    if ground.shape != blocked.shape:
        raise UserError(f"{folder}: ground of {ground.shape} tiles, and obstacles of {blocked.shape}")
    terrain = np.where(blocked != EMPTY, rules.SOLID, rules.OPEN)
    terrain[np.isin(ground, header.coast)] = rules.COAST
    rows, columns = ground.shape
    column, row = header.origin or (columns / 2, rows / 2)
    objects = _read_objects(folder / "objects.csv", monster_codes)
    return Level(
        name=str(folder) if name.startswith("~") else name,
        title=header.title,
        tile=header.tile,
        left=-column * header.tile,
        top=-row * header.tile,
        ground=ground,
        terrain=terrain.astype(np.uint8),
        starts=np.array([(x, y) for code, x, y in objects if code == START_CODE], np.float64),
        monsters=tuple((monster_codes[int(code)], x, y) for code, x, y in objects if code != START_CODE),
    )


def level_files(name: str) -> list[Path]:
    """Return the user's own files of a level; none for shipped and random levels."""
    return _folder_files(_level_path(name)) if is_own_level(name) else []


def _level_path(name: str) -> Path:
    if name in SHIPPED_LEVELS:
        return LEVELS / name
    path = Path(os.path.expanduser(name))
    if _folder_files(path):
        return path
    forms = f"{RANDOM}train:N, {RANDOM}test:N, or the path of a folder with obstacles.csv and objects.csv"
    raise UserError(f"{unknown_name('level', name, SHIPPED_LEVELS)}, {forms}")


def _folder_files(folder: Path) -> list[Path]:
    """Return the files of a level's folder, sorted; none if it holds no level."""
    return [folder / name for name in FOLDER_FILES if (folder / name).is_file()]


def _read_layer(path: Path) -> np.ndarray:
    """Return the codes of a layer, (rows, columns) int64."""
    rows = _read_rows(path, repeat(_code))
    if not rows or max(len(rows), len(rows[0])) > MAX_SIDE:
        raise UserError(f"{path}: a layer has 1 to {MAX_SIDE} tiles a side")
    return np.array(rows, np.int64)


def _read_objects(path: Path, monster_codes: Mapping[int, str]) -> list[tuple[Any, ...]]:
    """Return code, x and y of start places and monsters, in the file's order."""
    table = _read_rows(path, (_code, _pixels, _pixels), "code,x,y")
    if len(table) > MOST_PLACES:
        raise UserError(f"{path}: more than {MOST_PLACES} start places and monsters are not allowed")
    known = [START_CODE, *monster_codes]
    codes = [row[0] for row in table]
    if unknown := [code for code in codes if code not in known]:
        raise UserError(f"{path}: unknown code {unknown[0]}; known are {', '.join(map(str, known))}")
    if START_CODE not in codes:
        raise UserError(f"{path}: no start place")
    return table


def _code(cell: str) -> int:
    """Read a tile's code, of 32 bits with or without sign; by the highest four Tiled turns its picture."""
    code = int(cell)
    if not -(2**31) <= code < 2**32:
        raise ValueError
    return code if code == EMPTY else code % 2**28


def _pixels(cell: str) -> float:
    if not math.isfinite(pixels := float(cell)):
        raise ValueError
    return pixels


def _read_rows(path: Path, kinds: Iterable[Callable[[str], Any]], head: str = "") -> list[tuple[Any, ...]]:
    """Return the rows of a CSV table, of one kind of number a column, below the line `head` if given."""
    lines = read_text(path, LARGEST_LAYER).splitlines()
    if head and lines[:1] != [head]:
        raise UserError(f"{path}: the first line must be {head}")
    table: list[tuple[Any, ...]] = []
    for row, line in enumerate(lines, 1):
        if not line.strip() or (head and row == 1):
            continue
        cells, columns = line.split(","), len(table[0] if table else head.split(","))
        if len(cells) != columns and (head or table):
            raise UserError(f"{path}: row {row} has {len(cells)} columns, where {columns} are asked for")
        numbers = []
        for column, (read, cell) in enumerate(zip(kinds, cells, strict=False), 1):
            try:
                numbers.append(read(cell))
            except ValueError:
                raise UserError(f"{path}: row {row}, column {column}: {cell[:40]!r} is not allowed") from None
        table.append(tuple(numbers))
    return table


# --- Where bodies may begin ----------------------------------------------------------------------


def refuse_bad_places(level: Level, players: np.ndarray, monsters: np.ndarray, config: EnvConfig) -> None:
    """Refuse a level in which a body would begin beyond the grid, stuck, or where no player can walk to.

    The rules look up tiles without bounds checks, and a body that starts inside a wall may never get out. Any
    player may start at any start place, so each must have room for all of them. Monsters that no terrain
    stops may be anywhere. `players` are (P,) `state.PLAYER_STATS`, `monsters` (M,) `state.MONSTER_STATS` in
    the level's order.
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
    trees = (rules.SOLID,) if config.trees == "wall" else ()
    coast = (rules.COAST,) if config.coast == "wall" else ()
    stopped = others if config.terrain_stops == "all" else []
    left, top, right, bottom = level.grid
    for body in bodies:
        if (body.low < (left, top)).any() or (body.high > (right, bottom)).any():
            raise body.refusal(level, "reaches beyond the grid")
    side = 2 * float(max(players["half_width"].max(), players["half_height"].max()))
    open_tiles = ~np.isin(level.terrain, (*trees, rules.COAST))  # players drown in a deadly sea
    lost = first_cut_off(level, open_tiles, side, len(stopped))
    if lost is not None:
        who = [*starts[:: len(shapes)], *others][lost].who
        raise UserError(f"level {level.name}: {who} is walled in or off the land, for a body of {side:g} px")
    for body in starts:
        _refuse_terrain(level, body, (*trees, *coast))
    for body in stopped:
        _refuse_terrain(level, body, (*trees, rules.COAST))
    if config.bodies == "block":
        low, high = (np.array([getattr(each, edge) for each in bodies]) for edge in ("low", "high"))
        for body in bodies if config.players > 1 else others:
            depth = np.minimum(high, body.high) - np.maximum(low, body.low)
            for index in np.flatnonzero((depth > rules.CONTACT_EPS).all(axis=1)):  # touching is no overlap
                if bodies[index].who != body.who:  # itself, or another player's body at one place
                    raise UserError(f"level {level.name}: {body.who} begins inside {bodies[index].who}")


class _Body:
    """A body's box at the place where it begins."""

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


def _refuse_terrain(level: Level, body: _Body, stops: Sequence[int]) -> None:
    """Refuse a body that overlaps a tile that stops it; touching is allowed."""
    corner = (level.left, level.top)
    first = np.floor((body.low - corner) / level.tile).astype(int)
    last = np.ceil((body.high - corner) / level.tile).astype(int)
    under = level.terrain[first[1] : last[1], first[0] : last[0]]
    for row, column in np.argwhere(np.isin(under, stops)).tolist():
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
