"""Contrasts: effects and intervals as SciPy has them, their laws, and what has no interval."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy import stats

from pneuma.analysis.claims.contrasts import Contrast, compare, compare_arms
from pneuma.analysis.intervals import Interval

A, B = [3.0, 7.5, 4.0, 9.0, 8.0], [1.0, 2.5, 5.0, 2.0]
LEVEL = 0.995


def rng() -> np.random.Generator:
    return np.random.default_rng(11)


def ends(interval: Interval | Any) -> tuple[float, float]:
    return interval.low, interval.high


def compare_ranges(
    arms: Sequence[ArrayLike], a: Sequence[int], b: Sequence[int] | float, level: float = 0.95
) -> Contrast:
    """Compare the range of some arms, by their places, with that of others or with a number."""

    def named(places: Sequence[int]) -> dict[str, np.ndarray]:
        return {str(place): np.array(arms[place]) for place in places}

    if isinstance(b, float):
        return compare_arms("range", named(a), {}, level, constant=b)
    return compare_arms("range", named(a), named(b), level)


def both(contrast: Contrast) -> list[float]:
    return [*ends(contrast.interval), *ends(contrast.simultaneous)]


def test_means_have_welchs_interval_and_students_against_a_number() -> None:
    contrast, scipy_test = compare("mean", A, B, LEVEL), stats.ttest_ind(A, B, equal_var=False)
    assert contrast.effect == pytest.approx(6.3 - 2.625) and contrast.means == pytest.approx((6.3, 2.625))
    assert contrast.seeds == (5, 4) and contrast.reason == ""
    assert ends(contrast.interval) == pytest.approx(ends(scipy_test.confidence_interval(0.95)))
    assert ends(contrast.simultaneous) == pytest.approx(ends(scipy_test.confidence_interval(LEVEL)))
    contrast, scipy_test = compare("mean", A, 5.0, LEVEL), stats.ttest_1samp(np.array(A) - 5, 0)
    assert contrast.effect == pytest.approx(1.3) and contrast.means == pytest.approx((6.3, 5.0))
    assert contrast.seeds == (5, 0)
    assert ends(contrast.simultaneous) == pytest.approx(ends(scipy_test.confidence_interval(LEVEL)))


def test_shares_have_the_exact_interval_and_differ_as_far_as_both_together() -> None:
    """The distance of the ends from the shares, 4 of 5 and 1 of 4, squared and added."""
    a, b = (stats.binomtest(*counts).proportion_ci(LEVEL, "exact") for counts in ((4, 5), (1, 4)))
    contrast = compare("incidence", [1, 1, 1, 0, 1], 0.2, LEVEL)
    assert contrast.effect == pytest.approx(0.6) and contrast.means == pytest.approx((0.8, 0.2))
    assert ends(contrast.simultaneous) == pytest.approx((a.low - 0.2, a.high - 0.2))
    contrast = compare("incidence", [1, 1, 1, 0, 1], [0, 1, 0, 0], LEVEL)
    low = 0.55 - ((0.8 - a.low) ** 2 + (b.high - 0.25) ** 2) ** 0.5
    high = 0.55 + ((a.high - 0.8) ** 2 + (0.25 - b.low) ** 2) ** 0.5
    assert contrast.effect == pytest.approx(0.55) and ends(contrast.simultaneous) == pytest.approx(
        (low, high)
    )
    with pytest.raises(ValueError, match="0 or 1"):
        compare("incidence", [0.5, 1], [0, 1])


def test_spreads_have_the_interval_of_brown_and_forsythes_test() -> None:
    """It ends at 0 at the level at which SciPy's test just decides."""
    contrast = compare("spread", A, B, 1 - stats.levene(A, B, center="median").pvalue)
    assert contrast.effect == pytest.approx(
        (4.5 + 0 + 3.5 + 1.5 + 0.5) / 5 - np.mean([1.25, 0.25, 2.75, 0.25])
    )
    assert contrast.simultaneous.low == pytest.approx(0, abs=1e-12)
    far = [np.abs(np.array(arm) - np.median(arm)) for arm in (A, B)]
    assert ends(contrast.interval) == pytest.approx(ends(stats.ttest_ind(*far).confidence_interval(0.95)))


@pytest.mark.parametrize("kind", ["mean", "spread", "incidence"])
def test_turning_the_arms_turns_the_interval(kind: str) -> None:
    a = [0, 1, 1, 1, 1, 1] if kind == "incidence" else [3, 7.5, 4, 9, 8, 1]
    b = [0, 1, 0, 0, 0, 0] if kind == "incidence" else [1, 2.5, 5, 2, 3, 3.5]
    contrast, turned = compare(kind, a, b, LEVEL), compare(kind, b, a, LEVEL)
    low, high, lowest, highest = both(turned)
    assert both(contrast) == pytest.approx([-high, -low, -highest, -lowest])
    assert contrast.effect == pytest.approx(-turned.effect)


def test_units_do_not_matter() -> None:
    for kind in ("mean", "spread"):
        contrast = compare(kind, A, B)
        scaled = compare(kind, [1e6 * a - 3e8 for a in A], [1e6 * b - 3e8 for b in B])
        assert both(scaled) == pytest.approx([1e6 * end for end in both(contrast)])
    arms = [np.array([*A, *B]) + shift for shift in (0, 3, 1, 0)]
    large, small = (compare_ranges([arm * unit for arm in arms], [0, 1], [2, 3]) for unit in (1, 1e-9))
    assert both(small) == pytest.approx([1e-9 * end for end in both(large)], rel=1e-9)


# --- Main effects, interactions, hazards -----------------------------------------------------------

FOUR = {
    "a": np.array(A),
    "b": np.array(B),
    "c": np.array([1.0, 4.0, 2.0]),
    "d": np.array([0.5, 3.0, 2.5, 2.0]),
}


def pick(*names: str) -> dict[str, np.ndarray]:
    return {name: FOUR[name] for name in names}


def test_a_main_effect_of_one_pair_is_welchs_and_of_two_the_mean_of_both_differences() -> None:
    of_one_pair, welch = (
        compare_arms("main-effect", pick("a"), pick("b"), LEVEL),
        compare("mean", A, B, LEVEL),
    )
    assert both(of_one_pair) == pytest.approx(both(welch)) and of_one_pair.means == pytest.approx(welch.means)
    of_two_pairs = compare_arms("main-effect", pick("a", "c"), pick("b", "d"), LEVEL)
    means = {name: runs.mean() for name, runs in FOUR.items()}
    assert of_two_pairs.effect == pytest.approx((means["a"] - means["b"] + means["c"] - means["d"]) / 2)
    errors = np.array([runs.var(ddof=1) / runs.size / 4 for runs in FOUR.values()])
    freedom = errors.sum() ** 2 / sum(errors**2 / [runs.size - 1 for runs in FOUR.values()])
    half = stats.t.ppf((1 + LEVEL) / 2, freedom) * errors.sum() ** 0.5
    assert ends(of_two_pairs.simultaneous) == pytest.approx(
        (of_two_pairs.effect - half, of_two_pairs.effect + half)
    )


def test_an_interaction_is_the_difference_of_both_differences_and_twice_as_wide() -> None:
    contrast = compare_arms("interaction", pick("a", "c"), pick("b", "d"))
    main = compare_arms("main-effect", pick("a", "c"), pick("b", "d"))
    first, second = compare("mean", A, B), compare("mean", FOUR["c"], FOUR["d"])
    assert contrast.means == pytest.approx((first.effect, second.effect))
    assert contrast.effect == pytest.approx(first.effect - second.effect)
    widths = [effect.interval.high - effect.interval.low for effect in (contrast, main)]
    assert widths[0] == pytest.approx(2 * widths[1])


def test_a_hazard_is_the_log_rank_tests() -> None:
    """Its z, and by hand: of three runs against three one gets there at 1, when it is one of six."""
    generator = rng()
    times = [generator.exponential(scale, 20).round(1) for scale in (2.0, 1.0)]
    arms = [np.array([np.minimum(until, 1.5), until < 1.5]) for until in times]
    contrast = compare_arms("hazard", {"a": arms[0]}, {"b": arms[1]})
    censored = [stats.CensoredData(uncensored=arm[0][arm[1] == 1], right=arm[0][arm[1] == 0]) for arm in arms]
    z = contrast.effect / ((contrast.interval.high - contrast.interval.low) / 2 / stats.norm.ppf(0.975))
    assert z == pytest.approx(stats.logrank(*censored).statistic)
    assert contrast.means == pytest.approx([arm[1].mean() for arm in arms])
    three_runs = np.array([[1.0, 9, 9], [1, 0, 0]]), np.array([[9.0, 9, 9], [0, 0, 0]])
    hand = compare_arms("hazard", {"a": three_runs[0]}, {"b": three_runs[1]})
    assert hand.effect == pytest.approx((1 - 1 / 2) / (1 / 4))
    none = compare_arms("hazard", {"a": three_runs[1]}, {"b": three_runs[1]})
    assert not none.interval.exists and none.reason == "no run gets there"


# --- Without an interval ---------------------------------------------------------------------------

FEW, EQUAL, AS_FAR = "at least 2 runs", "all runs are equal", "equally far from their median"


@pytest.mark.parametrize(
    ("kind", "a", "b", "reason"),
    [
        ("mean", [], [1.0, 2.0], "no runs"),
        ("mean", [1.0], [1.0, 2.0], FEW),
        ("mean", [3.0] * 4, [1.0, 2.0, 3.0], EQUAL),
        ("mean", [0.0, 20.0] * 5, [10.0] * 10, EQUAL),  # an even split, against equal runs
        ("mean", [0.1 + 0.2, 0.3] * 4, A, EQUAL),  # they differ by rounding alone
        ("mean", [3.0] * 4, 1.0, EQUAL),
        ("spread", [0.0, 1.0], [0.5, 0.5], EQUAL),
        ("spread", [0.0, 1.0], A, AS_FAR),  # as two runs always are
        ("spread", [0.0, 20.0] * 15, A, AS_FAR),
    ],
)
def test_arms_that_do_not_show_how_runs_differ_have_no_interval(
    kind: str, a: list[float], b: list[float] | float, reason: str
) -> None:
    contrasts = [compare(kind, a, b)]
    if isinstance(b, list):
        contrasts.append(compare(kind, b, a))
    for contrast in contrasts:
        assert np.isnan(both(contrast)).all() and not contrast.simultaneous.exists
        assert reason in contrast.reason


def test_no_range_of_an_arm_that_does_not_vary_has_one() -> None:
    contrast = compare_ranges([A, B, [1.0] * 5], [0, 2], [1, 2])
    assert EQUAL in contrast.reason and not contrast.interval.exists
    assert FEW in compare_ranges([A, [1.0]], [0, 1], 2.0).reason


# --- Ranges ----------------------------------------------------------------------------------------


def _ladders() -> tuple[list[np.ndarray], list[np.ndarray]]:
    noise = rng().normal(size=(5, 12))
    return list(noise[:3] + [[0.0], [4.0], [1.0]]), list(noise[3:] + [[0.0], [1.0]])


def test_a_range_of_two_arms_against_a_number_is_welchs_difference() -> None:
    """One of two steps must be greater, hence half the error rate; all must be smaller, hence the whole."""
    (low, high, _), _ = _ladders()
    contrast, scipy_test = (
        compare_ranges([low, high], [0, 1], 2.0),
        stats.ttest_ind(high, low, equal_var=False),
    )
    assert contrast.effect == pytest.approx(high.mean() - low.mean() - 2)
    assert contrast.means == pytest.approx((high.mean() - low.mean(), 2.0))
    assert contrast.interval.low == pytest.approx(scipy_test.confidence_interval(0.975).low - 2)
    assert contrast.interval.high == pytest.approx(scipy_test.confidence_interval(0.95).high - 2)


def test_ranges_turn_with_their_ladders_and_not_with_signs() -> None:
    a, b = _ladders()
    contrast = compare_ranges([*a, *b], [0, 1, 2], [3, 4])
    for arms, first, second in (([*a, *b], [3, 4], [0, 1, 2]), ([*b, *a], [0, 1], [2, 3, 4])):
        turned = compare_ranges(arms, first, second)
        assert turned.effect == pytest.approx(-contrast.effect)
        assert ends(turned.interval) == pytest.approx((-contrast.interval.high, -contrast.interval.low))
    assert both(compare_ranges([-arm for arm in (*a, *b)], [0, 1, 2], [3, 4])) == pytest.approx(
        both(contrast)
    )


def test_an_arm_of_both_ladders_cancels_where_both_step_alike() -> None:
    """Of (0, 1) and (0, 2) the widest steps are from 0: their difference is that of 1 and 2, without 0."""
    noise = rng().normal(size=(3, 12))
    arms = [100 * noise[0], noise[1] + 900, noise[2] + 300]
    contrast = compare_ranges(arms, [0, 1], [0, 2])
    assert contrast.effect == pytest.approx(arms[1].mean() - arms[2].mean())
    scipy_interval = stats.ttest_ind(arms[1], arms[2], equal_var=False).confidence_interval(0.975)
    assert contrast.interval.high == pytest.approx(scipy_interval.high)


@pytest.mark.parametrize("means", [(0, 0, 0, 0, 0, 0), (0, 1, 2, 0, 1, 2), (0, 0, 3, 0, 3, 3)])
def test_equal_ranges_are_seldom_told_apart(means: tuple[float, ...]) -> None:
    generator, told_apart = np.random.default_rng(3), 0
    for arms in generator.normal(size=(400, 6, 10)) + np.array(means)[:, None]:
        interval = compare_ranges(arms, [0, 1, 2], [3, 4, 5]).interval
        told_apart += interval.low > 0 or interval.high < 0
    assert told_apart / 400 < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 400)
