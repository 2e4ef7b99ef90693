"""Judgement: claims and runs → a verdict on every claim in every world.

    ClaimList and Store → [Verdict]

Every claim is judged, separately in each world, by exactly the runs that it fixed beforehand. All contrasts
of all claims in one world, including those without runs, are one family for the correction. So the chance of
any false verdict in a world is at most the list's alpha, whichever claims are shown and whatever was run.

Each contrast enters with the smallest p-value that can decide it, corrected by Bonferroni. Holm's steps would
be wrong here: a contrast that is found equivalent would leave the list because its effect looked small, so
that those with large ones remain. Most lists of 60 true equivalences, judged in steps, can contain a false
difference. docs/evidence.md explains why the smaller p-value bounds the chance of any false verdict.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from pneuma.analysis.arms import FLOOR_LEVEL, TRAIN_WITH, Arm, ClaimRuns
from pneuma.analysis.claim_runs import find_runs
from pneuma.analysis.claims import MINUS, Claim, ClaimList
from pneuma.analysis.contrasts import Contrast, compare, compare_ranges, undecided
from pneuma.analysis.design import arms_of, not_admitted
from pneuma.analysis.outcomes import find_outcome
from pneuma.analysis.pvalues import one_share_p_values
from pneuma.analysis.run_index import RunIndex
from pneuma.errors import counted
from pneuma.study.store import Store

SUPPORTED, REFUTED, MIXED = "supported", "refuted", "mixed"
INCONCLUSIVE, UNTESTABLE = "inconclusive", "untestable"
VERDICTS = (SUPPORTED, REFUTED, MIXED, INCONCLUSIVE, UNTESTABLE)

AS_CLAIMED_BUT_SMALL = "in the direction claimed, but smaller than the margin"
"""The reason if equivalence refutes a claim whose interval lies wholly on the claimed side."""
WITH_CONTENT, BY_LETTER, OPEN, UNDECIDABLE, NOT_RUN = STANDINGS = (
    "decided with content", "decided by the letter", "open", "could not be decided", "not run yet",
)  # fmt: skip
"""The kinds of verdict that are counted (docs/evidence.md)."""


@dataclass(frozen=True)
class Comparison:
    """One contrast of a claim, with its verdict.

    Attributes:
        a, b: the names of the arms; b may be a number.
        outcome: the outcome that is compared.
        contrast: the result; its reason is not empty if nothing can be concluded.
        verdict: one of `VERDICTS`. p: corrected for the whole list.
    """

    a: str
    b: str
    outcome: str
    contrast: Contrast
    run_ids: tuple[str, ...] = ()
    verdict: str = ""
    p: float = 1.0


@dataclass(frozen=True)
class Verdict:
    """The verdict on a claim in one of `WORLDS`.

    Attributes:
        verdict: of `VERDICTS`.
        reason: why it is untestable, what is missing, or `AS_CLAIMED_BUT_SMALL`; empty for a plain result.
        comparisons: its contrasts; none if its study is not run in the world.
    """

    claim: Claim
    place: str
    verdict: str
    reason: str
    comparisons: tuple[Comparison, ...] = ()

    @property
    def decisive(self) -> Comparison | None:
        """The contrast that decides the outcome with the claim's verdict; of two such outcomes, the surer."""
        each = decisive_of(self)
        agreeing = [comparison for comparison in each if comparison.verdict == self.verdict]
        return min(agreeing or each, key=lambda comparison: comparison.p, default=None)

    @property
    def seen(self) -> bool:
        """Whether its runs were seen before the claim was stated: a description, and no test."""
        return self.place in self.claim.seen

    @property
    def run_ids(self) -> list[str]:
        return list(dict.fromkeys(run_id for comparison in self.comparisons for run_id in comparison.run_ids))

    @property
    def standing(self) -> str:
        """The kind of verdict, one of `STANDINGS`.

        A claim is decided by the letter only if it is supported by an effect inside the margin, or refuted
        although the effect is in the claimed direction.
        """
        if self.verdict == UNTESTABLE:
            return NOT_RUN if TRAIN_WITH in self.reason else UNDECIDABLE
        if self.verdict == INCONCLUSIVE:
            return OPEN
        if self.reason == AS_CLAIMED_BUT_SMALL:
            return BY_LETTER
        decisive = self.decisive
        margin = self.claim.of("margin", decisive.outcome) if decisive else None
        of_size = self.claim.direction not in ("equal", "no-less") and not self.claim.counts_itself
        if decisive and margin and self.verdict == SUPPORTED and of_size:
            return BY_LETTER if abs(decisive.contrast.effect) < margin else WITH_CONTENT
        return WITH_CONTENT


def judge(
    claims: ClaimList,
    store: Store,
    stored: bool = True,
    on_progress: Callable[[int, int], object] = lambda done, of: None,
) -> list[Verdict]:
    """Return the verdict on each claim of a list in each of its worlds.

    With `stored = False` only published tables are used. No claim can be judged without the others of the
    list. `on_progress` is called with the number of verdicts so far, and of all.
    """
    refused = not_admitted(claims)
    of = sum(len(claim.worlds) for claim in claims.claims.values())
    verdicts: list[Verdict] = []
    for runs in find_runs(RunIndex(store, stored, shipped=False), claims):
        verdicts.append(_judge_one(runs, claims, refused.get((runs.claim.name, runs.world), "")))
        on_progress(len(verdicts), of)
    return verdicts


def _judge_one(runs: ClaimRuns, claims: ClaimList, refused: str) -> Verdict:
    claim = runs.claim
    if refused:
        return Verdict(claim, runs.world, UNTESTABLE, f"not admitted: {refused}")
    arm = cache(runs.arm)
    made = tuple(
        _judge_contrast(runs, arm, outcome, *pair, claims)
        for outcome in claim.outcome
        for pair in claim.pairs
    )
    each = [
        [comparison.verdict for comparison in made if comparison.outcome == outcome]
        for outcome in claim.outcome
    ]
    untestable = any(comparison.verdict == UNTESTABLE for comparison in made)
    verdict = of_outcomes([together(verdicts) for verdicts in each])
    verdict = verdict or (UNTESTABLE if untestable else INCONCLUSIVE)
    reason = ""
    if verdict == UNTESTABLE:  # each part of the reasons once, the command that mends them last
        parts = dict.fromkeys(
            part for comparison in made for part in comparison.contrast.reason.split("; ") if part
        )
        reason = "; ".join(sorted(parts, key=lambda part: part.startswith(TRAIN_WITH)))
    elif verdict == REFUTED:
        refuted = [comparison.contrast for comparison in made if comparison.verdict == REFUTED]
        small = all(_is_as_claimed_but_small(contrast, claim.direction) for contrast in refuted)
        reason = AS_CLAIMED_BUT_SMALL if small else ""
    return Verdict(claim, runs.world, verdict, reason, made)


def decisive_of(verdict: Verdict) -> list[Comparison]:
    """Return, for each outcome of a claim, the contrast that decides.

    It is the surest if one is enough for the verdict, which is so if it refutes, else the least sure.
    """
    deciding = []
    for outcome in dict.fromkeys(comparison.outcome for comparison in verdict.comparisons):
        each = [comparison for comparison in verdict.comparisons if comparison.outcome == outcome]
        word = together([comparison.verdict for comparison in each]) or INCONCLUSIVE
        agreeing = [comparison for comparison in each if comparison.verdict == word] or each
        deciding.append((min if word == REFUTED else max)(agreeing, key=lambda comparison: comparison.p))
    return deciding


def _is_as_claimed_but_small(contrast: Contrast, direction: str) -> bool:
    """Return whether equivalence refutes a claim although its interval supports the direction."""
    low, high = contrast.interval.low, contrast.interval.high
    as_claimed = (direction != "less" and low > 0) or (direction != "greater" and high < 0)
    return what_it_shows(contrast) == "equal" and as_claimed


# --- Contrasts -----------------------------------------------------------------------------------


def _judge_contrast(
    runs: ClaimRuns,
    arm: Callable[[str, str], Arm],
    outcome: str,
    a: tuple[str, ...],
    b: tuple[str, ...],
    claims: ClaimList,
) -> Comparison:
    """Judge one contrast of a claim. It is untestable for a reason, or if too few runs could support it."""
    claim, names = runs.claim, [*dict.fromkeys((*a, *b, *runs.claim.control))]
    factor, alpha = claims.contrasts(runs.world), claims.head.alpha
    reason = runs.hindrance(outcome, names)
    arms = {} if reason else {name: arm(outcome, name) for name in names}
    reason = reason or next((arm.reason for arm in arms.values() if arm.reason), "")
    tested = {name: arm for name, arm in arms.items() if name in (*a, *b)}
    reason = reason or _at_floor(claim, outcome, tested) or _at_an_end(claim, outcome, [*tested.values()])
    reason = reason or _not_ill(claim, outcome, arms)
    if reason:
        sizes = [counted.values.size for counted in tested.values()] + [0, 0]
        contrast = undecided(reason, (sizes[0], sizes[1]))
    else:
        contrast = _compare(claim, outcome, a, b, arms, 1 - alpha / factor)
    verdict, p = decide(contrast, claim.direction, factor, alpha)
    if verdict == INCONCLUSIVE:  # equivalence may need fewer runs than a difference
        smallest = smallest_p(contrast, claim.direction)
        if not contrast.reason and smallest * factor > alpha:
            few = f"too few seeds: the smallest p possible of {claim.direction} is {smallest:.2g}"
            problem = f"{few}, and the list has {counted(factor, 'contrast')} in this world"
            contrast = replace(contrast, reason=problem)
        verdict = UNTESTABLE if contrast.reason else INCONCLUSIVE
    counted_ids = tuple(run_id for arm in arms.values() for run_id in arm.run_ids)
    known_ids = tuple(run.run_id for name in names for run in runs.found(name))
    run_ids = counted_ids if arms else known_ids
    other = arms_of(b, claim.of("value", outcome))
    return Comparison(arms_of(a, None), other, outcome, contrast, run_ids, verdict, p)


def _compare(
    claim: Claim,
    outcome: str,
    a: tuple[str, ...],
    b: tuple[str, ...],
    arms: Mapping[str, Arm],
    level: float,
) -> Contrast:
    value = float(claim.of("value", outcome) or 0)
    margin = None if claim.counts_itself else claim.of("margin", outcome)
    if claim.kind == "range":
        names = [*arms]
        places = [names.index(name) for name in b] if b else value
        values = [arm.values for arm in arms.values()]
        return compare_ranges(values, [names.index(name) for name in a], places, margin, level)
    against = arms[b[0]].values if b else value
    return compare(claim.kind, arms[a[0]].values, against, margin, level)


def _not_ill(claim: Claim, outcome: str, arms: Mapping[str, Arm]) -> str:
    """Return the reason if the control does not show what the claim says is cured; empty if it does."""
    for name in claim.control:
        ill, value = arms[name].values, float(claim.of("value", outcome) or 0)
        p = one_share_p_values(np.array([ill.sum()]), ill.size, value, None)
        if (p.greater if claim.direction == "less" else p.less)[0] > FLOOR_LEVEL:
            than = "more" if claim.direction == "less" else "less"
            runs = f"{ill.sum():.0f} of {ill.size} runs of {name}"
            return f"nothing to cure: {runs} are not shown to be {than} than {value:g}"
    return ""


def _at_floor(claim: Claim, outcome: str, arms: Mapping[str, Arm]) -> str:
    """Return why arms cannot be compared, given how well they play; empty if they can.

    An arm is at the floor if it is not shown to play better than the random player, whatever its number of
    runs. Outcomes that are meaningful only for runs that learned need every arm above the floor. Outcomes
    that measure play, and claims that nothing is lost, need one.
    """
    idle = [name for name, arm in arms.items() if arm.learned is False]
    if idle and any(find_outcome(part).supposes_rise for part in outcome.split(MINUS)):
        return f"arm at floor: {idle[0]} is not shown to play better than the random player"
    of_play = _is_of_play(outcome) and not claim.event
    if not (of_play or claim.direction in ("equal", "no-less")) or len(arms) < 2 or len(idle) < len(arms):
        return ""
    return f"arms at floor: none of {', '.join(arms)} is shown to play better than the random player"


def _at_an_end(claim: Claim, outcome: str, arms: Sequence[Arm]) -> str:
    """Return the reason if every run of both arms is at the outcome's least or greatest value.

    Values within the margin of an end count as there; without a margin, the outcome's own tolerance is used.
    For outcomes that measure play, the floor is decided by the comparison with the random player.
    """
    if len(arms) < 2 or claim.event or MINUS in outcome:
        return ""
    measured = find_outcome(outcome)
    near = claim.of("margin", outcome) or measured.alike
    known = _is_of_play(outcome) and all(arm.learned is not None for arm in arms)
    values = np.concatenate([arm.values for arm in arms])
    for end, bound in zip(("floor", "ceiling"), measured.bounds, strict=True):
        if not (known and end == "floor") and np.isfinite(bound) and (np.abs(values - bound) <= near).all():
            return f"both arms are at the {end}: every run has a {outcome} within {near:.2g} of {bound:g}"
    return ""


def _is_of_play(outcome: str) -> bool:
    """Return whether a greater outcome means better play."""
    parts = [find_outcome(part) for part in outcome.split(MINUS)]
    return all(part.better == "higher" and part.source not in ("times", "signs") for part in parts)


# --- Decisions -----------------------------------------------------------------------------------


def decide(contrast: Contrast, claimed: str, factor: float = 1.0, alpha: float = 0.05) -> tuple[str, float]:
    """Return the verdict on one contrast of a list, and its corrected p-value.

    A claim of no difference is refuted only by a difference beyond the margin, tested two-sided there, and
    one of no loss only by a loss beyond it.

    Args:
        contrast: the contrast.
        claimed: the claimed direction.
        factor: the factor on its p-value, such as the number of contrasts in the list.
        alpha: the chance of any false verdict in the list.
    """
    if claimed == "equal":
        p_far = min(2 * min(contrast.p.far_less, contrast.p.far_greater), 1.0)
        p, so = min(contrast.p.equivalent, p_far), contrast.p.equivalent <= p_far
    elif claimed == "no-less":
        p, so = min(contrast.p.no_less, contrast.p.far_less), contrast.p.no_less <= contrast.p.far_less
    else:
        what = what_it_shows(contrast)
        p = contrast.p.equivalent if what == "equal" else contrast.p_different
        so = what in _supporting(claimed)
    corrected = min(p * factor, 1.0)
    return (SUPPORTED if so else REFUTED) if corrected <= alpha else INCONCLUSIVE, corrected


def what_it_shows(contrast: Contrast) -> str:
    """Return what a significant contrast shows: "greater", "less" or "equal".

    It follows from the smaller p-value only. To use the other one too would be a second test of the same
    claim, which the correction does not count. If both are the smallest that relabelings can give, they say
    nothing about which is smaller, and the effect is equal if it is nearer to zero than to the margin.
    """
    floor = sum(contrast.smallest)
    if contrast.p_different <= floor and 2 * contrast.p.equivalent <= floor:
        near = contrast.margin is not None and abs(contrast.effect) < contrast.margin / 2
    else:
        near = contrast.p.equivalent < contrast.p_different
    if near:
        return "equal"
    return "greater" if contrast.p.greater < contrast.p.less else "less"


def together(verdicts: Sequence[str]) -> str:
    """Return the verdict on a claim, given those on its contrasts; empty if they do not decide."""
    if REFUTED in verdicts:
        return REFUTED
    return SUPPORTED if all(verdict == SUPPORTED for verdict in verdicts) else ""


def of_outcomes(verdicts: Sequence[str]) -> str:
    """Return the verdict on a claim, given those on its outcomes.

    It is supported if one outcome supports it and none refutes it, refuted in the opposite case, mixed if
    they contradict each other, and empty if none decides. Such a verdict is false only if that on one of the
    outcomes is.
    """
    decided = {verdict for verdict in verdicts if verdict in (SUPPORTED, REFUTED)}
    return MIXED if len(decided) == 2 else "".join(decided)


def smallest_p(contrast: Contrast, claimed: str) -> float:
    """Return the smallest p-value by which so many runs could support the claimed direction.

    For equivalence it is a lower bound, except for shares, where smaller ones may be possible.
    """
    greater, less = contrast.smallest
    possible = {"greater": 2 * greater, "less": 2 * less, "equal": min(greater, less)}
    possible["no-less"] = greater
    return min(possible[way] for way in _supporting(claimed))


def _supporting(claimed: str) -> tuple[str, ...]:
    return ("greater", "less") if claimed == "different" else (claimed,)
