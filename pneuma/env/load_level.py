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

import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from pneuma.env import rules
from pneuma.env.fields import RANDOM, SHIPPED_LEVELS, EnvConfig, is_own_level
from pneuma.env.level import EMPTY, START_CODE, WATER, Level, MonsterPlace, Rounded
from pneuma.env.random_level import parse_name, random_level
from pneuma.errors import UserError, unknown_name
from pneuma.files import read_text
from pneuma.schema import Table, TomlFile, read_model, read_toml

LEVELS = Path(__file__).parent / "data" / "levels"
MOST_TILES = 250_000
"""Most tiles of a level, whose picture then takes two gigabytes of memory; the thesis's has 2,850."""
LARGEST_TABLE = 2**24
"""Most bytes of a file of a level."""
LONGEST_SHOWN = 40
"""Most characters of a wrong cell in a message."""
FOLDER_FILES = ("ground.csv", "level.toml", "objects.csv", "obstacles.csv")

_Tiles = Annotated[float, Field(ge=-1e6, le=1e6), Rounded]
_GroundCode = Annotated[int, Field(ge=EMPTY, lt=2**28)]


class Header(Table):
    """The contents of `level.toml`."""

    title: str = ""
    tile: Annotated[float, Field(ge=8, le=4096), Rounded] = 64.0
    """Side of a tile in pixels; players move 5 a tick and look one tile ahead."""
    origin: Annotated[tuple[_Tiles, ...], Field(min_length=2, max_length=2)] | None = None
    """Column and row of the tile whose upper left corner is (0, 0); None: the centre."""
    coast: Annotated[tuple[_GroundCode, ...], Field(max_length=1000)] = (WATER,)
    """Ground codes where the land ends."""


def load_levels(config: EnvConfig, monster_codes: Mapping[int, str]) -> list[Level]:
    """Load a world's level, or `random_levels` consecutive random ones.

    Args:
        config: of the world.
        monster_codes: the name of the monster that each code in a folder's tables stands for.
    """
    if not config.level.startswith(RANDOM):
        return [load_level(config.level, monster_codes)]
    split, first_number = parse_name(config.level)
    numbers = range(first_number, first_number + config.random_levels)
    return [random_level(split, number, config.monsters) for number in numbers]


def load_level(level_name: str, monster_codes: Mapping[int, str]) -> Level:
    """Load a shipped level by its name, or a user's own by the path of its folder."""
    folder = _level_path(level_name)
    header_file = TomlFile(folder / "level.toml", "", {})
    if header_file.path.is_file():
        header_file = read_toml(header_file.path)
    header = read_model(Header, header_file)
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
    monster_places = []
    objects_path = folder / "objects.csv"
    for object_code, x, y in _read_objects(objects_path):
        if object_code == START_CODE:
            starts.append((x, y))
        elif object_code in monster_codes:
            monster_places.append(MonsterPlace(monster_codes[object_code], x, y))
        else:
            known_codes = ", ".join(map(str, (START_CODE, *monster_codes)))
            raise UserError(f"{objects_path}: unknown code {object_code}; known are {known_codes}")
    if not starts:
        raise UserError(f"{objects_path}: has no start place")
    return Level(
        name=level_name,
        title=header.title or level_name,
        tile=header.tile,
        left=-origin_column * header.tile,
        top=-origin_row * header.tile,
        ground=ground,
        terrain=terrain.astype(np.uint8),
        starts=np.array(starts, np.float64),
        monsters=tuple(monster_places),
    )


def level_files(level_name: str) -> list[Path]:
    """Return the user's own files of a level; none for shipped and random levels."""
    if not is_own_level(level_name):
        return []
    return _folder_files(_level_path(level_name))


def _level_path(level_name: str) -> Path:
    if level_name in SHIPPED_LEVELS:
        return LEVELS / level_name
    level_folder = Path(os.path.expanduser(level_name))
    if _folder_files(level_folder):
        return level_folder
    forms = f"{RANDOM}train:N, {RANDOM}test:N, or the path of a folder with obstacles.csv and objects.csv"
    raise UserError(f"{unknown_name('level', level_name, SHIPPED_LEVELS)}, {forms}")


def _folder_files(folder: Path) -> list[Path]:
    file_paths = [folder / file_name for file_name in FOLDER_FILES]
    return [file_path for file_path in file_paths if os.path.isfile(file_path)]


def _read_layer(table_path: Path) -> np.ndarray:
    """Return the code of each tile, (rows, columns)."""
    codes = _read_table(table_path, read_text(table_path, LARGEST_TABLE).splitlines(), first_row=1)
    if codes.size > MOST_TILES:
        raise UserError(f"{table_path}: has {codes.size:,} tiles; {MOST_TILES:,} are the most")
    return _without_turns(table_path, codes, first_row=1)


def _read_objects(table_path: Path) -> list[tuple[int, float, float]]:
    """Return code, x and y of each start place and monster."""
    header, *text_lines = read_text(table_path, LARGEST_TABLE).splitlines() or [""]
    if header != "code,x,y":
        raise UserError(f"{table_path}: the first line must be code,x,y")
    objects = _read_table(table_path, text_lines, first_row=2)
    if objects.shape[1] != 3:
        raise UserError(f"{table_path}: row 2 has {objects.shape[1]} numbers, not 3")
    objects[:, :1] = _without_turns(table_path, objects[:, :1], first_row=2)
    return [(int(object_code), x, y) for object_code, x, y in objects.tolist()]


def _without_turns(table_path: Path, codes: np.ndarray, first_row: int) -> np.ndarray:
    """Return codes, int64, without the highest four of their 32 bits, by which Tiled turns pictures."""
    is_wrong = (codes % 1 != 0) | (codes < -(2**31)) | (codes >= 2**32)
    for row, column in np.argwhere(is_wrong)[:1].tolist():
        problem = f"code {codes[row, column]:.12g} is not a whole number of 32 bits"
        raise UserError(f"{table_path}: row {first_row + row}, column {column + 1}: {problem}")
    return np.where(codes == EMPTY, EMPTY, codes % 2**28).astype(np.int64)


def _read_table(table_path: Path, text_lines: Sequence[str], first_row: int) -> np.ndarray:
    """Return the numbers in lines of a CSV file, (rows, columns); its rows are counted from `first_row`."""
    rows: list[list[float]] = []
    for row_number, text_line in enumerate(text_lines, start=first_row):
        if not text_line.strip():
            continue
        rows.append([])
        for column_number, cell in enumerate(text_line.split(","), start=1):
            number = _read_number(cell)
            if not math.isfinite(number):
                cell_name = f"row {row_number}, column {column_number}"
                raise UserError(f"{table_path}: {cell_name}: {cell[:LONGEST_SHOWN]!r} is not a number")
            rows[-1].append(number)
        if len(rows[-1]) != len(rows[0]):
            problem = f"has {len(rows[-1])} numbers, row {first_row} has {len(rows[0])}"
            raise UserError(f"{table_path}: row {row_number} {problem}")
    if not rows:
        raise UserError(f"{table_path}: contains no numbers")
    return np.array(rows)


def _read_number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan
