"""Verdicts on hand-made runs: every verdict, every reason for none, and what is never done."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from pneuma.analysis.claims.claim_list import load_claims
from pneuma.analysis.claims.words import lines
from pneuma.store.store import Store

from .claim_files import (
    BETTER,
    CLAIMS,
    HIGH,
    LOW,
    NEAR,
    changed,
    judge_claims,
    judge_one,
    published_alone,
    save_runs,
    write_files,
)

Shares = Sequence[float | Sequence[float]]
SharesByCondition = dict[str, Shares]
Changes = Sequence[tuple[str, str]]

NAN = float("nan")
HOLDS, FAILS, UNDECIDED, NOT_TESTED = "holds", "does not hold", "undecided", "not tested"
LESSER = [share - 0.15 for share in LOW]
GREATER = [share + 0.1 for share in LOW]
AROUND = [0.02 * (-1) ** k * (1 + k % 4) for k in range(8)]
"""Half of the runs lie above the random player and half below."""
ROUGH = [[own, -own, own] for own in AROUND]
SOON, LATE, NEVER = [0.6, 0.7], [0.1, 0.6], [0.1, 0.2]
"""Evaluations at 512 and 1,024 steps."""

PAIR, PAIRED = ('a = "high"', 'a = ["high", "other"]'), ('"low"', '["low", "middle"]\npaired = true')
CROSSED = ('"low"', '["low", "middle"]')
TWO = ('"final-share-killed"', '["final-share-killed", "final-return"]')
INCIDENCE = ('"mean"', '"incidence"\nabove = 0.5')
NO_MARGIN = ("margin = 0.04\n", "")
RANGES = (PAIR[0], 'a = ["low", "high"]'), ('b = "low"', 'b = ["middle", "low"]'), ('"mean"', '"range"')
ALL = ('"greater"', '"greater"\nneed = "all"')


def value(number: object) -> tuple[str, str]:
    return 'b = "low"', f"value = {number}"


def outcome(names: str) -> tuple[str, str]:
    return '"final-share-killed"', names


def direction(name: str) -> tuple[str, str]:
    return '"greater"', f'"{name}"'


CASES: dict[str, tuple[SharesByCondition, Changes, str, list[str]]] = {
    # name: (shares killed by condition, changes of the claim, verdict, those of its contrasts)
    "greater, and it is": ({"high": HIGH, "low": LOW}, [], HOLDS, [HOLDS]),
    "greater, and it is equal": ({"high": NEAR, "low": LOW}, [], FAILS, [FAILS]),
    "described": ({"high": HIGH, "low": LOW}, [direction("described")], "described", ["described"]),
    "more often above": ({"high": HIGH, "low": LOW}, [INCIDENCE, NO_MARGIN], HOLDS, [HOLDS]),
    "never there counts as not in time": (
        {"high": [SOON] * 8, "low": [NEVER] * 8},
        [outcome('"steps-to:0.5"'), (INCIDENCE[0], '"incidence"\nbelow = 1000')], HOLDS, [HOLDS],
    ),
    # a number refutes from its other side alone: it is itself what counts, without a margin
    "at a number": ({"high": HIGH}, [value(0.735)], UNDECIDED, [UNDECIDED]),
    "far below a number": ({"high": HIGH}, [value(0.77)], FAILS, [FAILS]),
    "one outcome against a number": (
        {"high": HIGH, "low": LOW}, [TWO, ('b = "low"', 'b = "low"\nvalue = { final-return = 0.5 }')],
        HOLDS, [HOLDS, HOLDS],
    ),
    "pairs": ({"high": LOW, "low": LESSER, "other": HIGH, "middle": NEAR}, [PAIR, PAIRED], HOLDS,
              [HOLDS] * 2),
    "each with each": ({"high": LOW, "low": LESSER, "other": HIGH, "middle": NEAR}, [PAIR, CROSSED], FAILS,
                       [HOLDS, FAILS, HOLDS, HOLDS]),
    "one pair without runs": ({"high": LOW, "low": HIGH}, [PAIR, PAIRED], FAILS, [FAILS, NOT_TESTED]),
    "ranges": ({"high": HIGH, "low": LOW, "middle": GREATER}, RANGES, HOLDS, [HOLDS]),
    # one outcome that cannot be tested voids nothing unless all are needed
    "rough where nobody learned": ({"high": ROUGH, "low": ROUGH[::-1]},
                                   [outcome('["curve-roughness", "final-return"]')], UNDECIDED,
                                   [NOT_TESTED, UNDECIDED]),
    "rough, all needed": ({"high": ROUGH, "low": ROUGH[::-1]},
                          [outcome('["curve-roughness", "final-return"]'), ALL], NOT_TESTED,
                          [NOT_TESTED, UNDECIDED]),
    "beside": ({"high": HIGH, "low": LOW}, [('"low"', '"low"\nbeside = "middle"')], HOLDS, [HOLDS]),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_every_verdict(case: str, store: Store, tmp_path: Path) -> None:
    shares, changes, verdict, of_contrasts = CASES[case]
    ids = save_runs(store, tmp_path, shares)
    one = judge_one(store, tmp_path, changed(*changes))
    assert (one.verdict, [row.verdict for row in one.contrasts]) == (verdict, of_contrasts)
    assert {*one.run_ids} == {*ids} and (one.reason == "") == (verdict != NOT_TESTED)


def test_two_measures_that_disagree_decide_nothing(store: Store, tmp_path: Path) -> None:
    """One is above its number and the other far below; which of them counts the judge cannot say."""
    save_runs(store, tmp_path, {"high": HIGH})
    numbers = ('b = "low"', "value = { final-share-killed = 0.5, final-return = 50 }")
    one = judge_one(store, tmp_path, changed(TWO, numbers))
    assert [row.verdict for row in one.contrasts] == [HOLDS, FAILS]
    assert (one.verdict, one.reason) == (UNDECIDED, "its two measures disagree")


def test_the_worlds_are_judged_side_by_side_each_as_a_family_of_its_own(store: Store, tmp_path: Path) -> None:
    like = '\n[claims.there]\nlike = "better"\nworlds = ["arena"]\nseeds_from = 3\nseeds = 5\n'
    save_runs(store, tmp_path, {"high": HIGH, "low": LOW})
    save_runs(store, tmp_path, {"high": LOW, "low": HIGH}, world="arena")
    text = CLAIMS.replace('["text"]', '["text", "godot"]') + like
    here, nowhere, there = judge_claims(store, tmp_path, text)
    assert [verdict.verdict for verdict in (here, nowhere, there)] == [HOLDS, NOT_TESTED, FAILS]
    assert (there.claim.row, there.claim.quote, len(there.run_ids)) == ("better", "a quote", 10)
    assert there.contrasts[0].contrast.effect == pytest.approx(np.mean(LOW[3:]) - np.mean(HIGH[3:]))
    claims = load_claims(write_files(tmp_path, text + BETTER.replace("better", "other")))
    assert [claims.family_size(world, "mine.toml") for world in ("text", "arena", "godot")] == [2, 1, 1]


def test_published_tables_of_any_study_give_the_same_verdicts_as_runs(store: Store, tmp_path: Path) -> None:
    save_runs(store, tmp_path, {"high": HIGH, "low": LOW})
    clone = published_alone(store, tmp_path, "another")
    assert judge_one(clone, tmp_path) == judge_one(store, tmp_path)


# --- Several outcomes ------------------------------------------------------------------------------


def test_the_outcome_that_supports_the_claim_decides(store: Store, tmp_path: Path) -> None:
    """The return supports it against both conditions, the share killed against one: that decides nothing."""
    scattered = [0.0, 1.0] * 4
    for condition, shares, returns in (("high", HIGH, HIGH), ("low", LOW, LOW), ("middle", scattered, LOW)):
        save_runs(store, tmp_path, {condition: shares}, returns=returns)
    verdict = judge_one(store, tmp_path, changed(TWO, CROSSED))
    verdicts = [contrast.verdict for contrast in verdict.contrasts]
    assert verdicts == [HOLDS, UNDECIDED, HOLDS, HOLDS]
    assert verdict.verdict == HOLDS
    assert [(contrast.outcome, contrast.names[1], contrast.verdict) for contrast in verdict.deciding] == [
        ("final-share-killed", "middle", UNDECIDED), ("final-return", "low", HOLDS),
    ]  # fmt: skip


# --- What is also shown -----------------------------------------------------------------------------


def test_where_a_margin_was_changed_both_verdicts_are_shown(store: Store, tmp_path: Path) -> None:
    """Means differ by 0.001, plus or minus 0.026."""
    save_runs(store, tmp_path, {"high": NEAR, "low": LOW})
    text = changed(("margin = 0.04", "margin = 0.04\nregistered_margin = 0.01"))
    verdict = judge_one(store, tmp_path, text)
    assert (verdict.verdict, verdict.registered_verdict) == (FAILS, UNDECIDED)
    assert "as registered: undecided" in lines(verdict)
    alike = judge_one(store, tmp_path)
    assert (alike.verdict, alike.registered_verdict) == (FAILS, FAILS)
    assert not any("registered" in line for line in lines(alike))


def test_unlike_numbers_of_runs_are_shown(store: Store, tmp_path: Path) -> None:
    save_runs(store, tmp_path, {"high": HIGH[:4], "low": LOW})
    verdict = judge_one(store, tmp_path, changed(("seeds = 8", "seeds = { high = 4, low = 8 }")))
    assert verdict.verdict == HOLDS and "4 against 8 runs" in lines(verdict)


def test_what_is_never_reached_counts_as_the_runs_budget(store: Store, tmp_path: Path) -> None:
    """Half of the runs of high get there at 512 of 1,024 steps, and two at four fifths of the way on."""
    save_runs(store, tmp_path, {"high": [SOON] * 4 + [LATE] * 2 + [NEVER] * 2, "low": [NEVER] * 8})
    (row,) = judge_one(store, tmp_path, changed(outcome('"steps-to:0.5"'), NO_MARGIN)).contrasts
    assert [*row.contrast.means] == pytest.approx([(4 * 512 + 2 * (512 + 0.8 * 512) + 2 * 1024) / 8, 1024])
    assert "equal" in row.contrast.reason and row.verdict == UNDECIDED


# --- What cannot be tested: every reason for which there is no verdict ----------------------------

REASONS: dict[str, tuple[SharesByCondition, Changes, str]] = {
    # name: (runs, changes of the claim, the reason)
    "A/A": (
        {"low": LOW}, [('a = "high"', 'a = "low-too"')],
        "what is compared is the same: low-too and low have one configuration",
    ),
    "engines": (
        {"reference": HIGH, "low": LOW}, [('a = "high"', 'a = "reference"')],
        "trained by different engines: reference by sb3, low by batched",
    ),
    "unlike rewards": (
        {"paid-for-kills": HIGH, "low": LOW},
        [('a = "high"', 'a = "paid-for-kills"'), outcome('"final-return"')],
        "returns of unlike rewards",
    ),
    "missing seeds": ({"high": HIGH[:5], "low": LOW}, [], "runs missing: high has 5 of the 8 fixed ones"),
    "nothing to cure": (
        {"high": NEAR, "low": LOW}, [INCIDENCE, ("margin = 0.04", "margin = 0.4"), direction("less")],
        "all runs end alike: at the floor, within 0.1 of 0",
    ),
    "ceiling": (
        {"high": [1 - k / 1000 for k in range(8)], "low": [1.0] * 8}, [direction("equal")],
        "all runs end alike: at the ceiling, within 0.04 of 1",
    ),
    "nobody could forget": (
        {"high": AROUND}, [value('"shuffled-fall"'), outcome('"late-fall"')],
        "the agents learned nothing there: high is not shown",
    ),
    "nobody learned": (
        {"high": ROUGH, "low": ROUGH}, [outcome('"curve-roughness"')],
        "the agents learned nothing there: high is not shown",
    ),
    "no value": ({"high": [*HIGH[:7], NAN], "low": LOW}, [], "a run has no value: high seed 7: "),
    "no value of the other outcome": (
        {"high": HIGH}, [value('"collapse-step"')], "a run has no value: high seed 0: no sign of collapse",
    ),
    "declared": ({"high": HIGH, "low": LOW}, [("margin", 'not_tested = "too short"\nmargin')], "too short"),
}  # fmt: skip


@pytest.mark.parametrize("case", REASONS)
def test_what_no_run_can_test(case: str, store: Store, tmp_path: Path) -> None:
    """It keeps its place in the correction."""
    runs, changes, reason = REASONS[case]
    save_runs(store, tmp_path, runs)
    verdict = judge_one(store, tmp_path, changed(*changes))
    assert verdict.verdict == NOT_TESTED and reason in verdict.reason
    assert load_claims(tmp_path / "claims.toml").family_size("text", "mine.toml") == 1


@pytest.mark.parametrize(("way", "expected"), [("greater", FAILS), ("equal", HOLDS), ("no-less", HOLDS)])
def test_at_the_floor_of_play_only_a_shown_difference_counts(
    way: str, expected: str, store: Store, tmp_path: Path
) -> None:
    """All runs are within the margin, which is 1; where one condition has learned, 0.5 counts as none."""
    text = changed(direction(way), ("margin = 0.04", "margin = 1"))
    save_runs(store, tmp_path, {"high": AROUND, "low": AROUND[::-1]})
    (row,) = judge_one(store, tmp_path, text).contrasts
    assert (row.verdict, row.none_learned) == (UNDECIDED, True)
    learned = Store(tmp_path / "learned")
    save_runs(learned, tmp_path, {"high": HIGH, "low": AROUND})
    (row,) = judge_one(learned, tmp_path, text).contrasts
    assert (row.verdict, row.none_learned) == (expected, False)


def test_at_the_floor_of_play_a_shown_difference_within_the_margin_decides_nothing(
    store: Store, tmp_path: Path
) -> None:
    """Both conditions play worse than at random, and one is better than the other by 0.05 of 0.1."""
    worse = [share - 0.5 for share in LOW]
    save_runs(store, tmp_path, {"high": [share + 0.05 for share in worse], "low": worse})
    text = changed(("margin = 0.04", "margin = 0.1"))
    (row,) = judge_one(store, tmp_path, text).contrasts
    assert (row.contrast.interval.low > 0, row.verdict, row.none_learned) == (True, UNDECIDED, True)
    (row,) = judge_one(store, tmp_path).contrasts  # a difference that may be more than 0.04 counts
    assert (row.verdict, row.none_learned) == (HOLDS, True)


def test_equal_runs_of_an_outcome_with_known_ends_have_an_interval(store: Store, tmp_path: Path) -> None:
    """Of all runs, at most a share of 1 - 0.025 ** (1 / 8), 37 %, is unlike eight equal ones."""
    save_runs(store, tmp_path, {"high": HIGH, "low": [0.0] * 8}, returns=HIGH)
    shares, returns = judge_one(store, tmp_path, changed(TWO)).contrasts
    level = 1 - 0.025  # a half of 0.05
    bound = 1 - (0.025 / 2) ** (1 / 8)
    half_width = stats.sem(HIGH) * stats.t.ppf((1 + level) / 2, 7)
    expected = np.mean(HIGH) - np.hypot(half_width, bound), np.mean(HIGH) + half_width
    interval = shares.contrast.simultaneous
    assert (interval.low, interval.high) == pytest.approx(expected)
    assert shares.verdict == HOLDS
    assert returns.contrast.interval.exists  # whose runs differ
