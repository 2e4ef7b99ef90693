"""Claims and runs → a verdict on every claim in every world.

    ClaimList and RunIndex → the table of contrasts with verdicts → [Verdict], one for each claim and world

Every claim is judged, separately in each world, by exactly the runs that it fixed beforehand. A verdict
compares the ends of the simultaneous interval, which is printed, with 0 and with the margin; nothing else
decides. All intervals of a world, also those of claims without runs, hold jointly with 95 % probability. So
the chance of any false verdict in a world is at most 5 %, whichever claims are shown and whatever was run.

Where margins or the judge's rules were changed when runs were known, claims are also judged in their
registered form: by the margins of before the first run, and by earlier rules. `SINCE_THEN` says what changed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from pneuma.analysis.claims.claim_list import RULES, Claim, ClaimList, PlannedContrast
from pneuma.analysis.claims.contrasts import DIFFERENCE_OF_SPREADS, Contrast, compare
from pneuma.analysis.claims.fixed_runs import TRAIN_WITH, ClaimRuns, find_claim_runs
from pneuma.analysis.claims.history import AMOUNT_KEYS, RULES_KEY, find_changes
from pneuma.analysis.intervals import NO_BOUNDS, Interval, is_constant
from pneuma.analysis.outcomes import find_outcome
from pneuma.store.index import RunIndex

HOLDS, FAILS, UNDECIDED, NOT_TESTED = "holds", "does not hold", "undecided", "not tested"
DESCRIBED = "described"
"""The verdict on a claim that states no direction."""
DECIDING_ORDER = {
    "all": (FAILS, NOT_TESTED, UNDECIDED, HOLDS, DESCRIBED),
    "one": (HOLDS, FAILS, UNDECIDED, DESCRIBED, NOT_TESTED),
}
"""The first of these that one of several verdicts is decides, if all must be as claimed, or one."""

RARE = 0.1
"""If at most this share of runs has an event, or has it not, that counts as none."""
AS_CLAIMED_BUT_SMALL = "in the direction claimed, but too small to count"
"""The reason if a claim does not hold although its interval lies wholly on the claimed side of 0."""
DISAGREE = "its two measures disagree"
"""The reason if a claim is undecided because one measure speaks for it and another against it."""

PREREGISTERED, AMENDED, DESCRIPTIVE = "preregistered", "amended", "descriptive"
UNVERIFIED = "unverified"
"""Labels. A claim is unverified if no commit shows that it was stated before its runs."""

FORGETTING = "late-fall"
SINCE_THEN = {
    "spread": "spreads are compared by their ratio",
    "steps": "steps are read off lines between evaluations",
    "equal": "equal runs have an interval",
    "idle": "idle agents are not tested for forgetting",
    "small": "where none has learned, a difference within the margin decides nothing",
}
"""How the rules of the judge differ since version 6, by short names."""


@dataclass(frozen=True, kw_only=True)
class ClaimContrast(PlannedContrast):
    """A row of the table of contrasts with what the runs show, and the verdict on it alone.

    Attributes:
        runs: the ids of the runs that were read, by condition.
        contrast: what the runs show; its reason is not empty if nothing can be concluded.
        registered_verdict: the same by the margin, and the rules, that were registered.
        rule_changes: the keys of `SINCE_THEN` that make a difference here, if it was registered before.
        none_learned: whether no condition is shown to play better than the random player, so that being alike
            counts for nothing.
    """

    runs: Mapping[str, Sequence[str]] = field(default_factory=dict)
    contrast: Contrast = Contrast()
    verdict: str = NOT_TESTED
    registered_verdict: str = NOT_TESTED
    rule_changes: tuple[str, ...] = ()
    none_learned: bool = False

    @property
    def has_effect(self) -> bool:
        return math.isfinite(self.contrast.means[0])


@dataclass(frozen=True)
class Verdict:
    """The verdict on a claim in one of `WORLDS`.

    Attributes:
        verdict: `HOLDS`, `FAILS`, `UNDECIDED`, `NOT_TESTED`, or `DESCRIBED` of a claim without a direction.
        reason: why it is not tested, what is missing, `AS_CLAIMED_BUT_SMALL` or `DISAGREE`; empty for a plain
            result.
        contrasts: its rows of the table.
        registered_verdict: the verdict by the margins, and the rules, that were registered.
        label: whether it tests: `PREREGISTERED`, `AMENDED`, `DESCRIPTIVE`, `UNVERIFIED`, or on which list's
            runs it was stated.
        changed: what has changed of the claim since its runs were trained; None if that is unknown.
        condition_labels: what its study calls conditions for people.
    """

    claim: Claim
    world: str
    verdict: str
    reason: str
    contrasts: tuple[ClaimContrast, ...] = ()
    registered_verdict: str = ""
    label: str = ""
    changed: tuple[str, ...] | None = None
    condition_labels: Mapping[str, str] = field(default_factory=dict)

    @property
    def deciding(self) -> tuple[ClaimContrast, ...]:
        """For each outcome the contrast that decides it, the first one with its verdict; or all pairs."""
        if self.claim.paired:
            return self.contrasts
        deciding: dict[str, ClaimContrast] = {}
        for claim_contrast in self.contrasts:
            current = deciding.setdefault(claim_contrast.outcome, claim_contrast)
            if combine([claim_contrast.verdict, current.verdict], "all") != current.verdict:
                deciding[claim_contrast.outcome] = claim_contrast
        return tuple(deciding.values())

    @property
    def run_ids(self) -> list[str]:
        run_ids: list[str] = []
        for claim_contrast in self.contrasts:
            for condition_ids in claim_contrast.runs.values():
                run_ids += condition_ids
        return list(dict.fromkeys(run_ids))

    @property
    def lacks_runs(self) -> bool:
        return TRAIN_WITH in self.reason

    @property
    def rule_changes(self) -> tuple[str, ...]:
        """The keys of `SINCE_THEN` because of which the registered verdict may differ."""
        rule_changes: list[str] = []
        for claim_contrast in self.contrasts:
            if claim_contrast.verdict != claim_contrast.registered_verdict:
                rule_changes += claim_contrast.rule_changes
        return tuple(dict.fromkeys(rule_changes))


def judge(
    claim_list: ClaimList,
    index: RunIndex,
    is_selected: Callable[[Claim, str], bool] = lambda claim, world: True,
) -> list[Verdict]:
    """Return the verdict on each claim of a list in each of its worlds, or on those that are selected.

    The correction is for the planned contrasts of the whole family, whichever are selected. It needs no data
    of the others.
    """
    verdicts: list[Verdict] = []
    for claim in claim_list.claims.values():
        for world in claim.worlds:
            if is_selected(claim, world):
                claim_runs = find_claim_runs(index, claim_list.studies[claim.study].in_world(world), claim)
                verdicts.append(_judge_claim(claim_list, claim_runs))
    return verdicts


def _judge_claim(claim_list: ClaimList, claim_runs: ClaimRuns) -> Verdict:
    """Return the verdict on a claim of a list in one world by its runs."""
    claim, world = claim_runs.claim, claim_runs.world
    changes = find_changes(claim_list, claim, world, claim_runs.commits)
    claim_contrasts = [
        _judge_contrast(claim_runs, planned, changes.rules)
        for planned in claim_list.contrasts_of(claim, world)
    ]
    verdicts_by_outcome = _verdicts_by_outcome(claim_contrasts, "verdict")
    word = combine(verdicts_by_outcome, claim.need)
    verdict = Verdict(
        claim=claim,
        world=world,
        verdict=word,
        reason=_reason(word, claim_contrasts, verdicts_by_outcome),
        contrasts=tuple(claim_contrasts),
        registered_verdict=combine(_verdicts_by_outcome(claim_contrasts, "registered_verdict"), claim.need),
        changed=changes.changed,
        condition_labels=claim_list.studies[claim.study].labels,
    )
    if (
        verdict.registered_verdict != word
        and verdict.rule_changes
        and RULES_KEY not in (verdict.changed or ())
    ):
        verdict = replace(verdict, changed=(*(verdict.changed or ()), RULES_KEY))
    return replace(verdict, label=_label(claim_list, verdict, has_runs=bool(claim_runs.commits)))


def _verdicts_by_outcome(claim_contrasts: Iterable[ClaimContrast], column: str) -> list[str]:
    """Return the verdict on each outcome of a claim, by one of the columns of its rows that have verdicts."""
    verdicts_by_outcome: dict[str, list[str]] = {}
    for claim_contrast in claim_contrasts:
        verdicts_by_outcome.setdefault(claim_contrast.outcome, []).append(getattr(claim_contrast, column))
    return [combine(verdicts, "all") for verdicts in verdicts_by_outcome.values()]


def _label(claim_list: ClaimList, verdict: Verdict, has_runs: bool) -> str:
    """Return whether a claim was stated before its runs."""
    claim, changed = verdict.claim, verdict.changed
    if claim.seen or set(changed or ()) - set(AMOUNT_KEYS):
        return DESCRIPTIVE
    if claim.first_seed < claim_list.head.known_below:
        return f"same runs as {claim_list.head.known_from}"
    if changed is None and has_runs:
        return UNVERIFIED
    return AMENDED if changed else PREREGISTERED


def _reason(
    verdict: str, claim_contrasts: Sequence[ClaimContrast], verdicts_by_outcome: Sequence[str]
) -> str:
    if verdict == NOT_TESTED:  # each part of the reasons once, the command that trains what is missing last
        reasons = dict.fromkeys(
            "; ".join(claim_contrast.contrast.reason for claim_contrast in claim_contrasts).split("; ")
        )
        return "; ".join(sorted(filter(None, reasons), key=lambda reason: reason.startswith(TRAIN_WITH)))
    if verdict == UNDECIDED and {HOLDS, FAILS} <= {*verdicts_by_outcome}:
        return DISAGREE
    if verdict != FAILS:
        return ""
    for claim_contrast in claim_contrasts:
        without_margin = decide(claim_contrast.contrast.simultaneous, claim_contrast.direction, margin=None)
        if claim_contrast.verdict == FAILS and without_margin != HOLDS:
            return ""
    return AS_CLAIMED_BUT_SMALL


# --- Contrasts -----------------------------------------------------------------------------------


def _judge_contrast(claim_runs: ClaimRuns, planned: PlannedContrast, registered_rules: int) -> ClaimContrast:
    claim, conditions, outcome, value = planned.claim, planned.conditions, planned.outcome, planned.value
    run_ids: dict[str, list[str]] = {}
    for condition in conditions:
        run_ids[condition] = [row.run_id for row in claim_runs.data.of_condition(condition)]
    claim_contrast = ClaimContrast(**vars(planned), runs=run_ids)
    compared_outcomes = [outcome, value] if isinstance(value, str) else [outcome]
    reason = claim.not_tested or claim_runs.why_incomparable(compared_outcomes, conditions)
    if reason:
        return replace(claim_contrast, contrast=Contrast(reason=reason))
    contrast, verdict = _compare(claim_runs, planned, planned.margin, RULES)
    _, registered_verdict = _compare(claim_runs, planned, planned.registered_margin, registered_rules)
    rule_changes: list[str] = []
    if registered_rules < RULES:
        rule_changes = _rule_changes(claim_runs, planned)
    return replace(
        claim_contrast,
        contrast=contrast,
        verdict=verdict,
        registered_verdict=registered_verdict,
        rule_changes=tuple(rule_changes),
        none_learned=verdict != NOT_TESTED and _have_none_learned(claim_runs, outcome, conditions, RULES),
    )


def _compare(
    claim_runs: ClaimRuns, planned: PlannedContrast, margin: float | None, rules: int
) -> tuple[Contrast, str]:
    """Return what finished runs show of a planned contrast, and the verdict on it, by some rules."""
    claim, outcome, constant = planned.claim, planned.outcome, planned.value or 0.0
    groups = {condition: claim_runs.values(outcome, condition, rules) for condition in planned.conditions}
    reason = _why_untestable(claim_runs, outcome, groups, margin, rules)
    groups_a = {condition: groups[condition] for condition in planned.a}
    groups_b = {condition: groups[condition] for condition in planned.b}
    kind, bounds = str(claim.kind), find_outcome(outcome).bounds
    if isinstance(constant, str):  # each run's other outcome is subtracted, and their mean added again
        (condition_a,) = planned.a
        other_values = claim_runs.values(constant, condition_a, rules)
        constant = float(other_values.mean())
        groups_a[condition_a] = groups_a[condition_a] - other_values + constant
        bounds = NO_BOUNDS
    if rules < RULES:
        bounds = NO_BOUNDS
        kind = DIFFERENCE_OF_SPREADS if claim.kind == "spread" else claim.kind
    contrast = compare(kind, groups_a, groups_b, 1 - planned.alpha, constant, bounds)
    if reason:
        return Contrast(seeds=contrast.seeds, reason=reason), NOT_TESTED
    none_learned = _have_none_learned(claim_runs, outcome, tuple(groups), rules)
    decided = decide(contrast.simultaneous, planned.direction, margin, not none_learned, rules)
    return contrast, decided


def _rule_changes(claim_runs: ClaimRuns, planned: PlannedContrast) -> list[str]:
    """Return the keys of `SINCE_THEN` that concern a contrast."""
    claim, outcome, conditions = planned.claim, planned.outcome, planned.conditions
    rule_changes: list[str] = []
    if claim.kind == "spread":
        rule_changes.append("spread")
    if outcome.startswith("steps-to"):
        rule_changes.append("steps")
    if outcome == FORGETTING and False in map(claim_runs.learned.get, conditions):
        rule_changes.append("idle")
    has_known_ends = bool(np.isfinite(find_outcome(outcome).bounds).all())
    is_of_means = claim.kind in ("mean", "main-effect", "interaction")
    values = [claim_runs.values(outcome, condition) for condition in conditions]
    if is_of_means and has_known_ends and any(map(is_constant, values)):
        rule_changes.append("equal")
    if _have_none_learned(claim_runs, outcome, conditions, RULES):
        rule_changes.append("small")
    return rule_changes


def _why_untestable(
    claim_runs: ClaimRuns,
    outcome: str,
    groups: Mapping[str, np.ndarray],
    margin: float | None,
    rules: int,
) -> str:
    """Return why finished runs of conditions decide nothing; empty if they can be compared.

    They cannot if every run of all conditions is at the outcome's least or greatest value: within the margin,
    or without one within the outcome's own tolerance. Of an incidence the shares of runs count.
    """
    declared, kind = find_outcome(outcome), claim_runs.claim.kind
    requires_learning = declared.requires_learning and (rules == RULES or outcome != FORGETTING)
    for condition in groups:
        if requires_learning and claim_runs.learned[condition] is False:
            random_player = "is not shown to play better than the random player"
            return f"the agents learned nothing there: {condition} {random_player}"
    if len(groups) < 2 or kind == "hazard":
        return ""
    all_values = np.concatenate(list(groups.values()))
    bounds, tolerance = declared.bounds, margin or declared.tolerance
    if kind == "spread" and rules == RULES:
        tolerance = declared.tolerance  # the margin is of a ratio
    if claim_runs.claim.is_incidence:
        all_values = np.array(list(map(np.mean, groups.values())))
        bounds, tolerance = (0.0, 1.0), RARE
    ends = {"floor": bounds[0], "ceiling": bounds[1]}
    if _is_of_play(claim_runs.claim, outcome) and None not in map(claim_runs.learned.get, groups):
        del ends["floor"]  # the comparison with the random player decides it
    for end_name, bound in ends.items():
        if np.isfinite(bound) and (np.abs(all_values - bound) <= tolerance).all():
            return f"all runs end alike: at the {end_name}, within {tolerance:.2g} of {bound:g}"
    return ""


def _have_none_learned(claim_runs: ClaimRuns, outcome: str, conditions: Sequence[str], rules: int) -> bool:
    """Return whether play is compared, and no condition is shown to play better than the random player.

    They may then be alike because nothing was learned, so that only a difference between them counts.
    """
    claim = claim_runs.claim
    if claim.kind == "hazard" or (len(conditions) < 2 and rules < RULES):
        return False
    needs_play = _is_of_play(claim, outcome) or claim.direction_of(outcome) in ("equal", "no-less")
    return needs_play and set(map(claim_runs.learned.get, conditions)) == {False}


def _is_of_play(claim: Claim, outcome: str) -> bool:
    """Return whether a greater value means better play."""
    return find_outcome(outcome).better == "higher" and not claim.is_incidence


def decide(
    interval: Interval, claimed: str, margin: float | None, alike_counts: bool = True, rules: int = RULES
) -> str:
    """Return the verdict of an interval of a minus b on a claimed direction.

    A difference is shown to be too small if the whole interval is nearer to 0 than the margin. That refutes
    a claim of a difference also where the interval lies on the claimed side of 0. Without an interval nothing
    is decided, nor is it by one that is too small where being alike does not count. Without a margin no
    difference is too small.
    """
    if claimed == DESCRIBED:
        return DESCRIBED
    if margin is None:
        margin = math.nan  # no interval lies within it or beyond it; ends that are NaN show nothing either
    is_within = -margin < interval.low and interval.high < margin
    if is_within and not alike_counts:
        if rules == RULES:
            return UNDECIDED
        is_within = False  # before, it counted as a difference
    far_above, far_below = interval.low > margin, interval.high < -margin
    no_less = interval.low > -margin and alike_counts
    is_above, is_below = interval.low > 0, interval.high < 0
    holds, fails = {
        "greater": (is_above, is_below or is_within),
        "less": (is_below, is_above or is_within),
        "different": (is_above or is_below, is_within),
        "equal": (is_within, far_above or far_below),
        "no-less": (no_less, far_below),
    }[claimed]
    if fails:
        return FAILS
    if holds:
        return HOLDS
    return UNDECIDED


def combine(verdicts: Sequence[str], need: str) -> str:
    """Return the verdict on several outcomes, or contrasts of one, of which all or one must be as claimed.

    If one is needed, it decides unless another speaks against the claim: then nothing is decided. What
    cannot be tested then decides nothing. A verdict is false only if that on one of the outcomes is.
    """
    if need == "one" and HOLDS in verdicts and FAILS in verdicts:
        return UNDECIDED
    return min(verdicts, key=DECIDING_ORDER[need].index)
