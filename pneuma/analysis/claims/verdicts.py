"""Judgement: claims and runs → a verdict on every claim in every world.

    ClaimList and Store → the table of contrasts with verdicts → [Verdict], one a claim and world

Every claim is judged, separately in each world, by exactly the runs that it fixed beforehand. A verdict
compares the ends of the simultaneous interval, which is printed, with 0 and with the margin; nothing else
decides. All intervals of a world, also those of claims without runs, hold together with 95 % probability. So
the chance of any false verdict in a world is at most 5 %, whichever claims are shown and whatever was run.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import groupby

import numpy as np

from pneuma.analysis.claims.claim_list import MINUS, Claim, ClaimList
from pneuma.analysis.claims.contrasts import Contrast, compare_arms
from pneuma.analysis.claims.fixed_runs import TRAIN_WITH, Arm, ClaimRuns, Wanted, find_claim_runs
from pneuma.analysis.claims.table import ClaimContrast, plan_contrasts
from pneuma.analysis.intervals import Interval
from pneuma.analysis.outcomes import find_outcome
from pneuma.analysis.run_index import RunIndex
from pneuma.study.store import Store

SUPPORTED, REFUTED, MIXED = "supported", "refuted", "mixed"
INCONCLUSIVE, UNTESTABLE = "inconclusive", "untestable"

RARE = 0.1
"""A share of runs up to which an event counts as none, and its absence likewise."""
AS_CLAIMED_BUT_SMALL = "in the direction claimed, but too small to count"
"""The reason if a claim is refuted although its interval lies wholly on the claimed side of 0."""


@dataclass(frozen=True)
class Verdict:
    """The verdict on a claim in one of `WORLDS`.

    Attributes:
        verdict: supported, refuted, mixed, inconclusive or untestable.
        reason: why it is untestable, what is missing, or `AS_CLAIMED_BUT_SMALL`; empty for a plain result.
        contrasts: its rows of the table, untestable all if it is not admitted.
        commits: of the code that trained its runs.
    """

    claim: Claim
    world: str
    verdict: str
    reason: str
    contrasts: tuple[ClaimContrast, ...] = ()
    commits: tuple[str, ...] = ()

    @property
    def deciding(self) -> tuple[ClaimContrast, ...]:
        """For each outcome the contrast that decides it, the first one with its verdict; or all pairs."""
        if self.claim.paired:
            return self.contrasts
        return tuple(
            next((row for row in rows if row.verdict == verdict_of_outcome(rows)), rows[0])
            for rows in by_outcome(self.contrasts)
        )

    @property
    def run_ids(self) -> list[str]:
        return list(
            dict.fromkeys(run_id for row in self.contrasts for ids in row.runs.values() for run_id in ids)
        )

    @property
    def lacks_runs(self) -> bool:
        return TRAIN_WITH in self.reason


def judge(
    claims: ClaimList,
    store: Store,
    stored: bool = True,
    asked: Wanted = lambda claim, world: True,
) -> list[Verdict]:
    """Return the verdict on each claim of a list in each of its worlds, or on those that are asked for.

    The correction is for the planned contrasts of the whole list, whichever are asked for: no data of the
    others are needed. With `stored = False` only published tables are used.
    """
    planned: dict[tuple[str, str], list[ClaimContrast]] = {}
    for row in plan_contrasts(claims):
        planned.setdefault((row.claim.name, row.world), []).append(row)
    verdicts: list[Verdict] = []
    for runs in find_claim_runs(RunIndex(store, stored, shipped=False), claims, asked):
        rows, arm = planned[runs.claim.name, runs.world], cache(runs.arm)
        if rows[0].refused:
            reason = f"not admitted: {rows[0].refused}"
            table = tuple(replace(row, verdict=UNTESTABLE, contrast=Contrast(reason=reason)) for row in rows)
            verdicts.append(Verdict(runs.claim, runs.world, UNTESTABLE, reason, table))
        else:
            table = tuple(_judge_contrast(row, runs, arm) for row in rows)
            verdicts.append(replace(_combine(runs.claim, runs.world, table), commits=runs.commits))
    return verdicts


def _combine(claim: Claim, world: str, table: tuple[ClaimContrast, ...]) -> Verdict:
    verdict, reason = combine_outcomes([*map(verdict_of_outcome, by_outcome(table))], claim.need), ""
    if verdict == UNTESTABLE:  # each part of the reasons once, the command that trains what lacks last
        parts = dict.fromkeys(part for row in table for part in row.contrast.reason.split("; ") if part)
        reason = "; ".join(sorted(parts, key=lambda part: part.startswith(TRAIN_WITH)))
    elif verdict == REFUTED:
        refuted = [row for row in table if row.verdict == REFUTED]
        reason = AS_CLAIMED_BUT_SMALL if all(map(_is_as_claimed_but_small, refuted)) else ""
    return Verdict(claim, world, verdict, reason, table)


def by_outcome(table: Iterable[ClaimContrast]) -> list[list[ClaimContrast]]:
    return [list(rows) for _, rows in groupby(table, key=lambda row: row.outcome)]


def _is_as_claimed_but_small(row: ClaimContrast) -> bool:
    """Return whether an effect is refuted as too small although its interval is on the claimed side of 0."""
    ends, claimed = row.contrast.simultaneous, row.claim.claimed(row.outcome)
    return (claimed in ("greater", "different") and ends.low > 0) or (
        claimed in ("less", "different") and ends.high < 0
    )


# --- Contrasts -----------------------------------------------------------------------------------


def _judge_contrast(row: ClaimContrast, runs: ClaimRuns, arm: Callable[[str, str], Arm]) -> ClaimContrast:
    """Judge one contrast of a claim; it is untestable for a reason."""
    names = [*dict.fromkeys((*row.a, *row.b))]
    reason = runs.why_incomparable(row.outcome, names)
    arms = {} if reason else {name: arm(row.outcome, name) for name in names}
    if reason := reason or _why_untestable(row, arms):
        sizes = [arms[name].values.size for name in (*row.a, *row.b) if name in arms] + [0, 0]
        contrast = Contrast(seeds=(sizes[0], sizes[1]), reason=reason)
    else:
        values = {name: own.values for name, own in arms.items()}
        contrast = compare_arms(row.claim.kind, values, row.a, row.b, row.value, 1 - row.alpha)
    found = {name: tuple(run.run_id for run in runs.found(name)) for name in names}
    margin = row.margin if row.b or not row.value else None  # a threshold itself is the least that counts
    none_learned = _none_learned(row, arms)
    ends, claimed = contrast.simultaneous, row.claim.claimed(row.outcome)
    verdict = UNTESTABLE if reason else decide(ends, claimed, margin, alike_counts=not none_learned)
    return replace(
        row,
        contrast=contrast,
        runs=found,
        verdict=verdict,
        none_learned=none_learned and not reason,
    )


def _why_untestable(row: ClaimContrast, arms: Mapping[str, Arm]) -> str:
    """Return why arms of finished runs decide nothing; empty if they can be compared."""
    return (
        next((own.reason for own in arms.values() if own.reason), "")
        or _at_floor(row, arms)
        or _at_an_end(row, [*arms.values()])
    )


def _at_floor(row: ClaimContrast, arms: Mapping[str, Arm]) -> str:
    """Return why arms cannot be compared by an outcome of runs that learned; empty if they can."""
    idle = [name for name, arm in arms.items() if arm.learned is False]
    if idle and any(find_outcome(part).requires_learning for part in row.outcome.split(MINUS)):
        return f"arm at floor: {idle[0]} is not shown to play better than the random player"
    return ""


def _none_learned(row: ClaimContrast, arms: Mapping[str, Arm]) -> bool:
    """Return whether play is compared of arms of which none is shown to play better than the random player.

    Such arms may be alike because nothing was learned, so that only a difference between them counts.
    """
    of_play = _is_of_play(row.outcome) and not row.claim.counts
    judged = of_play or row.claim.direction in ("equal", "no-less")
    return judged and len(arms) > 1 and all(arm.learned is False for arm in arms.values())


def _at_an_end(row: ClaimContrast, arms: Sequence[Arm]) -> str:
    """Return the reason if every run of both arms is at the outcome's least or greatest value.

    Values within the margin of an end count as there; without a margin, the outcome's own tolerance is used.
    For outcomes that measure play, the floor is decided by the comparison with the random player. Where runs
    are counted, arms of which at most a tenth have the event, or lack it, are at an end: there is nothing to
    cure, or to make worse.
    """
    if len(arms) < 2 or MINUS in row.outcome:
        return ""
    if row.claim.counts:
        shares = np.array([arm.values.mean() for arm in arms])
        ends = {"floor": (shares <= RARE).all(), "ceiling": (shares >= 1 - RARE).all()}
        reached = [end for end, there in ends.items() if there]
        return f"both arms are at the {reached[0]}: {RARE:.0%} of the runs or fewer differ" if reached else ""
    measured = find_outcome(row.outcome)
    near = row.margin or measured.alike
    known = _is_of_play(row.outcome) and all(arm.learned is not None for arm in arms)
    values = np.concatenate([arm.values for arm in arms])
    for end, bound in zip(("floor", "ceiling"), measured.bounds, strict=True):
        if not (known and end == "floor") and np.isfinite(bound) and (np.abs(values - bound) <= near).all():
            return f"both arms are at the {end}: every run has a {row.outcome} within {near:.2g} of {bound:g}"
    return ""


def _is_of_play(outcome: str) -> bool:
    """Return whether a greater outcome means better play."""
    parts = [find_outcome(part) for part in outcome.split(MINUS)]
    return all(part.better == "higher" and part.source not in ("times", "signs") for part in parts)


# --- Decisions -----------------------------------------------------------------------------------


def decide(ends: Interval, claimed: str, margin: float | None, alike_counts: bool = True) -> str:
    """Return what an interval of a less b says of a claimed direction.

    A difference is shown to be too small if the whole interval is nearer to 0 than the margin. That refutes
    a claim of a difference also where the interval lies on the claimed side of 0. Without an interval nothing
    is decided, and without a margin no difference is too small; nor if that arms are alike does not count.
    """
    if not ends.exists:
        return INCONCLUSIVE
    near = margin is not None and -margin < ends.low and ends.high < margin and alike_counts
    far_above, far_below = (
        margin is not None and ends.low > margin,
        margin is not None and ends.high < -margin,
    )
    shown = {
        "greater": (ends.low > 0, ends.high < 0 or near),
        "less": (ends.high < 0, ends.low > 0 or near),
        "different": (ends.low > 0 or ends.high < 0, near),
        "equal": (near, far_above or far_below),
        "no-less": (margin is not None and ends.low > -margin and alike_counts, far_below),
    }
    supported, refuted = shown[claimed]
    return REFUTED if refuted else SUPPORTED if supported else INCONCLUSIVE


def verdict_of_outcome(rows: Sequence[ClaimContrast]) -> str:
    """Return the verdict on one outcome: all its contrasts must be as claimed; one that is not refutes."""
    verdicts = [row.verdict for row in rows]
    for decides in (REFUTED, UNTESTABLE, INCONCLUSIVE):
        if decides in verdicts:
            return decides
    return SUPPORTED


def combine_outcomes(verdicts: Sequence[str], need: str = "one") -> str:
    """Return the verdict on a claim, given those on its outcomes.

    If it needs one, one outcome that is as claimed supports it unless another is not, which makes it mixed;
    and in the opposite case it is refuted. If it needs all, one that is not as claimed refutes it. An outcome
    that cannot be tested decides nothing. A verdict is false only if that on one of the outcomes is.
    """
    tested = [verdict for verdict in verdicts if verdict != UNTESTABLE]
    if not tested or (need == "all" and UNTESTABLE in verdicts and REFUTED not in verdicts):
        return UNTESTABLE
    if need == "all":
        return REFUTED if REFUTED in tested else SUPPORTED if {*tested} == {SUPPORTED} else INCONCLUSIVE
    decided = {*tested} - {INCONCLUSIVE}
    return MIXED if len(decided) == 2 else next(iter(decided), INCONCLUSIVE)
