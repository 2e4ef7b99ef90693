"""Levels: a folder of CSV layers and where its players and monsters stand.

A level's folder holds

    level.toml      title, tile size in pixels, the tile whose corner is the origin of coordinates,
                    and which ground codes are coast
    ground.csv      what every tile is made of; for the eye, and for the coast
    obstacles.csv   code 395 where something stands in the way, -1 elsewhere
    objects.csv     code,x,y: start places (400) and monsters (390 …), in pixels from the origin

Layers are whole numbers, one row of tiles a line, as map editors export them.
"""

from __future__ import annotations

import csv
import tomllib
from collections import deque
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pneuma.env import rules
from pneuma.errors import UserError, unknown_name

LEVELS = Path(__file__).parent / "data" / "levels"
START_CODE = 400
OBSTACLE_CODE = 395


@dataclass(frozen=True)
class Level:
    """A level as the rules need it; lengths in pixels, y downwards.

    Attributes:
        name: what the level was loaded as.
        title: what to call it.
        tile: side of a tile.
        left: x of the grid's left edge.
        top: y of the grid's upper edge.
        ground: (rows, columns) codes of the ground, for drawing.
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


def level_folder(name: str) -> Path:
    """Return the folder of a shipped level's name or of a path.

    Raises:
        UserError: when there is neither.
    """
    for folder in (LEVELS / name, Path(name)):
        if (folder / "level.toml").is_file():
            return folder
    raise unknown_name("level", name, sorted(path.name for path in LEVELS.iterdir() if path.is_dir()))


def load_level(name: str, monster_codes: dict[int, str]) -> Level:
    """Read a level from its folder; `monster_codes` says which code is which kind.

    Raises:
        UserError: naming file, row and column of what is wrong.
    """
    folder = level_folder(name)
    header = _read_header(folder / "level.toml")
    ground = _read_layer(folder / "ground.csv")
    obstacles = _read_layer(folder / "obstacles.csv")
    if obstacles.shape != ground.shape:
        raise UserError(
            f"{folder / 'obstacles.csv'}: {obstacles.shape[0]} x {obstacles.shape[1]} tiles, "
            f"where ground.csv has {ground.shape[0]} x {ground.shape[1]}"
        )
    tile = float(header["tile"])
    column, row = header["origin"]
    starts, monsters = _read_objects(folder / "objects.csv", monster_codes)
    level = Level(
        name=name,
        title=str(header["title"]),
        tile=tile,
        left=-column * tile,
        top=-row * tile,
        ground=ground,
        terrain=_terrain(ground, obstacles, header["coast"]),
        starts=starts,
        monsters=tuple(monsters),
    )
    _check_reachable(level, folder / "objects.csv")
    return level


def room_for_bodies(level: Level, margin: float) -> np.ndarray:
    """Return where a body cannot meet anything: (2 rows, 2 columns) uint8 over half tiles.

    A cell has room when every tile within `margin` pixels of it is open. The rules look here first:
    most moves need no closer look.
    """
    rows, columns = level.terrain.shape
    half = level.tile / 2
    free = np.pad(level.terrain == rules.OPEN, 1, constant_values=False)
    room = np.zeros((2 * rows, 2 * columns), np.uint8)
    for row in range(2 * rows):
        top, bottom = _tiles_between(row * half - margin, (row + 1) * half + margin, level.tile, rows)
        for column in range(2 * columns):
            left, right = _tiles_between(
                column * half - margin, (column + 1) * half + margin, level.tile, columns
            )
            room[row, column] = free[top:bottom, left:right].all()
    return room


def _tiles_between(low: float, high: float, tile: float, count: int) -> tuple[int, int]:
    """Return the slice, in a grid padded by one, of the tiles that [low, high] touches."""
    first, last = int(low // tile), int(high // tile)
    return max(first, -1) + 1, min(last, count) + 2


def _read_header(path: Path) -> dict:  # type: ignore[type-arg]
    try:
        with open(path, "rb") as file:
            header = tomllib.load(file)
    except tomllib.TOMLDecodeError as error:
        raise UserError(f"{path}: not TOML: {error}") from None
    for key in ("title", "tile", "origin", "coast"):
        if key not in header:
            raise UserError(f"{path}: the key {key!r} is missing")
    return header


def _read_layer(path: Path) -> np.ndarray:
    """Read a CSV layer of tile codes, shape (rows, columns)."""
    if not path.is_file():
        raise UserError(f"{path}: no such layer")
    lines: list[list[int]] = []
    with open(path, newline="", encoding="utf-8") as file:
        for number, cells in enumerate(csv.reader(file), start=1):
            lines.append([_tile_code(cell, path, number, place) for place, cell in enumerate(cells, start=1)])
            if len(lines[-1]) != len(lines[0]):
                raise UserError(
                    f"{path}, row {number}: {len(lines[-1])} tiles, where row 1 has {len(lines[0])}"
                )
    if not lines:
        raise UserError(f"{path}: the layer is empty")
    return np.array(lines, np.int64)


def _tile_code(cell: str, path: Path, row: int, column: int) -> int:
    try:
        return int(cell)
    except ValueError:
        raise UserError(f"{path}, row {row}, column {column}: {cell!r} is not a tile code") from None


def _read_objects(
    path: Path, monster_codes: dict[int, str]
) -> tuple[np.ndarray, list[tuple[str, float, float]]]:
    """Read start places, shape (S, 2), and monsters (kind, x, y) in the file's order."""
    starts: list[tuple[float, float]] = []
    monsters: list[tuple[str, float, float]] = []
    if not path.is_file():
        raise UserError(f"{path}: no such layer")
    with open(path, newline="", encoding="utf-8") as file:
        for number, line in enumerate(csv.DictReader(file), start=2):
            try:
                code, x, y = int(line["code"]), float(line["x"]), float(line["y"])
            except (KeyError, TypeError, ValueError):
                raise UserError(f"{path}, row {number}: expected code,x,y") from None
            if code == START_CODE:
                starts.append((x, y))
            elif code in monster_codes:
                monsters.append((monster_codes[code], x, y))
            else:
                known = ", ".join(str(known) for known in (START_CODE, *monster_codes))
                raise UserError(f"{path}, row {number}: unknown code {code}; known are {known}")
    if not starts:
        raise UserError(f"{path}: no start place (code {START_CODE})")
    return np.array(starts, np.float64), monsters


def _terrain(ground: np.ndarray, obstacles: np.ndarray, coast: list[int]) -> np.ndarray:
    """Return (rows, columns) uint8: what stops a body."""
    code = np.where(np.isin(ground, coast), rules.COAST, rules.OPEN)
    code = np.where((code == rules.OPEN) & (obstacles == OBSTACLE_CODE), rules.SOLID, code)
    return code.astype(np.uint8)


def _check_reachable(level: Level, path: Path) -> None:
    """Refuse a level in which some monster cannot be walked to from some start place."""
    reached = _walkable_from(level, level.starts[0])
    places = [("start", x, y) for x, y in level.starts] + list(level.monsters)
    for kind, x, y in places:
        if not reached[_tile_of(level, x, y)]:
            raise UserError(f"{path}: the {kind} at {x:g},{y:g} is walled in or off the land")


def _tile_of(level: Level, x: float, y: float) -> tuple[int, int]:
    rows, columns = level.ground.shape
    row, column = int((y - level.top) // level.tile), int((x - level.left) // level.tile)
    return (row, column) if 0 <= row < rows and 0 <= column < columns else (0, 0)


def _walkable_from(level: Level, place: np.ndarray) -> np.ndarray:
    """Return (rows, columns) bool: the tiles a body of up to one tile can reach, side by side."""
    free = level.terrain == rules.OPEN
    reached = np.zeros_like(free)
    start = _tile_of(level, *place)
    queue = deque([start] if free[start] else [])
    reached[start] = free[start]
    while queue:
        row, column = queue.popleft()
        for tile in ((row + 1, column), (row - 1, column), (row, column + 1), (row, column - 1)):
            inside = 0 <= tile[0] < free.shape[0] and 0 <= tile[1] < free.shape[1]
            if inside and free[tile] and not reached[tile]:
                reached[tile] = True
                queue.append(tile)
    return reached
