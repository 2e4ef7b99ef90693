"""Bands: what is drawn around a mean over runs, and whether it says where that mean lies.

Every band works on (runs, points) values, NaN where a run has none, and gives its lower and upper
edge, (points,) each, NaN where fewer than two runs have a value.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import special

from pneuma.errors import unknown_name

Edges = tuple[np.ndarray, np.ndarray]

CONFIDENCE = 0.95


@dataclass(frozen=True)
class Band:
    """What a band shows: its words for a legend, and its edges of (runs, points) values.

    Attributes:
        label: its words.
        edges: its lower and upper edge; None where the runs themselves are drawn in its place.
        about_mean: whether it says where the mean of all runs that there could be lies, and how often it
            does is in `LEAST_COVERAGE`; other bands say how far runs lie apart.
    """

    label: str
    edges: Callable[[np.ndarray], Edges] | None
    about_mean: bool = False


def count_of(runs: np.ndarray) -> np.ndarray:
    """Return how many runs have a value at each point, (points,)."""
    return np.isfinite(runs).sum(axis=0)


def mean_of(runs: np.ndarray) -> np.ndarray:
    """Return the mean over the runs that have a value, NaN where none has, (points,)."""
    count = count_of(runs)
    total = np.where(np.isfinite(runs), runs, 0.0).sum(axis=0)
    return np.divide(total, count, out=np.full(total.shape, np.nan), where=count > 0)


# --- Edges -----------------------------------------------------------------------------------------


def _around(half: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray], Edges]:
    return lambda runs: (mean_of(runs) - half(runs), mean_of(runs) + half(runs))


def _variance(runs: np.ndarray) -> np.ndarray:
    """Return the sample variance over runs, NaN where fewer than two have a value, (points,)."""
    count = count_of(runs)
    squares = np.where(np.isfinite(runs), (runs - mean_of(runs)) ** 2, 0.0).sum(axis=0)
    return np.divide(squares, count - 1, out=np.full(squares.shape, np.nan), where=count > 1)


def _standard_error(runs: np.ndarray) -> np.ndarray:
    return np.sqrt(_variance(runs) / np.maximum(count_of(runs), 1))


def _t_half(runs: np.ndarray) -> np.ndarray:
    """Return half the width of Student's interval for the mean, (points,)."""
    freedom = np.maximum(count_of(runs) - 1, 1)
    return special.stdtrit(freedom, 0.5 + CONFIDENCE / 2) * _standard_error(runs)


def _extremes(runs: np.ndarray) -> Edges:
    several = np.where(count_of(runs) > 1, np.where(np.isfinite(runs), runs, np.nan), np.nan)
    return np.fmin.reduce(several), np.fmax.reduce(several)


BANDS = {
    "ci": Band("95 % interval of the mean (Student's t)", _around(_t_half), about_mean=True),
    "se": Band("± 1 standard error", _around(_standard_error), about_mean=True),
    "std": Band("± 1 standard deviation", _around(lambda runs: np.sqrt(_variance(runs)))),
    "minmax": Band("least to greatest", _extremes),
    "runs": Band("every run as a thin line", None),
}


def find_band(name: str) -> Band:
    """Return a band by its name.

    Raises:
        UserError: for a name that is no band's.
    """
    if name not in BANDS:
        raise unknown_name("band", name, BANDS)
    return BANDS[name]


# --- How often a band covers the mean --------------------------------------------------------------

ENOUGH = 0.9
"""A band that covers its mean less often is drawn with the runs themselves, and marked."""

COVERAGE_SEEDS = (3, 5, 10, 20, 50)
LEAST_COVERAGE: dict[str, tuple[float, ...]] = {
    "ci": (0.815, 0.752, 0.886, 0.926, 0.942),
    "se": (0.403, 0.578, 0.637, 0.658, 0.663),
}
"""At each of `COVERAGE_SEEDS`: the least over normal, 80/20 bimodal and heavy-tailed runs, as printed by
`pneuma bench calibration`. Other bands say how far runs lie apart, and cover the mean by accident."""


def coverage(band: str, runs: int) -> float | None:
    """Return how often a band of `BANDS` covers the mean of what its runs are from.

    Between two of `COVERAGE_SEEDS` it is the lesser of theirs, as it need not grow with the runs; 0 of
    fewer than the first, for which nothing was drawn. None for a band that is no interval of a mean.
    """
    if band not in LEAST_COVERAGE:
        return None
    below, above = bisect_right(COVERAGE_SEEDS, runs), bisect_left(COVERAGE_SEEDS, runs)
    return min(LEAST_COVERAGE[band][below - 1 : above + 1]) if below else 0.0


def is_trusted(band: str, runs: int) -> bool:
    """Whether a band can be drawn without the runs that it is of."""
    covered = coverage(band, runs)
    return covered is None or covered >= ENOUGH
