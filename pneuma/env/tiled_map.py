"""Whole maps of the editor Tiled: a finite orthogonal .tmx with its layers stored as CSV.

    map.tmx → the layers of tiles and of objects in it → `tiled.Layers`

Beside what stands in a layer of entities, start places and monsters may be objects, classed or named `start`,
`bamboo` ... or made of a tile with such a code. `title`, `coast` and `obstacles` (codes, with commas between)
are properties of the map, and the origin is its centre.
"""

from __future__ import annotations

import math
import re
from bisect import bisect_right
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from pneuma.env.tiled import (
    CODE_BITS,
    EMPTY,
    MAX_CODE,
    MAX_SIDE,
    Entity,
    Grid,
    Header,
    Layers,
    join_layers,
    kinds_by_code,
    layer_name,
    listed,
    place_of,
    read_grid,
    read_text,
    refuse_many,
    refuse_other_size,
)
from pneuma.errors import UserError
from pneuma.schema import TomlFile, read_model

_STRAY = -2
"""In place of a tile's code: of no tileset."""


def read_tmx(path: Path, monster_codes: Mapping[int, str]) -> Layers:
    """Read a level from a finite orthogonal .tmx map whose layers are stored as CSV.

    Raises:
        UserError: naming file, layer, row and column, or object, of what is wrong.
    """
    root = _parse_map(path)
    header = _map_header(root, path)
    shape = tuple(int(_number(root, key, str(path), 1, MAX_SIDE)) for key in ("height", "width"))
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
    tile, height = (_number(root, key, str(path)) for key in ("tilewidth", "tileheight"))
    if tile != height:
        raise UserError(f"{path}: tiles of {tile:g} x {height:g} px; they must be square")
    found = root.findall("properties/property")
    properties: dict[str, Any] = {each.get("name", ""): each.get("value", each.text or "") for each in found}
    data = {"title": properties.get("title") or path.stem, "tile": tile}
    for key in ("coast", "obstacles"):
        try:
            if key in properties:
                data[key] = [int(code) for code in properties[key].split(",") if code.strip()]
        except ValueError:
            told = f"{key} = {properties[key]!r} is not allowed: codes with commas between"
            raise UserError(f"{path}: {told}") from None
    return read_model(Header, TomlFile(path, "", data))


def _take_tilesets(root: Element, path: Path) -> list[int]:
    """Return the tilesets' first global tile ids, rising, and take them out: they hold objects too."""
    tilesets = root.findall("tileset")
    for tileset in tilesets:
        root.remove(tileset)
    return sorted(int(_number(tileset, "firstgid", f"{path}, tileset", 1, MAX_CODE)) for tileset in tilesets)


def _map_grid(layer: Element, shape: tuple[int, ...], first_ids: list[int], where: str) -> Grid:
    """Read a layer of a map, and its global tile ids as each tileset's own codes."""
    _refuse_shift(layer, where)
    data = layer.find("data")
    if data is None or data.get("encoding") != "csv":
        raise UserError(f"{where}: not stored as CSV; set Tile Layer Format to CSV in Tiled's map properties")
    lines = (data.text or "").strip().splitlines()
    grid = read_grid([line.strip().removesuffix(",").split(",") for line in lines], where)
    refuse_other_size(grid, shape, "the map")
    tiles, which = np.unique(grid.codes, return_inverse=True)
    codes = np.array([_local_code(int(tile), first_ids) for tile in tiles])[which].reshape(shape)
    for row, column in np.argwhere(codes == _STRAY).tolist():
        stray = f"tile {grid.codes[row, column]} belongs to no tileset"
        raise UserError(f"{place_of(where, row, column)}: {stray}")
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
            refuse_many(str(path), len(entities))
    return entities


def _object_kind(item: Element, where: str, first_ids: list[int], kinds: Mapping[int, str]) -> str:
    """Return what an object is by its class (`type` to most versions of Tiled), name or tile."""
    by_name = {kind.lower(): kind for kind in kinds.values()}
    words = [item.get(key, "").strip() for key in ("type", "class", "name")]
    tile = int(_number(item, "gid", where, 0, 2**32, "0")) & CODE_BITS
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
    x, y = (_number(item, key, where) for key in ("x", "y"))
    width, height = (_number(item, key, where, 0, default="0") for key in ("width", "height"))
    if (width or height) and _number(item, "rotation", where, default="0"):
        raise UserError(f"{where}: turned by an angle; turn it back")
    return x + width / 2, y + (height if item.get("gid") is None else -height) / 2


def _number(
    element: Element, key: str, where: str, low: float = -1e9, high: float = 1e9, default: str = ""
) -> float:
    """Read an attribute as a number within bounds."""
    text = element.get(key, default)
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not low <= number <= high:
        raise UserError(f"{where}: {key} = {text!r} is not allowed: a number from {low:g} to {high:g}")
    return number


def _refuse_shift(element: Element, where: str) -> None:
    if any(element.get(key, "0") != "0" for key in ("offsetx", "offsety")):
        raise UserError(f"{where}: shifted against the tiles; set its offset to 0")
