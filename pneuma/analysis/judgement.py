"""Judgement: claims and runs → a verdict on every claim in every world.

    ClaimList and Store → [Judged]

Every claim is judged by the runs that it fixed beforehand, by their ids, and by no others: in each
world, and by the published logs where they bear on it, side by side and never pooled. All contrasts of all
claims in all worlds, also of those without runs, are one family for the correction:
whatever is asked for and whatever has been run, the chance of any false verdict stays at most `ALPHA`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pneuma.analysis.claim_runs import MEND, Arm, ClaimRuns
from pneuma.analysis.claims import Claim, ClaimList
from pneuma.analysis.contrasts import Contrast, compare, compare_with, undecided
from pneuma.analysis.log_contrasts import compare_logs
from pneuma.analysis.outcomes import find_outcome
from pneuma.analysis.power import seeds_needed
from pneuma.analysis.verdicts import (
    INCONCLUSIVE,
    REFUTED,
    SUPPORTED,
    Verdict,
    found,
    judge_list,
    smallest_p,
    together,
)
from pneuma.config import stream_seed
from pneuma.errors import counted
from pneuma.study.store import Store
from pneuma.worlds import WORLDS

ALPHA = 0.05
"""The chance of any false verdict in the whole list."""

LOGS = "logs"
"""The third place where a claim is judged: the author's published logs."""

PLACES = (*WORLDS, LOGS)
UNTESTABLE = "untestable"
AS_CLAIMED_BUT_SMALL = "in the direction claimed, but smaller than the margin"
"""The reason of a claim that equivalence refutes, where the interval lies wholly on the claim's side."""
VERDICTS = (SUPPORTED, REFUTED, INCONCLUSIVE, UNTESTABLE)


@dataclass(frozen=True)
class Pair:
    """One contrast of a claim, and what it comes to.

    Attributes:
        a, b: the arms' names; b is a number where a is held against one.
        contrast: its reason is not empty where nothing can be concluded.
        verdict: of `VERDICTS`.
        p: corrected for the whole list.
        seeds_needed: per arm, in all, to decide it; None where not known.
    """

    a: str
    b: str
    contrast: Contrast
    run_ids: tuple[str, ...] = ()
    verdict: str = ""
    p: float = 1.0
    seeds_needed: int | None = None


@dataclass(frozen=True)
class Judged:
    """A claim's verdict in one of `PLACES`.

    Attributes:
        verdict: of `VERDICTS`.
        reason: in words, why it is untestable, what is missing, or `AS_CLAIMED_BUT_SMALL`; empty for a plain
            result.
        pairs: its contrasts; none where its study is not run in the world.
    """

    claim: Claim
    place: str
    verdict: str
    reason: str
    pairs: tuple[Pair, ...]

    @property
    def told(self) -> Pair | None:
        """The contrast that decides: the surest where one is enough for the verdict, else the least sure."""
        deciding = [pair for pair in self.pairs if pair.verdict == self.verdict] or [*self.pairs]
        one_is_enough = self.verdict == (REFUTED if self.claim.need == "all" else SUPPORTED)
        return (min if one_is_enough else max)(deciding, key=lambda pair: pair.p, default=None)

    @property
    def seeds_needed(self) -> int | None:
        """Seeds per arm that an open claim needs for its open contrasts, all or any, where known of each."""
        if self.verdict != INCONCLUSIVE:
            return None
        needed = [pair.seeds_needed for pair in self.pairs if pair.verdict == INCONCLUSIVE]
        known = [count for count in needed if count is not None]
        most = max if self.claim.need == "all" else min
        return most(known) if known and len(known) == len(needed) else None

    @property
    def run_ids(self) -> list[str]:
        """Ids of every run that was looked at."""
        return list(dict.fromkeys(run_id for pair in self.pairs for run_id in pair.run_ids))


def judge(claims: ClaimList, store: Store) -> list[Judged]:
    """Return the verdict on every claim of a list in every place that it can be judged in.

    Args:
        claims: all of them: none can be judged without the others.
        store: the results folder, with its published tables.

    Raises:
        UserError: for a damaged published table.
    """
    runs = ClaimRuns(store, claims)
    open_cases = [
        (claim, place, _contrasts(claim, place, runs, claims))
        for claim in claims.claims.values()
        for place in PLACES
    ]
    family = [(pair.contrast, claim.direction) for claim, _, pairs in open_cases for pair in pairs]
    verdicts = iter(judge_list(family, ALPHA))
    judged = []
    for claim, place, pairs in open_cases:
        decided = tuple(_decided(pair, next(verdicts), claim, len(family)) for pair in pairs)
        if place in (*claim.worlds, LOGS) and (decided or place != LOGS):
            judged.append(_judged(claim, place, _planned(claim, place, runs, decided, len(family))))
        elif place != LOGS:
            reason = runs.undefined(claim, place)
            judged.append(Judged(claim, place, UNTESTABLE, reason, ()))
    return judged


# --- Contrasts -----------------------------------------------------------------------------------


def _contrasts(claim: Claim, place: str, runs: ClaimRuns, claims: ClaimList) -> list[Pair]:
    if place == LOGS:
        return [Pair(own.a, own.b, compare_logs(claims.logs, claim, own)) for own in claim.logs]
    if place not in claim.worlds:
        return []
    return [_pair(claim, place, runs, a, b) for a, b in claim.pairs]


def _pair(claim: Claim, world: str, runs: ClaimRuns, a: str, b: str | None) -> Pair:
    """Return a claim's contrast of two arms, or of one with a number."""
    told = f"{claim.value:g}" if b is None else b
    reason = claim.untestable or runs.hindrance(claim, world, a, b)
    if reason:
        return Pair(a, told, undecided(claim.kind, reason), runs.known_ids(claim, world, a, b))
    arms = [runs.arm(claim, world, name) for name in (a, b) if name is not None]
    run_ids = tuple(run_id for arm in arms for run_id in arm.run_ids)
    reason = _first(arm.blank or arm.idle for arm in arms) or _at_an_end(claim, arms)
    if reason:
        seeds = arms[0].values.size, arms[1].values.size if len(arms) > 1 else 0
        return Pair(a, told, undecided(claim.kind, reason, seeds), run_ids)
    generator = np.random.default_rng(stream_seed(f"{claim.name}/{world}", f"{a}/{told}"))
    first = _counted(claim, arms[0].values)
    if b is None:
        contrast = compare_with(claim.kind, first, float(claim.value or 0.0), claim.margin, generator)
    else:
        second = _counted(claim, arms[1].values)
        contrast = compare(claim.kind, first, second, claim.margin, generator)
    return Pair(a, told, contrast, run_ids)


def _counted(claim: Claim, values: np.ndarray) -> np.ndarray:
    """Return (runs,) values, or 1 and 0 for runs with and without the event."""
    if claim.event is None:
        return values
    over = values > claim.event.threshold if claim.event.above else values < claim.event.threshold
    return over.astype(float)


def _first(reasons: Iterable[str]) -> str:
    return next(filter(None, reasons), "")


def _at_an_end(claim: Claim, arms: Sequence[Arm]) -> str:
    """Say so where every run of both arms lies at the outcome's least or greatest value.

    As near as the margin counts as there: arms that kill nothing are alike for a reason of their own. The
    margin of a spread is a ratio; what is near an end is then the outcome's to say.
    """
    if len(arms) < 2 or claim.event is not None:
        return ""
    outcome = find_outcome(claim.outcome)
    near = claim.margin if claim.kind == "mean" and claim.margin else outcome.alike
    values = np.concatenate([arm.values for arm in arms])
    for end, bound in zip(("floor", "ceiling"), outcome.bounds, strict=True):
        if np.isfinite(bound) and (np.abs(values - bound) <= near).all():
            return (
                f"both arms are at the {end}: every run has a {claim.outcome} within {near:.2g} of {bound:g}"
            )
    return ""


# --- Verdicts ------------------------------------------------------------------------------------


def _decided(pair: Pair, verdict: Verdict, claim: Claim, family: int) -> Pair:
    """Give a contrast its verdict: untestable for a reason, or where so few runs could not support it.

    Args:
        pair: without a verdict.
        verdict: the list's on it.
        claim: whose it is.
        family: contrasts of the list, by whose number each p-value is multiplied.
    """
    pair = replace(pair, verdict=verdict.word, p=verdict.p)
    smallest = smallest_p(pair.contrast, claim.direction)
    if pair.verdict == INCONCLUSIVE and not pair.contrast.reason and smallest * family > ALPHA:
        told = (
            f"too few seeds: the smallest p possible of {claim.direction} is {smallest:.2g}, "
            f"and the list has {counted(family, 'contrast')}"
        )
        return replace(pair, verdict=UNTESTABLE, contrast=replace(pair.contrast, reason=told))
    if not pair.contrast.reason or pair.verdict != INCONCLUSIVE:
        return pair  # equivalence may be shown by fewer runs than a difference takes
    return replace(pair, verdict=UNTESTABLE)


def _planned(
    claim: Claim, place: str, runs: ClaimRuns, pairs: tuple[Pair, ...], family: int
) -> tuple[Pair, ...]:
    """Add how many seeds each contrast needs that is still open, at the error rate of so long a list."""

    def needed(pair: Pair) -> int | None:
        if pair.verdict != INCONCLUSIVE or place == LOGS or claim.value is not None or claim.only:
            return None  # of runs that count alone, nobody knows beforehand how many there are
        a, b = (_counted(claim, runs.arm(claim, place, name).values) for name in (pair.a, pair.b))
        count = seeds_needed(claim.kind, a, b, claim.margin, ALPHA / family, claim.direction)
        return count if count is not None and count > min(a.size, b.size) else None  # as many decided nothing

    return tuple(replace(pair, seeds_needed=needed(pair)) for pair in pairs)


def _judged(claim: Claim, place: str, pairs: tuple[Pair, ...]) -> Judged:
    """Return a claim's verdict by those on its contrasts; without one, untestable if a contrast is."""
    verdicts = [pair.verdict for pair in pairs]
    verdict = together(verdicts, claim.need) or (UNTESTABLE if UNTESTABLE in verdicts else INCONCLUSIVE)
    reason = _together(pair.contrast.reason for pair in pairs) if verdict == UNTESTABLE else ""
    judged = Judged(claim, place, verdict, reason, pairs)
    return replace(judged, reason=AS_CLAIMED_BUT_SMALL) if _is_as_claimed_but_small(judged) else judged


def _is_as_claimed_but_small(judged: Judged) -> bool:
    """Tell whether equivalence refutes a claim whose direction the interval of the difference bears out."""
    refuted = [pair.contrast for pair in judged.pairs if pair.verdict == REFUTED]
    return judged.verdict == REFUTED and all(
        found(own) == "equal" and _bears_out(own, judged.claim.direction) for own in refuted
    )


def _bears_out(contrast: Contrast, direction: str) -> bool:
    """Tell whether the interval lies wholly where the direction has it."""
    none, interval = 1.0 if contrast.kind == "spread" else 0.0, contrast.interval
    return interval.low > none if direction == "greater" else direction == "less" and interval.high < none


def _together(reasons: Iterable[str]) -> str:
    """Return the parts of several reasons, each once, the command that mends them last."""
    parts = dict.fromkeys(part for reason in reasons if reason for part in reason.split("; "))
    return "; ".join(sorted(parts, key=lambda part: part.startswith(MEND)))
