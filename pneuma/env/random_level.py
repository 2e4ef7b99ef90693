"""Random levels: islands generated from a number, for training on many and testing on others.

`random:train:17` is the island that number 17 draws on the training side. The two sides never share
an island's random stream: its key is 2 x number for training and 2 x number + 1 for testing.

An island looks like the thesis's: snow in the north, grass in the middle, desert in the south, in places cut
off by a strait with bridges, with the same ground codes, grid size and counts. Drawing uses only uniform
numbers, + - x / and comparisons, so that every processor draws the same island.
"""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np

from pneuma.env import rules
from pneuma.env.fields import RANDOM
from pneuma.env.level import BRIDGE, GRASS, SAND, SNOW, WATER, Level, MonsterPlace
from pneuma.env.tiles import number_regions, sum_around
from pneuma.errors import UserError

SPLITS = ("train", "test")
ROWS, COLUMNS = 50, 57
TILE = 64
ORIGIN = (28, 25)
STARTS = 6
POPULATIONS = {
    "bamboo": ("bamboo",) * 14,
    "mixed": ("bamboo",) * 8 + ("squid", "raccoon", "spirit") * 2,
}
"""The monsters of an island, by the field `monsters`."""
MONSTERS = 14

MARGIN = 3
"""Water on every side, in tiles."""
MIN_LAND, MAX_LAND = 1000, 1600
"""Tiles of land."""
MIN_TILES_BY_GROUND = 100
"""Least tiles of snow, grass and sand."""
START_GAP, MONSTER_GAP = 6, 4
"""Least distances in tiles: from a start place to anything (more than a monster notices), and between
monsters."""

Draw = Callable[[int], np.ndarray]
"""A function that takes `count` uniform numbers in [0, 1) from an island's random stream."""


def parse_name(level_name: str) -> tuple[str, int]:
    """Return split and number of a random level's name, such as random:train:17."""
    name_match = re.fullmatch(r"random:(train|test):(0|[1-9][0-9]{0,18})", level_name)
    if name_match is None:
        raise UserError(f"level {level_name!r} is not allowed: the form is random:train:17 or random:test:17")
    return name_match[1], int(name_match[2])


def random_level(split: str, number: int, monsters: str = "bamboo") -> Level:
    """Generate the island of a number; equal arguments give equal levels, in any order.

    Every monster can be walked to from every start place by a body as wide as a tile.

    Args:
        split: "train" or "test".
        number: of the island.
        monsters: who lives on it, as in `EnvConfig`, at places that do not depend on that.
    """
    generator = np.random.Generator(np.random.Philox(key=2 * number + SPLITS.index(split)))
    level = None
    while level is None:
        level = _attempt(generator.random, split, number, POPULATIONS[monsters])
    return level


def _attempt(draw_uniform: Draw, split: str, number: int, population: tuple[str, ...]) -> Level | None:
    """Generate an island with everything on it; None if it is not valid."""
    ground = _draw_ground(draw_uniform)
    terrain = _draw_terrain(draw_uniform, ground)
    tiles = _choose_tiles(draw_uniform, terrain, STARTS + MONSTERS)
    tiles_by_ground = np.bincount(ground.ravel(), minlength=BRIDGE + 1)
    if tiles is None or not MIN_LAND <= tiles_by_ground[SNOW:].sum() <= MAX_LAND:
        return None
    if tiles_by_ground[SNOW : SAND + 1].min() < MIN_TILES_BY_GROUND:
        return None
    x = (tiles[:, 1] - ORIGIN[0] + 0.5) * TILE
    y = (tiles[:, 0] - ORIGIN[1] + 0.5) * TILE
    monsters = zip(population, x[STARTS:].tolist(), y[STARTS:].tolist(), strict=True)
    return Level(
        name=f"{RANDOM}{split}:{number}",
        title=f"Random island {number} ({split})",
        tile=float(TILE),
        left=-float(ORIGIN[0] * TILE),
        top=-float(ORIGIN[1] * TILE),
        ground=ground,
        terrain=terrain,
        starts=np.stack([x, y], axis=1)[:STARTS],
        monsters=tuple(MonsterPlace(monster_name, x, y) for monster_name, x, y in monsters),
    )


# --- The ground ----------------------------------------------------------------------------------


def _draw_ground(draw_uniform: Draw) -> np.ndarray:
    """Return (rows, columns) ground codes of one island in the water."""
    land = _draw_land(draw_uniform)
    rows = np.arange(ROWS)[:, None]
    snow_ends = _draw_border(draw_uniform, 17, 3) + _draw_noise(draw_uniform, 3) * 3
    sand_begins = _draw_border(draw_uniform, 33, 2)
    ground = np.where(rows < snow_ends, SNOW, np.where(rows < sand_begins, GRASS, SAND))
    ground[~land] = WATER
    if draw_uniform(1)[0] < 0.6:
        _dig_strait(draw_uniform, ground, sand_begins)
    regions = number_regions(ground != WATER)
    ground[regions != _largest(regions)] = WATER
    return ground


def _draw_land(draw_uniform: Draw) -> np.ndarray:
    """Return (rows, columns) bool: a rough oval with bays and capes, without tiny islands and lakes."""
    width = 19 + 5 * draw_uniform(1)[0]
    height = 16 + 4 * draw_uniform(1)[0]
    corners = 0.7 * draw_uniform(1)[0]
    across = ((np.arange(COLUMNS) - (COLUMNS - 1) / 2) / width)[None, :]
    down = ((np.arange(ROWS) - (ROWS - 1) / 2) / height)[:, None]
    squared_x, squared_y = across * across, down * down
    oval = squared_x + squared_y  # how far out, 1 on the shore
    box = squared_x * squared_x + squared_y * squared_y
    roughness = 1.1 * (_draw_noise(draw_uniform, 9) - 0.5) + 0.5 * (_draw_noise(draw_uniform, 4) - 0.5)
    land = oval * (1 - corners) + box * corners + roughness < 1
    is_inside = np.zeros_like(land)
    is_inside[MARGIN:-MARGIN, MARGIN:-MARGIN] = True
    for _ in range(3):
        land = (_count_around(land) >= 5) & is_inside  # as most tiles around
    without_lakes = ~_without_specks(~land, 6)
    return _without_specks(without_lakes, 12)


def _draw_border(draw_uniform: Draw, row: int, swing: float) -> np.ndarray:
    """Return, for each column, the row at which one ground changes to the next."""
    along = _draw_noise(draw_uniform, 8)[0]  # (columns,)
    tilt = (draw_uniform(1)[0] - 0.5) * 8 * (np.arange(COLUMNS) / COLUMNS - 0.5)
    return row + (draw_uniform(1)[0] - 0.5) * 4 + tilt + (along - 0.5) * 4 * swing


def _dig_strait(draw_uniform: Draw, ground: np.ndarray, sand_begins: np.ndarray) -> None:
    """Separate the sand by a strait, with two or three bridges where both shores have room."""
    width = 2 + int(draw_uniform(1)[0] * 2)
    shore = np.ceil(sand_begins).astype(np.int64)
    bridge_columns = _bridge_columns(ground, shore, width)
    rows = np.arange(ROWS)[:, None]
    ground[(rows >= shore) & (rows < shore + width)] = WATER
    bridges = 2 + int(draw_uniform(1)[0] * 2)
    for section in np.array_split(bridge_columns, bridges):
        if len(section):
            column = int(section[int(draw_uniform(1)[0] * len(section))])
            ground[shore[column] : shore[column] + width, column - 1 : column + 2] = BRIDGE


def _bridge_columns(ground: np.ndarray, shore: np.ndarray, width: int) -> np.ndarray:
    """Return the columns where a bridge three tiles wide has two tiles of land on each shore."""
    straight = (shore[:-2] == shore[1:-1]) & (shore[1:-1] == shore[2:])
    columns = []
    for column in (np.flatnonzero(straight) + 1).tolist():
        surroundings = ground[shore[column] - 2 : shore[column] + width + 2, column - 1 : column + 2]
        if (surroundings != WATER).all():
            columns.append(column)
    return np.array(columns, np.int64)


# --- Obstacles and places ------------------------------------------------------------------------


def _draw_terrain(draw_uniform: Draw, ground: np.ndarray) -> np.ndarray:
    """Return (rows, columns) uint8: the coast, and obstacles inland, with varying density."""
    inland = _count_around((ground != WATER) & (ground != BRIDGE)) == 9
    chance = 0.01 + 0.12 * np.maximum(_draw_noise(draw_uniform, 5) - 0.4, 0)
    stones = inland & (draw_uniform(ROWS * COLUMNS).reshape(ROWS, COLUMNS) < chance)
    terrain = np.where(stones, rules.SOLID, rules.OPEN)
    terrain[ground == WATER] = rules.COAST
    return terrain.astype(np.uint8)


def _choose_tiles(draw_uniform: Draw, terrain: np.ndarray, count: int) -> np.ndarray | None:
    """Return (count, 2) rows and columns, start places first, far apart and with open tiles around."""
    is_open = terrain == rules.OPEN
    regions = number_regions(is_open)
    has_room = (regions == _largest(regions)) & (_count_around(is_open) == 9)
    tiles = np.argwhere(has_room)
    tiles = tiles[np.argsort(draw_uniform(len(tiles)), kind="stable")]
    selected: list[np.ndarray] = []
    while len(selected) < count and len(tiles):
        chosen_tile = tiles[0]
        selected.append(chosen_tile)
        min_distance = MONSTER_GAP
        if len(selected) <= STARTS:
            min_distance = START_GAP
        tiles = tiles[((tiles - chosen_tile) ** 2).sum(axis=1) >= min_distance * min_distance]
    if len(selected) < count:
        return None
    return np.array(selected)


# --- Shapes --------------------------------------------------------------------------------------


def _draw_noise(draw_uniform: Draw, cell: int) -> np.ndarray:
    """Return (rows, columns) smooth random numbers in [0, 1) that change over `cell` tiles."""
    cell_rows, cell_columns = ROWS // cell + 2, COLUMNS // cell + 2
    corners = draw_uniform(cell_rows * cell_columns).reshape(cell_rows, cell_columns)
    row, below = _cells(ROWS, cell)
    column, beyond = _cells(COLUMNS, cell)
    upper = corners[row][:, column] * (1 - beyond) + corners[row][:, column + 1] * beyond
    lower = corners[row + 1][:, column] * (1 - beyond) + corners[row + 1][:, column + 1] * beyond
    return upper * (1 - below[:, None]) + lower * below[:, None]


def _cells(count: int, cell: int) -> tuple[np.ndarray, np.ndarray]:
    """Return, for each of `count` tiles, its cell and how far into it, eased at both ends."""
    indices = np.arange(count) // cell
    fraction = np.arange(count) / cell - indices
    return indices, fraction * fraction * (3 - 2 * fraction)


def _count_around(tiles: np.ndarray) -> np.ndarray:
    """Return how many of each tile and its eight neighbours are set, for (rows, columns) bool."""
    return sum_around(tiles, 1, "constant")


def _without_specks(tiles: np.ndarray, smallest: int) -> np.ndarray:
    """Leave out the regions of set tiles that have fewer than `smallest`."""
    regions = number_regions(tiles)
    region_sizes = np.bincount(regions.ravel())
    return (regions > 0) & (region_sizes[regions] >= smallest)


def _largest(regions: np.ndarray) -> int:
    """Return the number of the region with the most tiles; 1 if there is none."""
    if not regions.any():
        return 1
    return int(np.bincount(regions.ravel())[1:].argmax()) + 1
