"""How many seeds each group needs: against textbooks, and simulated studies judged by the interval."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from pneuma.analysis.intervals import difference_interval, incidence_difference_interval
from pneuma.analysis.power import power_of_shares, seeds_for_means, seeds_for_shares, seeds_table
from pneuma.store.store import Store

from ..hand_made import healthy, learning, one_action, save_collapse, study_of


@pytest.mark.parametrize(("effect", "seeds"), [(0.2, 394), (0.5, 64), (0.8, 26), (1.0, 17)])
def test_equal_spreads_need_what_cohens_tables_say(effect: float, seeds: int) -> None:
    """Cohen (1988), Table 2.4.1: two-sided, alpha 0.05, power 0.8."""
    assert seeds_for_means(effect, 1, 1) == pytest.approx(seeds, abs=1)


@pytest.mark.parametrize(("effect", "seeds"), [(0.5, 34), (0.8, 15), (1.0, 10), (5.8, 3)])
def test_a_group_without_spread_needs_what_a_single_sample_does(effect: float, seeds: int) -> None:
    """Welch's degrees of freedom are then the other group's, n - 1; seeds of G*Power's one-sample t."""
    assert seeds_for_means(effect, 1, 1e-9) == seeds_for_means(effect, 1e-9, 1) == seeds


def test_a_stricter_level_needs_what_cohens_tables_say() -> None:
    """Cohen (1988), Table 2.4.1: two-sided, alpha 0.01, power 0.8, effect 0.5."""
    assert seeds_for_means(0.5, 1, 1, level=0.99) == pytest.approx(96, abs=1)
    strict, usual = (seeds_for_shares(0.9, 0.1, level=level) for level in (0.999, 0.95))
    assert strict and usual and strict > usual


def test_simulated_studies_find_a_difference_that_often() -> None:
    generator = np.random.default_rng(1)
    seeds = seeds_for_means(0.05, 0.03, 0.06)
    assert seeds
    found = 0
    for _ in range(2000):
        ends = difference_interval(generator.normal(0.05, 0.03, seeds), generator.normal(0, 0.06, seeds))
        found += ends.low > 0 or ends.high < 0
    assert found / 2000 == pytest.approx(0.8, abs=0.03)


def test_shares_are_summed_over_every_outcome() -> None:
    seeds, found = 6, 0.0
    for a in range(seeds + 1):
        for b in range(seeds + 1):
            ends = incidence_difference_interval(a, seeds, b, seeds)
            chance = stats.binom.pmf(a, seeds, 0.9) * stats.binom.pmf(b, seeds, 0.1)
            found += chance * (ends.low > 0 or ends.high < 0)
    assert power_of_shares(0.9, 0.1, seeds) == pytest.approx(found)
    fewest = seeds_for_shares(0.9, 0.1)
    assert fewest and power_of_shares(0.9, 0.1, fewest) >= 0.8 > power_of_shares(0.9, 0.1, fewest - 1)


def test_no_number_of_seeds_finds_nothing() -> None:
    assert seeds_for_means(0, 1, 1) is None
    assert seeds_for_shares(0.5, 0.5) is None


def test_shares_above_or_below_the_baselines_differ_by_as_much_and_none_by_more(store: Store) -> None:
    """Of the baseline's runs half collapsed: 0.4 more or less is possible, 0.6 is not."""
    cells = {("a", 0): "a0" * 8, ("a", 1): "a1" * 8, ("b", 0): "b0" * 8, ("b", 1): "b1" * 8}
    for run_id in cells.values():
        save_collapse(store, run_id, healthy(), learning())
    save_collapse(store, "a1" * 8, one_action(61), learning())
    study_data = study_of(store, cells)
    possible, impossible = (seeds_table(study_data, "collapsed", difference) for difference in (0.4, 0.6))
    assert possible["seeds"].tolist() == [str(seeds_for_shares(0.5, 0.9))]
    assert impossible["seeds"].tolist() == ["no shares differ so much"]
