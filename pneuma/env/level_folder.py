"""Level files: a folder of CSV tables, as the editor Tiled exports layers.

obstacles.csv   a code for every tile: -1, or anything else where something stands in the way
ground.csv      optional: what every tile is made of, for the eye and for the coast; code 0 is water
objects.csv     a table code,x,y of start places (400) and monsters (390 …), in pixels from the origin
level.toml      optional: what `Header` lists
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, NamedTuple

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


class Layers(NamedTuple):
    """What was read of a level, checked but for where bodies may begin."""

    header: Header
    ground: np.ndarray  # (rows, columns) codes, -1 where there is none
    blocked: np.ndarray  # (rows, columns) bool, where an obstacle stands
    entities: list[tuple[str, float, float]]  # kind, x and y of whoever begins, in order


def read_folder(folder: Path, monster_codes: Mapping[int, str]) -> Layers:
    """Read a level from a folder of CSV tables; `UserError` tells the file and what is wrong."""
    header = folder / "level.toml"
    file = read_toml(header) if header.is_file() else TomlFile(header, "", {})
    file.data.setdefault("title", folder.resolve().name or "level")
    obstacles = _codes(folder / "obstacles.csv")
    path = folder / "ground.csv"
    ground = _codes(path) if path.is_file() else np.full_like(obstacles, EMPTY)
    if ground.shape != obstacles.shape:
        raise UserError(f"{folder}: ground of {ground.shape} tiles, and obstacles of {obstacles.shape}")
    entities = _objects(folder / "objects.csv", {START_CODE: START, **monster_codes})
    return Layers(read_model(Header, file), ground, obstacles != EMPTY, entities)


def folder_files(folder: Path) -> list[Path]:
    """Return the files of a folder that make its level, sorted; none when it holds no level."""
    return [folder / name for name in FOLDER_FILES if (folder / name).is_file()]


def _codes(path: Path) -> np.ndarray:
    """Return the codes of a layer, (rows, columns) int64."""
    codes = _read_numbers(path, np.int64)
    if not 1 <= max(codes.shape) <= MAX_SIDE or not codes.size:
        raise UserError(f"{path}: a layer has 1 to {MAX_SIDE} tiles a side")
    return codes


def _objects(path: Path, kinds: Mapping[int, str]) -> list[tuple[str, float, float]]:
    """Read the table code,x,y of start places and monsters, in the file's order."""
    rows = _read_numbers(path, np.float64, "code,x,y")
    if len(rows) > MOST_PLACES:
        raise UserError(f"{path}: more than {MOST_PLACES} start places and monsters are not allowed")
    for code in rows[:, 0].tolist():
        if code not in kinds:
            raise UserError(f"{path}: unknown code {code:g}; known are {', '.join(map(str, kinds))}")
    if START_CODE not in rows[:, 0]:
        raise UserError(f"{path}: no start place")
    return [(kinds[int(code)], x, y) for code, x, y in rows.tolist()]


def _read_numbers(path: Path, kind: Any, head: str = "") -> np.ndarray:
    """Return the numbers of a CSV table, (rows, columns), whose first line is `head` if there is one."""
    lines = read_text(path, LARGEST_LAYER).splitlines()
    try:
        if head and lines[:1] != [head]:
            raise ValueError(f"the first line must be {head}")
        rows = [line for line in lines[bool(head) :] if line.strip()]
        columns = head.count(",") + 1
        table = np.loadtxt(rows, kind, delimiter=",", ndmin=2) if rows else np.zeros((0, columns), kind)
        if head and table.shape[1] != columns:
            raise ValueError(f"a row has {table.shape[1]} columns, where {head} are asked for")
    except ValueError as error:
        raise UserError(f"{path}: {error}") from None
    return table
