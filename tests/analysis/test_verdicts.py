"""Corrections and verdicts, worked out by hand."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy import stats

from pneuma.analysis.contrasts import Contrast, compare
from pneuma.analysis.intervals import no_interval
from pneuma.analysis.judgement import combine_contrasts, decide, significant_direction, smallest_p
from pneuma.analysis.pvalues import PValues, holm


def contrast(
    greater: float,
    less: float,
    equivalent: float,
    far_greater: float = 1.0,
    far_less: float = 1.0,
    no_less: float = 1.0,
) -> Contrast:
    p = PValues(greater, less, equivalent, far_greater, far_less, no_less)
    return Contrast(0.0, no_interval(), p, (10, 10))


def judged(*claims: tuple[Contrast, str], alpha: float = 0.05) -> list[str]:
    return [decide(own, direction, len(claims), alpha)[0] for own, direction in claims]


def test_holm_by_hand() -> None:
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.9, 0.6]) == pytest.approx([1.0, 1.0])
    assert holm([]).tolist() == []


@pytest.mark.parametrize(
    ("p", "greater", "less", "different", "equal"),
    [
        ((0.002, 0.998, 0.9, 0.02), "supported", "refuted", "supported", "refuted"),
        ((0.998, 0.002, 0.9, 1.0, 0.02), "refuted", "supported", "supported", "refuted"),
        ((0.002, 0.998, 0.9, 0.03), "supported", "refuted", "supported", "inconclusive"),  # margin: 0.06
        ((0.4, 0.6, 0.04), "refuted", "refuted", "refuted", "supported"),
        ((0.03, 0.97, 0.9), *["inconclusive"] * 4),  # two-sided: 0.06
        ((0.001, 0.999, 0.01), "supported", "refuted", "supported", "supported"),
        ((0.01, 0.99, 0.001), "refuted", "refuted", "refuted", "supported"),
    ],
)
def test_one_claim(p: tuple[float, ...], greater: str, less: str, different: str, equal: str) -> None:
    for direction, verdict in zip(
        ("greater", "less", "different", "equal"), (greater, less, different, equal), strict=True
    ):
        assert judged((contrast(*p), direction)) == [verdict]


def test_a_difference_inside_the_margin_does_not_refute_that_there_is_none() -> None:
    """Twenty runs an arm, a margin of 1, differences of 0.7 and of 1.6 beyond doubt."""
    spread = np.linspace(-0.2, 0.2, 20)
    inside, beyond = (compare("mean", spread + difference, spread[::-1], 1.0) for difference in (0.7, 1.6))
    assert inside.p_different < 0.001 and inside.p.far_greater > 0.9
    assert judged((inside, "equal")) == ["supported"]
    assert judged((beyond, "equal")) == ["refuted"]
    less = compare("mean", spread - 0.7, spread, 1.0)
    assert judged((less, "equal")) == ["supported"]
    assert judged((replace(less, p=less.p._replace(equivalent=1.0)), "equal")) == ["inconclusive"]


def test_the_smallest_p_is_of_the_claimed_direction() -> None:
    few = replace(contrast(1, 1, 1), seeds=(4, 4), smallest=(0.01, 0.3))
    told = {way: smallest_p(few, way) for way in ("greater", "less", "different", "equal", "no-less")}
    assert told == {"greater": 0.02, "less": 0.6, "different": 0.02, "equal": 0.01, "no-less": 0.01}


def test_no_loss_is_shown_by_its_own_side_alone() -> None:
    """Twenty runs an arm, a margin of 1: a gain of any size is no loss, one of 0.7 neither, one of 1.6 is."""
    spread = np.linspace(-0.2, 0.2, 20)
    told = {
        difference: judged((compare("mean", spread + difference, spread, 1.0), "no-less"))
        for difference in (5.0, 0.0, -0.7, -1.6)
    }
    assert told == {5.0: ["supported"], 0.0: ["supported"], -0.7: ["supported"], -1.6: ["refuted"]}
    wide = compare("mean", 5 * spread - 1, 5 * spread, 1.0)
    assert judged((wide, "no-less")) == ["inconclusive"]


@pytest.mark.parametrize("truth", [*product((True, False), repeat=3)])
def test_a_claims_verdict_is_false_only_where_a_contrasts_is(truth: tuple[bool, ...]) -> None:
    """Every combination of three contrasts' truths and verdicts."""
    for verdicts in product(("supported", "refuted", "inconclusive", "untestable"), repeat=3):
        verdict = combine_contrasts(verdicts)
        false = verdict == ("refuted" if all(truth) else "supported")
        false_ones = ["refuted" if so else "supported" for so in truth]
        assert not false or any(own == wrong for own, wrong in zip(verdicts, false_ones, strict=True))


def test_the_list_is_corrected_as_one() -> None:
    weak, strong = contrast(0.02, 0.98, 1.0), contrast(0.001, 0.999, 1.0)
    assert judged((weak, "greater")) == ["supported"]
    assert judged((weak, "greater"), (weak, "greater")) == ["inconclusive"] * 2
    assert judged((strong, "greater"), (weak, "greater")) == ["supported", "inconclusive"]
    assert judged((weak, "greater"), alpha=0.01) == ["inconclusive"]
    assert decide(strong, "greater", 2)[1] == 0.004


def test_what_is_found_makes_it_no_easier_for_the_rest() -> None:
    """60 arms alike, a margin of 4.5 standard errors: in steps, two lists of three would be wrong."""
    generator, wrong, wrong_in_steps = np.random.default_rng(6), 0, 0
    for z in generator.normal(size=(400, 60)):
        p_greater = stats.norm.sf(z)
        p_equivalent = np.maximum(stats.norm.cdf(z - 4.5), stats.norm.sf(z + 4.5))
        claims = [
            (contrast(*map(float, p)), "greater")
            for p in zip(p_greater, 1 - p_greater, p_equivalent, strict=True)
        ]
        verdicts = judged(*claims)
        assert verdicts.count("refuted") > 30
        told = {
            significant_direction(c)
            for v, (c, _) in zip(verdicts, claims, strict=True)
            if v != "inconclusive"
        }
        wrong += told > {"equal"}
        in_steps = holm([min(own.p_different, own.p.equivalent) for own, _ in claims]) <= 0.05
        wrong_in_steps += any(
            significant_direction(own) != "equal" for (own, _), so in zip(claims, in_steps, strict=True) if so
        )
    assert wrong_in_steps / 400 > 0.6
    assert wrong / 400 < 0.05 + 3 * np.sqrt(0.05 * 0.95 / 400)
