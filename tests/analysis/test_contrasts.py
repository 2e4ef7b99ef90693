"""Contrasts: against SciPy's permutation tests, by their laws, and at what cannot be concluded."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy import stats

from pneuma.analysis import pvalues
from pneuma.analysis.contrasts import compare, compare_ranges
from pneuma.analysis.pvalues import relabel, share_table

A, B = [3.0, 7.5, 4.0, 9.0, 8.0], [1.0, 2.5, 5.0, 2.0]


def rng() -> np.random.Generator:
    return np.random.default_rng(11)


def by_scipy(a: Any, b: Any, alternative: str) -> float:
    def welch(x: np.ndarray, y: np.ndarray, axis: int) -> np.ndarray:
        return stats.ttest_ind(x, y, axis=axis, equal_var=False).statistic

    return stats.permutation_test(
        (np.array(a), np.array(b)), welch, vectorized=True, n_resamples=np.inf, alternative=alternative
    ).pvalue


def greater_p(a: Any, b: Any, alternative: str) -> float:
    """Return the greater of the p-values by relabelings and by Student's distribution."""
    by_student = stats.ttest_ind(a, b, equal_var=False, alternative=alternative).pvalue
    return max(by_scipy(a, b, alternative), by_student)


def test_means_are_tested_as_scipy_permutes_welchs_t() -> None:
    own = compare("mean", A, B, 0.5)
    assert own.effect == pytest.approx(6.3 - 2.625)
    assert own.p.greater == pytest.approx(greater_p(A, B, "greater"), abs=1e-12)
    assert own.p.less == pytest.approx(greater_p(A, B, "less"), abs=1e-12)
    below = greater_p([a - 0.5 for a in A], B, "less")
    above = greater_p([a + 0.5 for a in A], B, "greater")
    assert own.p.equivalent == pytest.approx(max(below, above), abs=1e-12)
    assert own.p.far_greater == pytest.approx(greater_p([a - 0.5 for a in A], B, "greater"), abs=1e-12)
    assert own.p.far_less == pytest.approx(greater_p([a + 0.5 for a in A], B, "less"), abs=1e-12)


def test_a_small_arm_that_spreads_wide_is_not_found_different_too_often() -> None:
    """Six runs against ten, ten times as far apart: relabelings alone would find five times as much."""
    generator = np.random.default_rng(3)
    a, b = 10 * generator.normal(size=(400, 6)), generator.normal(size=(400, 10))
    p = pvalues.mean_p_values(a, b, None, relabel(6, 10, generator, draws=1_000))
    assert (p.greater <= 0.005).mean() < 0.012


def test_values_that_differ_by_rounding_alone_are_equal() -> None:
    own = compare("mean", [0.1 + 0.2] * 8, [0.3] * 8, None)
    assert (own.p.greater, own.p.less) == (1.0, 1.0)


@pytest.mark.parametrize("kind", ["mean", "incidence"])
def test_turning_the_arms_turns_the_verdict(kind: str) -> None:
    a = [0, 1, 1, 1, 1, 1] if kind == "incidence" else [3, 7.5, 4, 9, 8, 1]
    b = [0, 1, 0, 0, 0, 0] if kind == "incidence" else [1, 2.5, 5, 2, 3, 3.5]
    own, turned = compare(kind, a, b, 0.5), compare(kind, b, a, 0.5)
    assert (own.p.greater, own.p.less) == pytest.approx((turned.p.less, turned.p.greater))
    assert own.p.equivalent == pytest.approx(turned.p.equivalent)
    assert own.effect == pytest.approx(-turned.effect)


def test_units_do_not_matter() -> None:
    own = compare("mean", A, B, 0.5)
    other = compare("mean", [1e6 * a - 3e8 for a in A], [1e6 * b - 3e8 for b in B], 0.5e6)
    assert (other.p.greater, other.p.equivalent) == pytest.approx((own.p.greater, own.p.equivalent))
    large, small = (compare("mean", [a * unit for a in A], 0.0, None) for unit in (1, 1e-9))
    assert small.p.greater == large.p.greater
    arms = [np.array([*A, *B]) + shift for shift in (0, 3, 1, 0)]
    large, small = (
        compare_ranges([arm * unit for arm in arms], [0, 1], [2, 3], 0.5 * unit) for unit in (1, 1e-9)
    )
    assert (small.p.greater, small.p.equivalent) == pytest.approx((large.p.greater, large.p.equivalent))


@pytest.mark.parametrize("margin", [0.0, 0.2])
def test_the_test_of_shares_holds_its_level_at_every_share(margin: float) -> None:
    """Summed over all tables: the chance of p ≤ 0.05 where the shares differ by exactly the margin."""
    runs_a, runs_b = 9, 12
    a, b = np.meshgrid(np.arange(runs_a + 1), np.arange(runs_b + 1), indexing="ij")
    p = share_table(runs_a, runs_b, margin)[a, b]
    sizes = []
    for share in np.linspace(0, 1 - margin, 77):
        chance = stats.binom.pmf(a, runs_a, share + margin) * stats.binom.pmf(b, runs_b, share)
        sizes.append(chance[p <= 0.05].sum())
        assert chance[p <= 0.005].sum() <= 0.005 + 1e-6
    assert max(sizes) <= 0.05 + 1e-6
    assert max(sizes) > 0.03  # and is of use


def test_one_mean_is_tested_by_turning_signs() -> None:
    differences = np.array([0.4, 1.1, -0.2, 0.9, 0.5, 0.7])
    own = compare("mean", differences + 3, 3.0, None)
    theirs = stats.permutation_test(
        (differences,), np.mean, permutation_type="samples", n_resamples=np.inf, alternative="greater"
    ).pvalue
    by_student = stats.ttest_1samp(differences, 0, alternative="greater").pvalue
    assert own.p.greater == pytest.approx(max(theirs, by_student), abs=1e-12)


def test_one_arms_share_is_tested_as_scipys_binomial() -> None:
    own = compare("incidence", [1, 1, 1, 0, 1], 0.2, 0.1)
    assert own.p.greater == pytest.approx(stats.binomtest(4, 5, 0.2, "greater").pvalue)
    assert own.p.less == pytest.approx(stats.binomtest(4, 5, 0.2, "less").pvalue)
    assert own.effect == pytest.approx(0.6)


def test_a_margin_that_reaches_past_an_end_of_the_scale_binds_on_the_other_side_alone() -> None:
    """None of 50 with the event: at a true share of 0.05 + 0.1 that has a chance of 0.85 ** 50."""
    never, always = [0.0] * 50, [1.0] * 50
    assert compare("incidence", never, 0.05, 0.1).p.equivalent == pytest.approx(0.85**50)
    assert compare("incidence", always, 0.95, 0.1).p.equivalent == pytest.approx(0.85**50)


def test_equal_runs_are_handled_without_a_warning() -> None:
    apart = compare("mean", [3.0] * 4, [5.0] * 4, 0.5)
    assert apart.p.less == pytest.approx(1 / 70) and not apart.interval.exists
    same = compare("mean", [3.0] * 4, [3.0] * 4, 0.5)
    assert (same.p.greater, same.p.less) == (1, 1) and same.p.equivalent == pytest.approx(1 / 70)


def test_a_margin_that_reaches_no_event_at_all_is_kept_by_no_event() -> None:
    """Of a share of 0.1 +- 0.1, no event in 50 runs is surer to be within than one."""
    counts = [np.arange(50) < count for count in (0, 1, 2)]
    p = [compare("incidence", runs * 1.0, 0.1, 0.1).p.equivalent for runs in counts]
    assert p == pytest.approx([0.8**50, stats.binom.cdf(1, 50, 0.2), stats.binom.cdf(2, 50, 0.2)])


# --- Spreads and ranges ------------------------------------------------------------------------------


def test_spreads_are_tested_as_scipy_does_by_brown_and_forsythe() -> None:
    own = compare("spread", A, B, None)
    assert own.p_different == pytest.approx(stats.levene(A, B, center="median").pvalue)
    assert own.effect == pytest.approx((4.5 + 0 + 3.5 + 1.5 + 0.5) / 5 - np.mean([1.25, 0.25, 2.75, 0.25]))
    narrow, wide = rng().normal(size=(2, 31)) * [[1.0], [3.0]]
    own = compare("spread", narrow, wide, None)
    assert own.p.less == pytest.approx(stats.levene(narrow, wide, center="median").pvalue / 2)
    low, high = own.interval.low, own.interval.high
    at_end = compare("spread", narrow, wide, -low)  # 2.5 % below its low end
    assert low < high < 0 and at_end.p.no_less == pytest.approx(0.025)


def _ladders() -> tuple[list[np.ndarray], list[np.ndarray]]:
    noise = rng().normal(size=(5, 12))
    return list(noise[:3] + [[0.0], [4.0], [1.0]]), list(noise[3:] + [[0.0], [1.0]])


def test_a_range_of_two_arms_against_a_number_is_welchs_test_of_their_difference() -> None:
    """The step that is not so great as it is turned counts too, so that the p-value is doubled."""
    (low, high, _), _ = _ladders()
    own = compare_ranges([low, high], [0, 1], 2.0, None)
    theirs = stats.ttest_ind(high - 2.0, low, equal_var=False, alternative="greater").pvalue
    assert own.effect == pytest.approx(high.mean() - low.mean() - 2)
    assert own.p.greater == pytest.approx(2 * theirs)
    assert own.p.less == pytest.approx(1 - theirs)  # every step must be smaller


def test_ranges_turn_with_their_ladders_and_with_signs() -> None:
    a, b = _ladders()
    own = compare_ranges([*a, *b], [0, 1, 2], [3, 4], 1.0)
    for arms, first, second in (([*a, *b], [3, 4], [0, 1, 2]), ([*b, *a], [0, 1], [2, 3, 4])):
        other = compare_ranges(arms, first, second, 1.0)
        assert other.effect == pytest.approx(-own.effect)
        assert (other.p.less, other.p.far_less) == pytest.approx((own.p.greater, own.p.far_greater))
        assert other.p.equivalent == pytest.approx(own.p.equivalent)
        assert other.interval.low == pytest.approx(-own.interval.high)
    turned = compare_ranges([-arm for arm in (*a, *b)], [0, 1, 2], [3, 4], 1.0)
    assert turned.p.greater == pytest.approx(own.p.greater)


def test_the_ends_of_a_range_interval_are_where_the_test_just_decides() -> None:
    a, b = _ladders()
    own = compare_ranges([*a, *b], [0, 1, 2], [3, 4], None)
    assert own.interval.low > 0
    at_low = compare_ranges([*a, *b], [0, 1, 2], [3, 4], own.interval.low)
    assert at_low.p.far_greater == pytest.approx(0.025)
    at_high = compare_ranges([*a, *b], [0, 1, 2], [3, 4], own.interval.high)
    assert at_high.p.equivalent == pytest.approx(0.025)


@pytest.mark.parametrize("means", [(0, 0, 0, 0, 0, 0), (0, 1, 2, 0, 1, 2), (0, 0, 3, 0, 3, 3)])
def test_equal_ranges_are_seldom_told_apart(means: tuple[float, ...]) -> None:
    generator, found = np.random.default_rng(3), 0
    for arms in generator.normal(size=(400, 6, 10)) + np.array(means)[:, None]:
        own = compare_ranges(arms, [0, 1, 2], [3, 4, 5], None)
        found += 2 * min(own.p.greater, own.p.less) <= 0.05
    assert found / 400 < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 400)
