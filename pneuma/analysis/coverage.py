"""How often a band about the mean covers it, of so many runs: a figure marks those that rarely do."""

from __future__ import annotations

from bisect import bisect_left, bisect_right

ENOUGH = 0.9
"""A band that covers less often is drawn with the runs themselves, and marked."""

SEEDS = (3, 5, 10, 20, 50)
LEAST_COVERAGE: dict[str, tuple[float, ...]] = {
    "ci": (0.815, 0.752, 0.886, 0.926, 0.942),
    "bootstrap": (0.556, 0.675, 0.868, 0.920, 0.934),
    "se": (0.403, 0.578, 0.637, 0.658, 0.663),
}
"""At each of `SEEDS`: the least over normal, 80/20 bimodal and heavy-tailed runs, as printed by
`pneuma bench calibration`. Other bands say how far runs lie apart, and cover the mean by accident."""


def coverage(band: str, runs: int) -> float | None:
    """Return how often a band of `pneuma.analysis.bands.BANDS` covers the mean of what its runs are from.

    Of a number of runs between two of `SEEDS` it is the lesser of theirs, as it need not grow with the
    runs; and 0 of fewer than the first: what they may cover was not drawn. None for a band that is no
    interval of a mean.
    """
    if band not in LEAST_COVERAGE:
        return None
    below, above = bisect_right(SEEDS, runs), bisect_left(SEEDS, runs)
    return min(LEAST_COVERAGE[band][below - 1 : above + 1]) if below else 0.0


def is_trusted(band: str, runs: int) -> bool:
    """Whether a band can be drawn without the runs that it is of."""
    covered = coverage(band, runs)
    return covered is None or covered >= ENOUGH
