"""Verdicts over a list of claims, so that the chance of any false one among them stays at most alpha.

Each claim enters with one p-value, the lesser of what can decide it, times the number of claims: by
Bonferroni's correction and not by Holm's, whose steps do not hold here (`bonferroni` says why). For one of a
direction, or of any difference, these are the two-sided p-value of a difference and the p-value of
equivalence. That bounds the chance of any false verdict on the claim, whatever the truth. With no difference
only the two-sided test can err. With one inside the margin only the wrong direction can, at half that
rate. At the margin or beyond it, equivalence errs, and so does the wrong direction, but where that one is
significant the test against the near margin is too: both errors lie within that one test's.

A claim that there is no difference, or none downwards, is not refuted by one inside the margin, which counts
as none: it takes a difference beyond the margin, tested two-sided there. Inside the margin only that
test can err; at the margin or beyond, only equivalence, or the direction that would support the claim.

A claim on several contrasts speaks of all of them, or of any. With all, it is supported where every
contrast is, and refuted where one is; with any, the other way round. A claim's verdict is false only where
that on one of its contrasts is: in a true claim on all, none can be refuted truly; in a false one, some
contrast is not as claimed, and can be supported only falsely. For any, the same with both words exchanged.
Every contrast keeps its own place in the list, so the bound on false verdicts holds for claims too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from pneuma.analysis.contrasts import Contrast
from pneuma.analysis.corrections import bonferroni

SUPPORTED, REFUTED, INCONCLUSIVE = "supported", "refuted", "inconclusive"
DIRECTIONS = ("greater", "less", "different", "equal", "not-less")
_SUPPORTED_BY = {"different": ("greater", "less"), "not-less": ("greater", "equal")}
"""What a contrast must show, where that is not the direction itself."""

_MARGINAL = ("equal", "not-less")
"""What a difference inside the margin does not refute."""

NEEDS = ("all", "any")
"""Of how many of its contrasts a claim speaks."""


class Verdict(NamedTuple):
    """What a list comes to on one of its contrasts.

    Attributes:
        word: supported, refuted or inconclusive.
        p: the p-value after the list's correction.
    """

    word: str
    p: float


def judge_list(contrasts: Sequence[tuple[Contrast, str]], alpha: float = 0.05) -> list[Verdict]:
    """Return the verdict on each claim of a list, judged together.

    Args:
        contrasts: each claim's contrast and the direction of `DIRECTIONS` that it claims.
        alpha: the chance of any false verdict in the list.
    """
    read = [_read(contrast, direction) for contrast, direction in contrasts]
    adjusted = bonferroni([own.p for own in read])
    return [
        Verdict(own.word if p <= alpha else INCONCLUSIVE, float(p))
        for own, p in zip(read, adjusted, strict=True)
    ]


def found(contrast: Contrast) -> str:
    """Return what a significant contrast shows: "greater", "less" or "equal".

    It is what the lesser p-value says. To let the other one speak too would be a second test of the
    same claim, which the correction did not count.
    """
    if contrast.p_equivalent < contrast.p_different:
        return "equal"
    return "greater" if contrast.p_greater < contrast.p_less else "less"


def together(verdicts: Sequence[str], need: str) -> str:
    """Return the verdict on a claim by those on its contrasts; empty where some of them is neither.

    Args:
        verdicts: of each contrast, at least one.
        need: one of `NEEDS`.
    """
    by_one, by_all = (REFUTED, SUPPORTED) if need == "all" else (SUPPORTED, REFUTED)
    if by_one in verdicts:
        return by_one
    return by_all if all(own == by_all for own in verdicts) else ""


def smallest_p(contrast: Contrast, claimed: str) -> float:
    """Return the smallest p-value by which so many runs can support a claimed direction.

    For equivalence it is a lower bound, but for shares, where it may be above what can be reached.
    """
    one_sided = {"greater": contrast.smallest_greater, "less": contrast.smallest_less}
    least = min(one_sided.values())
    return min(2 * one_sided[way] if way in one_sided else least for way in _supporting(claimed))


def _supporting(claimed: str) -> tuple[str, ...]:
    if claimed not in DIRECTIONS:
        raise ValueError(f"a claimed direction of {claimed!r}; there are " + ", ".join(DIRECTIONS))
    return _SUPPORTED_BY.get(claimed, (claimed,))


def _read(contrast: Contrast, claimed: str) -> Verdict:
    """Return what a contrast comes to if its p-value, uncorrected here, is small enough."""
    supporting = _supporting(claimed)
    if claimed not in _MARGINAL:
        word = SUPPORTED if found(contrast) in supporting else REFUTED
        return Verdict(word, contrast.p_any)
    if claimed == "equal":
        p_supported, p_beyond = contrast.p_equivalent, min(contrast.p_far_less, contrast.p_far_greater)
    else:
        p_supported, p_beyond = min(contrast.p_equivalent, 2 * contrast.p_greater), contrast.p_far_less
    p_refuted = min(2 * p_beyond, 1.0)
    return Verdict(SUPPORTED, p_supported) if p_supported <= p_refuted else Verdict(REFUTED, p_refuted)
