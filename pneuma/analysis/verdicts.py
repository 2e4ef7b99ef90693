"""Verdicts over a list of claims, so that the chance of any false one among them stays at most alpha.

Each contrast enters with one p-value, the lesser of what can decide it, corrected by Bonferroni. Not by Holm,
whose steps suppose that what was found leaves fewer hypotheses that could still be true: a contrast found
equivalent leaves the list because its effect looked small, and those that are left look large. Most lists of
60 true equivalences, judged in steps, can hold a false difference.

For a claim of a direction, or of any difference, the two are the two-sided p-value of a difference and the
p-value of equivalence. Why the lesser of them bounds the chance of any false verdict, whatever the truth, is
in docs/evidence.md.

A claim that there is no difference is not refuted by one inside the margin, which counts as none: it takes a
difference beyond the margin, tested two-sided there.

A claim on several contrasts speaks of all of them, or of any. Its verdict is false only where that on one of
its contrasts is, so the bound on false verdicts holds for claims too.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from pneuma.analysis.contrasts import Contrast

SUPPORTED, REFUTED, MIXED = "supported", "refuted", "mixed"
INCONCLUSIVE, UNTESTABLE = "inconclusive", "untestable"
DIRECTIONS = ("greater", "less", "different", "equal")

NEEDS = ("all", "any")
"""Of how many of its contrasts a claim speaks."""


class Decision(NamedTuple):
    """What is concluded on one contrast.

    Attributes:
        verdict: supported, refuted or inconclusive.
        p: the p-value after the list's correction.
    """

    verdict: str
    p: float


def decide(contrast: Contrast, claimed: str, factor: float = 1.0, alpha: float = 0.05) -> Decision:
    """Return the decision on one contrast of a list.

    Args:
        contrast: the contrast.
        claimed: the direction of `DIRECTIONS` that is claimed of it.
        factor: what its p-value is multiplied by: the number of contrasts in the list.
        alpha: the chance of any false verdict in the list.
    """
    verdict, p = _read(contrast, claimed)
    corrected = min(p * factor, 1.0)
    return Decision(verdict if corrected <= alpha else INCONCLUSIVE, corrected)


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


def of_outcomes(verdicts: Sequence[str]) -> str:
    """Return the verdict on a claim by those on its outcomes, each supported, refuted or something else.

    Supported where one outcome supports it and none refutes it, refuted the other way round, mixed where they
    contradict each other; empty where none decides. Such a verdict is false only where that on an outcome is.
    """
    decided = {own for own in verdicts if own in (SUPPORTED, REFUTED)}
    return MIXED if len(decided) == 2 else "".join(decided)


def smallest_p(contrast: Contrast, claimed: str) -> float:
    """Return the smallest p-value by which so many runs can support a claimed direction.

    For equivalence it is a lower bound, but for shares, where it may be above what can be reached.
    """
    one_sided = {"greater": contrast.smallest_greater, "less": contrast.smallest_less}
    least = min(one_sided.values())
    return min(2 * one_sided[way] if way in one_sided else least for way in _supporting(claimed))


def _supporting(claimed: str) -> tuple[str, ...]:
    return ("greater", "less") if claimed == "different" else (claimed,)


def _read(contrast: Contrast, claimed: str) -> tuple[str, float]:
    """Return what a contrast comes to if its p-value, uncorrected here, is small enough."""
    supporting = _supporting(claimed)
    if claimed != "equal":
        return SUPPORTED if found(contrast) in supporting else REFUTED, contrast.p_any
    p_refuted = min(2 * min(contrast.p_far_less, contrast.p_far_greater), 1.0)
    supported = contrast.p_equivalent <= p_refuted
    return (SUPPORTED, contrast.p_equivalent) if supported else (REFUTED, p_refuted)
