"""The claims that a page shows, with their verdicts as `study verify` gives them.

Store → [Claim], for the report and for the pages that are written by hand around them
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from pneuma.analysis.claims import Claim as StatedClaim
from pneuma.analysis.claims import load_claims
from pneuma.analysis.judgement import ALPHA, LOGS, Judged, Pair, judge
from pneuma.analysis.outcomes import find_outcome
from pneuma.analysis.rounding import decimals
from pneuma.study.store import Store
from pneuma.worlds import WORLDS

MEANINGS = {
    "supported": "The test, corrected for all claims at once, finds a difference in the claimed direction; "
    "where none is claimed, it shows that there is none larger than the margin.",
    "refuted": "It finds one in the other direction, or shows that there is none larger than the margin; "
    "where none is claimed, it finds one beyond it.",
    "inconclusive": "It finds neither; where it can be told, with how many seeds an arm it might.",
    "untestable": "Nothing can be concluded from these runs, for the reason given.",
}
"""Every verdict, and what it says."""

PLACES = {
    **{name: world.title[0].upper() + world.title[1:] for name, world in WORLDS.items()},
    "logs": "Published logs",
}
"""Where a claim is judged, each for itself."""


@dataclass(frozen=True)
class Effect:
    """One contrast of a claim, as its runs have it.

    Attributes:
        arms: which are compared, for people.
        verdict: on this contrast alone.
        value: of the effect; None where there is none.
        interval: around it, low and high, if it has one.
        seeds: runs of each arm.
        p: corrected for all claims; None where nothing was tested.
        ratio: whether it is one, with 1 for no difference.
        quantity: what it is of, where that is not the claim's own outcome.
    """

    arms: str
    verdict: str
    value: float | None = None
    interval: tuple[float, float] | None = None
    seeds: tuple[int, ...] = ()
    p: float | None = None
    ratio: bool = False
    quantity: str = ""

    @property
    def told(self) -> str:
        """The number with its interval, as '+0.020 [+0.002, +0.039]'."""
        if self.value is None:
            return "no number"
        low, high = self.interval or (math.nan, math.nan)
        value, *ends = _numbers(self.value, low, high, signed=not self.ratio)
        interval = f" [{', '.join(ends)}]" if self.interval else ""
        of = f" in {self.quantity}" if self.quantity else ""
        return f"{'ratio ' if self.ratio else ''}{value}{interval}{of}"

    @property
    def p_told(self) -> str:
        """Its p for people; empty where nothing was tested."""
        return "" if self.p is None else "p < 0.001" if self.p < 0.001 else f"p = {self.p:.3f}"


@dataclass(frozen=True)
class Verdict:
    """A claim's verdict in one place.

    Attributes:
        verdict: of `MEANINGS`.
        reason: why nothing can be concluded, or what a refuted claim has right; empty for a plain result.
        effects: its contrasts, the one that decides first.
        seeds_needed: an arm, to decide; None where nothing is known of it.
        run_ids: of every run that was looked at.
    """

    verdict: str
    reason: str = ""
    effects: tuple[Effect, ...] = ()
    seeds_needed: int | None = None
    run_ids: tuple[str, ...] = ()


@dataclass(frozen=True)
class Claim:
    """A sentence of the thesis, stated as a test.

    Attributes:
        claim: its name.
        quote: the sentence.
        section: of the thesis.
        study: what tests it.
        measure: what is compared, with the outcome's name.
        verdicts: by place, of `PLACES`.
        tested: what is claimed of which arms.
        compared: the measure in plain words.
        note: why it is tested so.
    """

    claim: str
    quote: str
    section: str
    study: str
    measure: str = ""
    verdicts: Mapping[str, Verdict] = field(default_factory=dict)
    tested: str = ""
    compared: str = ""
    note: str = ""


_COMPARED = {"mean": "mean", "spread": "deviation between seeds"}
_LOGGED = {
    "start": "the first return",
    "best": "the best return",
    "end": "the final return",
    "length": "the final episode length",
    "hours": "hours",
    "steps_per_second": "steps a second",
}
"""What the published logs tell of a run, for people."""

_CLAIMED = {
    "greater": "greater than",
    "less": "less than",
    "different": "unlike",
    "equal": "the same as",
    "not-less": "not less than",
}


def judged_claims(store: Store, studies: Collection[str] | None = None) -> tuple[list[Claim], str]:
    """Return the claims that bear on some studies, and words on the list that they are judged in.

    The whole list is judged, whichever claims are shown: that is what the verdicts are corrected for.

    Args:
        store: the results folder, with its published tables.
        studies: left out: all.

    Raises:
        UserError: for a damaged published table.
    """
    known = load_claims()
    shown: dict[str, list[Judged]] = {}
    for one in judge(known, store):
        if studies is None or one.claim.study in studies:
            shown.setdefault(one.claim.name, []).append(one)
    note = (
        f"Claims: {known.path.name}, SHA-256 {known.digest}, fixed before the runs. The chance of any false "
        f"verdict in the whole list of {len(known.claims)} is at most {ALPHA:.0%} (Bonferroni)."
    )
    return [_claim(judged) for judged in shown.values()], note


def _claim(judged: list[Judged]) -> Claim:
    claim = judged[0].claim
    verdicts = {one.place: _verdict(one) for one in judged}
    return Claim(
        claim.name,
        " ".join(claim.quote.split()),
        claim.section,
        claim.study,
        _measure(claim),
        verdicts,
        _tested(claim),
        _compared(claim),
        claim.note,
    )


def _measure(claim: StatedClaim) -> str:
    """Say what is compared, as 'mean of final-share-killed (monsters killed, last evaluation)'."""
    words = find_outcome(claim.outcome).words
    margin = f"; margin {claim.margin:g}" if claim.margin is not None else ""
    if claim.event:
        return f"share of runs whose {claim.outcome} is {claim.event.words} ({words}{margin})"
    return f"{_COMPARED[claim.kind]} of {claim.outcome} ({words}{margin})"


def _compared(claim: StatedClaim) -> str:
    """Say what is compared without its name, as 'monsters killed, last evaluation'."""
    words = find_outcome(claim.outcome).words
    if claim.event:
        return f"share of runs, {words} {claim.event.words}"
    return words if claim.kind == "mean" else f"{_COMPARED[claim.kind]} of {words}"


def _tested(claim: StatedClaim) -> str:
    """Say what is claimed of which arms, as 'tanh greater than relu'."""
    joined = " and " if claim.need == "all" else " or "
    other = joined.join(claim.b) if claim.value is None else f"{claim.value:g}"
    return f"{joined.join(claim.a)} {_CLAIMED[claim.direction]} {other}"


def _verdict(judged: Judged) -> Verdict:
    effects = {
        id(pair): _effect(pair, told) for pair, told in zip(judged.pairs, _quantities(judged), strict=True)
    }
    first = sorted(judged.pairs, key=lambda pair: pair is not judged.told)
    ordered = tuple(effects[id(pair)] for pair in first)
    return Verdict(judged.verdict, judged.reason, ordered, judged.seeds_needed, tuple(judged.run_ids))


def _quantities(judged: Judged) -> list[str]:
    """Return, for each contrast, what is compared where that is not what the claim's own runs have."""
    if judged.place != LOGS:
        return [""] * len(judged.pairs)
    return [_LOGGED[own.figure] for own in judged.claim.logs]


def _effect(pair: Pair, quantity: str) -> Effect:
    contrast = pair.contrast
    interval = (contrast.interval.low, contrast.interval.high) if contrast.interval.exists else None
    return Effect(
        f"{pair.a} against {pair.b}",
        pair.verdict,
        contrast.effect if math.isfinite(contrast.effect) else None,
        interval,
        tuple(count for count in contrast.seeds if count),
        None if contrast.reason else pair.p,
        ratio=contrast.kind == "spread",
        quantity=quantity,
    )


def _numbers(value: float, low: float, high: float, signed: bool) -> list[str]:
    """Return a number and the ends of its interval, to the digits that the interval leaves certain."""
    places = decimals(value, low, high)
    return [_number(own, places, signed) for own in (value, low, high)]


def _number(value: float, places: int, signed: bool) -> str:
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    rounded = round(value, places)
    sign = "−" if rounded < 0 else "+" if signed and rounded > 0 else ""
    return f"{sign}{abs(rounded):,.{max(places, 0)}f}"
