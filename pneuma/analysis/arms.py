"""The runs that a claim fixed in a world, found by their ids → arms.

An arm has one value per run, or says why its runs cannot be compared.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from pneuma.analysis.asked import Asked, Stored, ask, read_runs
from pneuma.analysis.claims import MINUS, Claim, ClaimList
from pneuma.analysis.frames import StudyData, view
from pneuma.analysis.intervals import mean_interval
from pneuma.analysis.outcomes import MIN_CPU_SHARE, find_outcome, have_one_return, is_return, outcome, reason
from pneuma.analysis.run_index import RunIndex
from pneuma.study.plan import Selection, round_up
from pneuma.study.provenance import processors
from pneuma.study.rows import Row
from pneuma.study.series import SLACK
from pneuma.study.spec import CLAIMS, CLAIMS_FILE, Study
from pneuma.values import shown_seeds
from pneuma.worlds import world_option

TRAIN_WITH = "train with:"
"""The beginning of the part of a reason that names the command."""

FLOOR_LEVEL = 0.05
"""The chance that an arm that plays like the random player is said to play better."""


@dataclass(frozen=True)
class Arm:
    """One arm of a contrast.

    Attributes:
        values: (seeds,) the outcome of each run that counts, in the order of seeds; 1 or 0 if runs with an
            event are counted.
        reason: why it cannot be compared, if a run has no value.
        learned: whether it is shown to play better than the random player; None if unknown.
    """

    values: np.ndarray
    reason: str
    learned: bool | None


@dataclass(frozen=True)
class ClaimRuns:
    """The runs that a claim fixed in one world.

    Attributes:
        asked: its conditions, as its study has them in the world.
        data: the finished runs; None if there are none.
        fix: the end of a reason if runs are missing, with the command that trains them.
        damaged: published tables that could not be read, and may contain them.
    """

    claim: Claim
    world: str
    asked: Asked
    data: StudyData | None
    fix: str
    damaged: Sequence[str]

    @property
    def commits(self) -> tuple[str, ...]:
        """The commits of the code that trained them."""
        origins = [run.provenance for name in self.claim.compared for run in self.found(name)]
        return tuple(sorted({str(origin.get("commit")).removesuffix("-dirty") for origin in origins}))

    def budget(self, condition: str) -> int:
        return round_up(self.asked.runs[condition], self.claim.steps[condition])

    def found(self, condition: str) -> list[Row]:
        return self.data.of_condition(condition) if self.data else []

    def why_incomparable(self, outcome: str, names: Sequence[str]) -> str:
        """Return why arms cannot be compared, before any value is read; empty if they can."""
        if any(len({*names} & {*group}) > 1 for group in self.asked.same):
            return f"A/A: {' and '.join(names)} resolve to the same configuration"
        engines = [self.asked.runs[name].engine for name in names]
        if len({*engines}) > 1:
            mixed = ", ".join(map("{} by {}".format, names, engines))
            return f"engines are mixed: {mixed}"
        if missing := [*filter(None, map(self._missing, names))]:
            return "; ".join([*missing, self.fix])
        parts = outcome.split(MINUS)
        if self.data and any(map(is_return, parts)) and not have_one_return(self.data, names):
            return "returns of unlike rewards"
        timed = any(find_outcome(part).source == "times" for part in parts)
        return self._machines(names) if timed else ""

    def _missing(self, condition: str) -> str:
        fixed, found = len(self.claim.seeds[condition]), len(self.found(condition))
        if found == fixed:
            return ""
        steps = f"{self.budget(condition):,} steps" + "".join(f" ({problem})" for problem in self.damaged)
        if found:
            return f"runs missing: {condition} has {found} of the {fixed} fixed ones with {steps}"
        return f"no runs: {condition}, {fixed} seeds of {steps}"

    def _machines(self, names: Sequence[str]) -> str:
        """Return why times cannot be compared (machines differ, or did other work); empty if they can."""
        rows = [row for name in names for row in self.found(name)]
        origins = [row.provenance for row in rows]
        if len({(on, str(origin.get("threads"))) for origin in origins for on in processors(origin)}) > 1:
            return "timed on different machines"
        least = min((row.processor_share for row in rows if row.processor_share is not None), default=1.0)
        return f"timed beside other work: on {least:.0%} of a core" if least < MIN_CPU_SHARE else ""

    def arm(self, name: str, condition: str) -> Arm:
        """Return an arm: the outcome of each run of a condition, whose runs have all finished."""
        claim, data, runs = self.claim, self.data, self.found(condition)
        assert data is not None
        # budgets are rounded up to whole horizons; claims are judged at the steps that they state
        budgets = [self.budget(name) for name in claim.compared]
        unlike = max(budgets) > min(budgets) * (1 + SLACK)
        at_step = float(min(claim.steps.values())) if unlike else None
        parts, why = name.split(MINUS), ""
        values = np.subtract.reduce([[outcome(data, run, part, at_step) for run in runs] for part in parts])
        for run, value in zip(runs, values, strict=True):
            if not why and np.isnan(value):
                why = f"{condition} seed {run.seed}: " + next(
                    filter(None, (reason(data, run, part, at_step) for part in parts))
                )
        if claim.counts:
            values = claim.has_event(name, values).astype(float)
        # steps to what is never reached are at least those of the run
        values = np.where(np.isinf(values), at_step or self.budget(condition), values)
        return Arm(values, why, _learned(data, runs, at_step))


def _learned(data: StudyData, runs: Sequence[Row], at_step: float | None) -> bool | None:
    """Return whether an arm plays better than the random player: its interval of the mean is above it.

    Of each run its mean score over all evaluations counts, where 0 is the random player; the greatest score
    would be above 0 by chance alone. None if a run has no score.
    """
    every = [view(data, run, at_step).evaluations("score")[1] for run in runs]
    scores = np.array([scores.mean() if len(scores) else np.nan for scores in every])
    if not np.isfinite(scores).all() or scores.size < 2:
        return None
    interval = mean_interval(scores, 1 - 2 * FLOOR_LEVEL)
    return interval.low > 0 if interval.exists else bool(scores.mean() > 0)


# --- Finding runs ----------------------------------------------------------------------------------


Wanted = Callable[[Claim, str], bool]
"""Whether a claim is to be judged in a world."""


def find_runs(
    index: RunIndex, claims: ClaimList, wanted: Wanted = lambda claim, world: True
) -> Iterator[ClaimRuns]:
    """Yield the runs of each claim that is asked for, in each of its worlds, in the list's order."""
    rest = " --unpublished" if index.store.published(shipped=False) else ""
    for claim in claims.claims.values():
        is_path = claim.study.endswith(".toml")
        path = str(claims.path.parent / claim.study) if is_path else claim.study
        for world in filter(partial(wanted, claim), claim.worlds):
            asked = ask(index, path, Selection(conditions=claim.compared), world)
            commands = _commands(claims, claim, asked.study)
            fix = f"{TRAIN_WITH} {' && '.join(shlex.join(words) + rest for words in commands)}"
            runs = ClaimRuns(claim, world, asked, None, fix, index.problems)
            yield replace(runs, data=read_runs(index, asked, _fixed(index, runs)))


def _fixed(index: RunIndex, runs: ClaimRuns) -> list[Stored]:
    """Return those of the runs that a claim fixed which are stored, condition by condition."""
    found: list[Stored] = []
    for name in runs.claim.compared:
        stored = {
            entry.seed: entry
            for entry in index.of_run(runs.asked.runs[name])
            if entry.steps == runs.budget(name)
        }
        seeds = runs.claim.seeds[name]
        found += [(name, seed, stored[seed]) for seed in seeds if seed in stored]
    return found


def _commands(claims: ClaimList, claim: Claim, study: Study) -> Iterator[list[str]]:
    """Yield commands, as words, that train a claim's runs: by a preset if the list is beside the study."""
    words = ["pneuma", "study", "run", study.own_path or study.name]
    world = world_option(study.world, study.worlds)
    if study.path and claims.path.resolve() == (study.path.parent / CLAIMS_FILE).resolve():
        alike = [
            one
            for one in claims.claims.values()
            if (one.study, study.world in one.worlds) == (claim.study, True)
        ]
        several = len({steps for one in alike for steps in one.steps.values()}) > 1
        for steps in sorted({*claim.steps.values()}) if several else [0]:
            yield [*words, "--preset", CLAIMS, *world, *(["--steps", str(steps)] if steps else [])]
        return
    amounts: dict[tuple[str, int], list[str]] = {}
    for name in claim.conditions:
        amounts.setdefault((shown_seeds(claim.seeds[name]), claim.steps[name]), []).append(name)
    for (seeds, steps), names in amounts.items():
        conditions = [word for name in names for word in ("--condition", name)]
        yield [*words, *world, *conditions, "--seeds", seeds, "--steps", str(steps)]
