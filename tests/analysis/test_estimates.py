"""Point estimates against SciPy, and against rliable's published formulas written out again."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from pneuma.analysis import estimates

ESTIMATES = (estimates.mean, estimates.median, estimates.interquartile_mean, estimates.deviation)


@pytest.mark.parametrize("runs", [1, 2, 3, 4, 5, 8, 10, 17, 50])
def test_estimates_are_those_of_scipy_and_rliable(runs: int) -> None:
    values = np.random.default_rng(runs).standard_t(2, runs)
    trimmed = stats.trim_mean(values, proportiontocut=0.25)  # rliable's aggregate_iqm is this call
    assert estimates.interquartile_mean(values) == pytest.approx(trimmed, rel=1e-12)
    assert estimates.mean(values) == pytest.approx(math.fsum(values) / runs, rel=1e-12)
    assert estimates.median(values) == pytest.approx(stats.scoreatpercentile(values, 50), rel=1e-12)
    if runs > 1:
        assert estimates.deviation(values) == pytest.approx(stats.tstd(values), rel=1e-12)


def test_each_row_is_estimated_for_itself() -> None:
    rows = np.random.default_rng(0).normal(size=(4, 7))
    for estimate in ESTIMATES:
        assert estimate(rows) == pytest.approx([float(estimate(row)) for row in rows], rel=1e-14)


def test_probability_of_improvement_is_the_u_statistic_and_halves_ties() -> None:
    generator = np.random.default_rng(3)
    a, b = generator.integers(0, 5, 9), generator.integers(1, 6, 14)
    u = stats.mannwhitneyu(a, b).statistic  # rliable divides it by both counts
    assert estimates.probability_of_improvement(a, b) == pytest.approx(u / (9 * 14), rel=1e-12)
    assert estimates.probability_of_improvement([1, 1], [1]) == 0.5
    assert math.isnan(estimates.probability_of_improvement([], [1]))


def test_a_value_that_is_not_finite_is_told_and_not_dropped() -> None:
    for estimate in ESTIMATES:
        with pytest.raises(ValueError, match="2 of 3 values are not finite"):
            estimate([1.0, math.nan, math.inf])


def test_equal_runs_have_no_deviation_at_all() -> None:
    """Ten times 0.3 have a mean of 0.29999999999999993, from which NumPy's deviation is 6e-17."""
    assert np.std(np.full(10, 0.3), ddof=1) > 0
    assert estimates.deviation(np.full(10, 0.3)) == 0
    np.testing.assert_array_equal(estimates.deviation([[0.3] * 10, [0.0, 2.0] * 5])[0], 0)
