"""The ground of a level as a picture: snow, grass, sand and bridges, with banks, shores and water around.

It is painted as a whole, because shores and the borders between grounds cross tiles.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import numpy as np

from pneuma.env import rules
from pneuma.env.level import BRIDGE, GRASS, SAND, SNOW, WATER, Level, Rectangle
from pneuma.env.sprites import TILE, read_art, rgb
from pneuma.env.tiles import sum_around

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
_LAND = (SNOW, GRASS, SAND)
_ROUNDING = 6
_RAIL = 4


def paint_ground(ground: np.ndarray) -> np.ndarray:
    """Paint a map's ground, (rows, columns) of `visible_ground`: (16 rows, 16 columns, 3) uint8."""
    pixel_ground = _soften(np.where(ground == BRIDGE, WATER, ground))
    image = _texture(ground.shape, WATER)
    for ground_code in _LAND:
        np.copyto(image, _texture(ground.shape, ground_code), where=(pixel_ground == ground_code)[..., None])
    _paint_water(image, pixel_ground)
    _paint_banks(image, pixel_ground)
    framed_ground = np.pad(ground, 1, constant_values=WATER)
    for tile_row, tile_column in np.argwhere(framed_ground == BRIDGE).tolist():
        _paint_bridge(image, framed_ground, tile_row, tile_column)
    return image


def tile_hash(tile_row: np.ndarray | int, tile_column: np.ndarray | int, hash_salt: int = 0) -> np.ndarray:
    """Return 32 well-mixed bits for each tile, from which all variation between tiles follows."""
    mixed_rows = np.array(tile_row, np.uint64) * np.uint64(0x9E3779B1)
    mixed_columns = np.array(tile_column, np.uint64) * np.uint64(0x85EBCA77)
    mixed = mixed_rows ^ mixed_columns
    for factor in (0xC2B2AE3D, 0x2C1B3C6D):
        mixed = (mixed + np.uint64(hash_salt)) & np.uint64(0xFFFFFFFF)
        mixed = (mixed ^ (mixed >> np.uint64(15))) * np.uint64(factor)
    return (mixed >> np.uint64(16) & np.uint64(0xFFFFFFFF)).astype(np.int64)


def _texture(shape: tuple[int, ...], ground_code: int) -> np.ndarray:
    """Return a map of one ground, each tile in the variant that its hash selects."""
    rows, columns = shape
    pictures = _ground_pictures(ground_code)
    mirrored = pictures[:, :, ::-1]
    variants = np.concatenate([pictures, mirrored])
    tile_row, tile_column = np.ogrid[:rows, :columns]
    hash_by_tile = tile_hash(tile_row, tile_column, ground_code)
    variant_by_tile = np.array(_VARIANTS)[hash_by_tile % 8] + hash_by_tile // 8 % 2 * len(pictures)
    tiles = variants[variant_by_tile]  # (rows, columns, 16, 16, 3)
    image = tiles.swapaxes(1, 2).reshape(rows * TILE, columns * TILE, 3)
    background = pictures[0, 0, 0]
    is_background = (image == background).all(axis=-1)
    image[is_background & (_wobble(shape, 10 + ground_code, 32) > 8)] = rgb(_PATCHES[ground_code])
    return image


@cache
def _ground_pictures(ground_code: int) -> np.ndarray:
    """Return the four variants of one ground, (4, 16, 16, 3); a bridge has two."""
    sheet = read_art("ground.png")[TILE * ground_code : TILE * (ground_code + 1), :, :3]
    pictures = np.stack(np.split(sheet, 4, axis=1))
    if ground_code == BRIDGE:
        return pictures[:2]
    return pictures


def _soften(ground: np.ndarray) -> np.ndarray:
    """Return the ground of each art pixel, with rounded corners and slightly uneven borders.

    Each pixel takes the most frequent ground in a small square around it, shifted by a smooth noise. Only
    whole numbers are used, so that every processor paints the same picture.
    """
    pixel_ground = np.zeros((ground.shape[0] * TILE, ground.shape[1] * TILE), np.uint8)
    highest_count = np.full(pixel_ground.shape, -1000, np.int32)
    for ground_code in (WATER, *_LAND):
        tiles = ground == ground_code
        if not tiles.any():
            continue
        count = sum_around(tiles.repeat(TILE, 0).repeat(TILE, 1), _ROUNDING)
        count += np.where(count > 0, _wobble(ground.shape, ground_code), -1000)
        pixel_ground[count > highest_count] = ground_code
        np.maximum(highest_count, count, out=highest_count)
    return pixel_ground


def _wobble(shape: tuple[int, ...], hash_salt: int, step: int = 8) -> np.ndarray:
    """Return smooth noise from -36 to 36 over all art pixels, by lattice points `step` apart."""
    lattice_counts = [length * TILE // step + 2 for length in shape]
    tile_row, tile_column = np.ogrid[: lattice_counts[0], : lattice_counts[1]]
    noise = tile_hash(tile_row, tile_column, 100 + hash_salt).astype(np.int32) % 73 - 36
    for axis in (0, 1):
        noise = np.moveaxis(noise, axis, 0)
        before = noise[:-1].repeat(step, 0)
        after = noise[1:].repeat(step, 0)
        weight = np.tile(np.arange(step, dtype=np.int32), len(noise) - 1)[:, None]
        noise = np.moveaxis((before * (step - weight) + after * weight) // step, 0, axis)
    blurred = sum_around(noise[: shape[0] * TILE, : shape[1] * TILE], step // 4)
    return blurred // (2 * (step // 4) + 1) ** 2


def _paint_water(image: np.ndarray, pixel_ground: np.ndarray) -> None:
    """Lighten the shallows and draw foam along the shore."""
    water = pixel_ground == WATER
    land = pixel_ground != WATER
    shape = (pixel_ground.shape[0] // TILE, pixel_ground.shape[1] // TILE)
    noise = _wobble(shape, 7)
    shallow = water & (sum_around(land, 9) + noise > 50)
    image[shallow] = rgb(_SHALLOWS)
    near_shore, further, furthest = [sum_around(land, radius) > 0 for radius in (1, 4, 5)]
    image[water & (near_shore | (furthest & ~further & (noise > 6)))] = rgb(_FOAM)


def _paint_banks(image: np.ndarray, pixel_ground: np.ndarray) -> None:
    """Draw the rims where the land ends or turns, and the banks that face south."""
    water = np.pad(pixel_ground == WATER, 4, mode="edge")
    height, width = pixel_ground.shape

    def water_at(down: int, right: int = 0) -> np.ndarray:
        return water[4 + down : 4 + down + height, 4 + right : 4 + right + width]

    rim = water_at(0, -1) | water_at(0, 1) | water_at(-1)
    rim[1:] |= (pixel_ground[1:] != pixel_ground[:-1]) & (pixel_ground[:-1] != WATER)
    upper_bank = water_at(3) | water_at(4)
    lower_bank = water_at(1) | water_at(2)
    for ground_code in _LAND:
        ground = pixel_ground == ground_code
        for edge, colour in zip((rim, upper_bank, lower_bank), _EDGES[ground_code], strict=True):
            image[ground & edge] = rgb(colour)


def _paint_bridge(image: np.ndarray, ground: np.ndarray, tile_row: int, tile_column: int) -> None:
    """Draw one tile of a bridge: planks across the way that it leads, rails over the water.

    The ground has a frame of water, which the image has not.
    """
    variants = _ground_pictures(BRIDGE)
    planks = variants[int(tile_hash(tile_row - 1, tile_column - 1)) % len(variants)]
    if not _leads_down(ground, tile_row, tile_column):
        image, ground, tile_row, tile_column = image.swapaxes(0, 1), ground.T, tile_column, tile_row
    first_row = (tile_row - 1) * TILE
    first_column = (tile_column - 1) * TILE
    start = first_row
    if ground[tile_row - 1, tile_column] not in (WATER, BRIDGE):
        start = max(first_row - _RAIL, 0)
    end_row = first_row + TILE
    if ground[tile_row + 1, tile_column] not in (WATER, BRIDGE):
        end_row = min(end_row + _RAIL, image.shape[0])
    plank_rows = np.arange(start - first_row, end_row - first_row) % TILE
    image[start:end_row, first_column : first_column + TILE] = planks[plank_rows]
    for neighbour, edge in ((tile_column - 1, first_column), (tile_column + 1, first_column + TILE - 2)):
        if ground[tile_row, neighbour] == WATER:
            for offset, colour in enumerate(_RAIL_COLOURS):
                image[start:end_row, edge + offset] = rgb(colour)


def _leads_down(ground: np.ndarray, tile_row: int, tile_column: int) -> bool:
    """Return whether a bridge has land at its upper and lower end."""
    for step in (-1, 1):
        end_row = tile_row
        while ground[end_row, tile_column] == BRIDGE:
            end_row += step
        if ground[end_row, tile_column] == WATER:
            return False
    return True


def visible_ground(level: Level) -> np.ndarray:
    """Return the ground of each tile of a level, (rows, columns) of `WATER` to `BRIDGE`.

    Any other code looks like grass. The coast is always water.
    """
    has_picture = (level.ground >= WATER) & (level.ground <= BRIDGE)
    ground = np.where(has_picture, level.ground, GRASS)
    return np.where(level.terrain == rules.COAST, WATER, ground)


def land_and_shore(levels: Sequence[Level]) -> Rectangle:
    """Return the box of the land of all levels and the water around, in art pixels."""
    land = np.any([level.terrain != rules.COAST for level in levels], axis=0)
    land_tiles = np.argwhere(land)
    top_row, left_column = np.maximum(land_tiles.min(axis=0) - SHORE_TILES, 0).tolist()
    bottom_row, right_column = np.minimum(land_tiles.max(axis=0) + 1 + SHORE_TILES, land.shape).tolist()
    return Rectangle(left_column * TILE, top_row * TILE, right_column * TILE, bottom_row * TILE)
