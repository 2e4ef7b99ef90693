"""Level files: a folder of CSV tables, or a map of the editor Tiled.

A folder holds

    obstacles.csv   a code for every tile: -1, or anything else where something stands in the way
    ground.csv      optional: what every tile is made of, for the eye and for the coast; code 0 is water
    objects.csv     a table code,x,y of start places (400) and monsters (390 …), in pixels from the origin
    level.toml      optional: what `Header` lists

A finite orthogonal .tmx map has the tile layers `obstacles` and `ground`, stored as CSV, and objects named or
classed `start`, `bamboo` … anywhere. `title` and `coast` (codes, with commas between) are properties of the
map, and the origin is its centre.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
from pydantic import Field

from pneuma.errors import UserError
from pneuma.reading import read_text
from pneuma.schema import Table, TomlFile, read_model, read_toml

START, START_CODE = "start", 400
EMPTY, WATER_CODE = -1, 0
MAX_SIDE = 1000
LARGEST_LAYER = 16 * 2**20
"""Bytes of a layer, with every code of the longest."""
MOST_PLACES = 1000
"""Of start places and monsters together, in a level."""
FOLDER_FILES = ("ground.csv", "level.toml", "objects.csv", "obstacles.csv")
CODE_BITS = 0x0FFFFFFF
"""Tiled keeps how a tile is flipped or turned in the four bits above."""

_Pixels = Annotated[float, Field(ge=-1e6, le=1e6)]
_GroundCode = Annotated[int, Field(ge=EMPTY, lt=2**28)]


class Header(Table):
    """What a level says beside its layers, as `level.toml` has it."""

    title: Annotated[str, Field(min_length=1)]
    tile: Annotated[float, Field(ge=8, le=4096)] = 64.0
    """Side of a tile in pixels; players move 5 a tick and look one tile ahead."""
    origin: Annotated[tuple[_Pixels, ...], Field(min_length=2, max_length=2)] | None = None
    """Column and row of the tile at whose upper left corner (0, 0) lies; None: the centre."""
    coast: Annotated[tuple[_GroundCode, ...], Field(max_length=1000)] = (WATER_CODE,)
    """Ground codes where the land ends."""

    def corner(self, shape: tuple[int, ...]) -> tuple[float, float]:
        """Return x and y of the upper left corner of a grid of (rows, columns), in pixels."""
        rows, columns = shape
        column, row = self.origin or (columns / 2, rows / 2)
        return -column * self.tile, -row * self.tile


class Entity(NamedTuple):
    """A start place or a monster: its kind, its place in pixels, and what to call it in an error."""

    kind: str
    x: float
    y: float
    where: str


@dataclass(frozen=True)
class Layers:
    """What was read of a level, checked but for where bodies may begin.

    Attributes:
        header: what it says beside its layers.
        ground: (rows, columns) codes, -1 where there is none.
        blocked: (rows, columns) bool, where an obstacle stands.
        entities: start places and monsters in the order of the file.
    """

    header: Header
    ground: np.ndarray
    blocked: np.ndarray
    entities: list[Entity]


def read_folder(folder: Path, monster_codes: Mapping[int, str]) -> Layers:
    """Read a level from a folder of CSV tables; `UserError` tells file, row and column of what is wrong."""
    header = folder / "level.toml"
    file = read_toml(header) if header.is_file() else TomlFile(header, "", {})
    file.data.setdefault("title", folder.resolve().name or "level")
    names = ["obstacles", *(["ground"] if (folder / "ground.csv").is_file() else [])]
    grids = {}
    for name in names:
        path = folder / f"{name}.csv"
        grids[name] = _codes(read_text(path, LARGEST_LAYER), str(path))
    kinds = {START_CODE: START, **monster_codes}
    return _layers(read_model(Header, file), grids, _objects(folder / "objects.csv", kinds), folder)


def folder_files(folder: Path) -> list[Path]:
    """Return the files of a folder that make its level, sorted; none when it holds no level."""
    return [folder / name for name in FOLDER_FILES if (folder / name).is_file()]


def read_map(path: Path, monster_codes: Mapping[int, str]) -> Layers:
    """Read a level from a .tmx map; `UserError` tells file and layer or object of what is wrong."""
    try:
        root = ElementTree.fromstring(read_text(path, LARGEST_LAYER))
    except ElementTree.ParseError as error:
        raise UserError(f"{path}: not XML: {error}") from None
    whole = root.get("orientation", "orthogonal") == "orthogonal" and root.get("infinite", "0") == "0"
    if root.tag != "map" or not whole:
        raise UserError(f"{path}: not a finite orthogonal map of Tiled's")
    tilesets = root.findall("tileset")
    for tileset in tilesets:
        root.remove(tileset)  # they may hold objects too
    first_ids = sorted(int(_number(tileset, "firstgid", f"{path}, tileset")) for tileset in tilesets)
    for each in root.iter():
        if any(each.get(key, "0") != "0" for key in ("offsetx", "offsety", "rotation")):
            raise UserError(f"{_where(path, each)}: shifted or turned against the tiles; put it back")
    header = _map_header(root, path)
    layers = {layer.get("name", "").strip().lower(): layer for layer in root.iter("layer")}
    grids = {}
    for name in layers.keys() & {"obstacles", "ground"}:
        grids[name] = _map_codes(layers[name], first_ids, _where(path, layers[name]))
    if "obstacles" not in grids:
        raise UserError(f"{path}: no layer of tiles named obstacles")
    left, top = header.corner(grids["obstacles"].shape)
    names = {kind.lower(): kind for kind in (START, *monster_codes.values())}
    entities = [_map_object(item, path, names, left, top) for item in root.iter("object")]
    return _layers(header, grids, entities, path)


def _layers(header: Header, grids: Mapping[str, np.ndarray], entities: list[Entity], path: Path) -> Layers:
    obstacles = grids["obstacles"]
    ground = grids.get("ground", np.full_like(obstacles, EMPTY))
    if ground.shape != obstacles.shape:
        raise UserError(f"{path}: ground of {ground.shape} tiles, and obstacles of {obstacles.shape}")
    if len(entities) > MOST_PLACES:
        raise UserError(f"{path}: more than {MOST_PLACES} start places and monsters are not allowed")
    if all(entity.kind != START for entity in entities):
        raise UserError(f"{path}: no start place")
    return Layers(header, ground, obstacles != EMPTY, entities)


def _codes(text: str, where: str) -> np.ndarray:
    """Return the codes of a layer stored as CSV, (rows, columns) int64."""
    rows = [line.strip().removesuffix(",").split(",") for line in text.strip().splitlines()]
    if not rows or max(len(rows), len(rows[0])) > MAX_SIDE:
        raise UserError(f"{where}: a layer has 1 to {MAX_SIDE} tiles a side")
    for number, cells in enumerate(rows, start=1):
        if len(cells) != len(rows[0]):
            raise UserError(f"{where}, row {number}: {len(cells)} tiles, where row 1 has {len(rows[0])}")
        for column, cell in enumerate(cells, start=1):
            if not re.fullmatch(r"\s*-?[0-9]{1,10}\s*", cell):
                raise UserError(f"{where}, row {number}, column {column}: {cell!r} is not a tile code")
    return np.array([[int(cell) for cell in cells] for cells in rows], np.int64)


def _objects(path: Path, kinds: Mapping[int, str]) -> list[Entity]:
    """Read the table code,x,y of start places and monsters, in the file's order."""
    lines = read_text(path, LARGEST_LAYER).splitlines()
    if lines[:1] != ["code,x,y"]:
        raise UserError(f"{path}: the first line must be code,x,y")
    entities = []
    for number, line in enumerate(lines[1:], start=2):
        try:
            code, x, y = (float(cell) for cell in line.split(","))
        except ValueError:
            raise UserError(f"{path}, row {number}: expected numbers in the columns code,x,y") from None
        if code not in kinds:
            known = ", ".join(map(str, kinds))
            raise UserError(f"{path}, row {number}: unknown code {code:g}; known are {known}")
        kind = kinds[int(code)]
        entities.append(Entity(kind, x, y, f"{path}: the {kind} at {x:g},{y:g}"))
    return entities


# --- Maps of Tiled's ------------------------------------------------------------------------------


def _where(path: Path, element: Element) -> str:
    return f"{path}, {element.tag} {element.get('name') or element.get('id', '')!r}"


def _map_header(root: Element, path: Path) -> Header:
    tile = _number(root, "tilewidth", str(path))
    if _number(root, "tileheight", str(path)) != tile:
        raise UserError(f"{path}: tiles must be square")
    found = root.findall("properties/property")
    properties = {each.get("name"): each.get("value", each.text or "") for each in found}
    data: dict[str, Any] = {"title": properties.get("title") or path.stem, "tile": tile}
    if "coast" in properties:
        codes = [code.strip() for code in properties["coast"].split(",")]
        data["coast"] = [int(code) if code.isdigit() else code for code in codes]
    return read_model(Header, TomlFile(path, "", data))


def _map_codes(layer: Element, first_ids: list[int], where: str) -> np.ndarray:
    """Read a layer of global tile ids as each tileset's own codes."""
    data = layer.find("data")
    if data is None or data.get("encoding") != "csv":
        raise UserError(f"{where}: not stored as CSV; set Tile Layer Format to CSV in Tiled's map properties")
    tiles = _codes(data.text or "", where) & CODE_BITS
    if tiles.any() and first_ids[:1] != [1]:
        raise UserError(f"{where}: its tiles belong to no tileset")
    first = np.array([EMPTY + 1, *first_ids])[np.searchsorted(first_ids, tiles, side="right")]
    return np.where(tiles == 0, EMPTY, tiles - first)


def _map_object(item: Element, path: Path, names: Mapping[str, str], left: float, top: float) -> Entity:
    """Return what an object's class (`type` to most versions of Tiled) or name says, at its middle."""
    where = _where(path, item)
    words = [item.get(key, "").strip().lower() for key in ("type", "class", "name")]
    kind = next((names[word] for word in words if word in names), None)
    if kind is None:
        raise UserError(f"{where}: neither a start nor a monster; class or name it one of {', '.join(names)}")
    x, y, width, height = (_number(item, key, where, "0") for key in ("x", "y", "width", "height"))
    up = item.get("gid") is not None  # Tiled places an object made of a tile by its lower left corner
    return Entity(
        kind, left + x + width / 2, top + y + (-height if up else height) / 2, f"{where}: the {kind}"
    )


def _number(element: Element, key: str, where: str, default: str = "") -> float:
    text = element.get(key, default)
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not abs(number) < 1e9:
        raise UserError(f"{where}: {key} = {text!r} is not allowed: a number")
    return number
