"""How the oracle moves a body: a box that goes along x, then along y, until tiles or bodies stop it.

Part of `oracle.py`. Units: pixels; y points down. An axis is 0 for x, 1 for y.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

Pair = tuple[float, float]
"""Something along x and along y."""
CONTACT_EPS = 2**-10
"""Bodies that overlap by less only touch: what rounding leaves of a contact stops nobody from turning off."""


class Box(NamedTuple):
    """A body, or what strikes one: its centre and half its sides, x first."""

    centre: Pair
    half: Pair

    def meets(self, other: Box) -> bool:
        """Tell whether two boxes overlap; who only touches does not."""
        return all(
            abs(self.centre[axis] - other.centre[axis]) < self.half[axis] + other.half[axis]
            for axis in (0, 1)
        )


@dataclass(frozen=True)
class Ground:
    """The tiles of a level: `tiles[row][column]`."""

    left: float
    top: float
    tile: float
    tiles: list[list[int]]

    def is_closed(self, column: int, row: int, closed: Collection[int]) -> bool:
        """Tell whether a tile is of a closed code; what lies off the grid stops everybody."""
        if not (0 <= row < len(self.tiles) and 0 <= column < len(self.tiles[0])):
            return True
        return self.tiles[row][column] in closed

    def stop(self, body: Box, axis: int, step: float, closed: Collection[int]) -> float:
        """Return how far along an axis a body's centre may get: flush to a closed tile, or anywhere.

        It looks at the column or row of tiles that the leading edge would come to lie in, as far as
        the body is wide.
        """
        origin, half = (self.left, self.top)[axis], body.half[axis]
        across = self.covered(body, 1 - axis)
        if step > 0:
            cell = math.ceil((body.centre[axis] + step + half - origin) / self.tile) - 1
            flush = origin + cell * self.tile - half
        else:
            cell = math.floor((body.centre[axis] + step - half - origin) / self.tile)
            flush = origin + (cell + 1) * self.tile + half
        tiles = ((cell, other) if axis == 0 else (other, cell) for other in across)
        met = any(self.is_closed(column, row, closed) for column, row in tiles)
        return flush if met else math.copysign(math.inf, step)

    def covered(self, body: Box, axis: int) -> range:
        """Return the columns or rows that a body lies in; one that it only touches is not among them."""
        origin, centre, half = (self.left, self.top)[axis], body.centre[axis], body.half[axis]
        first = math.floor((centre - half - origin) / self.tile)
        return range(first, math.ceil((centre + half - origin) / self.tile))


def move(
    place: Pair, offset: Pair, half: Pair, steps: Pair, ground: Ground, closed: Collection[int],
    others: Sequence[Box],
) -> Pair:  # fmt: skip
    """Return where a body gets, first along x, then along y, among tiles and the bodies of others.

    On each axis it goes its whole step, or up to the first thing that stops it, and never back.

    Args:
        place: where it is.
        offset: the centre of its box from there.
        half: half the sides of its box.
        steps: how far it would go.
        ground: the tiles.
        closed: the codes of tiles that stop it.
        others: the bodies that stop it.
    """
    at = list(place)
    for axis, step in enumerate(steps):
        if step == 0.0:
            continue
        body = Box((at[0] + offset[0], at[1] + offset[1]), half)
        limits = [ground.stop(body, axis, step, closed), *_stops_at_bodies(body, axis, step, others)]
        end = body.centre[axis] + step
        if step > 0:
            at[axis] = max(at[axis], min(limits) - offset[axis]) if end > min(limits) else at[axis] + step
        else:
            at[axis] = min(at[axis], max(limits) - offset[axis]) if end < max(limits) else at[axis] + step
    return at[0], at[1]


def _stops_at_bodies(body: Box, axis: int, step: float, others: Sequence[Box]) -> Iterator[float]:
    """Yield where along an axis a body's centre is when it touches each other one that is in its way.

    Those that it passes by are not, nor those that it has passed, nor those that it is inside of.
    """
    across, way = 1 - axis, math.copysign(1.0, step)
    for other in others:
        touching = body.half[axis] + other.half[axis]
        aside = abs(body.centre[across] - other.centre[across])
        ahead = (other.centre[axis] - body.centre[axis]) * way
        if aside < body.half[across] + other.half[across] - CONTACT_EPS and ahead >= touching - CONTACT_EPS:
            yield other.centre[axis] - touching * way
