"""Verdicts on hand-made runs: every verdict, every reason for none, and what is never done."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from pneuma.analysis.claims.claim_list import load_claims
from pneuma.analysis.claims.verdicts import Verdict
from pneuma.analysis.claims.words import lines
from pneuma.store.store import Store

from .claim_files import (
    CLAIMS,
    HIGH,
    LOW,
    NEAR,
    SEEDS,
    WIDE,
    changed,
    judge_claims,
    judge_one,
    published_alone,
    save_runs,
    write_files,
)

# --- Verdicts --------------------------------------------------------------------------------------

CASES = {
    # name: (changes of the claim, runs of high, verdict)
    "greater, and it is": ((), HIGH, "supported"),
    "equal, and it is": ((('"greater"', '"equal"'),), NEAR, "supported"),
    "greater, and it is equal": ((), NEAR, "refuted"),
    "greater, and nothing is seen": ((), WIDE[::-1], "inconclusive"),
    "more often above, and it is": (
        (('"mean"', '"incidence"\nabove = 0.5'), ("margin = 0.04\n", "")), HIGH, "supported",
    ),
    "above a number, and it is": ((('b = "low"', "value = 0.3"),), HIGH, "supported"),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_every_verdict(case: str, store: Store, tmp_path: Path) -> None:
    changes, high, verdict = CASES[case]
    ids = save_runs(store, tmp_path, {"high": high, "low": LOW})
    one = judge_one(store, tmp_path, changed(*changes))
    assert (one.verdict, one.reason) == (verdict, "")
    assert one.run_ids == (ids[:SEEDS] if "number" in case else ids)


def test_a_run_that_never_gets_there_counts_among_those_that_were_not_there_in_time(
    store: Store, tmp_path: Path
) -> None:
    save_runs(store, tmp_path, {"high": [[0.6, 0.7]] * 8, "low": [[0.1, 0.2]] * 8})
    changes = ('"final-share-killed"', '"steps-to:0.5"'), ('"mean"', '"incidence"\nbelow = 1000')
    judged = judge_one(store, tmp_path, changed(*changes))
    assert judged.verdict == "supported"


def test_the_worlds_are_judged_side_by_side(store: Store, tmp_path: Path) -> None:
    claims = changed(('worlds = ["text"]\n', ""))
    save_runs(store, tmp_path, {"high": HIGH, "low": LOW})
    save_runs(store, tmp_path, {"high": LOW, "low": HIGH}, steps=1024, world="godot")
    verdicts = {one.world: one.verdict for one in judge_claims(store, tmp_path, claims)}
    assert verdicts == {"text": "supported", "godot": "refuted", "arena": "untestable"}


@pytest.mark.parametrize("study", ["mine", "another"])
def test_published_tables_give_the_same_verdicts_as_runs(study: str, store: Store, tmp_path: Path) -> None:
    """Whichever study they were published in: a run is the same run in all."""
    save_runs(store, tmp_path, {"high": HIGH, "low": LOW})
    clone = published_alone(store, tmp_path, study)
    assert judge_one(clone, tmp_path) == judge_one(store, tmp_path)


# --- What is never done ----------------------------------------------------------------------------


def test_seeds_that_the_claim_did_not_fix_are_not_read(store: Store, tmp_path: Path) -> None:
    save_runs(store, tmp_path, {"high": HIGH, "low": LOW})
    before = judge_one(store, tmp_path)
    save_runs(store, tmp_path, {"high": [*HIGH, *[0.0] * 20], "low": [*LOW, *[1.0] * 20]})
    assert judge_one(store, tmp_path) == before


MORE = CLAIMS[CLAIMS.index("[claims.better]") :].replace('a = "high"', 'a = "middle"')
"""A claim without runs."""


def _judge_among(count: int, store: Store, folder: Path) -> Verdict:
    """Judge the claim in a list of so many, of which the others have no runs."""
    more = "".join(MORE.replace("better", f"more-{k}") for k in range(count - 1))
    return judge_claims(store, folder, CLAIMS + more)[0]


def test_a_list_that_is_longer_asks_for_more(store: Store, tmp_path: Path) -> None:
    """Claims without runs count too: a verdict does not hang on what else has been run."""
    high = [share + 0.035 for share in LOW]
    save_runs(store, tmp_path, {"high": high, "low": LOW})
    alone, among = (_judge_among(count, store, tmp_path) for count in (1, 20))
    assert (alone.verdict, among.verdict) == ("supported", "inconclusive")
    welch = stats.ttest_ind(high, LOW, equal_var=False)
    for one, alpha in ((alone, 0.05), (among, 0.05 / 20)):
        (row,) = one.contrasts
        assert row.alpha == pytest.approx(alpha)
        assert row.contrast.simultaneous.low == pytest.approx(welch.confidence_interval(1 - alpha).low)
        assert row.contrast.interval.low == pytest.approx(welch.confidence_interval(0.95).low)


# --- Several outcomes, pairs, ranges, spreads, gaps ----------------------------------------------------


@pytest.mark.parametrize(
    ("shares", "verdict"),
    [
        ((HIGH, LOW, HIGH, LOW), "supported"),
        ((HIGH, LOW, LOW, HIGH), "mixed"),
    ],
)
def test_two_outcomes_are_judged_together(
    shares: tuple[list[float], ...], verdict: str, store: Store, tmp_path: Path
) -> None:
    """The share killed is greater; the return is as the case has it."""
    claims = changed(('"final-share-killed"', '["final-share-killed", "final-return"]'))
    high, low, own, other = shares
    save_runs(store, tmp_path, {"high": high}, returns=own)
    save_runs(store, tmp_path, {"low": low}, returns=other)
    one = judge_one(store, tmp_path, claims)
    assert one.verdict == verdict
    assert [own.outcome for own in one.contrasts] == ["final-share-killed", "final-return"]


def test_the_outcome_that_supports_the_claim_decides(store: Store, tmp_path: Path) -> None:
    """The return supports it against both arms, the share killed against one: the latter decides nothing."""
    both = ('"final-share-killed"', '["final-share-killed", "final-return"]'), ('"low"', '["low", "middle"]')
    scattered = [0.0, 1.0] * 4
    for arm, shares, returns in (("high", HIGH, HIGH), ("low", LOW, LOW), ("middle", scattered, LOW)):
        save_runs(store, tmp_path, {arm: shares}, returns=returns)
    one = judge_one(store, tmp_path, changed(*both))
    assert [own.verdict for own in one.contrasts] == ["supported", "inconclusive", "supported", "supported"]
    assert one.verdict == "supported"
    assert [(own.outcome, own.verdict) for own in one.deciding] == [
        ("final-share-killed", "inconclusive"), ("final-return", "supported"),
    ]  # fmt: skip


def test_an_outcome_that_cannot_be_tested_voids_nothing_unless_all_are_needed(
    store: Store, tmp_path: Path
) -> None:
    """Nobody learned, so that roughness says nothing; the return does."""
    two = ('"final-share-killed"', '["curve-roughness", "final-return"]')
    around = [[own, -own, own] for own in (0.02, -0.04, 0.06, -0.08) * 2]
    save_runs(store, tmp_path, {"high": around}, returns=HIGH)
    save_runs(store, tmp_path, {"low": around[::-1]}, returns=LOW)
    one = judge_one(store, tmp_path, changed(two))
    assert [own.verdict for own in one.contrasts] == ["untestable", "supported"]
    assert one.verdict == "supported"
    needed = judge_one(store, tmp_path, changed(two, ('"greater"', '"greater"\nneed = "all"')))
    assert needed.verdict == "untestable" and needed.reason.startswith("arm at floor: high")


def test_what_is_better_is_greater_of_kills_and_less_of_deaths(store: Store, tmp_path: Path) -> None:
    better = ('"final-share-killed"', '["final-share-killed", "max-grad-norm"]'), ('"greater"', '"better"')
    save_runs(store, tmp_path, {"high": HIGH, "low": LOW})
    rows = judge_one(store, tmp_path, changed(*better)).contrasts
    assert [row.claim.claimed(row.outcome) for row in rows] == ["greater", "less"]
    assert rows[0].verdict == "supported"
    worse = judge_one(store, tmp_path, changed(('"greater"', '"worse"')))
    assert worse.contrasts[0].claim.claimed("final-share-killed") == "less" and worse.verdict == "refuted"


def test_paired_arms_are_compared_pair_by_pair(store: Store, tmp_path: Path) -> None:
    """high with low, other with middle; each of a with each of b would hold high against middle too."""
    paired = ('a = "high"', 'a = ["high", "other"]'), ('b = "low"', 'b = ["low", "middle"]\npaired = true')
    arms = {"high": LOW, "low": [own - 0.15 for own in LOW], "other": HIGH, "middle": NEAR}
    save_runs(store, tmp_path, arms)
    one = judge_one(store, tmp_path, changed(*paired))
    assert [row.names for row in one.contrasts] == [("high", "low"), ("other", "middle")]
    assert one.verdict == "supported"
    less = Store(tmp_path / "less")  # one pair that refutes is enough, although the other has no runs yet
    save_runs(less, tmp_path, {"high": LOW, "low": HIGH})
    one = judge_one(less, tmp_path, changed(*paired))
    assert (one.verdict, one.reason) == ("refuted", "")
    crossed = changed(*paired).replace("paired = true\n", "")
    assert judge_one(store, tmp_path, crossed).verdict == "refuted"


def test_a_number_refutes_from_its_other_side_alone(store: Store, tmp_path: Path) -> None:
    """0.735 is beyond doubt above 0.7, by less than the margin: the number itself is what counts."""
    save_runs(store, tmp_path, {"high": HIGH})
    told = {
        value: judge_one(store, tmp_path, changed(('b = "low"', f"value = {value}"))).verdict
        for value in (0.7, 0.735, 0.77)
    }
    assert told == {0.7: "supported", 0.735: "inconclusive", 0.77: "refuted"}


def test_where_a_margin_was_set_anew_both_verdicts_are_told(store: Store, tmp_path: Path) -> None:
    """Arms differ by 0.001, give or take 0.026."""
    save_runs(store, tmp_path, {"high": NEAR, "low": LOW})
    anew = changed(("margin = 0.04", "margin = 0.04\nregistered_margin = 0.01"))
    one = judge_one(store, tmp_path, anew)
    assert (one.verdict, one.registered_verdict) == ("refuted", "inconclusive")
    assert "by the registered margins: undecided" in lines(one)
    alike = judge_one(store, tmp_path)
    assert (alike.verdict, alike.registered_verdict) == ("refuted", "refuted")
    assert not any("registered" in line and "margin" in line for line in lines(alike))


def test_arms_of_unlike_size_are_told(store: Store, tmp_path: Path) -> None:
    save_runs(store, tmp_path, {"high": HIGH[:4], "low": LOW})
    one = judge_one(store, tmp_path, changed(("seeds = 8", "seeds = { high = 4, low = 8 }")))
    assert one.verdict == "supported" and "4 against 8 runs" in lines(one)


def test_what_is_never_reached_counts_as_the_runs_budget(store: Store, tmp_path: Path) -> None:
    """Runs of 1,024 steps, evaluated at 512 and 1,024; half of those of high get there at 512."""
    soon, late, never = [0.6, 0.7], [0.1, 0.6], [0.1, 0.2]
    save_runs(store, tmp_path, {"high": [soon] * 4 + [late] * 2 + [never] * 2, "low": [never] * 7 + [late]})
    steps = ('"final-share-killed"', '"steps-to:0.5"'), ("margin = 0.04\n", "")
    (row,) = judge_one(store, tmp_path, changed(*steps)).contrasts
    assert [*row.contrast.means] == [768, 1024]
    assert "equal" in row.contrast.reason and row.verdict == "inconclusive"


def test_a_claim_like_another_stands_in_its_row_with_its_own_runs(store: Store, tmp_path: Path) -> None:
    like = """
[claims.better-there]
like = "better"
worlds = ["arena"]
seeds_from = 3
seeds = 5
"""
    save_runs(store, tmp_path, {"high": HIGH, "low": LOW})
    save_runs(store, tmp_path, {"high": LOW, "low": HIGH}, world="arena")
    here, there = judge_claims(store, tmp_path, CLAIMS + like)
    assert (here.verdict, there.verdict) == ("supported", "refuted")
    assert (there.claim.row, there.claim.quote, len(there.run_ids)) == ("better", "a quote", 10)
    effect = np.mean(LOW[3:]) - np.mean(HIGH[3:])  # of seeds 3 to 7
    assert there.contrasts[0].contrast.effect == pytest.approx(effect)


def test_ranges_of_two_ladders(store: Store, tmp_path: Path) -> None:
    """0.72 - 0.22 against 0.32 - 0.22, whichever way the arms of either go; low belongs to both."""
    ranges = (
        ('a = "high"', 'a = ["low", "high"]'),
        ('b = "low"', 'b = ["middle", "low"]'),
        ('"mean"', '"range"'),
    )
    arms = {"high": HIGH, "low": LOW, "middle": [share + 0.1 for share in LOW]}
    save_runs(store, tmp_path, arms)
    one = judge_one(store, tmp_path, changed(*ranges))
    (own,) = one.deciding
    assert one.verdict == "supported"
    assert own.names == ("low, high", "middle, low")
    assert own.contrast.effect == pytest.approx(0.4)
    assert judge_one(store, tmp_path, changed(*ranges, ('"greater"', '"less"'))).verdict == "refuted"


def test_runs_that_are_told_beside_decide_nothing(store: Store, tmp_path: Path) -> None:
    save_runs(store, tmp_path, {"high": HIGH, "low": LOW})
    beside = judge_one(store, tmp_path, changed(('b = "low"', 'b = "low"\nbeside = "middle"')))
    assert (beside.verdict, len(beside.run_ids)) == ("supported", 16)


def test_runs_that_were_seen_before_are_said_to_be(store: Store, tmp_path: Path) -> None:
    """Their seeds may be below the first of the list."""
    seen = changed(
        ("[defaults]", "[list]\nseeds_from = 50\n[defaults]"),
        ("margin = 0.04", "margin = 0.04\nseen = true\nseeds_from = 0"),
    )
    save_runs(store, tmp_path, {"high": HIGH, "low": LOW})
    one = judge_one(store, tmp_path, seen)
    assert (one.verdict, one.claim.seen, len(one.run_ids)) == ("supported", True, 16)


def test_an_outcome_may_be_compared_with_another_of_the_same_runs(store: Store, tmp_path: Path) -> None:
    """The best score of a run and its last: 0.1 apart in every run."""
    claim = ('"final-share-killed"', '"best-score"'), ('b = "low"', 'value = "normalised-score"')
    falls = [0.1, 0.12, 0.08, 0.11, 0.09, 0.1, 0.12, 0.08]
    save_runs(store, tmp_path, {"high": [[x + y, x] for x, y in zip(HIGH, falls, strict=True)]})
    one = judge_one(store, tmp_path, changed(*claim))
    (row,) = one.contrasts
    assert row.contrast.means == pytest.approx((np.mean(HIGH) + 0.1, np.mean(HIGH)))
    student = stats.ttest_1samp(falls, 0).confidence_interval()
    assert row.contrast.interval.low == pytest.approx(student.low) and one.verdict == "supported"


def test_some_outcomes_may_be_compared_with_numbers_and_others_with_an_arm(
    store: Store, tmp_path: Path
) -> None:
    both = (
        ('"final-share-killed"', '["final-share-killed", "final-return"]'),
        ('b = "low"', 'b = "low"\nvalue = { final-return = 0.5 }'),
    )
    save_runs(store, tmp_path, {"high": HIGH, "low": LOW})
    one = judge_one(store, tmp_path, changed(*both))
    assert [row.names for row in one.contrasts] == [("high", "low"), ("high", "0.5")]
    assert [row.verdict for row in one.contrasts] == ["supported", "supported"]


def test_what_the_list_declares_not_tested_keeps_its_place_in_the_correction(
    store: Store, tmp_path: Path
) -> None:
    save_runs(store, tmp_path, {"high": HIGH, "low": LOW})
    text = changed(('"greater"', '"greater"\nnot_tested = "too short"'))
    one = judge_one(store, tmp_path, text)
    assert (one.verdict, one.reason, len(one.run_ids)) == ("untestable", "too short", 16)
    assert load_claims(tmp_path / "claims.toml").family_size("text", "mine.toml") == 1


def test_each_world_is_a_family_of_its_own(tmp_path: Path) -> None:
    """Two claims in the text's world, of which one is about both others too."""
    other = (
        CLAIMS[CLAIMS.index("[claims.better]") :].replace("better", "other").replace('worlds = ["text"]', "")
    )
    claims = load_claims(write_files(tmp_path, CLAIMS + other))
    assert [claims.family_size(world, "mine.toml") for world in ("text", "arena", "godot")] == [2, 1, 1]


# --- What cannot be tested: every reason for which there is no verdict ----------------------------


def _untestable(store: Store, folder: Path, *changes: tuple[str, str]) -> str:
    one = judge_one(store, folder, changed(*changes))
    assert one.verdict == "untestable"
    return one.reason


NAN = float("nan")
REASONS: dict[str, tuple[dict[str, list[float]], list[tuple[str, str]], str]] = {
    # name: (runs, changes of the claim, the reason)
    "A/A": (
        {"low": LOW}, [('a = "high"', 'a = "low-too"')],
        "A/A: low-too and low resolve to the same configuration",
    ),
    "engines": (
        {"reference": HIGH, "low": LOW}, [('a = "high"', 'a = "reference"')],
        "engines are mixed: reference by sb3, low by batched",
    ),
    "missing seeds": ({"high": HIGH[:5], "low": LOW}, [], "runs missing: high has 5 of the 8 fixed ones"),
    "nothing to cure": (
        {"high": NEAR, "low": LOW},
        [('"mean"', '"incidence"\nabove = 0.5'), ("margin = 0.04", "margin = 0.4"), ('"greater"', '"less"')],
        "both arms are at the floor: 10% of the runs or fewer differ",
    ),
    "ceiling": (
        {"high": [1 - k / 1000 for k in range(8)], "low": [1.0] * 8}, [('"greater"', '"equal"')],
        "both arms are at the ceiling",
    ),
    "no value": ({"high": [*HIGH[:7], NAN], "low": LOW}, [], "high seed 7: "),
}  # fmt: skip


@pytest.mark.parametrize("case", REASONS)
def test_what_no_run_can_tell(case: str, store: Store, tmp_path: Path) -> None:
    runs, changes, reason = REASONS[case]
    save_runs(store, tmp_path, runs)
    assert reason in _untestable(store, tmp_path, *changes)


@pytest.mark.parametrize("direction", ["greater", "equal", "no-less"])
def test_at_the_floor_of_play_only_a_shown_difference_counts(
    direction: str, store: Store, tmp_path: Path
) -> None:
    """Half of either arm's runs lie above the random player and half below, all within the margin."""
    around = [0.02 * (-1) ** k * (1 + k % 4) for k in range(8)]
    way = ('"greater"', f'"{direction}"'), ("margin = 0.04", "margin = 1")
    save_runs(store, tmp_path, {"high": around, "low": around[::-1]})
    (row,) = judge_one(store, tmp_path, changed(*way)).contrasts
    assert (row.verdict, row.none_learned) == ("inconclusive", True)
    learned = Store(tmp_path / "learned")
    save_runs(learned, tmp_path, {"high": HIGH, "low": around})
    (row,) = judge_one(learned, tmp_path, changed(*way)).contrasts
    expected = {"greater": "refuted", "equal": "supported", "no-less": "supported"}  # 0.5 counts as none
    assert (row.verdict, row.none_learned) == (expected[direction], False)


@pytest.mark.parametrize(
    "told",
    [
        {"cpu": "another"},
        {"attempts": [{"machine": {"cpu": "another"}}, {"machine": {"cpu": "a"}}]},
    ],
)
def test_times_of_different_machines(store: Store, tmp_path: Path, told: dict[str, Any]) -> None:
    """Of another processor, all the way or until a resume; a clone knows no less than who trained them."""
    save_runs(store, tmp_path, {"high": HIGH}, **told)
    save_runs(store, tmp_path, {"low": LOW})
    store = published_alone(store, tmp_path)
    reason = _untestable(store, tmp_path, ('"final-share-killed"', '"wall-seconds"'))
    assert reason == "timed on different machines"


@pytest.mark.parametrize(
    ("share", "reason"), [(0.71, "timed beside other work: on 71% of a core"), (0.97, "")]
)
def test_times_on_a_busy_machine(store: Store, tmp_path: Path, share: float, reason: str) -> None:
    """Also where only the published times are left; runs of before it was noted are believed."""
    save_runs(store, tmp_path, {"high": HIGH}, processor_share=share)
    save_runs(store, tmp_path, {"low": LOW})
    timed = changed(('"final-share-killed"', '"wall-seconds"'))
    assert judge_one(store, tmp_path, timed).reason == reason
