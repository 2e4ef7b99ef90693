"""Verdicts in words and as a picture: the words by hand, and the same bytes again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from pneuma.analysis.claims import words
from pneuma.analysis.claims.claim_list import shipped_claims
from pneuma.analysis.claims.verdicts import AS_CLAIMED_BUT_SMALL, DISAGREE, Verdict
from pneuma.analysis.claims.words import cell, compared_text, effect, sentence, short_sentence, verdict_table
from tools.verdicts import draw_verdicts

from .hand_made_verdicts import claim, comparison, judged

Pair = tuple[float, float]
KILLS = "kills 85 against 83 % (−1 to 5)"
MEANS, ENDS = (0.85, 0.83), (-0.012, 0.052)
RETURN, LESS = {"outcome": "final-return"}, {"outcome": "final-return", "direction": "less"}
RANGES = {"kind": "range", "a": ("x", "y"), "b": ("y", "z")}
SHARE = {"kind": "incidence", "b": (), "value": 0.2, "outcome": "one-action", "above": 0.9}
RATIO, SLOPE = {"outcome": "log-max-grad-norm"}, {"outcome": "late-slope", "b": (), "value": 0}
FALL = {"outcome": "late-fall", "b": (), "value": "shuffled-fall", "margin": 0.0714}
TWO: dict[str, Any] = {"a": ("x", "y"), "b": ("z", "w"), "called": ("new", "old", "narrow", "wide")}
LATE = {"outcome": "late-one-action-time"}
STAY = {"kind": "hazard", "outcome": "lasting-one-action-step", "direction": "less", "margin": 0.69}


@pytest.mark.parametrize(
    ("fields", "means", "ends", "text"),
    [
        ({}, MEANS, ENDS, KILLS),
        (RETURN, (8.6, 7.5), (0.3, 2.0), "return 8.6 against 7.5 (0.3 to 2.0)"),
        (LESS, (3401, 3902), (-900, -101), "return 3,400 against 3,900 (−900 to −100)"),
        (  # a quarter to 1.002 times as far
            {"kind": "spread", "margin": 0.405}, (0.025, 0.04), (-1.386, 0.002),
            "spread of kills 2.5 against 4.0 % (0.25 to 1.002 times; ×1.5)",
        ),
        (RANGES, (0.4, 0.1), (0.1, 0.5), "range of kills 40 against 10 % (10 to 50)"),
        # of a threshold the interval is that of the value
        (SHARE, (1, 0.2), (0.7, 0.8), "runs with one action 100 % (90 to 100), threshold 20 %"),
        (
            {**RATIO, "b": (), "value": 0.693}, (1.163, 0.693), (0.3, 0.642),
            "greatest gradient norm 3.2 (2.7 to 3.8), threshold 2.0",
        ),
        (  # of 100 and 50; 1 to 4
            RATIO, (4.605, 3.912), (0.0, 1.386),
            "greatest gradient norm 100 against 50 (1.0 to 4.0 times)",
        ),
        (SLOPE, (-0.01, 0), (-0.05, 0.03), "late rise of kills −1 % (−5 to 3)"),
        (
            FALL, (0.07, 0.073), (-0.01, 0.004),
            "fall from the best five evaluations 7.0 %, in random order 7.3 % (−1.0 to 0.4; ±7.1)",
        ),
        (
            {**TWO, **LATE, "kind": "main-effect"}, (0.09, 0.45), (-0.47, -0.25),
            "time in one action 9 against 45 % (−47 to −25)",
        ),
        (
            {**TWO, **LATE, "kind": "interaction", "direction": "described"}, (-0.37, -0.09), (-0.5, -0.06),
            "effect on time in one action, narrow against wide: −37 against −9 % (−50 to −6)",
        ),
        (
            STAY, (0.2, 0.6), (-1.386, -0.1),
            "runs that come to stay in one action 20 against 60 % (0.25 to 0.90 times; ×2.0)",
        ),
    ],
)  # fmt: skip
def test_effects_are_told_in_plain_units(fields: dict[str, Any], means: Pair, ends: Pair, text: str) -> None:
    row = comparison("holds", means[0] - means[1], ends, of=claim(**fields), means=means)
    assert effect(row) == text


@pytest.mark.parametrize(
    ("verdict", "reason", "text"),
    [
        ("holds", "", f"holds [p]\n{KILLS}"),
        ("does not hold", AS_CLAIMED_BUT_SMALL, f"does not hold [p]\n{KILLS}\n{AS_CLAIMED_BUT_SMALL}"),
        ("undecided", DISAGREE, f"undecided [p]\n{KILLS}\n{DISAGREE}"),
        ("undecided", "", f"undecided [p]\n{KILLS}"),
        ("described", "", f"described [p]\n{KILLS}"),
        ("not tested", "runs missing: tanh; train with: pneuma", "not tested [p]\nnot trained yet"),
        ("not tested", "a run has no value: tanh seed 7", "not tested [p]\na run has no value"),
    ],
)
def test_a_cell_is_a_word_and_the_effect_or_why_there_is_none(verdict: str, reason: str, text: str) -> None:
    row = comparison(verdict, 0.02, ENDS, means=MEANS)
    assert cell(judged(claim(), text=(verdict, reason, (row,)))["text"]) == text


def test_every_outcome_is_told_and_that_nobody_learned() -> None:
    one_claim = claim(outcome="final-share-killed final-return", called=("tanh", "ReLU"))
    rows = (
        comparison("undecided", 0.02, ENDS, of=one_claim, means=MEANS, none_learned=True),
        comparison("holds", 1.1, (0.3, 2.0), of=one_claim, means=(8.6, 7.5), outcome="final-return"),
    )
    returns = "return 8.6 against 7.5 (0.3 to 2.0)"
    text = ["holds [p]", KILLS, returns, "none beats random"]
    assert cell(judged(one_claim, text=("holds", "", rows))["text"]).split("\n") == text


def test_pairs_are_named_and_arms_are_called_once_a_row() -> None:
    one_claim = claim(**TWO, paired=True)
    row = comparison("holds", 0.02, ENDS, of=one_claim, means=MEANS, a=("y",), b=("w",))
    assert effect(row) == f"wide, {KILLS}"
    assert compared_text(one_claim) == "new against old"
    assert compared_text(claim(a=("tanh", "wide"), b=(), value=0.2)) == "tanh and wide"


def test_sentences_are_without_tex_and_short_ones_are_the_thesiss_words() -> None:
    claims = shipped_claims()[0].claims
    assert "where β₁ = β₂ = 0.9, rather than" in sentence(claims["betas-solve"])
    assert sentence(claims["leaky-helps"]).endswith("the clipping limit of the norm to ‖∇L(ϑₜ)‖₂ ≤ 0.5.")
    for one_claim in claims.values():
        assert not {*sentence(one_claim)} & {*"\\$*{}"}
        for part in short_sentence(one_claim).split("…"):
            assert part.strip(" ,") in sentence(one_claim)


def test_the_table_is_by_section_and_says_a_sentence_once() -> None:
    """What is like another claim stands in its row, unless it is about the same world or another sentence."""
    sections = {"first": "5.10", "second": "5.9", "third": "6"}
    verdicts = [
        Verdict(claim(name, section=section, short=name, context=name), "text", "undecided", "")
        for name, section in sections.items()
    ]
    there = claim("there", like="third", section="6", short="third")
    again = claim("again", like="third", section="6", short="again")
    verdicts += [Verdict(there, "arena", "does not hold", ""), Verdict(again, "text", "holds", "")]
    ordered = words.verdicts_by_claim(verdicts)
    assert {name: [*worlds] for name, worlds in ordered.items()} == {
        "second": ["text"], "first": ["text"], "third": ["text", "arena"], "again": ["text"],
    }  # fmt: skip
    text = [f"“{heading}”\ntanh against relu" for heading in ("second", "first", "third", "again")]
    assert verdict_table(ordered)["The thesis's sentence"].tolist() == text
    counts = words.count_words(ordered).to_numpy().tolist()
    assert counts == [["text", 1, 0, 3, 0], ["arena", 0, 1, 0, 0]]


def test_one_sentence_has_one_row_with_what_each_list_says_of_it() -> None:
    """A claim without a quote stands with an earlier one about the same conditions."""
    issue = {"quote": "To combat this issue, we used betas", "list_name": "second list"}
    first = claim("first", quote="To combat this, we used betas", list_name="first list")
    claims = [
        first,
        claim("again", **issue),
        claim("described", quote=""),
        claim("other", quote="", b=("x",)),
    ]
    verdicts = [Verdict(one, "text", "holds", "", label="preregistered") for one in claims]
    by_claim = words.verdicts_by_claim(verdicts)
    rows = words.sentence_rows(by_claim)
    assert [row.claims for row in rows] == [("first", "again", "described"), ("other",)]
    table = verdict_table(by_claim)
    assert table["text"].tolist() == [
        "first list, first: holds [p]\nsecond list, again: holds [p]\ndescribed: holds [p]", "holds [p]",
    ]  # fmt: skip
    assert words.erratum(claims[1]).endswith("the thesis “To combat this, we used”.") and not words.erratum(
        first
    )


def test_a_registered_verdict_is_shown_with_why_it_differs() -> None:
    one_claim = claim(kind="spread")
    row = comparison("undecided", 0.02, ENDS, of=one_claim, means=MEANS, registered_verdict="does not hold")
    for rule_changes, text in (
        ((), ["as registered: does not hold"]),
        (("spread",), ["as registered: does not hold; since then spreads are compared by their ratio"]),
    ):
        contrasts = (replace(row, rule_changes=rule_changes),)
        verdict = Verdict(one_claim, "text", "undecided", "", contrasts, registered_verdict="does not hold")
        assert words.lines(verdict)[1:] == text


def test_the_letter_of_a_label_has_a_star_if_the_claim_was_changed() -> None:
    verdict = Verdict(claim(), "text", "holds", "", label="same runs as list 3", changed=("seeds",))
    assert (words.letter(verdict), words.letter(replace(verdict, changed=()))) == ("3*", "3")
    assert words.registration(verdict) == "same runs as list 3; changed since the first run: seeds"
    assert words.letter(replace(verdict, label="amended")) == "a"


def test_an_interval_is_drawn_in_margins_and_as_claimed_to_the_right(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """0.02 (−0.012 to 0.052), with a margin of 0.04; where less is claimed, the other way round.

    A factor of 1 / 3 (1 / 9 to 1), of rates with a margin of 3, is one margin (0 to 2) to the right.
    """
    claims = {}
    for name, way in (("one", "greater"), ("two", "less")):
        one_claim = claim(name, section="6.1", short=name, direction=way, margin=0.04)
        row = comparison("holds", 0.02, ENDS, of=one_claim, means=MEANS)
        claims[name] = judged(one_claim, text=("holds", "", (row,)), arena=("not tested", "A/A: same", ()))
    one_claim = claim("three", section="6.1", **{**STAY, "margin": np.log(3)})
    row = comparison("holds", -np.log(3), (-np.log(9), 0.0), of=one_claim, means=(0.2, 0.5))
    claims["three"] = judged(one_claim, text=("holds", "", (row,)))
    figures: list[Figure] = []
    monkeypatch.setattr(plt, "close", figures.append)
    (path,), (again,) = (draw_verdicts(claims, tmp_path / name) for name in ("first", "again"))
    assert path.name == "verdicts.png" and path.read_bytes() == again.read_bytes()
    sentences, text, arena = figures[0].axes
    ends = [np.asarray(line.get_xdata(), float).tolist() for line in text.lines[1:]]  # after the zero line
    assert [pair for pair in ends if len(pair) == 2] == [
        pytest.approx(pair) for pair in ([-0.3, 1.3], [-1.3, 0.3], [0.0, 2.0])
    ]
    assert [line.get_marker() for line in arena.lines[1:]] == ["_", "_"]
    assert "“one”" in [one.get_text() for one in sentences.texts]
    with Image.open(path) as image:
        assert image.width / image.info["dpi"][0] == pytest.approx(7.4, abs=0.01)
    assert min(float(one.get_fontsize()) for axes in figures[0].axes for one in axes.texts) >= 5.5
