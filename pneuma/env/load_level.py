"""Levels by name: shipped ones and a user's own, from folders of tables, and random ones.

A level's name is one of

    thesis              a level that comes with the package, as a folder of CSV tables
    path/to/folder      a user's own folder of such tables, as the editor Tiled exports layers
    random:train:17     an island drawn from a number; see `random_level.py`

A folder holds

    obstacles.csv   a code for every tile: -1, or anything else where something stands in the way
    ground.csv      optional: what every tile is made of, for the eye and for the coast; code 0 is water
    objects.csv     a table code,x,y of start places (400) and monsters (390 …), in pixels from the origin
    level.toml      optional: what `Header` lists
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any
from warnings import catch_warnings

import numpy as np
from pydantic import Field

from pneuma.env import rules
from pneuma.env.fields import SHIPPED_LEVELS, EnvConfig, is_own_level
from pneuma.env.level import EMPTY, RANDOM, START_CODE, WATER, Level, Rounded
from pneuma.env.random_level import parse_name, random_level
from pneuma.errors import UserError, unknown_name
from pneuma.files import read_text
from pneuma.schema import Table, TomlFile, read_model, read_toml

LEVELS = Path(__file__).parent / "data" / "levels"
MAX_SIDE = 1000
"""Most bytes of a layer."""
MOST_PLACES = 1000
"""Most start places and monsters together in a level."""
FOLDER_FILES = ("ground.csv", "level.toml", "objects.csv", "obstacles.csv")

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


def load_levels(config: EnvConfig, monster_codes: Mapping[int, str]) -> list[Level]:
    """Load a world's level, or `random_levels` consecutive random ones."""
    names = [config.level]
    if config.random_levels > 1:
        split, first = parse_name(config.level)
        names = [f"{RANDOM}{split}:{first + i}" for i in range(config.random_levels)]
    return [load_level(name, monster_codes, config.monsters) for name in names]


def load_level(name: str, monster_codes: Mapping[int, str], monsters: str = "bamboo") -> Level:
    """Load a level by its name.

    `monster_codes` has the kind of monster of each code; `monsters` live on random levels.
    """
    if name.startswith(RANDOM):
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
    return [folder / name for name in FOLDER_FILES if (folder / name).is_file()]


def _read_layer(path: Path) -> np.ndarray:
    table = _read_table(path, np.int64)
    if not table.size or max(table.shape) > MAX_SIDE:
        raise UserError(f"{path}: a layer has 1 to {MAX_SIDE} tiles a side")
    return _codes(path, table)


def _read_objects(path: Path, monster_codes: Mapping[int, str]) -> list[tuple[int, float, float]]:
    """Return code, x and y of start places and monsters, in the file's order."""
    table = _read_table(path, [("code", np.int64), ("x", np.float64), ("y", np.float64)], "code,x,y")
    if len(table) > MOST_PLACES:
        raise UserError(f"{path}: more than {MOST_PLACES} start places and monsters are not allowed")
    codes = _codes(path, table["code"][:, None])[:, 0]
    for column, pixels in enumerate((table["x"], table["y"]), 2):
        if not np.isfinite(pixels).all():
            row = int(np.isfinite(pixels).argmin())
            raise UserError(f"{path}: row {row + 2}, column {column}: {pixels[row]} is not allowed")
    known = [START_CODE, *monster_codes]
    if unknown := [code for code in codes.tolist() if code not in known]:
        raise UserError(f"{path}: unknown code {unknown[0]}; known are {', '.join(map(str, known))}")
    if START_CODE not in codes:
        raise UserError(f"{path}: no start place")
    return [*zip(codes.tolist(), table["x"].tolist(), table["y"].tolist(), strict=True)]


def _codes(path: Path, table: np.ndarray) -> np.ndarray:
    """Return codes without their highest four of 32 bits, by which Tiled turns its picture."""
    for row, column in np.argwhere((table < -(2**31)) | (table >= 2**32)).tolist():
        wrong = table[row, column]
        raise UserError(f"{path}: row {row + 1}, column {column + 1}: {wrong} is not allowed")
    return np.where(table == EMPTY, EMPTY, table % 2**28)


def _read_table(path: Path, kinds: Any, head: str = "") -> np.ndarray:
    """Return a CSV table of numbers, of these kinds a column, below the line `head` if given."""
    lines = read_text(path).splitlines()
    if head and lines[:1] != [head]:
        raise UserError(f"{path}: the first line must be {head}")
    below = int(bool(head))
    try:
        with catch_warnings(action="ignore", category=UserWarning):  # that there are no rows
            return np.loadtxt(lines[below:], kinds, delimiter=",", comments=None, ndmin=1 if head else 2)
    except ValueError as error:
        raise UserError(f"{path}: {_mended(str(error), below)}") from None


def _mended(message: str, below: int) -> str:
    """Return NumPy's message, short, with rows counted from 1; where a cell is wrong it counts from 0."""
    told = re.fullmatch(r"(.*) at row (\d+)(?:(, column \d+)\.|; use .*)", message, re.DOTALL)
    if told is None:
        return message[:90]
    what, row, column = told.groups(default="")
    return f"row {int(row) + below + bool(column)}{column}: {what[:90]}"
