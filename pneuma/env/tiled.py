"""Layers of tile codes, as the map editor Tiled leaves them, and folders of them as CSV files.

A layer is known by the last word of its name, in upper or lower case (`island_Ground`):

    ground        optional: what every tile is made of; for the eye, and for the coast: code 0, water
    obstacles     (or floorblocks, blocks) code 395 where something stands in the way, empty elsewhere
    entities      optional: at the centre of its tile stands a start place (400) or a monster (390 ...)

A folder may also hold

    objects       instead of entities or with them: a table code,x,y in pixels from the origin
    level.toml    optional: what `Header` lists

What is wrong is told with file, row and column. `tiled_map.py` reads whole .tmx maps with these parts.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator

from pneuma.errors import UserError
from pneuma.schema import Table, TomlFile, read_model, read_toml, wrong

START = "start"
START_CODE = 400
OBSTACLE_CODE = 395
EMPTY = -1
WATER_CODE = 0
WATER = "water"
"""What ground of that code is, and the name by which a level may call other codes so."""
GROUNDS = (WATER, "snow", "grass", "sand", "bridge")
"""What a tile of the ground may be, by its code where no `[ground]` names the codes."""
MAX_SIDE = 1000
MAX_CODE = 2**24 - 1
MOST_PLACES = 1000
"""Of start places and monsters together, in a level."""
CODE_BITS = 0x0FFFFFFF
"""Tiled keeps how a tile is flipped or turned in the four bits above."""
NEEDED = "obstacles.csv, and entities.csv or objects.csv"

_LAYERS = {"floorblocks": "obstacles", "blocks": "obstacles"}
_LAYERS |= {name: name for name in ("ground", "obstacles", "entities", "objects")}
_Pixels = Annotated[float, Field(ge=-1e6, le=1e6)]
_GroundCode = Annotated[int, Field(ge=EMPTY, le=MAX_CODE)]
_ObstacleCode = Annotated[int, Field(ge=0, le=MAX_CODE)]


@dataclass(frozen=True)
class Entity:
    """A start place or a monster; lengths in pixels from the origin.

    Attributes:
        kind: `START`, or which kind of monster.
        x: to the right.
        y: downwards.
        where: what to call it in an error: file, row and column or object.
    """

    kind: str
    x: float
    y: float
    where: str


class Header(Table):
    """What a level says beside its layers, as `level.toml` has it."""

    title: Annotated[str, Field(min_length=1)]
    tile: Annotated[float, Field(ge=8, le=4096)] = 64.0
    """Side of a tile in pixels; players move 5 a tick and look one tile ahead."""
    origin: tuple[_Pixels, _Pixels] | None = None
    """Column and row of the tile at whose upper left corner (0, 0) lies; None: the centre."""
    coast: Annotated[tuple[_GroundCode, ...], Field(max_length=1000)] | None = None
    """Ground codes where the land ends; None: those called water in [ground], or 0."""
    obstacles: Annotated[tuple[_ObstacleCode, ...], Field(max_length=1000)] = ()
    """Codes that block besides 395."""
    ground: dict[str, Literal[GROUNDS]] | None = None  # type: ignore[valid-type]
    """The ground codes that there are, and which of `GROUNDS` each is; None: any."""

    @field_validator("ground")
    @classmethod
    def _by_codes(cls, ground: dict[str, str] | None) -> dict[str, str] | None:
        for code in ground or ():
            if not re.fullmatch(r"-1|\d{1,8}", code):
                raise wrong(f"{code!r} is not allowed: a tile's code")
        return ground

    @property
    def ground_names(self) -> dict[int, str] | None:
        """`ground` by whole numbers."""
        return None if self.ground is None else {int(code): name for code, name in self.ground.items()}

    @property
    def coast_codes(self) -> tuple[int, ...]:
        """Ground codes where the land ends."""
        if self.coast is not None:
            return self.coast
        names = self.ground_names or {WATER_CODE: WATER}
        return tuple(code for code, name in names.items() if name == WATER)

    def corner(self, shape: tuple[int, ...]) -> tuple[float, float]:
        """Return x and y of the upper left corner of a grid of (rows, columns), in pixels."""
        rows, columns = shape
        column, row = self.origin or (columns / 2, rows / 2)
        return -column * self.tile, -row * self.tile


@dataclass(frozen=True)
class Grid:
    """A layer of tiles: (rows, columns) codes, and what to call the layer in an error."""

    codes: np.ndarray
    where: str


@dataclass(frozen=True)
class Layers:
    """What was read of a level, checked but for where bodies may begin.

    Attributes:
        header: what it says beside its layers.
        ground: (rows, columns) codes, -1 where there is none.
        blocked: (rows, columns) bool, where an obstacle stands.
        entities: start places and monsters in the order of the files.
    """

    header: Header
    ground: np.ndarray
    blocked: np.ndarray
    entities: tuple[Entity, ...]


# --- Layers --------------------------------------------------------------------------------------


def layer_name(title: str) -> str | None:
    """Return which layer is meant by the last word of a file's or layer's name; None for no layer."""
    words = [word for word in re.split(r"[\W_]+", title.lower()) if word]
    return _LAYERS.get(words[-1]) if words else None


def kinds_by_code(monster_codes: Mapping[int, str]) -> dict[int, str]:
    """Return what every code of an entity stands for: `START` or a kind of monster."""
    return {START_CODE: START, **monster_codes}


def listed(values: Iterable[object]) -> str:
    """Return values as an error lists them."""
    return ", ".join(map(str, values))


def place_of(where: str, row: int, column: int) -> str:
    """Return the place of a tile as people count, from 1."""
    return f"{where}, row {row + 1}, column {column + 1}"


def refuse_many(where: str, count: int) -> None:
    """Refuse more start places and monsters than a level may have."""
    if count > MOST_PLACES:
        raise UserError(f"{where}: more than {MOST_PLACES} start places and monsters are not allowed")


def refuse_other_size(grid: Grid, shape: tuple[int, ...], reference: str) -> None:
    """Refuse a layer that has not as many rows and columns as the one it is compared with."""
    if grid.codes.shape != shape:
        have, want = (f"{rows} x {columns}" for rows, columns in (grid.codes.shape, shape))
        raise UserError(f"{grid.where}: {have} tiles, where {reference} has {want}")


def read_text(path: Path) -> str:
    """Read a file of text; raise `UserError` when it cannot be read."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:  # which an XML parser takes for UTF-16, whatever it is told
        raise UserError(f"{path}: cannot be read: it is not UTF-8 text")
    return text


def read_grid(rows: Sequence[Sequence[str]], where: str) -> Grid:
    """Read a layer of codes from the text of its cells.

    Raises:
        UserError: naming the row, and the column of a cell, counted from 1.
    """
    if not rows:
        raise UserError(f"{where}: the layer is empty")
    if max(len(rows), len(rows[0])) > MAX_SIDE:
        raise UserError(f"{where}: {len(rows)} x {len(rows[0])} tiles; at most {MAX_SIDE} a side are allowed")
    for number, cells in enumerate(rows, start=1):
        if len(cells) != len(rows[0]):
            count = len(cells) if cells != [""] else 0
            raise UserError(f"{where}, row {number}: {count} tiles, where row 1 has {len(rows[0])}")
    codes = [[_tile_code(cell, where, r, c) for c, cell in enumerate(cells)] for r, cells in enumerate(rows)]
    return Grid(np.array(codes, np.int64), where)


def _tile_code(cell: str, where: str, row: int, column: int) -> int:
    """Return a cell's code without the flags of flipped tiles, with which it may look negative."""
    text = cell.strip()
    if len(text) <= 11 and re.fullmatch(r"-?[0-9]+", text):
        number = int(text)
        code = number if number == EMPTY else number & CODE_BITS
        if -(2**31) <= number < 2**32 and code <= MAX_CODE:
            return code
    raise UserError(f"{place_of(where, row, column)}: {cell!r} is not a tile code")


def join_layers(
    header: Header,
    grids: Mapping[str, Grid],
    objects: Sequence[Entity],
    monster_codes: Mapping[int, str],
    where: str,
) -> Layers:
    """Put the layers of a level together.

    Args:
        header: what the level says beside them.
        grids: the layers of tiles by name, that of obstacles among them.
        objects: start places and monsters beside those in the layer of entities.
        monster_codes: which code is which kind of monster.
        where: the file in which a missing start place would be.

    Raises:
        UserError: when layers differ in size, a code is unknown, or there is no start place.
    """
    obstacles, ground = grids["obstacles"], grids.get("ground")
    reference = ground or obstacles
    for grid in grids.values():
        refuse_other_size(grid, reference.codes.shape, Path(reference.where).name)
    blocking = (OBSTACLE_CODE, *header.obstacles)
    _refuse_unknown(obstacles, (EMPTY, *blocking), "; list it as `obstacles` if it blocks")
    if ground and header.ground_names is not None:
        _refuse_unknown(ground, (EMPTY, *sorted(header.ground_names)), "; name it in [ground]")
    entities = [*_entities(grids.get("entities"), monster_codes, header), *objects]
    refuse_many(where, len(entities))
    if all(entity.kind != START for entity in entities):
        raise UserError(f"{where}: no start place (code {START_CODE})")
    codes = ground.codes if ground else np.full_like(obstacles.codes, EMPTY)
    return Layers(header, codes, np.isin(obstacles.codes, blocking), tuple(entities))


def _entities(grid: Grid | None, monster_codes: Mapping[int, str], header: Header) -> list[Entity]:
    """Return who stands at the centre of which tile, row by row."""
    if grid is None:
        return []
    kinds = kinds_by_code(monster_codes)
    _refuse_unknown(grid, (EMPTY, *kinds))
    refuse_many(grid.where, np.count_nonzero(grid.codes != EMPTY))
    left, top = header.corner(grid.codes.shape)
    entities = []
    for row, column in np.argwhere(grid.codes != EMPTY).tolist():
        kind = kinds[int(grid.codes[row, column])]
        x, y = left + (column + 0.5) * header.tile, top + (row + 0.5) * header.tile
        entities.append(Entity(kind, x, y, f"{place_of(grid.where, row, column)}: the {kind}"))
    return entities


def _refuse_unknown(grid: Grid, known: Sequence[int], hint: str = "") -> None:
    """Refuse the first tile, row by row, whose code is none of `known`."""
    for row, column in np.argwhere(~np.isin(grid.codes, known)).tolist():
        told = f"unknown code {grid.codes[row, column]}; known are {listed(known)}{hint}"
        raise UserError(f"{place_of(grid.where, row, column)}: {told}")


# --- Folders -------------------------------------------------------------------------------------


def read_folder(folder: Path, monster_codes: Mapping[int, str]) -> Layers:
    """Read a level from a folder of CSV layers."""
    path = folder / "level.toml"
    file = read_toml(path) if path.is_file() else TomlFile(path, "", {})
    file.data.setdefault("title", folder.resolve().name or "level")
    header = read_model(Header, file)
    files = _layer_files(folder)
    for name, is_needed in {"obstacles": True, "ground": bool(header.coast)}.items():
        if is_needed and name not in files:
            raise UserError(f"{folder / name}.csv: no such layer")
    if not files.keys() & {"entities", "objects"}:
        raise UserError(f"{folder}: no entities.csv and no objects.csv; one must say where players start")
    where = str(files.get("objects") or files["entities"])
    table = files.pop("objects", None)
    objects = _read_objects(table, monster_codes) if table else []
    grids = {name: read_grid(_csv_rows(each), str(each)) for name, each in files.items()}
    return join_layers(header, grids, objects, monster_codes, where)


def folder_files(folder: Path) -> list[Path]:
    """Return the files of a folder that make its level, sorted; none when it holds no level."""
    header = folder / "level.toml"
    return sorted([*_layer_files(folder).values(), *([header] if header.is_file() else [])])


def _layer_files(folder: Path) -> dict[str, Path]:
    """Return which file of a folder is which layer."""
    files: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        name = layer_name(path.stem) if path.suffix.lower() == ".csv" and path.is_file() else None
        if name in files:
            raise UserError(f"{folder}: {files[name].name} and {path.name} are both named {name}; keep one")
        if name:
            files[name] = path
    return files


def _csv_rows(path: Path) -> list[list[str]]:
    return [line.split(",") for line in read_text(path).rstrip().splitlines()]


def _read_objects(path: Path, monster_codes: Mapping[int, str]) -> list[Entity]:
    """Read the table code,x,y of start places and monsters, in the file's order."""
    kinds = kinds_by_code(monster_codes)
    entities: list[Entity] = []
    table = csv.DictReader(read_text(path).splitlines())
    try:
        for line in table:
            row = f"{path}, row {table.line_num}"
            try:
                code, x, y = int(line["code"]), float(line["x"]), float(line["y"])
            except (KeyError, TypeError, ValueError):
                raise UserError(f"{row}: expected numbers in the columns code,x,y") from None
            if not (math.isfinite(x) and math.isfinite(y)):
                raise UserError(f"{row}: expected numbers in the columns code,x,y")
            if code not in kinds:
                raise UserError(f"{row}: unknown code {code}; known are {listed(kinds)}")
            entities.append(Entity(kinds[code], x, y, f"{path}: the {kinds[code]} at {x:g},{y:g}"))
            refuse_many(str(path), len(entities))
    except csv.Error as error:
        raise UserError(f"{path}, row {table.line_num}: not CSV: {error}") from None
    return entities
