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
from typing import Annotated, Any, Literal
from warnings import catch_warnings

import numpy as np
from pydantic import Field

from pneuma.env import rules
from pneuma.env.fields import SHIPPED_LEVELS, EnvConfig, is_own_level
from pneuma.env.level import EMPTY, RANDOM, START_CODE, WATER, Level, MonsterPlace, Rounded
from pneuma.env.random_level import parse_name, random_level
from pneuma.errors import UserError, unknown_name
from pneuma.files import read_text
from pneuma.schema import Table, TomlFile, read_model, read_toml

LEVELS = Path(__file__).parent / "data" / "levels"
MAX_SIDE = 1000
"""Most tiles along a side of a layer."""
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
        numbers = range(first, first + config.random_levels)
        names = [f"{RANDOM}{split}:{number}" for number in numbers]
    return [load_level(name, monster_codes, config.monsters) for name in names]


def load_level(level_name: str, monster_codes: Mapping[int, str], monsters: str = "bamboo") -> Level:
    """Load a level by its name.

    Args:
        level_name: of a shipped or random level, or the path of a folder.
        monster_codes: the name of the monster that each code in a folder's tables stands for.
        monsters: who lives on random levels, as in `EnvConfig`.
    """
    if level_name.startswith(RANDOM):
        return random_level(*parse_name(level_name), monsters)
    folder = _level_path(level_name)
    header = _read_header(folder)
    obstacles = _read_layer(folder / "obstacles.csv")
    ground = np.full_like(obstacles, EMPTY)
    if (folder / "ground.csv").is_file():
        ground = _read_layer(folder / "ground.csv")
    if ground.shape != obstacles.shape:
        raise UserError(f"{folder}: ground of {ground.shape} tiles, and obstacles of {obstacles.shape}")
    terrain = np.where(obstacles != EMPTY, rules.SOLID, rules.OPEN)
    terrain[np.isin(ground, header.coast)] = rules.COAST
    rows, columns = ground.shape
    origin_column, origin_row = header.origin or (columns / 2, rows / 2)
    starts = []
    living = []
    for code, x, y in _read_objects(folder / "objects.csv", monster_codes):
        if code == START_CODE:
            starts.append((x, y))
        else:
            living.append(MonsterPlace(monster_codes[code], x, y))
    if not starts:
        raise UserError(f"{folder / 'objects.csv'}: no start place")
    if level_name.startswith("~"):
        level_name = str(folder)
    return Level(
        name=level_name,
        title=header.title,
        tile=header.tile,
        left=-origin_column * header.tile,
        top=-origin_row * header.tile,
        ground=ground,
        terrain=terrain.astype(np.uint8),
        starts=np.array(starts, np.float64),
        monsters=tuple(living),
    )


def _read_header(folder: Path) -> Header:
    path = folder / "level.toml"
    file = TomlFile(path, "", {})
    if path.is_file():
        file = read_toml(path)
    file.data.setdefault("title", folder.resolve().name or "level")
    return read_model(Header, file)


def level_files(level_name: str) -> list[Path]:
    """Return the user's own files of a level; none for shipped and random levels."""
    if not is_own_level(level_name):
        return []
    return _folder_files(_level_path(level_name))


def _level_path(level_name: str) -> Path:
    if level_name in SHIPPED_LEVELS:
        return LEVELS / level_name
    path = Path(os.path.expanduser(level_name))
    if _folder_files(path):
        return path
    forms = f"{RANDOM}train:N, {RANDOM}test:N, or the path of a folder with obstacles.csv and objects.csv"
    raise UserError(f"{unknown_name('level', level_name, SHIPPED_LEVELS)}, {forms}")


def _folder_files(folder: Path) -> list[Path]:
    paths = [folder / file_name for file_name in FOLDER_FILES]
    return [path for path in paths if path.is_file()]


def _read_layer(table_path: Path) -> np.ndarray:
    table = _read_table(table_path, np.int64)
    if not table.size or max(table.shape) > MAX_SIDE:
        raise UserError(f"{table_path}: a layer has 1 to {MAX_SIDE} tiles a side")
    return _codes(table_path, table)


def _read_objects(table_path: Path, monster_codes: Mapping[int, str]) -> list[tuple[int, float, float]]:
    """Return code, x and y of start places and monsters, in the file's order."""
    columns = [("code", np.int64), ("x", np.float64), ("y", np.float64)]
    table = _read_table(table_path, columns, header="code,x,y")
    if len(table) > MOST_PLACES:
        raise UserError(f"{table_path}: more than {MOST_PLACES} start places and monsters are not allowed")
    codes = _codes(table_path, table["code"][:, None])[:, 0].tolist()
    for column, pixels in ((2, table["x"]), (3, table["y"])):
        finite = np.isfinite(pixels)
        if not finite.all():
            row = int(finite.argmin())
            raise UserError(f"{table_path}: row {row + 2}, column {column}: {pixels[row]} is not allowed")
    allowed = [START_CODE, *monster_codes]
    for code in codes:
        if code not in allowed:
            raise UserError(f"{table_path}: unknown code {code}; known are {', '.join(map(str, allowed))}")
    return list(zip(codes, table["x"].tolist(), table["y"].tolist(), strict=True))


def _codes(table_path: Path, table: np.ndarray) -> np.ndarray:
    """Return codes without their highest four of 32 bits, by which Tiled turns its picture."""
    too_large = (table < -(2**31)) | (table >= 2**32)
    if too_large.any():
        row, column = np.argwhere(too_large)[0]
        code = table[row, column]
        raise UserError(f"{table_path}: row {row + 1}, column {column + 1}: {code} is not allowed")
    return np.where(table == EMPTY, EMPTY, table % 2**28)


def _read_table(table_path: Path, dtype: Any, header: str = "") -> np.ndarray:
    """Return a CSV file of numbers: a table, or below a header a record for each row."""
    lines = read_text(table_path).splitlines()
    header_lines = 0
    dimensions: Literal[1, 2] = 2
    if header:
        header_lines = 1
        dimensions = 1
        if lines[:1] != [header]:
            raise UserError(f"{table_path}: the first line must be {header}")
    rows = lines[header_lines:]
    try:
        with catch_warnings(action="ignore", category=UserWarning):  # that there are no rows
            return np.loadtxt(rows, dtype, delimiter=",", comments=None, ndmin=dimensions)
    except ValueError as error:
        raise UserError(f"{table_path}: {_with_file_row(str(error), header_lines)}") from None


def _with_file_row(message: str, header_lines: int) -> str:
    """Return NumPy's message, short, with rows of the file counted from 1."""
    match = re.fullmatch(r"(.*) at row (\d+)(?:(, column \d+)\.|; use .*)", message, re.DOTALL)
    if match is None:
        return message[:90]
    problem, row, column = match.groups(default="")
    file_row = int(row) + header_lines
    if column:  # NumPy counts rows from 0 where a cell is wrong, and from 1 elsewhere
        file_row += 1
    return f"row {file_row}{column}: {problem[:90]}"
