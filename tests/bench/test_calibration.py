"""The calibration of the statistics: its parts, and that the committed table is what it prints."""

from __future__ import annotations

import numpy as np
import pytest

from pneuma.analysis.contrasts import Contrast
from pneuma.analysis.curves import BANDS
from pneuma.analysis.intervals import no_interval
from pneuma.analysis.judgement import decide
from pneuma.analysis.pvalues import PValues

from .calibration import DISTRIBUTIONS, SETTINGS, band_coverage, is_false, wrong_lists


@pytest.mark.parametrize(("band", "seeds", "enough"), [("ci", 10, False), ("ci", 20, True)])
def test_bands_of_enough_runs_cover_the_mean_of_every_distribution(
    band: str, seeds: int, enough: bool
) -> None:
    generator = np.random.default_rng(1)
    drawn = [band_coverage(band, draw(generator, (20_000, seeds))) for draw in DISTRIBUTIONS.values()]
    assert (min(drawn) >= 0.9) == (seeds >= BANDS[band].enough_runs) == enough


def test_a_t_band_covers_as_theory_says_and_a_range_by_hand() -> None:
    runs = np.random.default_rng(2).normal(size=(20_000, 3))
    assert band_coverage("ci", runs) == pytest.approx(0.95, abs=0.006)
    within = 3**0.5  # of t with 2 degrees: its chance is t / sqrt(2 + t ** 2)
    assert band_coverage("sd", runs) == pytest.approx(within / 5**0.5, abs=0.014)
    assert band_coverage("minmax", runs) == pytest.approx(1 - 2 / 8, abs=0.011)  # not all on one side


@pytest.mark.parametrize(
    ("truth", "claimed", "p", "wrong"),
    [
        ("alike", "greater", (1e-6, 1.0, 1.0, 1.0, 1.0), True),
        ("alike", "greater", (0.5, 0.5, 1e-6, 1.0, 1.0), False),
        ("alike", "greater", (0.01, 0.99, 1.0, 1.0, 1.0), False),  # 60 claims: not enough
        ("edge", "greater", (1e-6, 1.0, 1.0, 1.0, 1.0), False),
        ("edge", "greater", (0.5, 0.5, 1e-6, 1.0, 1.0), True),
        ("half", "equal", (1e-6, 1.0, 0.9, 0.9, 1.0), False),  # a difference that counts as none
        ("half", "equal", (1e-6, 1.0, 1.0, 1e-6, 1.0), True),
        ("far", "equal", (1e-6, 1.0, 1.0, 1e-6, 1.0), False),
    ],
)
def test_what_counts_as_a_false_verdict(truth: str, claimed: str, p: tuple[float, ...], wrong: bool) -> None:
    own = Contrast(0.0, no_interval(), PValues._make((*p, 1.0)), (9, 9))
    assert is_false(decide(own, claimed, 60)[0], own, truth, claimed) == wrong


def test_lists_on_one_arm_are_judged_falsely_no_more_often_than_they_may() -> None:
    """Of 60 true claims each; and a test without correction would be wrong in nearly every list."""
    draw, setting = DISTRIBUTIONS["normal"], SETTINGS["one arm, alike"]
    wrong = wrong_lists(60, draw, 10, setting, np.random.default_rng(5))
    assert wrong <= 3 + 3 * np.sqrt(3)


@pytest.mark.slow
@pytest.mark.parametrize("name", DISTRIBUTIONS)
def test_lists_of_ten_seeds_keep_their_error_rate(name: str) -> None:
    wrong = wrong_lists(400, DISTRIBUTIONS[name], 10, SETTINGS["alike"], np.random.default_rng(5))
    known = 0.023  # the greatest of the three that docs/evidence.md has for ten seeds
    assert 0 < wrong / 400 < known + 3 * np.sqrt(known * (1 - known) / 400)
