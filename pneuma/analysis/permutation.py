"""Permutation tests: how often a relabeling of the runs is as extreme as what was seen.

All relabelings are counted where there are few, and drawn at random where there are many; the one
that was seen is always among them, so that no p-value is zero. One set of relabelings serves many
samples at once: they are laid out as rows, and a sum over one arm is a matrix product.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations
from math import comb

import numpy as np

MOST_COUNTED = 200_000
"""More relabelings than this are drawn and not counted out; of ten runs against ten there are 184,756."""
DRAWS = 100_000
"""So many that what is decided hangs little on which are drawn: a list of 170 contrasts asks for p-values of
3e-4, which then rest on thirty of them."""
FEW_COUNTED = 20_000
"""Up to so many are counted out, however few draws are asked for."""
_AT_ONCE = 20_000
"""Relabelings that are drawn at once, for their keys take as much room as they do."""

_SLACK = 1e-9
"""By how much of itself a statistic may fall short of the seen one and still be as extreme: sums in
another order differ in their last bits."""
ROUNDING = 1e-13
"""Of the greatest magnitude: values that lie closer together are equal, but for their last bits."""
LEAST_VARIANCE = 1e-13
"""Of values scaled to at most 1: below it, a variance is rounding, and the arm has no spread."""


@dataclass(frozen=True)
class Relabelings:
    """Which runs are called arm a, in every relabeling.

    Attributes:
        in_a: (relabelings, runs) 1.0 or 0.0; the first is what was seen.
        exact: whether these are all there are.
    """

    in_a: np.ndarray
    exact: bool

    @property
    def smallest_p(self) -> float:
        """The smallest one-sided p-value that they can give."""
        return 1 / len(self.in_a)


def relabel(size_a: int, size_b: int, generator: np.random.Generator, draws: int = DRAWS) -> Relabelings:
    """Return all ways to call so many runs a and the others b, or the seen one and that many draws."""
    if comb(size_a + size_b, size_a) <= _most_counted(draws):
        return Relabelings(_every(size_a, size_b), exact=True)
    in_a = np.zeros((1 + draws, size_a + size_b))
    in_a[0, :size_a] = 1.0
    for first in range(1, 1 + draws, _AT_ONCE):
        rows = in_a[first : first + _AT_ONCE]
        keys = generator.random(rows.shape)
        rows[:] = keys <= np.partition(keys, size_a - 1, axis=1)[:, size_a - 1 : size_a]
    return Relabelings(in_a, exact=False)


def _most_counted(draws: int) -> int:
    """Return up to how many relabelings are counted out, where else so many would be drawn."""
    return MOST_COUNTED if draws >= DRAWS else FEW_COUNTED


@lru_cache(maxsize=8)  # 30 MB of ten runs against ten
def _every(size_a: int, size_b: int) -> np.ndarray:
    chosen = np.array(list(combinations(range(size_a + size_b), size_a)))
    in_a = np.zeros((len(chosen), size_a + size_b))
    np.put_along_axis(in_a, chosen, 1.0, axis=1)
    in_a.flags.writeable = False
    return in_a


def tails(statistics: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the shares of relabelings at least and at most as great as the seen one.

    Args:
        statistics: (relabelings, samples), the seen one first.

    Returns:
        p_greater and p_less, each (samples,).
    """
    seen = statistics[0]
    slack = _SLACK * (1 + np.abs(seen))
    return (statistics >= seen - slack).mean(axis=0), (statistics <= seen + slack).mean(axis=0)


def studentised_difference(samples: np.ndarray, labels: Relabelings) -> np.ndarray:
    """Return Welch's t of arm a against arm b in every relabeling, (relabelings, samples).

    Args:
        samples: (samples, runs), arm a first. Each is centred and scaled, which alters no t.
        labels: the relabelings of as many runs.
    """
    values = scaled(samples)
    size_a = labels.in_a[0].sum()
    size_b = values.shape[1] - size_a
    sum_a, squares_a = labels.in_a @ values.T, labels.in_a @ (values**2).T
    sum_b, squares_b = values.sum(axis=1) - sum_a, (values**2).sum(axis=1) - squares_a
    variance = _of_mean(sum_a, squares_a, size_a) + _of_mean(sum_b, squares_b, size_b)
    return (sum_a / size_a - sum_b / size_b) / np.sqrt(np.maximum(variance, LEAST_VARIANCE))


def scaled(samples: np.ndarray) -> np.ndarray:
    """Return each row less its mean and over its greatest magnitude; all zero where it is constant.

    Constant is also what differs by rounding alone, such as 0.3 and 0.1 + 0.2.
    """
    centred = samples - samples.mean(axis=1, keepdims=True)
    size = np.abs(centred).max(axis=1, keepdims=True)
    differs = size > ROUNDING * np.abs(samples).max(axis=1, keepdims=True)
    return np.divide(centred, size, out=np.zeros_like(centred), where=differs)


def _of_mean(total: np.ndarray, squares: np.ndarray, size: float) -> np.ndarray:
    """Return the variance of an arm's mean."""
    return (squares - total**2 / size) / (size - 1) / size


def sign_flips(runs: int, generator: np.random.Generator, draws: int = DRAWS) -> np.ndarray:
    """Return all ways to turn the signs of so many values, or drawn ones, (flips, runs); the seen first."""
    if 2**runs <= _most_counted(draws):
        return 1.0 - 2.0 * (np.arange(2**runs)[:, None] >> np.arange(runs) & 1)
    drawn = generator.integers(0, 2, (draws, runs)) * 2.0 - 1.0
    return np.concatenate([np.ones((1, runs)), drawn])
