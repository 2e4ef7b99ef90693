"""The claims that a page shows, with their verdicts as `study verify` gives them.

Store → [Claim], for the report and for the pages that are written by hand around them
"""

from __future__ import annotations

import math
from collections.abc import Collection

from pneuma.analysis.claims import Claim as StatedClaim
from pneuma.analysis.claims import load_claims
from pneuma.analysis.judgement import ALPHA, LOGS, Judged, Pair, judge
from pneuma.analysis.outcomes import find_outcome
from pneuma.figures.report_verdicts import Claim, Effect, Verdict
from pneuma.study.store import Store

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
