"""Seeds still needed, and crossed factors."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from pneuma.analysis import pvalues
from pneuma.analysis.crossed import factorial
from pneuma.analysis.design import seeds_needed
from pneuma.analysis.pvalues import relabel


def spaced(mean: float, deviation: float, runs: int = 10) -> np.ndarray:
    """Return runs of exactly that mean and sample deviation."""
    values = stats.norm.ppf((np.arange(runs) + 0.5) / runs)
    return mean + deviation * (values - values.mean()) / values.std(ddof=1)


def test_the_seeds_asked_for_decide_with_the_power_asked_for() -> None:
    """An effect of one deviation at 5 % takes 17 seeds an arm in every textbook."""
    needed = seeds_needed("mean", spaced(1, 1), spaced(0, 1), None, 0.05)
    assert needed is not None and 16 <= needed <= 18
    generator = np.random.default_rng(2)
    a, b = generator.normal(size=(2, 1_500, needed)) + [[[1.0]], [[0.0]]]
    p = pvalues.mean_p_values(a, b, None, relabel(needed, needed, generator, draws=1_000))
    assert (2 * p.greater <= 0.05).mean() == pytest.approx(0.8, abs=0.04)


def test_equivalence_may_decide_too() -> None:
    far, near = (seeds_needed("mean", spaced(0, 1), spaced(0, 1), m, 0.05) for m in (0.25, 1.0))
    assert far is not None and near is not None and near < far
    assert 17 <= near <= 20  # normal theory: 2 (1.645 + 1.282)² = 17.1
    assert seeds_needed("mean", spaced(0, 1), spaced(0, 1), None, 0.05) is None


def test_a_claim_of_no_difference_is_decided_by_what_lies_beyond_the_margin() -> None:
    """0.8 beyond a margin of 0.2 is an effect of 0.6 deviations: 2 (1.96 + 0.84)² / 0.36 = 44 seeds."""
    one, other = spaced(0.8, 1), spaced(0, 1)
    asked = [
        seeds_needed("mean", *arms, 0.2, 0.05, direction)
        for arms, direction in [
            ((one, other), "equal"), ((other, one), "equal"), ((one, other), "greater"),
        ]
    ]  # fmt: skip
    assert all(needed is not None and 44 <= needed <= 46 for needed in asked[:2])
    assert all(needed is not None and 25 <= needed <= 27 for needed in asked[2:])  # 2 · 2.8² / 0.64 = 24.5


def test_fewer_than_a_permutation_test_takes_are_never_asked_for() -> None:
    assert seeds_needed("mean", spaced(100, 1), spaced(0, 1), None, 0.05) == 4  # 2 / 70; of 3 it is 2 / 20
    assert seeds_needed("mean", spaced(100, 1), spaced(0, 1), None, 0.05 / 66) == 7


def crossed(runs: int, **effects: float) -> tuple[np.ndarray, dict[str, list[str]]]:
    """Return a 2 × 2 design: values, and the levels of x and y."""
    x, y = np.repeat([1, 1, -1, -1], runs), np.tile(np.repeat([1, -1], runs), 2)
    noise = np.random.default_rng(4).normal(size=4 * runs)
    values = effects.get("x", 0) * x + effects.get("y", 0) * y + effects.get("xy", 0) * x * y + noise
    return values, {"x": [str(i) for i in x], "y": [str(i) for i in y]}


def test_a_single_factor_is_the_analysis_of_variance() -> None:
    generator = np.random.default_rng(5)
    values, levels = generator.normal(size=21), ["a"] * 5 + ["b"] * 9 + ["c"] * 7
    (effect,) = factorial(values, {"x": levels}, generator)
    theirs = stats.f_oneway(values[:5], values[5:14], values[14:])
    assert effect.statistic == pytest.approx(theirs.statistic)
    assert effect.p_value == pytest.approx(theirs.pvalue, abs=0.03)


def test_effects_are_found_where_they_are_and_only_there() -> None:
    values, factors = crossed(8, x=1.0, xy=-1.0)
    found = {effect.factors: effect for effect in factorial(values, factors, np.random.default_rng(6))}
    assert found["x",].p_value < 0.001 and found["x", "y"].p_value < 0.001
    assert found["y",].p_value > 0.05
    cells = values.reshape(4, 8)
    error = cells.var(axis=1, ddof=1).mean()  # by hand: F = 32 (contrast of cell means / 4)² / error
    contrast = cells.mean(axis=1) @ [1, -1, -1, 1] / 4
    assert found["x", "y"].statistic == pytest.approx(32 * contrast**2 / error)


def test_unequal_cells_do_not_lend_one_factors_effect_to_another() -> None:
    generator = np.random.default_rng(7)
    x, y = [1] * 12 + [0] * 12, [1] * 10 + [0] * 2 + [1] * 2 + [0] * 10
    values = 3.0 * np.array(x) + generator.normal(size=24)
    found = {e.factors: e for e in factorial(values, {"x": map_text(x), "y": map_text(y)}, generator)}
    assert found["x",].p_value < 0.01 < found["y",].p_value


def test_a_factor_that_another_hides_has_no_p_value() -> None:
    levels = ["a", "a", "b", "b"] * 3
    found = factorial(np.arange(12.0), {"x": levels, "z": levels}, np.random.default_rng(8))
    assert all(math.isnan(effect.p_value) for effect in found)
    constant = factorial(np.ones(12), {"x": levels}, np.random.default_rng(8))
    assert constant[0].p_value == 1.0


def map_text(levels: list[int]) -> list[str]:
    return [str(level) for level in levels]
