"""Regions and squares of tiles are those of SciPy's `ndimage`, which is not needed to play."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from pneuma.env.tiles import has_free_square, number_regions, sum_around

SIZES = ((1, 1), (1, 9), (9, 1), (2, 3), (17, 23), (50, 57))


def _grids() -> list[np.ndarray]:
    """Return sparse to dense grids of many sizes, a spiral, and grids where all or none is set."""
    generator = np.random.default_rng(0)
    grids = [generator.random(size) < density for size in SIZES for density in (0, 0.1, 0.4, 0.6, 0.8, 1)]
    spiral = np.zeros((41, 41), np.bool_)
    for ring in range(0, 20, 2):
        end = 41 - ring
        spiral[ring, max(ring - 1, 0) : end] = spiral[ring:end, end - 1] = True
        spiral[end - 1, ring:end] = spiral[ring + 2 : end, ring] = True
    return [*grids, spiral, spiral[::-1], spiral.T]


def test_regions_are_numbered_by_their_first_tiles() -> None:
    tiles = np.array([[0, 1, 0, 1], [1, 1, 0, 0], [0, 0, 1, 0], [1, 0, 1, 1]], np.bool_)
    by_hand = [[0, 1, 0, 2], [1, 1, 0, 0], [0, 0, 3, 0], [4, 0, 3, 3]]
    assert number_regions(tiles).tolist() == by_hand and number_regions(tiles).dtype == np.int32
    for grid in _grids():
        np.testing.assert_array_equal(number_regions(grid), ndimage.label(grid)[0])


def test_a_square_is_free_where_all_its_tiles_are() -> None:
    free = np.array([[1, 1, 1], [1, 1, 0], [1, 1, 1]], np.bool_)
    assert has_free_square(free, 2).tolist() == [[True, False, False], [True, False, False], [False] * 3]
    for grid in _grids():
        for side in (1, 2, 3, 4):
            expected = ndimage.minimum_filter(grid, side, mode="constant", cval=False, origin=-(side // 2))
            np.testing.assert_array_equal(has_free_square(grid, side), expected)


def test_sums_are_of_the_square_around() -> None:
    tiles = np.array([[1, 0, 0], [0, 0, 2]])
    assert sum_around(tiles, 1, "constant").tolist() == [[1, 3, 2], [1, 3, 2]]
    assert sum_around(tiles, 1).tolist() == [[4, 4, 4], [2, 5, 8]]
    for grid in _grids():
        numbers = grid.astype(np.int32) * 73 - 36
        square = np.ones((3, 3), np.int64)
        expected = ndimage.convolve(numbers.astype(np.int64), square, mode="constant")
        np.testing.assert_array_equal(sum_around(numbers, 1, "constant"), expected)
        for radius in (1, 4, 9):
            for axis in (0, 1):
                weights = np.ones(2 * radius + 1)
                expected = ndimage.convolve1d(
                    numbers if axis == 0 else expected, weights, axis, mode="nearest"
                )
            np.testing.assert_array_equal(sum_around(numbers, radius), expected)
