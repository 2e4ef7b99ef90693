"""Claims and runs → a verdict on every claim in every world.

    ClaimList and RunIndex → the table of contrasts with verdicts → [Verdict], one for each claim and world

Every claim is judged, separately in each world, by exactly the runs that it fixed beforehand. A verdict
compares the ends of the simultaneous interval, which is printed, with 0 and with the margin; nothing else
decides. All intervals of a world, also those of claims without runs, hold together with 95 % probability. So
the chance of any false verdict in a world is at most 5 %, whichever claims are shown and whatever was run.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pneuma.analysis.claims.claim_list import Claim, ClaimList
from pneuma.analysis.claims.contrasts import Contrast, compare_arms
from pneuma.analysis.claims.fixed_runs import TRAIN_WITH, Arm, ClaimRuns, find_claim_runs
from pneuma.analysis.claims.history import HOW_MANY, changed_since
from pneuma.analysis.intervals import Interval
from pneuma.analysis.outcomes import find_outcome
from pneuma.store.index import RunIndex

SUPPORTED, REFUTED, MIXED = "supported", "refuted", "mixed"
INCONCLUSIVE, UNTESTABLE = "inconclusive", "untestable"
DESCRIBED = "described"
"""The verdict on a claim that states no direction."""
DECIDING_FIRST = (REFUTED, UNTESTABLE, INCONCLUSIVE, SUPPORTED, DESCRIBED)
"""Where all of several verdicts must be as claimed, the first of these that one of them has decides."""

RARE = 0.1
"""A share of runs up to which an event counts as none, and its absence likewise."""
AS_CLAIMED_BUT_SMALL = "in the direction claimed, but too small to count"
"""The reason if a claim is refuted although its interval lies wholly on the claimed side of 0."""

PREREGISTERED, DESCRIPTIVE = "preregistered", "descriptive"

Wanted = Callable[[Claim, str], bool]
"""Whether a claim is to be judged in a world."""


@dataclass(frozen=True)
class ClaimContrast:
    """A row of the table: a contrast of a claim in a world, and the verdict on it alone.

    Attributes:
        a, b: the conditions of either arm, several for a range; b is empty for a constant.
        alpha: the contrast's own part of the list's error rate in the world.
        contrast: what the runs show; its reason is not empty if nothing can be concluded.
        runs: the ids of the runs that were read, by condition.
        verdict: empty before it is judged.
        registered_verdict: the same by the margin that was registered, where margins were set anew.
        none_learned: whether neither arm is shown to play better than the random player, so that being alike
            counts for nothing.
    """

    claim: Claim
    world: str
    outcome: str
    a: tuple[str, ...]
    b: tuple[str, ...]
    alpha: float = 1.0
    contrast: Contrast = Contrast()
    runs: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    verdict: str = ""
    registered_verdict: str = ""
    none_learned: bool = False

    @property
    def margin(self) -> float | None:
        """The smallest difference that counts; None against a constant, which is itself what counts."""
        return self.claim.margin_of(self.world, self.outcome) if self._has_margin else None

    @property
    def registered_margin(self) -> float | None:
        return self.claim.registered_margin_of(self.world, self.outcome) if self._has_margin else None

    @property
    def _has_margin(self) -> bool:
        return bool(self.b) or not self.value

    @property
    def value(self) -> float:
        """The constant that arm a is compared with; 0 if there is none."""
        return self.claim.value_of(self.world, self.outcome) or 0.0

    @property
    def conditions(self) -> tuple[str, ...]:
        return tuple(dict.fromkeys((*self.a, *self.b)))

    @property
    def other_outcome(self) -> str:
        """The outcome of the same runs that is compared with this one; mostly empty."""
        return self.claim.other_outcome(self.outcome)

    @property
    def names(self) -> tuple[str, str]:
        """The arms as text; b may be a number or an outcome."""
        return ", ".join(self.a), ", ".join(self.b) or self.other_outcome or f"{self.value:g}"

    @property
    def has_effect(self) -> bool:
        return math.isfinite(self.contrast.effect)

    def compare(self, arms: Mapping[str, Arm]) -> Contrast:
        """Return the contrast of the arms of each condition."""
        a = {name: arms[name].values for name in self.a}
        if self.other_outcome:
            others = arms[self.a[0]].other_values
            contrast = compare_arms(self.claim.kind, {"a": a[self.a[0]] - others}, 0.0, 1 - self.alpha)
            return replace(contrast, means=(contrast.means[0] + float(others.mean()), float(others.mean())))
        b = {name: arms[name].values for name in self.b} or self.value
        return compare_arms(self.claim.kind, a, b, 1 - self.alpha)


@dataclass(frozen=True)
class Verdict:
    """The verdict on a claim in one of `WORLDS`.

    Attributes:
        verdict: supported, refuted, mixed, inconclusive, untestable or described.
        reason: why it is untestable, what is missing, or `AS_CLAIMED_BUT_SMALL`; empty for a plain result.
        contrasts: its rows of the table.
        registered_verdict: the verdict by the margins that were registered, where they were set anew.
        label: whether it tests: `PREREGISTERED`, `DESCRIPTIVE`, or on which list's runs it was stated.
        changed: what of the claim is not as it was when its runs were trained; None if that is unknown.
    """

    claim: Claim
    world: str
    verdict: str
    reason: str
    contrasts: tuple[ClaimContrast, ...] = ()
    registered_verdict: str = ""
    label: str = ""
    changed: tuple[str, ...] | None = None

    @property
    def deciding(self) -> tuple[ClaimContrast, ...]:
        """For each outcome the contrast that decides it, the first one with its verdict; or all pairs."""
        if self.claim.paired:
            return self.contrasts
        deciding: dict[str, ClaimContrast] = {}
        for verdict in DECIDING_FIRST:
            for row in self.contrasts:
                if row.verdict == verdict:
                    deciding.setdefault(row.outcome, row)
        in_order = dict.fromkeys(row.outcome for row in self.contrasts)
        return tuple(deciding[outcome] for outcome in in_order)

    @property
    def run_ids(self) -> list[str]:
        every = [run_id for row in self.contrasts for run_ids in row.runs.values() for run_id in run_ids]
        return list(dict.fromkeys(every))

    @property
    def lacks_runs(self) -> bool:
        return TRAIN_WITH in self.reason


def judge(claims: ClaimList, index: RunIndex, wanted: Wanted = lambda claim, world: True) -> list[Verdict]:
    """Return the verdict on each claim of a list in each of its worlds, or on those that are wanted.

    The correction is for the planned contrasts of the whole family, whichever are wanted: no data of the
    others are needed.
    """
    verdicts: list[Verdict] = []
    for claim in claims.claims.values():
        for world in claim.worlds:
            if wanted(claim, world):
                verdicts.append(judge_claim(claims, find_claim_runs(index, claims, claim, world)))
    return verdicts


def judge_claim(claims: ClaimList, runs: ClaimRuns) -> Verdict:
    """Return the verdict on a claim of a list in one world by its runs."""
    claim, world = runs.claim, runs.world
    alpha = claims.head.alpha / claims.family_size(world, claim.study)
    rows: list[ClaimContrast] = []
    verdicts: list[str] = []
    registered: list[str] = []
    for outcome in claim.outcome:
        of_outcome = [
            _judge_contrast(ClaimContrast(claim, world, outcome, a, b, alpha), runs)
            for a, b in claim.pairs(outcome)
        ]
        verdicts.append(all_of(row.verdict for row in of_outcome))
        registered.append(all_of(row.registered_verdict for row in of_outcome))
        rows += of_outcome
    verdict = combine(verdicts, claim.need)
    changed = changed_since(claims, claim, world, runs.commits)
    return Verdict(
        claim=claim,
        world=world,
        verdict=verdict,
        reason=_reason(verdict, rows),
        contrasts=tuple(rows),
        registered_verdict=combine(registered, claim.need),
        label=_label(claims, claim, changed),
        changed=changed,
    )


def _label(claims: ClaimList, claim: Claim, changed: Sequence[str] | None) -> str:
    """Return whether a claim was stated before its runs."""
    if claim.seen or {*(changed or ())} - {*HOW_MANY}:
        return DESCRIPTIVE
    seeds = [seed for condition in claim.compared for seed in claim.seeds_of(condition)]
    if min(seeds) < claims.head.known_below:
        return f"same runs as {claims.head.known_from}"
    return PREREGISTERED


def _reason(verdict: str, rows: Sequence[ClaimContrast]) -> str:
    if verdict == UNTESTABLE:  # each part of the reasons once, the command that trains what is missing last
        parts = dict.fromkeys(part for row in rows for part in row.contrast.reason.split("; ") if part)
        return "; ".join(sorted(parts, key=lambda part: part.startswith(TRAIN_WITH)))
    refuted = [row for row in rows if row.verdict == REFUTED]
    if verdict == REFUTED and all(map(_is_as_claimed_but_small, refuted)):
        return AS_CLAIMED_BUT_SMALL
    return ""


def _is_as_claimed_but_small(row: ClaimContrast) -> bool:
    """Return whether an effect is refuted as too small although its interval is on the claimed side of 0."""
    ends, claimed = row.contrast.simultaneous, row.claim.claimed(row.outcome)
    is_above = claimed in ("greater", "different") and ends.low > 0
    is_below = claimed in ("less", "different") and ends.high < 0
    return is_above or is_below


# --- Contrasts -----------------------------------------------------------------------------------


def _judge_contrast(row: ClaimContrast, runs: ClaimRuns) -> ClaimContrast:
    row = replace(row, runs={name: tuple(run.run_id for run in runs.rows[name]) for name in row.conditions})
    reason = row.claim.not_tested or runs.why_incomparable(row.outcome, row.conditions)
    if reason:
        contrast = Contrast(reason=reason)
        return replace(row, verdict=UNTESTABLE, registered_verdict=UNTESTABLE, contrast=contrast)
    arms = {name: runs.arm(row.outcome, name, row.other_outcome) for name in row.conditions}
    contrast, verdict = _verdict_by_margin(row, arms, row.margin)
    _, registered_verdict = _verdict_by_margin(row, arms, row.registered_margin)
    return replace(
        row,
        contrast=contrast,
        verdict=verdict,
        registered_verdict=registered_verdict,
        none_learned=verdict != UNTESTABLE and _have_none_learned(row, arms),
    )


def _verdict_by_margin(
    row: ClaimContrast, arms: Mapping[str, Arm], margin: float | None
) -> tuple[Contrast, str]:
    """Return the contrast of arms of finished runs, and the verdict on it with a margin."""
    if reason := _why_untestable(row, arms, margin):
        sizes = [arms[name].values.shape[-1] for name in (*row.a, *row.b)] + [0]
        return Contrast(seeds=(sizes[0], sizes[1]), reason=reason), UNTESTABLE
    contrast = row.compare(arms)
    alike_counts = not _have_none_learned(row, arms)
    return contrast, decide(contrast.simultaneous, row.claim.claimed(row.outcome), margin, alike_counts)


def _why_untestable(row: ClaimContrast, arms: Mapping[str, Arm], margin: float | None) -> str:
    """Return why arms of finished runs decide nothing; empty if they can be compared."""
    for arm in arms.values():
        if arm.reason:
            return arm.reason
    for name, arm in arms.items():
        if find_outcome(row.outcome).requires_learning and arm.learned is False:
            return f"arm at floor: {name} is not shown to play better than the random player"
    if len(arms) < 2 or row.claim.kind == "hazard":
        return ""
    return _rare_or_common(arms) if row.claim.is_incidence else _at_an_end(row.outcome, arms, margin)


def _have_none_learned(row: ClaimContrast, arms: Mapping[str, Arm]) -> bool:
    """Return whether play is compared of arms of which none is shown to play better than the random player.

    Such arms may be alike because nothing was learned, so that only a difference between them counts.
    """
    is_of_play = _is_of_play(row.outcome) and not row.claim.is_incidence
    if not is_of_play and row.claim.claimed(row.outcome) not in ("equal", "no-less"):
        return False
    return len(arms) > 1 and all(arm.learned is False for arm in arms.values())


def _rare_or_common(arms: Mapping[str, Arm]) -> str:
    """Return the reason if in every arm at most a tenth of the runs have the event, or lack it."""
    shares = np.array([arm.values.mean() for arm in arms.values()])
    for end, is_there in (("floor", shares <= RARE), ("ceiling", shares >= 1 - RARE)):
        if is_there.all():
            return f"both arms are at the {end}: {RARE:.0%} of the runs or fewer differ"
    return ""


def _at_an_end(outcome: str, arms: Mapping[str, Arm], margin: float | None) -> str:
    """Return the reason if every run of all arms is at the outcome's least or greatest value.

    Values within the margin of an end count as there; without a margin, the outcome's own tolerance is used.
    For outcomes that measure play, the floor is decided by the comparison with the random player.
    """
    measured = find_outcome(outcome)
    tolerance = margin or measured.alike
    values = np.concatenate([arm.values for arm in arms.values()])
    low, high = measured.bounds
    ends = {"floor": low, "ceiling": high}
    if _is_of_play(outcome) and all(arm.learned is not None for arm in arms.values()):
        del ends["floor"]
    for end, bound in ends.items():
        if np.isfinite(bound) and (np.abs(values - bound) <= tolerance).all():
            within = f"within {tolerance:.2g} of {bound:g}"
            return f"both arms are at the {end}: every run has a {outcome} {within}"
    return ""


def _is_of_play(outcome: str) -> bool:
    """Return whether a greater outcome means better play."""
    measured = find_outcome(outcome)
    return measured.better == "higher" and measured.source not in ("times", "signs")


# --- Decisions -----------------------------------------------------------------------------------


def decide(ends: Interval, claimed: str, margin: float | None, alike_counts: bool = True) -> str:
    """Return the verdict of an interval of a minus b on a claimed direction.

    A difference is shown to be too small if the whole interval is nearer to 0 than the margin. That refutes
    a claim of a difference also where the interval lies on the claimed side of 0. Without an interval nothing
    is decided, and without a margin no difference is too small; nor if that arms are alike does not count.
    """
    if claimed == DESCRIBED:
        return DESCRIBED
    if not ends.exists:
        return INCONCLUSIVE
    # without a margin, no interval lies within it or beyond it
    within = margin is not None and -margin < ends.low and ends.high < margin and alike_counts
    far_above = margin is not None and ends.low > margin
    far_below = margin is not None and ends.high < -margin
    no_less = margin is not None and ends.low > -margin and alike_counts
    is_above, is_below = ends.low > 0, ends.high < 0
    holds, fails = {
        "greater": (is_above, is_below or within),
        "less": (is_below, is_above or within),
        "different": (is_above or is_below, within),
        "equal": (within, far_above or far_below),
        "no-less": (no_less, far_below),
    }[claimed]
    if fails:
        return REFUTED
    return SUPPORTED if holds else INCONCLUSIVE


def all_of(verdicts: Iterable[str]) -> str:
    """Return the verdict where all must be as claimed: one that is refuted refutes."""
    return min(verdicts, key=DECIDING_FIRST.index)


def combine(verdicts: Sequence[str], need: str = "one") -> str:
    """Return the verdict on a claim, given those on its outcomes.

    If it needs one, one outcome that is as claimed supports it unless another is not, which makes it mixed;
    and in the opposite case it is refuted. An outcome that cannot be tested then decides nothing. A verdict
    is false only if that on one of the outcomes is.
    """
    if need == "all":
        return all_of(verdicts)
    if SUPPORTED in verdicts and REFUTED in verdicts:
        return MIXED
    for decisive in (SUPPORTED, REFUTED, INCONCLUSIVE, DESCRIBED):
        if decisive in verdicts:
            return decisive
    return UNTESTABLE
