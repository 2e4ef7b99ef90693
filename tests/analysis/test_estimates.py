"""Estimates and intervals against SciPy, rliable's published formulas and laws."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy import stats

from pneuma.analysis import intervals
from pneuma.analysis.intervals import interquartile_mean


@pytest.mark.parametrize("runs", [1, 2, 3, 4, 5, 8, 10, 17, 50])
def test_estimates_are_those_of_scipy_and_rliable(runs: int) -> None:
    values = np.random.default_rng(runs).standard_t(2, runs)
    trimmed = stats.trim_mean(values, proportiontocut=0.25)  # rliable's aggregate_iqm is this call
    assert intervals.interquartile_mean(values) == pytest.approx(trimmed, rel=1e-12)
    if runs > 1:
        assert intervals.deviation(values) == pytest.approx(stats.tstd(values), rel=1e-12)
        assert intervals.deviation(np.full(runs, 0.3)) == 0  # NumPy's of ten is 6e-17


def test_probability_of_improvement_is_the_u_statistic_and_halves_ties() -> None:
    generator = np.random.default_rng(3)
    a, b = generator.integers(0, 5, 9), generator.integers(1, 6, 14)
    u = stats.mannwhitneyu(a, b).statistic  # rliable divides it by both counts
    assert intervals.probability_of_improvement(a, b) == pytest.approx(u / (9 * 14), rel=1e-12)
    assert intervals.probability_of_improvement(np.ones(2), np.ones(1)) == 0.5


def test_a_wide_gap_parts_runs_of_two_kinds() -> None:
    """The larger group has an SD of 1, and the gap is 3.5 or 2.5 times as wide."""
    around = np.array([-1.0, 0.0, 1.0])
    assert intervals.has_two_modes(np.concatenate([around, [-4.5]]))
    assert not intervals.has_two_modes(np.concatenate([around, [-3.5]]))
    assert not intervals.has_two_modes(np.full(10, 0.3)) and not intervals.has_two_modes(around[:2])


# --- Intervals ------------------------------------------------------------------------------------

RUNS = np.random.default_rng(1).gamma(2, size=12)


@pytest.mark.parametrize("statistic", [partial(np.mean, axis=-1), interquartile_mean])
def test_bca_is_close_to_scipys_with_resamples_of_its_own(
    statistic: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(intervals, "RESAMPLES", 20_000)
    own = intervals.bootstrap_interval(RUNS, statistic, np.random.default_rng(6))
    resampled = stats.bootstrap(
        (RUNS,),
        lambda runs, axis: statistic(runs),
        method="BCa",
        n_resamples=20_000,
        rng=np.random.default_rng(5),
    )
    theirs = resampled.confidence_interval
    assert (own.low, own.high) == pytest.approx((theirs.low, theirs.high), abs=0.03)


def test_intervals_of_deviations_cover_of_normal_runs() -> None:
    generator = np.random.default_rng(8)
    covered = 0
    for runs in generator.normal(size=(600, 20)):
        interval = intervals.deviation_interval(runs)
        covered += interval.low <= 1 <= interval.high
    assert 0.92 < covered / 600 < 0.98


def test_the_interval_of_a_deviation_by_hand() -> None:
    """About the trimmed mean: of eight runs two are cut at each end, as 8 / (2 x root of 4) is 2.

    That is 1.5, about which the fourth powers sum up to 5,269.5; about the mean, 2.5, the squares to 76.
    So the kurtosis is 8 x 5,269.5 / 76^2 = 7.2985 and the error of ln(variance), root((7.2985 - 5/8) / 7),
    0.9764. 8 / (8 - 1.96) = 1.3245: ln(1.3245 x 76/7) = 2.6658, give or take 1.96 x 1.3245 x 0.9764 = 2.5347.
    """
    interval = intervals.deviation_interval(np.array([0.0, 0, 1, 1, 2, 2, 4, 10]))
    assert interval.low == pytest.approx(math.exp((2.6658 - 2.5347) / 2), rel=1e-4)
    assert interval.high == pytest.approx(math.exp((2.6658 + 2.5347) / 2), rel=1e-4)


@pytest.mark.parametrize("values", [[], [3.0], [2.0, 2.0, 2.0, 2.0, 2.0, 2.0]])
def test_too_few_or_equal_runs_have_no_interval(values: list[float]) -> None:
    generator, runs = np.random.default_rng(0), np.array(values)
    for interval in (
        intervals.mean_interval(runs),
        intervals.difference_interval(runs, runs),
        intervals.deviation_interval(runs),
        intervals.bootstrap_interval(runs, interquartile_mean, generator),
    ):
        assert interval.method == "none" and not interval.exists
        assert np.isnan([interval.low, interval.high]).all()
    assert not intervals.incidence_interval(0, 0).exists
