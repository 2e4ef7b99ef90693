"""How often an interval or band covers the true mean, or spread, of what its runs were drawn from."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from scipy import special

from pneuma.analysis import bands, intervals
from pneuma.analysis.estimates import mean
from pneuma.bench.claim_lists import DISTRIBUTIONS, EVENT_SHARE, SEEDS

FEWER = 20
"""What takes a while is drawn so many times more rarely."""

BANDS = tuple(name for name, band in bands.BANDS.items() if band.edges and name != "variance")
"""The bands of a figure that have the mean's unit."""


def coverages(samples: int, generator: np.random.Generator) -> Iterator[dict[str, Any]]:
    """Yield, for each distribution, number of seeds, and interval or band, how often it covers.

    Args:
        samples: how many times a band is drawn; a twentieth as often where each takes a while.
        generator: draws the runs.
    """
    fewer = max(1, samples // FEWER)
    for name, draw in DISTRIBUTIONS.items():
        for seeds in SEEDS:
            runs = draw(generator, (samples, seeds))
            for band in BANDS:
                drawn = runs[:fewer] if band == "bootstrap" else runs
                yield _row(band, name, seeds, band_coverage(band, drawn))
            for method, interval, truth in _one_by_one(generator):
                made = [interval(own) for own in runs[:fewer]]
                covered = [own.low <= truth <= own.high for own in made if own.exists]
                yield _row(method, name, seeds, float(np.mean(covered)) if covered else float("nan"))
    for seeds in SEEDS:
        yield _row("Clopper-Pearson", f"share {EVENT_SHARE}", seeds, _share_coverage(seeds))


def band_coverage(band: str, runs: np.ndarray) -> float:
    """Return how often a figure's band covers the mean 0 of what (samples, runs) were drawn from."""
    edges = bands.BANDS[band].edges
    assert edges
    low, high = edges(runs.T)
    return float(((low <= 0) & (high >= 0)).mean())


def _one_by_one(
    generator: np.random.Generator,
) -> list[tuple[str, Callable[[np.ndarray], intervals.Interval], float]]:
    """Return intervals of one sample, and what is true of it."""
    return [
        ("BCa bootstrap", lambda runs: intervals.bootstrap_interval(runs, mean, generator), 0.0),
        ("deviation", intervals.deviation_interval, 1.0),
    ]


def _share_coverage(runs: int) -> float:
    """Return how often the interval of a share covers, summed over every count."""
    count = np.arange(runs + 1)
    chance = special.comb(runs, count) * EVENT_SHARE**count * (1 - EVENT_SHARE) ** (runs - count)
    made = [intervals.incidence_interval(int(k), runs) for k in count]
    return float(sum(p for p, own in zip(chance, made, strict=True) if own.low <= EVENT_SHARE <= own.high))


def _row(method: str, distribution: str, seeds: int, coverage: float) -> dict[str, Any]:
    return {"method": method, "distribution": distribution, "seeds": seeds, "coverage": coverage}
