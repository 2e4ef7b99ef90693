"""Contrasts: effects and intervals against SciPy's, their laws, and what has no interval."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy import stats

from pneuma.analysis.claims import contrasts
from pneuma.analysis.claims.contrasts import DIFFERENCE_OF_SPREADS, Contrast
from pneuma.analysis.intervals import Interval

from .two_groups import compare

A, B = [3.0, 7.5, 4.0, 9.0, 8.0], [1.0, 2.5, 5.0, 2.0]
LEVEL = 0.995


def ends(interval: Interval | Any) -> tuple[float, float]:
    return interval.low, interval.high


def compare_ranges(groups: Sequence[ArrayLike], a: Sequence[int], b: Sequence[int] | float) -> Contrast:
    """Compare the range of some groups, by their places, with that of others or with a number."""
    range_a = {str(place): np.array(groups[place]) for place in a}
    if isinstance(b, float):
        return contrasts.compare("range", range_a, {}, constant=b)
    return contrasts.compare("range", range_a, {str(place): np.array(groups[place]) for place in b})


def test_means_have_welchs_interval_and_students_against_a_number() -> None:
    contrast, welch = compare("mean", A, B, LEVEL), stats.ttest_ind(A, B, equal_var=False)
    assert contrast.effect == pytest.approx(6.3 - 2.625) and contrast.means == pytest.approx((6.3, 2.625))
    assert contrast.seeds == (5, 4) and contrast.reason == ""
    assert ends(contrast.interval) == pytest.approx(ends(welch.confidence_interval(0.95)))
    assert ends(contrast.simultaneous) == pytest.approx(ends(welch.confidence_interval(LEVEL)))
    contrast, student = compare("mean", A, 5.0), stats.ttest_1samp(np.array(A) - 5, 0)
    assert contrast.effect == pytest.approx(1.3) and contrast.means == pytest.approx((6.3, 5.0))
    assert contrast.seeds == (5, 0)
    assert ends(contrast.interval) == pytest.approx(ends(student.confidence_interval(0.95)))


def test_shares_have_the_exact_interval_and_newcombes_for_their_difference() -> None:
    """The distances of the ends from the shares, 4 of 5 and 1 of 4, squared and added."""
    a, b = (stats.binomtest(*counts).proportion_ci(0.95, "exact") for counts in ((4, 5), (1, 4)))
    contrast = compare("incidence", [1, 1, 1, 0, 1], 0.2)
    assert contrast.effect == pytest.approx(0.6) and contrast.means == pytest.approx((0.8, 0.2))
    assert ends(contrast.interval) == pytest.approx((a.low - 0.2, a.high - 0.2))
    contrast = compare("incidence", [1, 1, 1, 0, 1], [0, 1, 0, 0])
    low = 0.55 - np.hypot(0.8 - a.low, b.high - 0.25)
    high = 0.55 + np.hypot(a.high - 0.8, 0.25 - b.low)
    assert contrast.effect == pytest.approx(0.55) and ends(contrast.interval) == pytest.approx((low, high))


def test_differences_of_spreads_have_the_interval_of_brown_and_forsythes_test() -> None:
    """It ends at 0 at the level at which SciPy's test just decides."""
    contrast = compare(DIFFERENCE_OF_SPREADS, A, B, 1 - stats.levene(A, B, center="median").pvalue)
    assert contrast.means == pytest.approx(((4.5 + 0 + 3.5 + 1.5 + 0.5) / 5, (1.25 + 0.25 + 2.75 + 0.25) / 4))
    assert contrast.simultaneous.low == pytest.approx(0, abs=1e-12)


def test_spreads_have_welchs_interval_of_the_logarithm_of_their_ratio() -> None:
    """Distances in proportion to their means, 2 and 1.125, have the standard errors of the logarithms."""
    distances_a, distances_b = np.array([4.5, 0, 3.5, 1.5, 0.5]), np.array([1.25, 0.25, 2.75, 0.25])
    welch = stats.ttest_ind(distances_a / 2, distances_b / 1.125, equal_var=False)
    contrast = compare("spread", A, B, LEVEL)
    assert contrast.means == pytest.approx((2, 1.125)) and contrast.effect == pytest.approx(np.log(2 / 1.125))
    low, high = ends(welch.confidence_interval(LEVEL))
    expected = contrast.effect + low, contrast.effect + high
    assert ends(contrast.simultaneous) == pytest.approx(expected)
    wider = compare("spread", 3 * np.array(A) + 7, B, LEVEL)  # which does not depend on units
    assert ends(wider.simultaneous) == pytest.approx(np.log(3) + np.array(expected))
    assert not compare("spread", [5.0, 5.0, 5.0], B).interval.exists


def test_equal_runs_have_clopper_and_pearsons_bound_between_known_ends() -> None:
    """Of 30 runs at 0 at most 1 - 0.025 ** (1 / 30), 11.6 %, are above; at 0.25 they are below, too."""
    most = 1 - 0.025 ** (1 / 30)
    zeros = contrasts.compare("mean", {"a": np.zeros(30)}, {}, constant=0.2, bounds=(0.0, 1.0))
    assert ends(zeros.interval) == pytest.approx((-0.2, most - 0.2))
    quarters = contrasts.compare("mean", {"a": np.full(30, 0.25)}, {}, bounds=(0.0, 1.0))
    assert ends(quarters.interval) == pytest.approx((0.25 - 0.25 * most, 0.25 + 0.75 * most))
    against = contrasts.compare("mean", {"a": np.zeros(30)}, {"b": np.array(B)}, bounds=(0.0, 5.0))
    half = stats.sem(B) * stats.t.ppf(0.975, 3)
    assert ends(against.interval) == pytest.approx((-2.625 - half, -2.625 + np.hypot(5 * most, half)))
    assert not contrasts.compare("mean", {"a": np.zeros(30)}, {}, bounds=(0.0, np.inf)).interval.exists


# --- Main effects, interactions, hazards -----------------------------------------------------------

FOUR = {
    "a": np.array(A),
    "b": np.array(B),
    "c": np.array([1.0, 4.0, 2.0]),
    "d": np.array([0.5, 3.0, 2.5, 2.0]),
}


def compare_named(kind: str, a: str, b: str) -> Contrast:
    """Compare some of the four groups with others."""
    return contrasts.compare(kind, {name: FOUR[name] for name in a}, {name: FOUR[name] for name in b})


def test_a_main_effect_is_the_mean_of_both_differences_and_an_interaction_their_difference() -> None:
    means = {name: runs.mean() for name, runs in FOUR.items()}
    main, interaction = compare_named("main-effect", "ac", "bd"), compare_named("interaction", "ac", "bd")
    first, second = means["a"] - means["b"], means["c"] - means["d"]
    assert main.effect == pytest.approx((first + second) / 2)
    assert interaction.means == pytest.approx((first, second))
    errors = np.array([runs.var(ddof=1) / runs.size / 4 for runs in FOUR.values()])
    freedom = errors.sum() ** 2 / sum(errors**2 / [runs.size - 1 for runs in FOUR.values()])
    half = stats.t.ppf(0.975, freedom) * errors.sum() ** 0.5
    assert ends(main.interval) == pytest.approx((main.effect - half, main.effect + half))
    low, high = first - second - 2 * half, first - second + 2 * half
    assert ends(interaction.interval) == pytest.approx((low, high))


def test_a_condition_on_both_sides_counts_with_the_sum_of_its_weights() -> None:
    """(a - b + b - c) / 2 is half of a - c; (a - b) - (b - d) has b twice."""
    main, welch = compare_named("main-effect", "ab", "bc"), stats.ttest_ind(A, FOUR["c"], equal_var=False)
    assert main.effect == pytest.approx((np.mean(A) - FOUR["c"].mean()) / 2)
    low, high = ends(welch.confidence_interval(0.95))
    assert ends(main.interval) == pytest.approx((low / 2, high / 2))
    interaction = compare_named("interaction", "ab", "bd")
    assert interaction.effect == pytest.approx(np.mean(A) - 2 * np.mean(B) + FOUR["d"].mean())
    assert sum(ends(interaction.interval)) / 2 == pytest.approx(interaction.effect)


def test_a_hazard_is_the_log_rank_tests() -> None:
    """Its z, and by hand: of three runs against three one gets there at 1, when it is one of six."""
    generator = np.random.default_rng(11)
    times = [generator.exponential(scale, 20).round(1) for scale in (2.0, 1.0)]
    groups = [np.array([np.minimum(until, 1.5), until < 1.5]) for until in times]
    contrast = compare("hazard", groups[0], groups[1])
    censored = [
        stats.CensoredData(uncensored=group[0][group[1] == 1], right=group[0][group[1] == 0])
        for group in groups
    ]
    z = contrast.effect / ((contrast.interval.high - contrast.interval.low) / 2 / stats.norm.ppf(0.975))
    assert z == pytest.approx(stats.logrank(*censored).statistic)
    assert contrast.means == pytest.approx([group[1].mean() for group in groups])
    one_of_three, none_of_three = np.array([[1.0, 9, 9], [1, 0, 0]]), np.array([[9.0, 9, 9], [0, 0, 0]])
    assert compare("hazard", one_of_three, none_of_three).effect == pytest.approx((1 - 1 / 2) / (1 / 4))
    none = compare("hazard", none_of_three, none_of_three)
    assert not none.interval.exists and none.reason == "no run gets there"


# --- Without an interval ---------------------------------------------------------------------------

FEW, EQUAL, AS_FAR = "at least 2 runs", "all runs of a group are equal", "equally far from their median"


@pytest.mark.parametrize(
    ("kind", "a", "b", "reason"),
    [
        ("mean", [1.0], [1.0, 2.0], FEW),
        ("mean", [0.0, 20.0] * 5, [10.0] * 10, EQUAL),  # an even split, against equal runs
        ("mean", [0.1 + 0.2, 0.3] * 4, A, EQUAL),  # they differ by rounding alone
        ("mean", [3.0] * 4, 1.0, EQUAL),
        ("spread", [0.0, 1.0], [0.5, 0.5], EQUAL),
        ("spread", [0.0, 1.0], A, AS_FAR),  # as two runs always are
        ("spread", [0.0, 20.0] * 15, A, AS_FAR),
    ],
)
def test_groups_that_do_not_show_how_runs_differ_have_no_interval(
    kind: str, a: list[float], b: list[float] | float, reason: str
) -> None:
    results = [compare(kind, a, b)]
    if isinstance(b, list):
        results.append(compare(kind, b, a))
    for contrast in results:
        assert np.isnan([*ends(contrast.interval), *ends(contrast.simultaneous)]).all()
        assert not contrast.simultaneous.exists and reason in contrast.reason


def test_no_range_with_a_group_that_does_not_vary_has_an_interval() -> None:
    contrast = compare_ranges([A, B, [1.0] * 5], [0, 2], [1, 2])
    assert EQUAL in contrast.reason and not contrast.interval.exists


# --- Ranges ----------------------------------------------------------------------------------------


def test_a_range_of_two_groups_against_a_number_is_welchs_difference() -> None:
    """One of two steps must be greater, hence half the error rate; all must be smaller, hence the whole."""
    contrast, welch = compare_ranges([B, A], [0, 1], 2.0), stats.ttest_ind(A, B, equal_var=False)
    assert contrast.effect == pytest.approx(6.3 - 2.625 - 2)
    assert contrast.means == pytest.approx((6.3 - 2.625, 2.0))
    assert contrast.interval.low == pytest.approx(welch.confidence_interval(0.975).low - 2)
    assert contrast.interval.high == pytest.approx(welch.confidence_interval(0.95).high - 2)


def test_ranges_turn_with_their_sides_and_not_with_signs() -> None:
    groups = list(np.random.default_rng(11).normal(size=(5, 12)) + [[0.0], [4.0], [1.0], [0.0], [1.0]])
    contrast = compare_ranges(groups, [0, 1, 2], [3, 4])
    turned = compare_ranges(groups, [3, 4], [0, 1, 2])
    assert turned.effect == pytest.approx(-contrast.effect)
    assert ends(turned.interval) == pytest.approx((-contrast.interval.high, -contrast.interval.low))
    negative = compare_ranges([-group for group in groups], [0, 1, 2], [3, 4])
    assert ends(negative.interval) == pytest.approx(ends(contrast.interval))


def test_a_group_on_both_sides_cancels_where_both_step_alike() -> None:
    """Of (0, 1) and (0, 2) the widest steps are from 0: their difference is that of 1 and 2, without 0."""
    noise = np.random.default_rng(11).normal(size=(3, 12))
    groups = [100 * noise[0], noise[1] + 900, noise[2] + 300]
    contrast = compare_ranges(groups, [0, 1], [0, 2])
    assert contrast.effect == pytest.approx(groups[1].mean() - groups[2].mean())
    welch = stats.ttest_ind(groups[1], groups[2], equal_var=False)
    assert contrast.interval.high == pytest.approx(welch.confidence_interval(0.975).high)


@pytest.mark.parametrize("means", [(0, 0, 0, 0, 0, 0), (0, 0, 3, 0, 3, 3)])
def test_equal_ranges_are_seldom_told_apart(means: tuple[float, ...]) -> None:
    generator, told_apart = np.random.default_rng(3), 0
    for groups in generator.normal(size=(200, 6, 10)) + np.array(means)[:, None]:
        interval = compare_ranges(groups, [0, 1, 2], [3, 4, 5]).interval
        told_apart += interval.low > 0 or interval.high < 0
    assert told_apart / 200 < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 200)
