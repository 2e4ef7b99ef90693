"""The design check: what so many seeds can tell, held against textbook formulas and against simulation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from pneuma.analysis.claims import load_claims
from pneuma.analysis.design import Plan, check_design, not_admitted
from pneuma.analysis.pvalues import share_table
from pneuma.study.store import Store

from .claim_files import HIGH, LOW, changed, judge_one, save_runs, write_files

PILOT = """
[pilot]
command = "pneuma study summary mine --seeds 50,51"
[pilot.spreads.text]
final-share-killed = 0.1
"collapsed above 0.5" = 0.1
[plausible]
final-share-killed = 0.3
collapsed = 0.5
"""
INCIDENCE = (
    (
        'outcome = "final-share-killed"\nkind = "mean"',
        'outcome = "collapsed"\nabove = 0.5\nkind = "incidence"',
    ),
    ("margin = 0.04\n", ""),
)


def plan_of(folder: Path, *changes: tuple[str, str], seeds: int | str = 50) -> Plan:
    text = changed(*changes).replace("seeds = 8", f"seeds = {seeds}") + PILOT
    (plan,) = check_design(load_claims(write_files(folder, text)))
    return plan


def test_the_least_difference_is_found_with_the_power_asked_for(tmp_path: Path) -> None:
    """A normal arm that much above the other, at 5 %: four of five pairs of 50 runs show it."""
    plan = plan_of(tmp_path)
    assert plan.alpha == 0.05 and plan.seeds == (50, 50) and plan.reason == ""
    assert plan.detectable == pytest.approx(0.1 * np.sqrt(2 / 50) * (1.96 + 0.84), rel=0.02)
    generator = np.random.default_rng(1)
    a, b = generator.normal(0, 0.1, size=(2, 4_000, 50))
    p = stats.ttest_ind(a + plan.detectable, b, axis=1).pvalue
    assert (p <= 0.05).mean() == pytest.approx(0.8, abs=0.02)


def test_arms_of_unlike_size_have_welchs_degrees_of_freedom(tmp_path: Path) -> None:
    """Eight runs against 50, at one in a thousand: with 56 degrees of freedom power would be half."""
    plan = plan_of(
        tmp_path, ("[defaults]", "[list]\nalpha = 0.001\n[defaults]"), seeds="{ high = 8, low = 50 }"
    )
    assert plan.detectable is not None
    generator = np.random.default_rng(1)
    a, b = generator.normal(0, 0.1, (20_000, 8)), generator.normal(0, 0.1, (20_000, 50))
    p = stats.ttest_ind(a + plan.detectable, b, axis=1, equal_var=False).pvalue
    assert (p <= 0.001).mean() == pytest.approx(0.8, abs=0.05)


def test_so_few_seeds_cannot_decide_what_is_plausible(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, seeds=4)
    assert plan.reason == "" and plan.detectable is not None and 0.2 < plan.detectable < 0.3
    few = plan_of(tmp_path, ("margin = 0.04", "margin = 0.04\nplausible = 0.1"), seeds=4)
    assert few.reason.startswith("cannot be decided with so many seeds (8 runs): the least difference")
    assert plan_of(tmp_path, seeds=3).detectable == np.inf  # the smallest p of 3 against 3 is 2 / 20


def test_equivalence_is_planned_by_the_margin_that_can_be_shown(tmp_path: Path) -> None:
    """0.1 sqrt(2 / 50) (1.66 + 1.28) = 0.0588 for arms alike: past a margin of 0.04, within one of 0.06."""
    equal = ('"greater"', '"equal"')
    plan = plan_of(tmp_path, equal)
    assert plan.provable == pytest.approx(0.0588, abs=2e-4)
    assert plan.reason.endswith("arms alike are shown to lie within 0.0589, and the margin is 0.04")
    assert plan_of(tmp_path, equal, ("margin = 0.04", "margin = 0.06")).reason == ""


@pytest.mark.parametrize("against", ['b = "low"', "value = 0.1"])
def test_a_share_is_planned_by_exact_chances(against: str, tmp_path: Path) -> None:
    """From the pilot's share of 0.1 of runs, or a constant: the first of whole percents that is found."""
    plan = plan_of(tmp_path, *INCIDENCE, ('b = "low"', against))
    assert plan.detectable is not None
    counts = np.arange(51)
    for share, enough in ((0.1 + plan.detectable, True), (0.09 + plan.detectable, False)):
        chance = stats.binom.pmf(counts, 50, share)
        if against.startswith("b"):
            both = np.outer(chance, stats.binom.pmf(counts, 50, 0.1))
            p = share_table(50, 50)
            power = both[2 * p <= 0.05].sum()
        else:
            p = np.array([stats.binomtest(int(k), 50, 0.1, "greater").pvalue for k in counts])
            power = chance[2 * p <= 0.05].sum()
        assert (power >= 0.8) == enough


def test_equal_shares_are_planned_by_the_margin_of_two_exact_tests(tmp_path: Path) -> None:
    """Of 50 runs against 0.4: within the margin from above and from below, at 5 % each."""
    equal = ('direction = "greater"', 'direction = "equal"\nmargin = 0.2')
    plan = plan_of(tmp_path, *INCIDENCE, ('b = "low"', "value = 0.4"), equal)
    counts, powers = np.arange(51), []
    two_arms = plan_of(tmp_path, *INCIDENCE, equal).provable  # about sqrt(0.18 / 50) (1.645 + 1.28)
    assert plan.provable is not None and two_arms == pytest.approx(0.176, abs=0.03)
    for margin in (plan.provable, plan.provable - 0.01):
        above, below = stats.binom.cdf(counts, 50, 0.4 + margin), stats.binom.sf(counts - 1, 50, 0.4 - margin)
        powers.append(stats.binom.pmf(counts, 50, 0.4)[np.maximum(above, below) <= 0.05].sum())
    assert powers[1] < 0.8 <= powers[0]


def test_a_claim_that_cannot_be_decided_is_not_admitted(store: Store, tmp_path: Path) -> None:
    """Though its runs are there; of two outcomes one is enough."""
    low = PILOT.replace("final-share-killed = 0.3", "final-share-killed = 0.01\nfinal-return = 0.01")
    text = changed(('"final-share-killed"', '["final-share-killed", "final-return"]')) + low
    save_runs(store, tmp_path, {"high": HIGH, "low": LOW})
    one = judge_one(store, tmp_path, text)
    assert one.standing == "could not be decided"
    assert one.reason.startswith("not admitted: cannot be decided with so many seeds (16 runs)")
    enough = text.replace("final-return = 0.01", "final-return = 9").replace(
        "[pilot.spreads.text]", "[pilot.spreads.text]\nfinal-return = 0.1"
    )
    assert not_admitted(load_claims(write_files(tmp_path, enough))) == {}
