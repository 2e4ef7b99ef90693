"""Where bodies may stand when an episode begins: inside the grid, and players clear of what stops them."""

from __future__ import annotations

import math

import numpy as np

from pneuma.env import rules
from pneuma.env.level import Level
from pneuma.errors import UserError


def refuse_bad_places(level: Level, players: np.ndarray, monsters: np.ndarray, coast_stops: bool) -> None:
    """Refuse a level in which a body would begin beyond the grid, or a player's on a tile that stops it.

    The rules look up tiles unchecked, and a player who begins inside a wall may never get out. Players
    take turns at the start places, so each must hold the widest and the tallest.

    Args:
        level: the level.
        players: (P,) `state.PLAYER_STATS`.
        monsters: (M,) `state.MONSTER_STATS`, in the level's order.
        coast_stops: whether the coast is a wall.

    Raises:
        UserError: naming the start place or the monster.
    """
    halves = float(players["half_width"].max()), float(players["half_height"].max())
    for i, (x, y) in enumerate(level.starts):
        who = f"start place {i}"
        _refuse_off_the_grid(level, who, x, y, *halves)
        _refuse_overlap(level, who, x, y, *halves, coast_stops)
    for i, ((name, x, y), kind) in enumerate(zip(level.monsters, monsters, strict=True)):
        _refuse_off_the_grid(level, f"monster {i} ({name})", x, y, kind["half_width"], kind["half_height"])


def _refuse_off_the_grid(
    level: Level, who: str, x: float, y: float, half_width: float, half_height: float
) -> None:
    left, top, right, bottom = level.grid
    inside = left <= x - half_width and x + half_width <= right
    if not inside or y - half_height < top or y + half_height > bottom:
        body = _body(level, who, x, y, half_width, half_height)
        raise UserError(f"{body}, which reaches beyond the grid")


def _refuse_overlap(
    level: Level, who: str, x: float, y: float, half_width: float, half_height: float, coast_stops: bool
) -> None:
    """Refuse a body that overlaps a tile that stops it; touching one is no overlap."""
    rows = _tiles(y - level.top, half_height, level.tile)
    columns = _tiles(x - level.left, half_width, level.tile)
    tiles = level.terrain[rows, columns]
    stops = (tiles == rules.SOLID) | ((tiles == rules.COAST) & coast_stops)
    for row, column in np.argwhere(stops).tolist():
        place = f"row {rows.start + row + 1}, column {columns.start + column + 1}"
        body = _body(level, who, x, y, half_width, half_height)
        raise UserError(f"{body}, which overlaps the tile in {place}: it would be stuck there")


def _tiles(middle: float, half: float, tile: float) -> slice:
    """Return the rows or columns that a body lies on."""
    return slice(math.floor((middle - half) / tile), math.ceil((middle + half) / tile))


def _body(level: Level, who: str, x: float, y: float, half_width: float, half_height: float) -> str:
    size = f"{2 * half_width:g} x {2 * half_height:g} px"
    return f"level {level.name}: {who} at ({x:g}, {y:g}) has a body of {size}"
