"""Claims and their verdicts in words, as the report, the findings and their picture write them."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from pneuma.analysis.claims import MINUS, Claim, ClaimList, load_claims
from pneuma.analysis.intervals import decimals
from pneuma.analysis.judgement import Comparison, Verdict, judge
from pneuma.analysis.outcomes import find_outcome
from pneuma.study.store import Store
from pneuma.worlds import WORLDS

MEANINGS = {
    "supported": "The test, corrected for all claims at once, finds a difference in the claimed direction; "
    "where none is claimed, it shows that there is none larger than the margin.",
    "refuted": "It finds one in the other direction, or shows that there is none larger than the margin; "
    "where none is claimed, it finds one beyond it.",
    "mixed": "One of two outcomes supports it, and the other refutes it.",
    "inconclusive": "It finds neither; where it can be told, with how many seeds an arm it might.",
    "untestable": "Nothing can be concluded from these runs, for the reason given.",
}
"""Every verdict, and what it says."""

PLACES = {name: world.title[0].upper() + world.title[1:] for name, world in WORLDS.items()}
"""Where a claim is judged, each for itself."""

_CLAIMED = {
    "greater": "greater than",
    "less": "less than",
    "different": "unlike",
    "equal": "the same as",
}


@dataclass(frozen=True)
class JudgedClaim:
    """A claim with its verdicts, by place of `PLACES`."""

    claim: Claim
    verdicts: Mapping[str, Verdict]


def judged_claims(
    store: Store, studies: Collection[str] | None = None, known: ClaimList | None = None
) -> tuple[dict[str, JudgedClaim], str]:
    """Return the claims that bear on some studies, by name, and words on the list that they are judged in.

    The whole list is judged, whichever claims are shown: that is what the verdicts are corrected for.

    Args:
        store: the results folder, with its published tables.
        studies: left out: all.
        known: the list; left out: the shipped one.

    Raises:
        UserError: for a damaged published table.
    """
    known = known or load_claims()
    verdicts: dict[str, dict[str, Verdict]] = {}
    for one in judge(known, store):
        if studies is None or one.claim.study in studies:
            verdicts.setdefault(one.claim.name, {})[one.place] = one
    note = (
        f"Claims: {known.path.name}, SHA-256 {known.digest}, fixed before the runs. The chance of any false "
        f"verdict in the whole list of {len(known.claims)} is at most {known.head.alpha:.0%} (Bonferroni)."
    )
    return {name: JudgedClaim(known.claims[name], own) for name, own in verdicts.items()}, note


# --- Claims ----------------------------------------------------------------------------------------


def measure(claim: Claim) -> str:
    """Say what is compared, as 'mean of final-share-killed (monsters killed, last evaluation)'."""
    return " and ".join(_measure(claim, outcome) for outcome in claim.outcome)


def _measure(claim: Claim, outcome: str) -> str:
    margin = claim.of("margin", outcome)
    words = outcome_words(outcome) + (f"; margin {margin:g}" if margin is not None else "")
    if claim.event:
        return f"share of runs whose {outcome} is {claim.event.words} ({words})"
    return f"mean of {outcome} ({words})"


def compared(claim: Claim) -> str:
    """Say what is compared without its name, as 'monsters killed, last evaluation'."""
    words = " and ".join(map(outcome_words, claim.outcome))
    if claim.event:
        return f"share of runs, {words} {claim.event.words}"
    return words


def tested(claim: Claim) -> str:
    """Say what is claimed of which arms, as 'tanh greater than relu'."""
    joined = " and " if claim.need == "all" else " or "
    a, b = joined.join(claim.a), joined.join(claim.b) if claim.value is None else f"{claim.value:g}"
    if claim.c:
        a, b = f"{a} less {b}", f"{claim.c[0]} less {claim.d[0]}"
    return f"{a} {_CLAIMED[claim.direction]} {b}"


def outcome_words(name: str) -> str:
    """Return an outcome, or how far one of a run exceeds another, in words."""
    return ", less ".join(find_outcome(part).words for part in name.split(MINUS))


# --- Verdicts --------------------------------------------------------------------------------------


def effect(own: Comparison) -> str:
    """Return the number with its interval, as '+0.020 [+0.002, +0.039]'."""
    contrast = own.contrast
    if not math.isfinite(contrast.effect):
        return "no number"
    interval = contrast.interval
    places = decimals(contrast.effect, interval.low, interval.high)
    value, low, high = (_number(each, places) for each in (contrast.effect, interval.low, interval.high))
    between = f" [{low}, {high}]" if interval.exists else ""
    return f"{value}{between}"


def arms(own: Comparison) -> str:
    """Return which arms are compared, how many runs each has, and the p-value."""
    seeds = " and ".join(f"{count:,}" for count in own.contrast.seeds if count)
    p = "" if own.contrast.reason else "p < 0.001" if own.p < 0.001 else f"p = {own.p:.3f}"
    return ", ".join(filter(None, [f"{own.a} against {own.b}", f"n = {seeds}" if seeds else "", p]))


def _number(value: float, places: int) -> str:
    if not math.isfinite(value):
        return "–" if math.isnan(value) else "∞" if value > 0 else "−∞"
    rounded = round(value, places)
    sign = "−" if rounded < 0 else "+" if rounded > 0 else ""
    return f"{sign}{abs(rounded):,.{max(places, 0)}f}"


def decisive(verdict: Verdict) -> Comparison | None:
    """Return the contrast that decides, where it has a number."""
    own = verdict.decisive
    return own if own and math.isfinite(own.contrast.effect) else None
