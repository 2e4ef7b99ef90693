"""Verdicts from an interval by hand, how they are combined, and how often they are false."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy import stats

from pneuma.analysis.claims.claim_list import RULES_BEFORE
from pneuma.analysis.claims.verdicts import combine, decide
from pneuma.analysis.intervals import Interval, no_interval

from .two_groups import compare

DIRECTIONS = ("greater", "less", "different", "equal", "no-less")
S, R, I, U = "holds", "does not hold", "undecided", "not tested"  # noqa: E741


@pytest.mark.parametrize(
    ("ends", "margin", "alike_counts", "expected"),
    [
        # expected of greater, less, different, equal, no-less
        ((2.0, 3.0), 1.0, True, [S, R, S, R, S]),
        ((0.5, 3.0), 1.0, True, [S, R, S, I, S]),
        ((-0.5, 3.0), 1.0, True, [I, I, I, I, S]),
        ((-2.0, 3.0), 1.0, True, [I, I, I, I, I]),
        ((-0.5, 0.9), 1.0, True, [R, R, R, S, S]),
        ((0.1, 0.9), 1.0, True, [R, R, R, S, S]),  # beyond doubt, but too small to count
        ((-0.9, -0.1), 1.0, True, [R, R, R, S, S]),
        ((-3.0, 0.5), 1.0, True, [I, I, I, I, I]),
        ((-3.0, -0.5), 1.0, True, [R, S, S, I, I]),
        ((-3.0, -1.5), 1.0, True, [R, S, S, R, R]),
        ((0.0, 3.0), 1.0, True, [I, I, I, I, S]),  # an end at 0, or at the margin, shows nothing
        ((-1.0, 1.0), 1.0, True, [I, I, I, I, I]),
        (None, 1.0, True, [I, I, I, I, I]),  # no interval
        ((0.001, 0.002), None, True, [S, R, S, I, I]),  # without a margin none is too small
        ((-0.001, 0.001), None, True, [I, I, I, I, I]),
        # what nobody learned may well be alike, and no loss
        ((-0.1, 0.1), 1.0, False, [I, I, I, I, I]),
        ((0.1, 0.9), 1.0, False, [I, I, I, I, I]),  # nor does a small difference count there
        ((0.5, 3.0), 1.0, False, [S, R, S, I, I]),
        ((-3.0, -2.0), 1.0, False, [R, S, S, R, R]),
    ],
)
def test_the_ends_of_the_interval_decide(
    ends: tuple[float, float] | None, margin: float | None, alike_counts: bool, expected: list[str]
) -> None:
    interval = Interval(*ends, "hand") if ends else no_interval()
    assert [decide(interval, way, margin, alike_counts) for way in DIRECTIONS] == expected
    assert decide(interval, "described", margin, alike_counts) == "described"


def test_by_the_rules_before_a_small_difference_of_agents_that_learned_nothing_counted() -> None:
    interval = Interval(0.1, 0.9, "hand")
    assert decide(interval, "greater", 1.0, alike_counts=False, rules=RULES_BEFORE) == S
    assert decide(interval, "greater", 1.0, alike_counts=True, rules=RULES_BEFORE) == R


# --- Several outcomes --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("verdicts", "one", "every"),
    [
        ((S,), S, S),
        ((S, S), S, S),
        ((S, I), S, I),
        ((R, I), R, R),
        ((S, R), "undecided", R),
        ((I, I), I, I),
        ((S, U), S, U),  # what cannot be tested decides nothing and voids nothing …
        ((R, U), R, R),
        ((I, U), I, U),
        ((U, U), U, U),
        ((S, S, R), "undecided", R),
        ((S, U, R), "undecided", R),
    ],
)
def test_outcomes_together(verdicts: tuple[str, ...], one: str, every: str) -> None:
    assert (combine(verdicts, "one"), combine(verdicts, "all")) == (one, every)
    assert combine(verdicts[::-1], "one") == one


@pytest.mark.parametrize("need", ["one", "all"])
def test_a_claims_verdict_is_false_only_where_an_outcomes_is(need: str) -> None:
    """Every combination of three outcomes' truths and verdicts."""
    for truth, verdicts in product(product((True, False), repeat=3), product((S, R, I, U), repeat=3)):
        holds = all(truth) if need == "all" else any(truth)
        verdict = combine(verdicts, need)
        is_false = (verdict == R and all(truth)) or (verdict == S and not holds)
        wrong = [R if so else S for so in truth]
        assert not is_false or any(own == other for own, other in zip(verdicts, wrong, strict=True))


# --- How often they are false --------------------------------------------------------------------------


@pytest.mark.parametrize("runs", [2, 3, 5, 10, 30])
@pytest.mark.parametrize(
    ("apart", "way", "wrong"), [(0.0, "different", S), (0.2, "greater", R), (0.4, "greater", R)]
)
def test_shares_are_told_falsely_as_seldom_as_they_may(runs: int, apart: float, way: str, wrong: str) -> None:
    """Summed over all tables: that shares alike differ, or that those a margin apart do not."""
    counts = range(runs + 1)
    false = np.zeros((runs + 1, runs + 1), bool)
    for place in np.ndindex(false.shape):
        a, b = (np.arange(runs) < count for count in place)
        false[place] = decide(compare("incidence", a, b).interval, way, apart or None) == wrong
    for share in np.linspace(0, 1 - apart, 21):
        chance = np.outer(stats.binom.pmf(counts, runs, share + apart), stats.binom.pmf(counts, runs, share))
        assert chance[false].sum() <= 0.05
