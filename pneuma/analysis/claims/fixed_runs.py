"""The runs that claims fix: in a world, found by their ids → arms; and of a study, as a preset to train.

An arm has one value per run, or says why its runs cannot be compared.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pandas as pd

from pneuma.analysis.claims.claim_list import MINUS, Claim, ClaimList, load_claims
from pneuma.analysis.intervals import mean_interval
from pneuma.analysis.outcomes import MIN_CPU_SHARE, find_outcome, have_one_return, is_return, outcome, reason
from pneuma.analysis.run_index import RunIndex
from pneuma.analysis.runs import find_runs, finished_rows
from pneuma.analysis.study_data import StudyData
from pneuma.config import round_up
from pneuma.errors import UserError
from pneuma.presets import world_option
from pneuma.study.plan import Selection
from pneuma.study.provenance import processors
from pneuma.study.rows import Row
from pneuma.study.shipped import CLAIMS_FILE
from pneuma.study.spec import CLAIMS, Amount, Preset, Study, results_words
from pneuma.values import shown_seeds

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
        data: its conditions, as its study has them in the world, and their finished runs; there may be none.
        fix: the end of a reason if runs are missing, with the command that trains them.
        damaged: published tables that could not be read, and may contain them.
    """

    claim: Claim
    world: str
    data: StudyData
    fix: str
    damaged: Sequence[str]

    @property
    def commits(self) -> tuple[str, ...]:
        """The commits of the code that trained them."""
        origins = [run.provenance for name in self.claim.compared for run in self.found(name)]
        return tuple(sorted({str(origin.get("commit")).removesuffix("-dirty") for origin in origins}))

    def budget(self, condition: str) -> int:
        return round_up(self.data.configurations[condition], self.claim.steps[condition])

    def found(self, condition: str) -> list[Row]:
        return self.data.of_condition(condition)

    def why_incomparable(self, outcome: str, names: Sequence[str]) -> str:
        """Return why arms cannot be compared, before any value is read; empty if they can."""
        if any(len({*names} & {*group}) > 1 for group in self.data.same):
            return f"A/A: {' and '.join(names)} resolve to the same configuration"
        engines = [self.data.configurations[name].engine for name in names]
        if len({*engines}) > 1:
            mixed = ", ".join(map("{} by {}".format, names, engines))
            return f"engines are mixed: {mixed}"
        if missing := [*filter(None, map(self._missing, names))]:
            return "; ".join([*missing, self.fix])
        parts = outcome.split(MINUS)
        if any(map(is_return, parts)) and not have_one_return(self.data, names):
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
        claim, runs, parts, why = self.claim, self.found(condition), name.split(MINUS), ""
        values = np.subtract.reduce([[outcome(run, part) for run in runs] for part in parts])
        for run, value in zip(runs, values, strict=True):
            if not why and np.isnan(value):
                why = f"{condition} seed {run.seed}: " + next(filter(None, (reason(run, p) for p in parts)))
        if claim.counts:
            values = claim.has_event(name, values).astype(float)
        # steps to what is never reached are at least those of the run
        values = np.where(np.isinf(values), self.budget(condition), values)
        return Arm(values, why, _learned(runs))


def _learned(runs: Sequence[Row]) -> bool | None:
    """Return whether an arm plays better than the random player: its interval of the mean is above it.

    Of each run its mean score over all evaluations counts, where 0 is the random player; the greatest score
    would be above 0 by chance alone. None if a run has no score.
    """
    every = [run.known_evaluations("score")[1] for run in runs]
    scores = np.array([scores.mean() if len(scores) else np.nan for scores in every])
    if not np.isfinite(scores).all() or scores.size < 2:
        return None
    interval = mean_interval(scores, 1 - 2 * FLOOR_LEVEL)
    return interval.low > 0 if interval.exists else bool(scores.mean() > 0)


# --- Finding runs ----------------------------------------------------------------------------------


Wanted = Callable[[Claim, str], bool]
"""Whether a claim is to be judged in a world."""


def find_claim_runs(
    index: RunIndex, claims: ClaimList, wanted: Wanted = lambda claim, world: True
) -> Iterator[ClaimRuns]:
    """Yield the runs of each claim that is asked for, in each of its worlds, in the list's order."""
    rest = results_words(index.store.root)
    rest += ["--unpublished"] if index.store.published(shipped=False) else []
    for claim in claims.claims.values():
        for world in filter(partial(wanted, claim), claim.worlds):
            study = claims.studies[claim.study].in_world(world)
            data = find_runs(index, study, Selection(conditions=claim.compared))
            commands = _commands(claims, claim, data.study)
            fix = f"{TRAIN_WITH} {' && '.join(shlex.join([*words, *rest]) for words in commands)}"
            runs = ClaimRuns(claim, world, data, fix, index.problems)
            yield replace(runs, data=finished_rows(index, replace(data, runs=_fixed(runs))))


def _fixed(runs: ClaimRuns) -> pd.DataFrame:
    """Return those of the runs that a claim fixed which are stored, seed by seed."""
    every = runs.data.runs.sort_values("seed", kind="stable")
    budgets = {name: runs.budget(name) for name in runs.claim.compared}
    of_each = zip(every["condition"], every["seed"], every["steps"], strict=True)
    fixed = [seed in runs.claim.seeds[name] and steps == budgets[name] for name, seed, steps in of_each]
    return every.loc[fixed]


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


# --- The preset `claims`: runs to train ----------------------------------------------------------------


def with_claims(study: Study, steps: int | None = None) -> Study:
    """Return a study with the preset `claims`: the runs that claims beside its file fix in its world.

    Conditions without a claim are left out. A condition of several claims has the seeds of all of them. If
    claims fix several budgets, `steps` chooses one; any other number chooses the conditions of all.

    Raises:
        UserError: when no claim is about the study, or several budgets are possible.
    """
    found = fixed_amounts(study)
    if not found:
        raise UserError(
            f"--preset {CLAIMS}: no {CLAIMS_FILE} beside study {study.name} has a claim on it in this world"
        )
    if len(found) > 1 and steps is None:
        budgets = " or ".join(f"{each:,}" for each in found)
        raise UserError(f"--preset {CLAIMS}: claims fix runs of {budgets} steps: say which with --steps")
    every = {name: preset for each in found.values() for name, preset in each.items()}
    steps = steps or next(iter(found))
    preset = Preset.model_construct(seeds=(), steps=steps, conditions=found.get(steps, every))
    return study.model_copy(update={"presets": {**study.presets, CLAIMS: preset}})


def fixed_amounts(study: Study) -> dict[int, dict[str, Amount]]:
    """Return seeds and steps of each condition by number of steps; empty if no claim is about the study."""
    if study.path is None or not (beside := study.path.parent / CLAIMS_FILE).exists():
        return {}
    found: dict[int, dict[str, set[int]]] = {}
    for claim in load_claims(beside).claims.values():
        own = (beside.parent / claim.study).resolve() == study.path.resolve()
        shipped = study.own_path is None and claim.study == study.path.stem
        if (own or shipped) and study.world in claim.worlds:
            for condition, seeds in claim.seeds.items():
                found.setdefault(claim.steps[condition], {}).setdefault(condition, set()).update(seeds)
    return {
        steps: {
            name: Amount.model_construct(seeds=tuple(sorted(seeds_of[name])), steps=steps)
            for name in study.conditions
            if name in seeds_of
        }
        for steps, seeds_of in found.items()
    }
