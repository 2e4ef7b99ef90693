"""Verdicts over a list of claims, so that the chance of any false one among them stays at most alpha.

Each claim enters Holm's correction with one p-value: the lesser of its two-sided p-value of a
difference and its p-value of equivalence. That bounds the chance of any false verdict on the claim,
whatever the truth. With no difference only the two-sided test can err. With one inside the margin only
the wrong direction can, at half that rate. At the margin or beyond it, equivalence errs, and so does
the wrong direction, but where that one is significant the test against the near margin is too: both
errors lie within that one test's.
"""

from __future__ import annotations

from collections.abc import Sequence

from pneuma.analysis.contrasts import Contrast
from pneuma.analysis.corrections import holm

SUPPORTED, REFUTED, INCONCLUSIVE = "supported", "refuted", "inconclusive"
DIRECTIONS = ("greater", "less", "different", "equal")


def judge_list(contrasts: Sequence[tuple[Contrast, str]], alpha: float = 0.05) -> list[str]:
    """Return the verdict on each claim of a list, judged together.

    Args:
        contrasts: each claim's contrast and the direction of `DIRECTIONS` that it claims.
        alpha: the chance of any false verdict in the list.
    """
    adjusted = holm([contrast.p_any for contrast, _ in contrasts])
    return [
        _verdict(found(contrast) if p <= alpha else None, direction)
        for (contrast, direction), p in zip(contrasts, adjusted, strict=True)
    ]


def found(contrast: Contrast) -> str:
    """Return what a significant contrast shows: "greater", "less" or "equal".

    It is what the lesser p-value says. To let the other one speak too would be a second test of the
    same claim, which the correction did not count.
    """
    if contrast.p_equivalent < contrast.p_different:
        return "equal"
    return "greater" if contrast.p_greater < contrast.p_less else "less"


def _verdict(shown: str | None, claimed: str) -> str:
    if claimed not in DIRECTIONS:
        raise ValueError(f"a claimed direction of {claimed!r}; there are " + ", ".join(DIRECTIONS))
    if shown is None:
        return INCONCLUSIVE
    if shown == claimed or (claimed == "different" and shown != "equal"):
        return SUPPORTED
    return REFUTED
