"""How often a band of so many runs covers the true mean: a figure marks those that rarely do."""

from __future__ import annotations

ENOUGH = 0.9
"""A band that covers less often is drawn with the runs themselves, and marked."""

SEEDS = (3, 5, 10, 20, 50)
LEAST_COVERAGE: dict[str, tuple[float, ...]] = {
    "ci": (0.815, 0.752, 0.886, 0.926, 0.942),
    "se": (0.403, 0.578, 0.637, 0.658, 0.663),
    "std": (0.545, 0.712, 0.897, 0.988, 1.000),
    "minmax": (0.548, 0.757, 0.937, 0.996, 1.000),
    "iqr": (0.390, 0.344, 0.418, 0.459, 0.417),
}
"""At each of `SEEDS`: the least over normal, 80/20 bimodal and heavy-tailed runs, as printed by
`pneuma bench calibration`. A band of a variance has another unit than the mean, and covers by accident."""


def coverage(band: str, runs: int) -> float:
    """Return how often a band of `pneuma.analysis.curves.BANDS` covers the mean of what its runs are from.

    It is that of the largest number in `SEEDS` not above the number of runs; 0 of fewer than three
    runs, and for a band that is no interval of a mean.
    """
    known = [i for i, seeds in enumerate(SEEDS) if seeds <= runs]
    return LEAST_COVERAGE[band][known[-1]] if known and band in LEAST_COVERAGE else 0.0


def is_trusted(band: str, runs: int) -> bool:
    """Whether a band covers often enough to be drawn without the runs that it is of."""
    return coverage(band, runs) >= ENOUGH
