"""The ground of a level as a picture: snow, grass, sand and bridges, with banks, shores and water around.

It is painted as a whole, because shores and the borders between grounds cross tiles.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np
from scipy.ndimage import convolve1d

from pneuma.env import rules
from pneuma.env.level import BRIDGE, GRASS, SAND, SNOW, WATER, Level
from pneuma.env.sprites import TILE, read_art, rgb

SHORE_TILES = 2
"""Tiles of water around the land on the whole map."""

_PATCHES = ("3a7fc5", "e9f0f9", "7fbd66", "eed798")
"""Colours of water, snow, grass and sand, in patches."""
_FOAM, _SHALLOWS = "bfe8f2", "62b6dc"
_EDGES = {
    SNOW: ("c4d6ec", "9db8da", "7c98c4"),  # rim, then the bank down to the water: upper, lower
    GRASS: ("66a556", "97714b", "6d4f3d"),
    SAND: ("d9bb7d", "cfa76b", "a97f54"),
}
_RAIL_COLOURS = ("d09d68", "5b3a2e")
_VARIANTS = (0, 0, 0, 0, 1, 1, 2, 3)
"""The variant of its ground for a tile, by three bits of its hash."""
_SOFT = (WATER, SNOW, GRASS, SAND)
_ROUNDING = 6
_RAIL = 4


def paint_ground(ground: np.ndarray) -> np.ndarray:
    """Paint a map's ground, (rows, columns) of `ground_kinds`: (16 rows, 16 columns, 3) uint8."""
    kinds = _soften(np.where(ground == BRIDGE, WATER, ground))
    image = _texture(ground.shape, WATER)
    for kind in (SNOW, GRASS, SAND):
        np.copyto(image, _texture(ground.shape, kind), where=(kinds == kind)[..., None])
    _paint_water(image, kinds)
    _paint_banks(image, kinds)
    framed = np.pad(ground, 1, constant_values=WATER)
    for row, column in np.argwhere(framed == BRIDGE).tolist():
        _paint_bridge(image, framed, row, column)
    return image


def tile_hash(row: np.ndarray | int, column: np.ndarray | int, salt: int = 0) -> np.ndarray:
    """Return 32 well-mixed bits for each tile, from which all variation between tiles follows."""
    mixed = np.array(row, np.uint64) * np.uint64(0x9E3779B1) ^ np.array(column, np.uint64) * np.uint64(
        0x85EBCA77
    )
    for factor in (0xC2B2AE3D, 0x2C1B3C6D):
        mixed = (mixed + np.uint64(salt)) & np.uint64(0xFFFFFFFF)
        mixed = (mixed ^ (mixed >> np.uint64(15))) * np.uint64(factor)
    return (mixed >> np.uint64(16) & np.uint64(0xFFFFFFFF)).astype(np.int64)


def _texture(shape: tuple[int, ...], kind: int) -> np.ndarray:
    """Return a map of one ground, each tile in the variant that its hash selects."""
    rows, columns = shape
    drawn = _ground_pictures(kind)
    variants = np.concatenate([drawn, drawn[:, :, ::-1]])  # and each the other way round
    row, column = np.ogrid[:rows, :columns]
    mixed = tile_hash(row, column, kind)
    chosen = np.array(_VARIANTS)[mixed % 8] + mixed // 8 % 2 * len(drawn)
    tiles = variants[chosen]  # (rows, columns, 16, 16, 3)
    image = tiles.swapaxes(1, 2).reshape(rows * TILE, columns * TILE, 3)
    plain = (image == drawn[0, 0, 0]).all(axis=-1)
    image[plain & (_wobble(shape, 10 + kind, 32) > 8)] = rgb(_PATCHES[kind])
    return image


@cache
def _ground_pictures(kind: int) -> np.ndarray:
    """Return the four variants of one ground, (4, 16, 16, 3); a bridge has two."""
    row = read_art("ground.png")[TILE * kind : TILE * (kind + 1), :, :3]
    return np.stack(np.split(row, 4, axis=1)[: 2 if kind == BRIDGE else 4])


def _soften(ground: np.ndarray) -> np.ndarray:
    """Return the ground of each art pixel, with rounded corners and slightly uneven borders.

    Each pixel takes the most frequent ground in a small square around it, shifted by a smooth noise. Only
    whole numbers are used, so that every processor paints the same picture.
    """
    kinds = np.zeros((ground.shape[0] * TILE, ground.shape[1] * TILE), np.uint8)
    most = np.full(kinds.shape, -1000, np.int32)
    for kind in _SOFT:
        mask = ground == kind
        if not mask.any():
            continue
        share = _sum_around(mask.repeat(TILE, 0).repeat(TILE, 1), _ROUNDING)
        share += np.where(share > 0, _wobble(ground.shape, kind), -1000)
        kinds[share > most] = kind
        np.maximum(most, share, out=most)
    return kinds


def _sum_around(pixels: np.ndarray, radius: int) -> np.ndarray:
    """Return the sum of the pixels in a square of 2 radius + 1 around each."""
    total, ones = pixels.astype(np.int32), np.ones(2 * radius + 1)
    for axis in (0, 1):
        total = convolve1d(total, ones, axis, mode="nearest")
    return total


def _wobble(shape: tuple[int, ...], salt: int, step: int = 8) -> np.ndarray:
    """Return smooth noise from -36 to 36 over all art pixels, by lattice points `step` apart."""
    counts = [length * TILE // step + 2 for length in shape]
    row, column = np.ogrid[: counts[0], : counts[1]]
    noise = tile_hash(row, column, 100 + salt).astype(np.int32) % 73 - 36
    weight = np.arange(step, dtype=np.int32)
    for axis in (0, 1):
        noise = np.moveaxis(noise, axis, 0)
        low, high = noise[:-1].repeat(step, 0), noise[1:].repeat(step, 0)
        part = np.tile(weight, len(noise) - 1)[:, None]
        noise = np.moveaxis((low * (step - part) + high * part) // step, 0, axis)
    rounded = _sum_around(noise[: shape[0] * TILE, : shape[1] * TILE], step // 4)
    return rounded // (2 * (step // 4) + 1) ** 2


def _paint_water(image: np.ndarray, kinds: np.ndarray) -> None:
    """Lighten the shallows and draw foam along the shore."""
    water, land = kinds == WATER, kinds != WATER
    shape = (kinds.shape[0] // TILE, kinds.shape[1] // TILE)
    noise = _wobble(shape, 7)
    shallow = water & (_sum_around(land, 9) + noise > 50)
    image[shallow] = rgb(_SHALLOWS)
    near = [_sum_around(land, radius) > 0 for radius in (1, 4, 5)]
    image[water & (near[0] | (near[2] & ~near[1] & (noise > 6)))] = rgb(_FOAM)


def _paint_banks(image: np.ndarray, kinds: np.ndarray) -> None:
    """Draw the rims where the land ends or turns, and the banks that face south."""
    water = np.pad(kinds == WATER, 4, mode="edge")
    height, width = kinds.shape

    def water_at(down: int, right: int = 0) -> np.ndarray:
        return water[4 + down : 4 + down + height, 4 + right : 4 + right + width]

    rim = water_at(0, -1) | water_at(0, 1) | water_at(-1)
    rim[1:] |= (kinds[1:] != kinds[:-1]) & (kinds[:-1] != WATER)
    upper, lower = water_at(3) | water_at(4), water_at(1) | water_at(2)
    for kind in (SNOW, GRASS, SAND):
        mask = kinds == kind
        for where, colour in zip((rim, upper, lower), _EDGES[kind], strict=True):
            image[mask & where] = rgb(colour)


def _paint_bridge(image: np.ndarray, ground: np.ndarray, row: int, column: int) -> None:
    """Draw one tile of a bridge: planks across the way that it leads, rails over the water.

    The ground has a frame of water, which the image has not.
    """
    variants = _ground_pictures(BRIDGE)
    planks = variants[int(tile_hash(row - 1, column - 1)) % len(variants)]
    upright = _leads_down(ground, row, column)
    if not upright:
        image, ground, row, column = image.swapaxes(0, 1), ground.T, column, row
    top, left = (row - 1) * TILE, (column - 1) * TILE
    ends = [ground[row + way, column] not in (WATER, BRIDGE) for way in (-1, 1)]
    first, last = max(top - _RAIL * ends[0], 0), min(top + TILE + _RAIL * ends[1], image.shape[0])
    image[first:last, left : left + TILE] = planks[np.arange(first - top, last - top) % TILE]
    for way, edge in ((-1, left), (1, left + TILE - 2)):
        if ground[row, column + way] == WATER:
            for place, colour in enumerate(_RAIL_COLOURS, start=edge):
                image[first:last, place] = rgb(colour)


def _leads_down(ground: np.ndarray, row: int, column: int) -> bool:
    for way in (-1, 1):
        r = row
        while ground[r, column] == BRIDGE:
            r += way
        if ground[r, column] == WATER:
            return False
    return True


def ground_kinds(level: Level) -> np.ndarray:
    """Return the ground of each tile of a level, (rows, columns) of `WATER` to `BRIDGE`.

    Any other code is drawn as grass. The coast is always water.
    """
    kinds = np.where((level.ground >= 0) & (level.ground <= BRIDGE), level.ground, GRASS)
    return np.where(level.terrain == rules.COAST, WATER, kinds)


def land_and_shore(levels: Sequence[Level]) -> tuple[int, int, int, int]:
    """Return left, top, width and height of the land of all levels and the water around, in art pixels."""
    land = np.any([level.terrain != rules.COAST for level in levels], axis=0)
    edges = []
    for axis in (0, 1):
        lines = np.flatnonzero(land.any(axis=axis))
        first, last = (lines[0], lines[-1]) if lines.size else (0, land.shape[1 - axis] - 1)
        start = max(int(first) - SHORE_TILES, 0)
        edges.append((start, min(int(last) + 1 + SHORE_TILES, land.shape[1 - axis]) - start))
    (left, width), (top, height) = edges
    return left * TILE, top * TILE, width * TILE, height * TILE
