"""Where bodies may begin an episode: inside the grid, clear of what stops them and of each other."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from pneuma.config import EnvConfig
from pneuma.env import rules
from pneuma.env.level import Level
from pneuma.errors import UserError


def refuse_bad_places(level: Level, players: np.ndarray, monsters: np.ndarray, config: EnvConfig) -> None:
    """Refuse a level in which a body would begin beyond the grid, in what stops it, or in another body.

    The rules look up tiles unchecked, and who begins inside a wall may never get out. Players take turns
    at the start places, so each must hold everybody.

    Args:
        level: the level.
        players: (P,) `state.PLAYER_STATS`.
        monsters: (M,) `state.MONSTER_STATS`, in the level's order.
        config: says what stops whom.

    Raises:
        UserError: naming the start place or the monster.
    """
    shapes = np.unique(players[["half_width", "half_height", "body_x", "body_y"]])
    starts = [
        _Body(f"start place {i}", x, y, shape) for i, (x, y) in enumerate(level.starts) for shape in shapes
    ]
    others = [
        _Body(f"monster {i} ({name})", x, y, kind)
        for i, ((name, x, y), kind) in enumerate(zip(level.monsters, monsters, strict=True))
    ]
    trees = (rules.SOLID,) if config.trees == "wall" else ()
    coast = (rules.COAST,) if config.coast == "wall" else ()
    for body in starts + others:
        _refuse_off_the_grid(level, body)
    for body in starts:
        _refuse_terrain(level, body, trees + coast)
    for body in others if config.terrain_stops == "all" else ():
        _refuse_terrain(level, body, (*trees, rules.COAST))
    if config.bodies == "block":
        _refuse_overlaps(level, starts if config.players > 1 else [], [])
        _refuse_overlaps(level, others, starts)


class _Body:
    """A body box at the place where it begins."""

    def __init__(self, who: str, x: float, y: float, stats: Any) -> None:
        self.told = f"{who} at ({x:g}, {y:g})"
        self.half_width, self.half_height = float(stats["half_width"]), float(stats["half_height"])
        self.x, self.y = x + float(stats["body_x"]), y + float(stats["body_y"])


def _refuse_off_the_grid(level: Level, body: _Body) -> None:
    left, top, right, bottom = level.grid
    inside = left <= body.x - body.half_width and body.x + body.half_width <= right
    if not inside or body.y - body.half_height < top or body.y + body.half_height > bottom:
        raise UserError(f"{_told(level, body)}, which reaches beyond the grid")


def _refuse_terrain(level: Level, body: _Body, stops: Sequence[int]) -> None:
    """Refuse a body that overlaps a tile that stops it; touching one is no overlap."""
    rows = _tiles(body.y - level.top, body.half_height, level.tile)
    columns = _tiles(body.x - level.left, body.half_width, level.tile)
    for row, column in np.argwhere(np.isin(level.terrain[rows, columns], stops)).tolist():
        place = f"row {rows.start + row + 1}, column {columns.start + column + 1}"
        raise UserError(f"{_told(level, body)}, which overlaps the tile in {place}: it would be stuck there")


def _refuse_overlaps(level: Level, bodies: Sequence[_Body], others: Sequence[_Body]) -> None:
    """Refuse bodies that overlap each other or any of the others; touching is no overlap."""
    for i, body in enumerate(bodies):
        for other in (*bodies[:i], *others):
            if body.told == other.told:
                continue  # two players' bodies at one place
            across = abs(body.x - other.x) < body.half_width + other.half_width - rules.HAIR
            if across and abs(body.y - other.y) < body.half_height + other.half_height - rules.HAIR:
                raise UserError(f"level {level.name}: {body.told} begins inside {other.told}")


def _tiles(middle: float, half: float, tile: float) -> slice:
    """Return the rows or columns that a body lies on."""
    return slice(math.floor((middle - half) / tile), math.ceil((middle + half) / tile))


def _told(level: Level, body: _Body) -> str:
    size = f"{2 * body.half_width:g} x {2 * body.half_height:g} px"
    return f"level {level.name}: {body.told} has a body of {size}"
