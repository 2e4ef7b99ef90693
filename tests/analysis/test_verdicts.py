"""Verdicts from an interval by hand, how they are combined, and how often they are false."""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import pytest
from scipy import stats

from pneuma.analysis.claims.contrasts import compare
from pneuma.analysis.claims.verdicts import combine, decide
from pneuma.analysis.intervals import Interval, no_interval

DIRECTIONS = ("greater", "less", "different", "equal", "no-less")
S, R, I = "supported", "refuted", "inconclusive"  # noqa: E741


def verdicts(low: float, high: float, margin: float | None = 1.0, alike_counts: bool = True) -> list[str]:
    return [decide(Interval(low, high, "hand"), way, margin, alike_counts) for way in DIRECTIONS]


@pytest.mark.parametrize(
    ("ends", "expected"),
    [
        # greater, less, different, equal, no-less, with a margin of 1
        ((2.0, 3.0), [S, R, S, R, S]),
        ((0.5, 3.0), [S, R, S, I, S]),
        ((-0.5, 3.0), [I, I, I, I, S]),
        ((-2.0, 3.0), [I, I, I, I, I]),
        ((-0.5, 0.9), [R, R, R, S, S]),
        ((0.1, 0.9), [R, R, R, S, S]),  # a difference beyond doubt that is too small to count
        ((-0.9, -0.1), [R, R, R, S, S]),
        ((-3.0, 0.5), [I, I, I, I, I]),
        ((-3.0, -0.5), [R, S, S, I, I]),
        ((-3.0, -1.5), [R, S, S, R, R]),
        ((0.0, 3.0), [I, I, I, I, S]),  # an end at 0, or at the margin, shows nothing
        ((-1.0, 1.0), [I, I, I, I, I]),
    ],
)
def test_the_ends_of_the_interval_decide(ends: tuple[float, float], expected: list[str]) -> None:
    assert verdicts(*ends) == expected


def test_without_an_interval_nothing_is_decided() -> None:
    assert [decide(no_interval(), way, 1.0) for way in DIRECTIONS] == [I] * 5


def test_without_a_margin_no_difference_is_too_small() -> None:
    assert verdicts(0.001, 0.002, None) == [S, R, S, I, I]
    assert verdicts(-0.001, 0.001, None) == [I] * 5


def test_at_the_floor_of_play_only_a_shown_difference_counts() -> None:
    """What nobody learned may well be alike, and no loss."""
    assert verdicts(-0.1, 0.1, alike_counts=False) == [I] * 5
    assert verdicts(0.5, 3.0, alike_counts=False) == [S, R, S, I, I]
    assert verdicts(-3.0, -2.0, alike_counts=False) == [R, S, S, R, R]


# --- Several outcomes --------------------------------------------------------------------------------

U = "untestable"


@pytest.mark.parametrize(
    ("verdicts", "one", "every"),
    [
        ((S,), S, S),
        ((S, S), S, S),
        ((S, I), S, I),
        ((R, I), R, R),
        ((S, R), "mixed", R),
        ((I, I), I, I),
        ((S, U), S, U),  # what cannot be tested decides nothing and voids nothing …
        ((R, U), R, R),
        ((I, U), I, U),
        ((U, U), U, U),
        ((S, S, R), "mixed", R),
        ((S, U, R), "mixed", R),
    ],
)
def test_outcomes_together(verdicts: tuple[str, ...], one: str, every: str) -> None:
    assert (combine(verdicts), combine(verdicts, "all")) == (one, every)
    assert combine(verdicts[::-1]) == one


@pytest.mark.parametrize("truth", [*product((True, False), repeat=3)])
@pytest.mark.parametrize("need", ["one", "all"])
def test_a_claims_verdict_is_false_only_where_an_outcomes_is(truth: tuple[bool, ...], need: str) -> None:
    """Every combination of three outcomes' truths and verdicts."""
    holds = all(truth) if need == "all" else any(truth)
    false_ones = [R if so else S for so in truth]
    for told in product((S, R, I, U), repeat=3):
        verdict = combine(told, need)
        false = (verdict == R and all(truth)) or (verdict == S and not holds)
        assert not false or any(own == wrong for own, wrong in zip(told, false_ones, strict=True))


# --- How often they are false --------------------------------------------------------------------------

LISTS, ALPHA = 300, 0.05
MOST = ALPHA + 3 * np.sqrt(ALPHA * (1 - ALPHA) / LISTS)
DRAWS: dict[str, Callable[[np.random.Generator, int], np.ndarray]] = {
    "normal": lambda generator, runs: generator.normal(size=runs),
    "with ties": lambda generator, runs: np.round(generator.normal(size=runs)),
    "0 or 20, half each": lambda generator, runs: 20.0 * (generator.random(runs) < 0.5),
    "0 or 20, a fifth": lambda generator, runs: 20.0 * (generator.random(runs) < 0.2),
}


@pytest.mark.parametrize("runs", [2, 5, 30])
@pytest.mark.parametrize("draw", DRAWS)
def test_arms_alike_are_seldom_found_different(draw: str, runs: int) -> None:
    generator = np.random.default_rng(runs)
    for kind in ("mean", "spread"):
        arms = [(DRAWS[draw](generator, runs), DRAWS[draw](generator, runs)) for _ in range(LISTS)]
        told = [decide(compare(kind, *pair).interval, "different", None) for pair in arms]
        assert told.count(S) / LISTS <= MOST, kind


@pytest.mark.parametrize("runs", [2, 3, 5, 10, 30])
def test_arms_a_margin_apart_are_seldom_found_alike(runs: int) -> None:
    """With margins of one to four standard errors; a difference the other way is never found."""
    generator, told = np.random.default_rng(runs), []
    for place in range(LISTS):
        margin = (1 + place % 4) * np.sqrt(2 / runs)
        a, b = generator.normal(size=(2, runs))
        told.append(decide(compare("mean", a + margin, b).interval, "greater", margin))
    assert told.count(R) / LISTS <= MOST / 2


@pytest.mark.parametrize("runs", [2, 3, 5, 10, 30])
@pytest.mark.parametrize("apart", [0.0, 0.2, 0.4])
def test_shares_are_told_falsely_as_seldom_as_they_may(runs: int, apart: float) -> None:
    """Summed over all tables: that shares alike differ, or that those a margin apart do not."""
    counts = range(runs + 1)
    arms = [np.arange(runs) < count for count in counts]
    false = np.array(
        [
            [
                decide(
                    compare("incidence", a, b).interval, "greater" if apart else "different", apart or None
                )
                == (R if apart else S)
                for b in arms
            ]
            for a in arms
        ]
    )
    for share in np.linspace(0, 1 - apart, 21):
        chance = np.outer(stats.binom.pmf(counts, runs, share + apart), stats.binom.pmf(counts, runs, share))
        assert chance[false].sum() <= ALPHA


def test_two_runs_that_are_ten_times_as_far_apart_are_never_found_closer_together() -> None:
    """Of two runs an arm both are equally far from their median: a zero error once decided the opposite."""
    generator = np.random.default_rng(4)
    for a, b in zip(10 * generator.normal(size=(1000, 2)), generator.normal(size=(1000, 2)), strict=True):
        own = compare("spread", a, b)
        assert decide(own.simultaneous, "less", None) == I and "equally far" in own.reason
