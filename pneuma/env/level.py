"""Levels: where the land, the obstacles, the players and the monsters are.

A level's name is one of

    thesis              a level that comes with the package, as a folder of CSV layers
    path/to/folder      a user's own folder
    path/to/map.tmx     a map as the editor Tiled saves it; see `tiled_map.py`
    random:train:17     an island drawn from a number; see `random_level.py`

A folder holds one CSV file a layer, as Tiled exports them: ground, obstacles and entities, described
in `tiled.py`, and

    objects       instead of entities or with them: a table code,x,y in pixels from the origin
    level.toml    optional: title, tile (its side in pixels), origin (column and row of the tile at
                  whose upper left corner the origin lies), coast (ground codes where the land ends;
                  otherwise those called water in [ground], or 0),
                  obstacles (codes that block besides 395), [ground] (what each ground code is)

Whatever its source, a level in which a start place cannot be walked from to every monster is refused.
"""

from __future__ import annotations

import csv
import json
import math
import os
import re
import tomllib
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pneuma.env import rules, tiled
from pneuma.env.tiled import GROUNDS, WATER, Entity, Header, Layers
from pneuma.env.tiled_map import read_tmx
from pneuma.errors import UserError, unknown_name
from pneuma.values import Number, Reader, Several, Text

LEVELS = Path(__file__).parent / "data" / "levels"
RANDOM = "random:"
BODY = (47.0, 48.0)
"""Width and height of the usual player's body: where it passes, the level can be walked."""

_NEEDED = "obstacles.csv, and entities.csv or objects.csv"
_HEADER: dict[str, Reader] = {
    "title": Text("text in quotes"),
    "tile": tiled.TILE_PIXELS,
    "origin": Several(Number(-1e6, 1e6), 2, 2),
    **tiled.CODES,
}


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
        ground_names: which of `GROUNDS` each code is; None: their indices.
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
    ground_names: Mapping[int, str] | None = None

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


def load_level(name: str, monster_codes: dict[int, str], body: tuple[float, float] = BODY) -> Level:
    """Load a level by its name.

    Args:
        name: as above.
        monster_codes: which code is which kind.
        body: width and height of the greatest player, who must be able to walk everywhere.

    Raises:
        UserError: naming the file and the row and column, or the object, of what is wrong.
    """
    if name.startswith(RANDOM):
        return _random_level(name, monster_codes, body)
    path = _level_path(name)
    layers = (_read_folder if path.is_dir() else read_tmx)(path, monster_codes)
    starts = [entity for entity in layers.entities if entity.kind == tiled.START]
    monsters = [entity for entity in layers.entities if entity.kind != tiled.START]
    left, top = layers.header.corner(layers.ground.shape)
    level = Level(
        name=str(path) if name.startswith("~") else name,
        title=layers.header.title,
        tile=layers.header.tile,
        left=left,
        top=top,
        ground=layers.ground,
        terrain=_terrain(layers),
        starts=np.array([(entity.x, entity.y) for entity in starts], np.float64),
        monsters=tuple((entity.kind, entity.x, entity.y) for entity in monsters),
        ground_names=layers.header.ground,
    )
    lost = first_cut_off(level, body)
    if lost is not None:
        whom = "" if body == BODY else f", for a body of {body[0]:g} x {body[1]:g} px"
        raise UserError(f"{[*starts, *monsters][lost].where} is walled in or off the land{whom}")
    return level


def level_files(name: str) -> list[Path]:
    """Return the user's own files that a level depends on; none for shipped and random levels.

    Raises:
        UserError: when there is no such level.
    """
    if name.startswith(RANDOM) or name in _shipped():
        return []
    path = _level_path(name)
    return _folder_files(path) if path.is_dir() else [path]


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


def first_cut_off(level: Level, body: tuple[float, float] = BODY) -> int | None:
    """Return the first place, counting starts, then monsters, that a player cannot walk to from the others.

    A player walks where it fits: over open tiles side by side, as many abreast as its body needs.
    None when every place can be walked to from every other.
    """
    abreast = math.ceil(max(body) / level.tile)
    regions = walkable_regions(level.terrain == rules.OPEN, abreast)
    places = [(x, y) for x, y in level.starts] + [(x, y) for _, x, y in level.monsters]
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
    fits = _fits(_fits(free, abreast).T, abreast).T
    # One row and column of closed tiles around the rest, laid out as one list: no edges to look after.
    padded = np.pad(fits, 1, constant_values=False)
    regions, width = np.where(padded, -1, 0).ravel().tolist(), padded.shape[1]
    count = 0
    for first in np.flatnonzero(padded).tolist():
        if regions[first] < 0:
            count += 1
            _flood(regions, first, count, (1, -1, width, -width))
    return np.array(regions, np.int32).reshape(padded.shape)[1:-1, 1:-1]


# --- Finding and reading -------------------------------------------------------------------------


def _shipped() -> list[str]:
    return sorted(path.name for path in LEVELS.iterdir() if path.is_dir())


def _level_path(name: str) -> Path:
    """Return the folder or the .tmx file that a name other than `random:…` stands for."""
    if name in _shipped():
        return LEVELS / name
    path = Path(os.path.expanduser(name))
    if path.is_dir():
        if _folder_files(path):
            return path
        raise UserError(f"level {name!r}: the folder holds no layers: {_NEEDED}")
    if path.suffix.lower() == ".tmx" and path.is_file():
        return path
    forms = f"{RANDOM}train:N, {RANDOM}test:N, or the path of a folder of layers or of a .tmx file"
    raise UserError(f"{unknown_name('level', name, _shipped())}, {forms}")


def _random_level(name: str, monster_codes: dict[int, str], body: tuple[float, float]) -> Level:
    """Draw a random level; which one is the number's business, not that of who walks there."""
    from pneuma.env.random_level import parse_name, random_level  # builds on this module

    level = random_level(*parse_name(name), monster_codes)
    if first_cut_off(level, body) is not None:
        raise UserError(f"level {name}: a body of {body[0]:g} x {body[1]:g} px cannot walk everywhere")
    return level


def _terrain(layers: Layers) -> np.ndarray:
    """Return (rows, columns) uint8: what stops a body."""
    terrain = np.where(layers.blocked, rules.SOLID, rules.OPEN)
    return np.where(np.isin(layers.ground, layers.header.coast_codes), rules.COAST, terrain).astype(np.uint8)


def _read_folder(folder: Path, monster_codes: Mapping[int, str]) -> Layers:
    """Read a level from a folder of CSV layers."""
    header = _read_header(folder)
    files = _layer_files(folder)
    for name, is_needed in {"obstacles": True, "ground": bool(header.coast)}.items():
        if is_needed and name not in files:
            raise UserError(f"{folder / name}.csv: no such layer")
    if not files.keys() & {"entities", "objects"}:
        raise UserError(f"{folder}: no entities.csv and no objects.csv; one must say where players start")
    where = str(files.get("objects") or files["entities"])
    table = files.pop("objects", None)
    objects = _read_objects(table, monster_codes) if table else []
    grids = {name: tiled.read_grid(_csv_rows(path), str(path)) for name, path in files.items()}
    return tiled.join_layers(header, grids, objects, monster_codes, where)


def _folder_files(folder: Path) -> list[Path]:
    """Return the files of a folder that make its level, sorted; none when it holds no level."""
    header = folder / "level.toml"
    return sorted([*_layer_files(folder).values(), *([header] if header.is_file() else [])])


def _layer_files(folder: Path) -> dict[str, Path]:
    """Return which file of a folder is which layer."""
    files: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        name = tiled.layer_name(path.stem) if path.suffix.lower() == ".csv" and path.is_file() else None
        if name in files:
            raise UserError(f"{folder}: {files[name].name} and {path.name} are both named {name}; keep one")
        if name:
            files[name] = path
    return files


def _read_header(folder: Path) -> Header:
    """Read `level.toml`, every key of which has a default."""
    path = folder / "level.toml"
    title = folder.resolve().name
    if not path.is_file():
        return Header(title)
    text = tiled.read_text(path)
    try:
        values = tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        raise UserError(f"{path}: not TOML: {error}") from None
    read = {key: _header_value(key, value, _line_of(key, path, text)) for key, value in values.items()}
    if "ground" in read and "coast" not in read:
        read["coast"] = tuple(int(code) for code, name in values["ground"].items() if name == WATER)
    return Header(**{"title": title, **read})


def _header_value(key: str, value: Any, where: str) -> Any:
    """Check one key of `level.toml`; the codes of the table [ground] become numbers."""
    allowed = {name: reader.allowed for name, reader in _HEADER.items()}
    allowed["ground"] = f'a table of code = "name", each name one of {", ".join(GROUNDS)}'
    if key not in allowed:
        raise UserError(f"{where}: {unknown_name('key', key, allowed)}")
    try:
        if key in _HEADER:
            return _HEADER[key].read(value)
        if not all(name in GROUNDS for name in {**value}.values()):
            raise ValueError
        return {int(code): ground for code, ground in value.items()}
    except (ValueError, TypeError):
        shown = json.dumps(value, default=str)
        raise UserError(f"{where}: {key} = {shown} is not allowed: {allowed[key]}") from None


def _line_of(key: str, path: Path, text: str) -> str:
    """Return the path of a TOML file and the line that sets a key."""
    setting = re.compile(rf"""\s*\[?["']?{re.escape(key)}\b""")
    lines = (number for number, line in enumerate(text.splitlines(), start=1) if setting.match(line))
    number = next(lines, None)
    return f"{path}, line {number}" if number else str(path)


def _csv_rows(path: Path) -> list[list[str]]:
    return [line.split(",") for line in tiled.read_text(path).rstrip().splitlines()]


def _read_objects(path: Path, monster_codes: Mapping[int, str]) -> list[Entity]:
    """Read the table code,x,y of start places and monsters, in the file's order."""
    kinds = tiled.kinds_by_code(monster_codes)
    entities: list[Entity] = []
    table = csv.DictReader(tiled.read_text(path).splitlines())
    try:
        for line in table:
            row = f"{path}, row {table.line_num}"
            code, x, y = _object_line(line, row)
            if code not in kinds:
                raise UserError(f"{row}: unknown code {code}; known are {tiled.listed(kinds)}")
            entities.append(Entity(kinds[code], x, y, f"{path}: the {kinds[code]} at {x:g},{y:g}"))
    except csv.Error as error:
        raise UserError(f"{path}, row {table.line_num}: not CSV: {error}") from None
    return entities


def _object_line(line: Mapping[str, str], row: str) -> tuple[int, float, float]:
    """Return code, x and y of one line of the table of objects."""
    try:
        code, x, y = int(line["code"]), float(line["x"]), float(line["y"])
        if math.isfinite(x) and math.isfinite(y):
            return code, x, y
    except KeyError:
        hint = "as the first line names them (a layer of tiles is called entities)"
        raise UserError(f"{row}: expected code,x,y {hint}") from None
    except (TypeError, ValueError):
        pass
    raise UserError(f"{row}: expected code,x,y")


# --- Walking -------------------------------------------------------------------------------------


def _regions_at(regions: np.ndarray, abreast: int, level: Level, x: float, y: float) -> set[int]:
    """Return the regions of the bodies that cover the tile at (x, y); none off the grid."""
    rows, columns = level.terrain.shape
    row, column = (y - level.top) // level.tile, (x - level.left) // level.tile
    if not (0 <= row < rows and 0 <= column < columns):
        return set()
    top, left = max(int(row) - abreast + 1, 0), max(int(column) - abreast + 1, 0)
    return set(regions[top : int(row) + 1, left : int(column) + 1].ravel().tolist()) - {0}


def _fits(free: np.ndarray, abreast: int) -> np.ndarray:
    """Return (rows - abreast + 1, columns) bool: whether so many tiles below one another are free."""
    count = max(free.shape[0] - abreast + 1, 0)
    return np.logical_and.reduce([free[shift : shift + count] for shift in range(abreast)])


def _flood(regions: list[int], first: int, region: int, steps: tuple[int, ...]) -> None:
    """Give every place marked -1 that is joined to `first` by `steps` the number of a region."""
    regions[first] = region
    stack = [first]
    while stack:
        place = stack.pop()
        for step in steps:
            if regions[place + step] < 0:
                regions[place + step] = region
                stack.append(place + step)


def _tiles_near(count: int, tile: float, margin: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the slice, in a grid padded by one, of the tiles within `margin` of each half tile."""
    edges = np.arange(2 * count + 1) * (tile / 2)
    first = np.maximum((edges[:-1] - margin) // tile, -1)
    last = np.minimum((edges[1:] + margin) // tile, count)
    return first.astype(np.int64) + 1, last.astype(np.int64) + 2
