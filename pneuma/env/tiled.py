"""Tiles as the map editor Tiled leaves them: layers of codes, and whole .tmx maps.

A layer is known by the last word of its name, in upper or lower case (`island_Ground`):

    ground        optional: what every tile is made of; for the eye, and for the coast: code 0, water
    obstacles     (or floorblocks, blocks) code 395 where something stands in the way, empty elsewhere
    entities      optional: at the centre of its tile stands a start place (400) or a monster (390 ...)

In a .tmx map start places and monsters may also be objects, classed or named `start`, `bamboo` ...
or made of a tile with such a code; `title`, `coast` and `obstacles` (codes, with commas between)
are properties of the map, and the origin is its centre.

Everything but who can walk where is checked here: what is wrong is told with file, row and column.
`level.py` reads folders of CSV layers with these parts, and makes levels.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from pneuma.errors import UserError
from pneuma.values import Number, Several

START = "start"
START_CODE = 400
OBSTACLE_CODE = 395
EMPTY = -1
WATER_CODE = 0
WATER = "water"
"""What ground of that code is, and the name by which a level may call other codes so."""
MAX_SIDE = 1000
MAX_CODE = 2**24 - 1
TILE_PIXELS = Number(8, 4096)
"""A player moves 5 px a tick and looks one tile ahead, so tiles must not be much smaller."""
CODES = {
    key: Several(Number(low, MAX_CODE, whole=True), 0, 1000) for key, low in (("coast", -1), ("obstacles", 0))
}
"""What the two lists of codes beside the layers may hold."""

_CODE_BITS = 0x0FFFFFFF  # Tiled keeps how a tile is flipped or turned in the four bits above
_PIXELS = Number(-1e9, 1e9)
_STRAY = -2  # in place of a tile's code: of no tileset
_LAYERS = {"floorblocks": "obstacles", "blocks": "obstacles"}
_LAYERS |= {name: name for name in ("ground", "obstacles", "entities", "objects")}


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


@dataclass(frozen=True)
class Header:
    """What a level says beside its layers.

    Attributes:
        title: what to call it.
        tile: side of a tile in pixels.
        origin: column and row of the tile at whose upper left corner (0, 0) lies; None: the centre.
        coast: ground codes where the land ends; None: those that are drawn as water unless named.
        obstacles: codes that block besides 395.
        ground: the ground codes that there are; None: any.
    """

    title: str
    tile: float = 64.0
    origin: tuple[float, float] | None = None
    coast: tuple[int, ...] | None = None
    obstacles: tuple[int, ...] = ()
    ground: frozenset[int] | None = None

    @property
    def coast_codes(self) -> tuple[int, ...]:
        """Ground codes where the land ends."""
        return (WATER_CODE,) if self.coast is None else self.coast

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
    """What was read of a level, checked but for who can walk where.

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


# --- Layers of tiles -----------------------------------------------------------------------------


def layer_name(title: str) -> str | None:
    """Return which layer is meant by the last word of a file's or layer's name; None for no layer."""
    return _LAYERS.get(re.split(r"[\W_]+", title.strip().lower())[-1])


def kinds_by_code(monster_codes: Mapping[int, str]) -> dict[int, str]:
    """Return what every code of an entity stands for: `START` or a kind of monster."""
    return {START_CODE: START, **monster_codes}


def listed(values: Iterable[object]) -> str:
    """Return values as an error lists them."""
    return ", ".join(str(value) for value in values)


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
        _refuse_other_size(grid, reference.codes.shape, Path(reference.where).name)
    blocking = (OBSTACLE_CODE, *header.obstacles)
    _refuse_unknown(obstacles, (EMPTY, *blocking), "; list it as `obstacles` if it blocks")
    if ground and header.ground is not None:
        _refuse_unknown(ground, (EMPTY, *sorted(header.ground)), "; name it in [ground]")
    entities = [*_entities(grids.get("entities"), monster_codes, header), *objects]
    if all(entity.kind != START for entity in entities):
        raise UserError(f"{where}: no start place (code {START_CODE})")
    codes = ground.codes if ground else np.full_like(obstacles.codes, EMPTY)
    return Layers(header, codes, np.isin(obstacles.codes, blocking), tuple(entities))


def _tile_code(cell: str, where: str, row: int, column: int) -> int:
    """Return a cell's code without the flags of flipped tiles, with which it may look negative."""
    text = cell.strip()
    if len(text) <= 11 and re.fullmatch(r"-?[0-9]+", text):
        number = int(text)
        code = number if number == EMPTY else number & _CODE_BITS
        if -(2**31) <= number < 2**32 and code <= MAX_CODE:
            return code
    raise UserError(f"{_at(where, row, column)}: {cell!r} is not a tile code")


def _entities(grid: Grid | None, monster_codes: Mapping[int, str], header: Header) -> list[Entity]:
    """Return who stands at the centre of which tile, row by row."""
    if grid is None:
        return []
    kinds = kinds_by_code(monster_codes)
    _refuse_unknown(grid, (EMPTY, *kinds))
    left, top = header.corner(grid.codes.shape)
    entities = []
    for row, column in np.argwhere(grid.codes != EMPTY).tolist():
        kind = kinds[int(grid.codes[row, column])]
        x, y = left + (column + 0.5) * header.tile, top + (row + 0.5) * header.tile
        entities.append(Entity(kind, x, y, f"{_at(grid.where, row, column)}: the {kind}"))
    return entities


def _refuse_other_size(grid: Grid, shape: tuple[int, ...], reference: str) -> None:
    if grid.codes.shape != shape:
        have, want = (f"{rows} x {columns}" for rows, columns in (grid.codes.shape, shape))
        raise UserError(f"{grid.where}: {have} tiles, where {reference} has {want}")


def _refuse_unknown(grid: Grid, known: Sequence[int], hint: str = "") -> None:
    """Refuse the first tile, row by row, whose code is none of `known`."""
    for row, column in np.argwhere(~np.isin(grid.codes, known)).tolist():
        told = f"unknown code {grid.codes[row, column]}; known are {listed(known)}{hint}"
        raise UserError(f"{_at(grid.where, row, column)}: {told}")


def _at(where: str, row: int, column: int) -> str:
    """Return the place of a tile as people count, from 1."""
    return f"{where}, row {row + 1}, column {column + 1}"


# --- Tiled's own maps ----------------------------------------------------------------------------


def read_tmx(path: Path, monster_codes: Mapping[int, str]) -> Layers:
    """Read a level from a finite orthogonal .tmx map whose layers are stored as CSV.

    Raises:
        UserError: naming file, layer, row and column, or object, of what is wrong.
    """
    root = _parse_map(path)
    header = _map_header(root, path)
    sides = Number(1, MAX_SIDE, whole=True)
    shape = tuple(int(_number(root, key, str(path), sides)) for key in ("height", "width"))
    first_ids = _take_tilesets(root, path)
    grids: dict[str, Grid] = {}
    for layer in root.iter("layer"):
        where, name = f"{path}, layer {layer.get('name', '')!r}", layer_name(layer.get("name", ""))
        if name in grids:
            raise UserError(f"{where}: the second layer named {name}; keep one")
        if name and name != "objects":
            grids[name] = _map_grid(layer, shape, first_ids, where)
    for name in ("obstacles", "ground") if header.coast else ("obstacles",):
        if name not in grids:
            raise UserError(f"{path}: no layer of tiles named {name}")
    objects = _map_objects(root, path, header.corner(shape), first_ids, kinds_by_code(monster_codes))
    return join_layers(header, grids, objects, monster_codes, str(path))


def _parse_map(path: Path) -> Element:
    """Parse a map, but none that declares entities: those of a stranger's file may expand without end."""
    text = read_text(path)
    if re.search(r"<!(doctype|entity)", text, re.IGNORECASE):
        raise UserError(f"{path}: a DOCTYPE or entities are declared, which no map of Tiled's needs")
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise UserError(f"{path}: not XML: {error}") from None
    if root.tag != "map" or root.get("orientation", "orthogonal") != "orthogonal":
        raise UserError(f"{path}: not an orthogonal map of Tiled's")
    if root.get("infinite", "0") != "0":
        raise UserError(f"{path}: the map is infinite; untick Infinite in Tiled's map properties")
    for group in root.iter("group"):
        _refuse_shift(group, f"{path}, group {group.get('name', '')!r}")
    return root


def _map_header(root: Element, path: Path) -> Header:
    """Read the size of a map's tiles and its properties."""
    tile, height = (_number(root, key, str(path), TILE_PIXELS) for key in ("tilewidth", "tileheight"))
    if tile != height:
        raise UserError(f"{path}: tiles of {tile:g} x {height:g} px; they must be square")
    found = root.findall("properties/property")
    properties = {each.get("name", ""): each.get("value", each.text or "") for each in found}
    codes = {key: _property_codes(properties[key], key, path) for key in CODES if key in properties}
    return Header(properties.get("title") or path.stem, tile, **codes)


def _property_codes(text: str, key: str, path: Path) -> Any:
    try:
        return CODES[key].read([int(code) for code in text.split(",")] if text.strip() else [])
    except ValueError:
        raise UserError(f"{path}: {key} = {text!r} is not allowed: codes with commas between") from None


def _take_tilesets(root: Element, path: Path) -> list[int]:
    """Return the tilesets' first global tile ids, rising, and take them out: they hold objects too."""
    tilesets = root.findall("tileset")
    for tileset in tilesets:
        root.remove(tileset)
    whole = Number(1, MAX_CODE, whole=True)
    return sorted(int(_number(tileset, "firstgid", f"{path}, tileset", whole)) for tileset in tilesets)


def _map_grid(layer: Element, shape: tuple[int, ...], first_ids: list[int], where: str) -> Grid:
    """Read a layer of a map, and its global tile ids as each tileset's own codes."""
    _refuse_shift(layer, where)
    data = layer.find("data")
    if data is None or data.get("encoding") != "csv":
        raise UserError(f"{where}: not stored as CSV; set Tile Layer Format to CSV in Tiled's map properties")
    lines = (data.text or "").strip().splitlines()
    grid = read_grid([line.strip().removesuffix(",").split(",") for line in lines], where)
    _refuse_other_size(grid, shape, "the map")
    tiles, which = np.unique(grid.codes, return_inverse=True)
    codes = np.array([_local_code(int(tile), first_ids) for tile in tiles])[which].reshape(shape)
    for row, column in np.argwhere(codes == _STRAY).tolist():
        raise UserError(f"{_at(where, row, column)}: tile {grid.codes[row, column]} belongs to no tileset")
    return Grid(codes, where)


def _local_code(tile: int, first_ids: list[int]) -> int:
    """Return the code that a global tile id has in the tileset that it belongs to."""
    tilesets_below = bisect_right(first_ids, tile)
    if tile == 0:
        return EMPTY
    return tile - first_ids[tilesets_below - 1] if tilesets_below else _STRAY


def _map_objects(
    root: Element, path: Path, corner: tuple[float, float], first_ids: list[int], kinds: Mapping[int, str]
) -> list[Entity]:
    """Read the objects of all layers of objects; whatever is no start place or monster is refused."""
    entities: list[Entity] = []
    for group in root.iter("objectgroup"):
        _refuse_shift(group, f"{path}, layer {group.get('name', '')!r}")
        for item in group.findall("object"):
            where = f"{path}, object {item.get('id', len(entities) + 1)}"
            kind = _object_kind(item, where, first_ids, kinds)
            x, y = _object_middle(item, where)
            entities.append(Entity(kind, corner[0] + x, corner[1] + y, f"{where}: the {kind}"))
    return entities


def _object_kind(item: Element, where: str, first_ids: list[int], kinds: Mapping[int, str]) -> str:
    """Return what an object is by its class (`type` to most versions of Tiled), name or tile."""
    by_name = {kind.lower(): kind for kind in kinds.values()}
    words = [item.get(key, "").strip() for key in ("type", "class", "name")]
    tile = int(_number(item, "gid", where, Number(0, 2**32, whole=True), "0")) & _CODE_BITS
    named = (by_name[word.lower()] for word in words if word.lower() in by_name)
    kind = next(named, None) or kinds.get(_local_code(tile, first_ids))
    if kind is None:
        called = next((f" {word!r}" for word in words if word), "")
        told = f"class or name it one of {listed(by_name.values())}, or use a tile of code {listed(kinds)}"
        raise UserError(f"{where}:{called} is neither a start nor a monster; {told}")
    return kind


def _object_middle(item: Element, where: str) -> tuple[float, float]:
    """Return the middle of an object in pixels from the map's upper left corner.

    Tiled places an object made of a tile by its lower left corner, any other by its upper left.
    """
    x, y = (_number(item, key, where, _PIXELS) for key in ("x", "y"))
    width, height = (_number(item, key, where, Number(0), "0") for key in ("width", "height"))
    if (width or height) and _number(item, "rotation", where, _PIXELS, "0"):
        raise UserError(f"{where}: turned by an angle; turn it back")
    return x + width / 2, y + (height if item.get("gid") is None else -height) / 2


def _number(element: Element, key: str, where: str, allowed: Number, default: str = "") -> float:
    """Read an attribute as a number."""
    text = element.get(key, default)
    try:
        return float(allowed.read(float(text)) or 0)
    except ValueError:
        raise UserError(f"{where}: {key} = {text!r} is not allowed: {allowed.allowed}") from None


def _refuse_shift(element: Element, where: str) -> None:
    if any(element.get(key, "0") != "0" for key in ("offsetx", "offsety")):
        raise UserError(f"{where}: shifted against the tiles; set its offset to 0")
