"""Judgement: claims and runs → a verdict on every claim in every world.

    ClaimList and Store → the table of contrasts with verdicts → [Verdict], one a claim and world

Every claim is judged, separately in each world, by exactly the runs that it fixed beforehand. All contrasts
of all claims in one world, including those without runs, are one family for the correction. So the chance of
any false verdict in a world is at most the list's alpha, whichever claims are shown and whatever was run.

Each contrast enters with the smallest p-value that can decide it, corrected by Bonferroni. Holm's steps would
be wrong here: a contrast that is found equivalent would leave the list because its effect looked small, so
that those with large ones remain. Most lists of 60 true equivalences, judged in steps, can contain a false
difference. docs/evidence.md explains why the smaller p-value bounds the chance of any false verdict.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import groupby

import numpy as np

from pneuma.analysis.arms import FLOOR_LEVEL, TRAIN_WITH, Arm, ClaimRuns, Wanted, find_runs
from pneuma.analysis.claim_table import ClaimContrast, plan_contrasts
from pneuma.analysis.claims import MINUS, Claim, ClaimList
from pneuma.analysis.contrasts import Contrast, compare, compare_ranges, undecided
from pneuma.analysis.outcomes import find_outcome
from pneuma.analysis.pvalues import one_share_p_values
from pneuma.analysis.run_index import RunIndex
from pneuma.errors import counted
from pneuma.study.store import Store

SUPPORTED, REFUTED, MIXED = "supported", "refuted", "mixed"
INCONCLUSIVE, UNTESTABLE = "inconclusive", "untestable"

AS_CLAIMED_BUT_SMALL = "in the direction claimed, but too small to count"
"""The reason if equivalence refutes a claim whose interval lies wholly on the claimed side."""


@dataclass(frozen=True)
class Verdict:
    """The verdict on a claim in one of `WORLDS`.

    Attributes:
        verdict: supported, refuted, mixed, inconclusive or untestable.
        reason: why it is untestable, what is missing, or `AS_CLAIMED_BUT_SMALL`; empty for a plain result.
        contrasts: its rows of the table, untestable all if it is not admitted.
    """

    claim: Claim
    world: str
    verdict: str
    reason: str
    contrasts: tuple[ClaimContrast, ...] = ()

    @property
    def decisive(self) -> ClaimContrast | None:
        """The contrast that decides the outcome with the claim's verdict; of two such outcomes, the surer.

        An outcome is decided by the surest if one is enough for its verdict, which is so if it refutes, else
        by the least sure.
        """
        deciding = []
        for each in _by_outcome(self.contrasts):
            word = combine_contrasts([row.verdict for row in each]) or INCONCLUSIVE
            agreeing = [row for row in each if row.verdict == word] or each
            deciding.append((min if word == REFUTED else max)(agreeing, key=lambda row: row.p))
        agreeing = [row for row in deciding if row.verdict == self.verdict]
        return min(agreeing or deciding, key=lambda row: row.p, default=None)

    @property
    def run_ids(self) -> list[str]:
        return list(dict.fromkeys(run_id for row in self.contrasts for run_id in row.run_ids))

    @property
    def lacks_runs(self) -> bool:
        return TRAIN_WITH in self.reason


def judge(
    claims: ClaimList,
    store: Store,
    stored: bool = True,
    asked: Wanted = lambda claim, world: True,
    on_progress: Callable[[int, int], object] = lambda done, of: None,
) -> list[Verdict]:
    """Return the verdict on each claim of a list in each of its worlds, or on those that are asked for.

    The correction is for the planned contrasts of the whole list, whichever are asked for: no data of the
    others are needed. With `stored = False` only published tables are used. `on_progress` is called with the
    number of verdicts so far, and of all.
    """
    planned: dict[tuple[str, str], list[ClaimContrast]] = {}
    for row in plan_contrasts(claims):
        planned.setdefault((row.claim.name, row.world), []).append(row)
    wanted = sum(asked(claim, world) for claim in claims.claims.values() for world in claim.worlds)
    verdicts: list[Verdict] = []
    for runs in find_runs(RunIndex(store, stored, shipped=False), claims, asked):
        rows, arm = planned[runs.claim.name, runs.world], cache(runs.arm)
        if rows[0].refused:
            reason = f"not admitted: {rows[0].refused}"
            table = tuple(replace(row, verdict=UNTESTABLE, contrast=undecided(reason)) for row in rows)
            verdicts.append(Verdict(runs.claim, runs.world, UNTESTABLE, reason, table))
        else:
            table = tuple(_judge_contrast(row, runs, arm, claims) for row in rows)
            verdicts.append(_combine(runs.claim, runs.world, table))
        on_progress(len(verdicts), wanted)
    return verdicts


def _combine(claim: Claim, world: str, table: tuple[ClaimContrast, ...]) -> Verdict:
    each = [combine_contrasts([row.verdict for row in rows]) for rows in _by_outcome(table)]
    untestable = any(row.verdict == UNTESTABLE for row in table)
    verdict = combine_outcomes(each) or (UNTESTABLE if untestable else INCONCLUSIVE)
    reason = ""
    if verdict == UNTESTABLE:  # each part of the reasons once, the command that trains what lacks last
        parts = dict.fromkeys(part for row in table for part in row.contrast.reason.split("; ") if part)
        reason = "; ".join(sorted(parts, key=lambda part: part.startswith(TRAIN_WITH)))
    elif verdict == REFUTED:
        refuted = [row.contrast for row in table if row.verdict == REFUTED]
        small = all(_is_as_claimed_but_small(contrast, claim.direction) for contrast in refuted)
        reason = AS_CLAIMED_BUT_SMALL if small else ""
    return Verdict(claim, world, verdict, reason, table)


def _by_outcome(table: Iterable[ClaimContrast]) -> list[list[ClaimContrast]]:
    return [list(rows) for _, rows in groupby(table, key=lambda row: row.outcome)]


def _is_as_claimed_but_small(contrast: Contrast, direction: str) -> bool:
    """Return whether equivalence refutes a claim although its interval supports the direction."""
    low, high = contrast.interval.low, contrast.interval.high
    as_claimed = (direction != "less" and low > 0) or (direction != "greater" and high < 0)
    return significant_direction(contrast) == "equal" and as_claimed


# --- Contrasts -----------------------------------------------------------------------------------


def _judge_contrast(
    row: ClaimContrast, runs: ClaimRuns, arm: Callable[[str, str], Arm], claims: ClaimList
) -> ClaimContrast:
    """Judge one contrast of a claim. It is untestable for a reason, or if too few runs could support it."""
    claim, names = row.claim, [*dict.fromkeys((*row.a, *row.b, *row.claim.control))]
    reason = runs.why_incomparable(row.outcome, names)
    arms = {} if reason else {name: arm(row.outcome, name) for name in names}
    if reason := reason or _why_untestable(row, arms):
        sizes = [arms[name].values.size for name in (*row.a, *row.b) if name in arms] + [0, 0]
        contrast = undecided(reason, (sizes[0], sizes[1]))
    else:
        contrast = _compare(row, arms)
    factor, alpha = claims.contrasts(row.world), claims.head.alpha
    verdict, p = decide(contrast, claim.direction, factor, alpha)
    if verdict == INCONCLUSIVE:  # equivalence may need fewer runs than a difference
        smallest = smallest_p(contrast, claim.direction)
        if not contrast.reason and smallest * factor > alpha:
            few = f"too few seeds: the smallest p possible of {claim.direction} is {smallest:.2g}"
            problem = f"{few}, and the list has {counted(factor, 'contrast')} in this world"
            contrast = replace(contrast, reason=problem)
        verdict = UNTESTABLE if contrast.reason else INCONCLUSIVE
    found = [run_id for own in arms.values() for run_id in own.run_ids]
    found = found or [run.run_id for name in names for run in runs.found(name)]
    return replace(row, contrast=contrast, run_ids=tuple(found), verdict=verdict, p=p)


def _compare(row: ClaimContrast, arms: Mapping[str, Arm]) -> Contrast:
    margin, level = row.margin, 1 - row.alpha
    if row.claim.kind == "range":
        margin = margin if row.b else None  # the constant itself counts as none, as no range is below 0
        a, b = ([[*arms].index(name) for name in names] for names in (row.a, row.b))
        return compare_ranges([own.values for own in arms.values()], a, b or row.value, margin, level)
    against = arms[row.b[0]].values if row.b else row.value
    return compare(row.claim.kind, arms[row.a[0]].values, against, margin, level)


def _why_untestable(row: ClaimContrast, arms: Mapping[str, Arm]) -> str:
    """Return why arms of finished runs decide nothing; empty if they can be compared."""
    tested = {name: own for name, own in arms.items() if name in (*row.a, *row.b)}
    return (
        next((own.reason for own in arms.values() if own.reason), "")
        or _at_floor(row, tested)
        or _at_an_end(row, [*tested.values()])
        or _not_ill(row, arms)
    )


def _not_ill(row: ClaimContrast, arms: Mapping[str, Arm]) -> str:
    """Return the reason if the control does not show what the claim says is cured; empty if it does."""
    for name in row.claim.control:
        ill, value = arms[name].values, row.value
        p = one_share_p_values(np.array([ill.sum()]), ill.size, value, None)
        if (p.greater if row.claim.direction == "less" else p.less)[0] > FLOOR_LEVEL:
            than = "more" if row.claim.direction == "less" else "less"
            runs = f"{ill.sum():.0f} of {ill.size} runs of {name}"
            return f"nothing to cure: {runs} are not shown to be {than} than {value:g}"
    return ""


def _at_floor(row: ClaimContrast, arms: Mapping[str, Arm]) -> str:
    """Return why arms cannot be compared, given how well they play; empty if they can.

    An arm is at the floor if it is not shown to play better than the random player, whatever its number of
    runs. Outcomes that are meaningful only for runs that learned need every arm above the floor. Outcomes
    that measure play, and claims that nothing is lost, need one.
    """
    idle = [name for name, arm in arms.items() if arm.learned is False]
    if idle and any(find_outcome(part).requires_learning for part in row.outcome.split(MINUS)):
        return f"arm at floor: {idle[0]} is not shown to play better than the random player"
    of_play = _is_of_play(row.outcome) and not row.claim.event
    if not (of_play or row.claim.direction in ("equal", "no-less")) or len(arms) < 2 or len(idle) < len(arms):
        return ""
    return f"arms at floor: none of {', '.join(arms)} is shown to play better than the random player"


def _at_an_end(row: ClaimContrast, arms: Sequence[Arm]) -> str:
    """Return the reason if every run of both arms is at the outcome's least or greatest value.

    Values within the margin of an end count as there; without a margin, the outcome's own tolerance is used.
    For outcomes that measure play, the floor is decided by the comparison with the random player.
    """
    if len(arms) < 2 or row.claim.event or MINUS in row.outcome:
        return ""
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


def decide(contrast: Contrast, claimed: str, factor: float = 1.0, alpha: float = 0.05) -> tuple[str, float]:
    """Return the verdict on one contrast of a list, and its corrected p-value.

    A claim of no difference is refuted only by a difference beyond the margin, tested two-sided there, and
    one of no loss only by a loss beyond it. `factor` is that on its p-value, such as the number of contrasts
    in the list, and `alpha` the chance of any false verdict in the list.
    """
    if claimed == "equal":
        p_far = min(2 * min(contrast.p.far_less, contrast.p.far_greater), 1.0)
        p, so = min(contrast.p.equivalent, p_far), contrast.p.equivalent <= p_far
    elif claimed == "no-less":
        p, so = min(contrast.p.no_less, contrast.p.far_less), contrast.p.no_less <= contrast.p.far_less
    else:
        what = significant_direction(contrast)
        p = contrast.p.equivalent if what == "equal" else contrast.p_different
        so = what in _supporting(claimed)
    corrected = min(p * factor, 1.0)
    return (SUPPORTED if so else REFUTED) if corrected <= alpha else INCONCLUSIVE, corrected


def significant_direction(contrast: Contrast) -> str:
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


def combine_contrasts(verdicts: Sequence[str]) -> str:
    """Return the verdict on a claim, given those on its contrasts; empty if they do not decide."""
    if REFUTED in verdicts:
        return REFUTED
    return SUPPORTED if all(verdict == SUPPORTED for verdict in verdicts) else ""


def combine_outcomes(verdicts: Sequence[str]) -> str:
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
