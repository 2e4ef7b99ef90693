"""Regions and squares of a grid of tiles, in NumPy alone: SciPy is not needed to play."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view


def number_regions(tiles: np.ndarray) -> np.ndarray:
    """Number the connected regions of set tiles from 1, (rows, columns) int32; 0 where no tile is set.

    Tiles are connected over their sides. Regions are numbered in the order of their first tiles, row by row.
    """
    index = np.arange(tiles.size).reshape(tiles.shape)
    below = tiles[1:] & tiles[:-1]
    beside = tiles[:, 1:] & tiles[:, :-1]
    first = np.concatenate([index[:-1][below], index[:, :-1][beside]])
    second = np.concatenate([index[1:][below], index[:, 1:][beside]])
    root = index.ravel().copy()  # of each tile, one of its region with a lower index, in the end the lowest
    while (root[first] != root[second]).any():
        lower = np.minimum(root[first], root[second])
        np.minimum.at(root, root[first], lower)
        np.minimum.at(root, root[second], lower)
        while (root != root[root]).any():
            root = root[root]
    regions = np.zeros(tiles.shape, np.int32)
    regions[tiles] = np.unique(root[tiles.ravel()], return_inverse=True)[1] + 1
    return regions


def has_free_square(free: np.ndarray, side: int) -> np.ndarray:
    """Return whether a square of tiles is free, by its upper left tile, (rows, columns) bool."""
    padded = np.pad(free, (0, side - 1))
    return np.asarray(sliding_window_view(padded, (side, side)).all(axis=(2, 3)))


def sum_around(tiles: np.ndarray, radius: int, beyond: Literal["edge", "constant"] = "edge") -> np.ndarray:
    """Return the sum of the square of 2 radius + 1 around each tile, (rows, columns) int32.

    Beyond the grid its edge goes on, or there are zeros (`constant`).
    """
    sums = np.pad(tiles.astype(np.int32), radius, mode=beyond)
    for axis in (0, 1):
        total = np.moveaxis(np.cumsum(sums, axis, np.int32), axis, 0)
        total = np.concatenate([np.zeros_like(total[:1]), total])
        sums = np.moveaxis(total[2 * radius + 1 :] - total[: -2 * radius - 1], 0, axis)
    return sums
