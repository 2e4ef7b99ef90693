"""The calibration of the statistics: its parts, and that lists of claims keep their error rate."""

from __future__ import annotations

import numpy as np
import pytest

from pneuma.analysis.curves import BANDS

from .calibration import ALPHA, DISTRIBUTIONS, SETTINGS, band_coverage, is_wrong


@pytest.mark.parametrize(("seeds", "is_enough"), [(10, False), (20, True)])
def test_bands_of_enough_runs_cover_the_mean_of_every_distribution(seeds: int, is_enough: bool) -> None:
    generator, coverages = np.random.default_rng(1), []
    for name in ("normal", "80/20", "t, 3 degrees"):
        runs = DISTRIBUTIONS[name](generator, 20_000 * seeds).reshape(-1, seeds)
        coverages.append(band_coverage("ci", runs))
    assert (min(coverages) >= 0.9) == (seeds >= BANDS["ci"].enough_runs) == is_enough


def test_a_t_band_covers_as_theory_says_and_a_range_by_hand() -> None:
    generator = np.random.default_rng(2)
    assert band_coverage("ci", generator.normal(size=(20_000, 5))) == pytest.approx(0.95, abs=0.006)
    runs = generator.normal(size=(20_000, 3))
    within = 3**0.5  # Student's t of 2 degrees is within t with probability t / sqrt(2 + t ** 2)
    assert band_coverage("sd", runs) == pytest.approx(within / 5**0.5, abs=0.014)
    assert band_coverage("minmax", runs) == pytest.approx(1 - 2 / 8, abs=0.011)  # not all on one side


@pytest.mark.parametrize("name", ["normal", "t, 3 degrees", "two values"])
def test_lists_of_ten_seeds_keep_their_error_rate(name: str) -> None:
    generator, lists = np.random.default_rng(5), 60
    wrong = sum(is_wrong(DISTRIBUTIONS[name], 10, SETTINGS["alike"], generator) for _ in range(lists))
    assert wrong / lists < ALPHA + 3 * np.sqrt(ALPHA * (1 - ALPHA) / lists)
