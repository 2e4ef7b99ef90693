"""What the rays of a player of the oracle's world meet: every body and every closed tile is tried.

Part of `oracle_view.py`. The kernel goes along a ray from tile to tile instead.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator

from .oracle import Oracle
from .oracle_moves import Ground, Pair
from .oracle_parts import Player

TERRAIN, PLAYER, MONSTERS = 0, 1, 2
"""What can be met: from the last on, monsters by the number of their kind."""


def look_around(world: Oracle, player: Player) -> list[float]:
    """Return a row for each ray: how far it goes, then 1 for what it meets, else 0."""
    settings, told = world.book.settings, []
    closed = world.book.closed_to_players
    for way in list(zip(settings.ray_x, settings.ray_y, strict=True))[: settings.rays]:
        origin = player.x, player.y
        ends = [*_bodies(world, player, way), (_terrain(world.ground, origin, way, closed), TERRAIN)]
        distance, what = min(ends, key=lambda end: end[0])  # of equals the first
        told += [distance * settings.ray_scale]
        told += [float(thing == what) for thing in range(MONSTERS + settings.sights)]
    return told


def _bodies(world: Oracle, player: Player, way: Pair) -> Iterator[tuple[float, int]]:
    """Yield how far off each living body is entered, and what it is; one that is only touched is not."""
    seen = [(monster.box, MONSTERS + monster.kind.sight) for monster in world.monsters if monster.hp > 0.0]
    seen += [(other.box, PLAYER) for other in world.players if other is not player and other.hp > 0.0]
    for box, what in seen:
        low, high = ([c + side * h for c, h in zip(box.centre, box.half, strict=True)] for side in (-1, 1))
        start, end, beside = _inside((low[0], low[1]), (high[0], high[1]), (player.x, player.y), way)
        if start < end and end > 0.0 and not beside:
            yield max(start, 0.0), what


def _terrain(ground: Ground, origin: Pair, way: Pair, closed: Collection[int]) -> float:
    """Return how far off the first closed tile is met, if only at a corner, or the edge of the grid."""
    columns, rows = len(ground.tiles[0]), len(ground.tiles)
    corner = ground.left, ground.top
    _, nearest, _ = _inside(corner, _place(ground, columns, rows), origin, way)
    for row in range(rows):
        for column in range(columns):
            if not ground.is_closed(column, row, closed):
                continue
            low, high = _place(ground, column, row), _place(ground, column + 1, row + 1)
            if all(low[axis] <= origin[axis] < high[axis] for axis in (0, 1)):
                return 0.0
            start, end, _ = _inside(low, high, origin, way)
            level = all(low[axis] <= origin[axis] < high[axis] for axis in (0, 1) if way[axis] == 0.0)
            if start <= end and end > 0.0 and level:
                nearest = min(nearest, max(start, 0.0))
    return nearest


def _place(ground: Ground, column: int, row: int) -> Pair:
    """Return the upper left corner of a tile."""
    return ground.left + column * ground.tile, ground.top + row * ground.tile


def _inside(low: Pair, high: Pair, origin: Pair, way: Pair) -> tuple[float, float, bool]:
    """Return from when to when a ray is in a box, and whether it goes straight along, beside it."""
    start, end, beside = -math.inf, math.inf, False
    for axis in (0, 1):
        if way[axis] == 0.0:
            beside |= not low[axis] < origin[axis] < high[axis]
            continue
        lines = [(line - origin[axis]) / way[axis] for line in (low[axis], high[axis])]
        start, end = max(start, min(lines)), min(end, max(lines))
    return start, end, beside
