"""The runs that a claim fixed in a world, found by their ids → arms.

An arm has one value per run, or says why its runs cannot be compared.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from pneuma.analysis.claims import MINUS, Claim, ClaimList
from pneuma.analysis.frames import SLACK, FinishedRun, StudyData, view
from pneuma.analysis.outcomes import MIN_CPU_SHARE, find_outcome, have_one_return, is_return, outcome, reason
from pneuma.analysis.pvalues import student_tails
from pneuma.analysis.run_index import RunIndex
from pneuma.config import as_fields
from pneuma.study.plan import Cell, Selection, make_plan
from pneuma.study.provenance import processors
from pneuma.study.spec import CLAIMS, CLAIMS_FILE, Study, load_study
from pneuma.worlds import world_option

TRAIN_WITH = "train with:"
"""The beginning of the part of a reason that names the command."""

FLOOR_LEVEL = 0.05
"""The level of the one-sided test of whether an arm plays better than the random player."""


@dataclass(frozen=True)
class Arm:
    """One arm of a contrast.

    Attributes:
        values: (seeds,) the outcome of each run that counts, in the order of seeds; 1 or 0 if runs with an
            event are counted.
        run_ids: of the same runs.
        reason: why it cannot be compared, if a run has no value.
        learned: whether it is shown to play better than the random player; None if unknown.
    """

    values: np.ndarray
    run_ids: tuple[str, ...]
    reason: str
    learned: bool | None


@dataclass(frozen=True)
class ClaimRuns:
    """The runs that a claim fixed in one world.

    Attributes:
        cells: the fixed runs, by condition.
        data: the finished ones; None if there are none.
        fix: the end of a reason if runs are missing, with the command that trains them.
        damaged: published tables that could not be read, and may contain them.
    """

    claim: Claim
    world: str
    cells: Mapping[str, tuple[Cell, ...]]
    data: StudyData | None
    fix: str
    damaged: Sequence[str]

    def found(self, condition: str) -> list[FinishedRun]:
        return self.data.of_condition(condition) if self.data else []

    def why_incomparable(self, outcome: str, names: Sequence[str]) -> str:
        """Return why arms cannot be compared, before any value is read; empty if they can."""
        runs = [self.cells[name][0].run for name in names]
        if len({replace(run, steps=1, seed=0) for run in runs}) < len(runs):
            return f"A/A: {' and '.join(names)} resolve to the same configuration"
        if len({run.engine for run in runs}) > 1:
            engines = ", ".join(f"{name} by {run.engine}" for name, run in zip(names, runs, strict=True))
            return f"engines are mixed: {engines}"
        if missing := [*filter(None, map(self._missing, names))]:
            return "; ".join([*missing, self.fix])
        parts = outcome.split(MINUS)
        if self.data and any(map(is_return, parts)) and not have_one_return(self.data, names):
            return "returns of unlike rewards"
        timed = any(find_outcome(part).source == "times" for part in parts)
        return self._machines(names) if timed else ""

    def _missing(self, condition: str) -> str:
        cells, found = self.cells[condition], len(self.found(condition))
        if found == len(cells):
            return ""
        steps = f"{cells[0].run.steps:,} steps" + "".join(f" ({problem})" for problem in self.damaged)
        if found:
            return f"runs missing: {condition} has {found} of the {len(cells)} fixed ones with {steps}"
        return f"no runs: {condition}, {len(cells)} seeds of {steps}"

    def _machines(self, names: Sequence[str]) -> str:
        """Return why times cannot be compared (machines differ, or did other work); empty if they can."""
        rows = [run.row for name in names for run in self.found(name)]
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
        budgets = [cells[0].run.steps for cells in self.cells.values()]
        unlike = max(budgets) > min(budgets) * (1 + SLACK)
        at_step = float(min(claim.steps.values())) if unlike else None
        learned, reasons = _learned(data, runs, at_step), []
        values = _values(data, runs, name, at_step)
        # A threshold that is never reached gives inf: not a number to compare, but one to count.
        for run, value in zip(runs, values, strict=True):
            if np.isnan(value) or (np.isinf(value) and not claim.event):
                why = next(filter(None, (reason(data, run, part, at_step) for part in name.split(MINUS))), "")
                reasons.append(f"{condition} seed {run.seed}: {why or f'it never gets to its {name}'}")
        if claim.event:
            values = claim.has_event(values).astype(float)
        return Arm(values, tuple(run.run_id for run in runs), next(iter(reasons), ""), learned)


def _values(data: StudyData, runs: Sequence[FinishedRun], name: str, at_step: float | None) -> np.ndarray:
    """Return each run's outcome, or by how much the first of two outcomes exceeds the second, (runs,)."""
    first, *second = (
        np.array([outcome(data, run, part, at_step) for run in runs], float) for part in name.split(MINUS)
    )
    return first - second[0] if second else first


def _learned(data: StudyData, runs: Sequence[FinishedRun], at_step: float | None) -> bool | None:
    """Return whether an arm plays better than the random player, by a one-sided Student's test.

    The test uses each run's mean score over all evaluations, where 0 is the random player; the greatest score
    would be above 0 by chance alone. None if a run has no score.
    """
    every = [view(data, run, at_step).evaluations("score")[1] for run in runs]
    scores = np.array([scores.mean() if len(scores) else np.nan for scores in every])
    if not np.isfinite(scores).all() or scores.size < 2:
        return None
    error = scores.std(ddof=1) / np.sqrt(scores.size)
    p_greater, _ = student_tails(scores.mean(), np.array(error), scores.size - 1)
    return bool(p_greater <= FLOOR_LEVEL) and bool(scores.mean() > 0)


# --- Finding runs ----------------------------------------------------------------------------------


Asked = Callable[[Claim, str], bool]
"""Whether a claim is to be judged in a world."""


def find_runs(
    index: RunIndex, claims: ClaimList, asked: Asked = lambda claim, world: True
) -> Iterator[ClaimRuns]:
    """Yield the runs of each claim that is asked for, in each of its worlds, in the list's order."""
    read_study = cache(load_study)

    @cache
    def plan(name: str, world: str, condition: str, seeds: tuple[int, ...], steps: int) -> tuple[Cell, ...]:
        study = read_study(name, world)
        selection = Selection(next(iter(study.presets)), seeds, steps, conditions=(condition,))
        return make_plan(study, selection, index.engine_of).cells

    rest = " --unpublished" if index.store.published(shipped=False) else ""
    for claim in claims.claims.values():
        is_path = claim.study.endswith(".toml")
        path = str(claims.path.parent / claim.study) if is_path else claim.study
        for world in (world for world in claim.worlds if asked(claim, world)):
            study = read_study(path, world)
            seeds = claim.seeds_in(world)
            cells = {
                condition: plan(path, world, condition, seeds[condition], claim.steps[condition])
                for condition in claim.compared
            }
            commands = _preset_commands(claims, claim, study) or _commands(claim, path, world, study.worlds)
            fix = f"{TRAIN_WITH} {' && '.join(command + rest for command in commands)}"
            data = _read(index, study, cells)
            yield ClaimRuns(claim.in_world(world), world, cells, data, fix, index.problems)


def _read(index: RunIndex, study: Study, cells: Mapping[str, Sequence[Cell]]) -> StudyData | None:
    """Return the finished runs among some cells; None if there are none."""
    every = [cell for each in cells.values() for cell in each]
    rows = index.rows(index.entries[cell.run_id] for cell in every if cell.run_id in index.entries)
    found = [
        FinishedRun(cell.condition, cell.seed, rows[cell.run_id]) for cell in every if cell.run_id in rows
    ]
    fields = {condition: as_fields(each[0].run) for condition, each in cells.items()}
    return StudyData(study.name, study.title, study.figure, "", fields, found) if found else None


def _preset_commands(claims: ClaimList, claim: Claim, study: Study) -> list[str]:
    """Return the commands, one a budget, that train a study's claimed runs; none if the list is elsewhere."""
    if study.path is None or claims.path.resolve() != (study.path.parent / CLAIMS_FILE).resolve():
        return []
    alike = [one for one in claims.claims.values() if one.study == claim.study and study.world in one.worlds]
    several = len({steps for one in alike for steps in one.steps.values()}) > 1
    name = study.own_path or study.name
    words = ["pneuma", "study", "run", name, "--preset", CLAIMS, *world_option(study.world, study.worlds)]
    budgets = sorted({*claim.steps.values()}) if several else [0]
    return [shlex.join([*words, *(["--steps", str(steps)] if steps else [])]) for steps in budgets]


def _commands(claim: Claim, study: str, world: str, worlds: Sequence[str]) -> list[str]:
    """Return the commands that train the runs of a claim in a list that is not beside the study's file."""
    alike: dict[tuple[tuple[int, ...], int], list[str]] = {}
    for name in claim.conditions:
        alike.setdefault((tuple(sorted(claim.seeds[name])), claim.steps[name]), []).append(name)
    commands = []
    for (seeds, steps), names in alike.items():
        every = seeds == tuple(range(seeds[0], seeds[-1] + 1))
        listed = f"{seeds[0]}..{seeds[-1]}" if every else ",".join(map(str, seeds))
        words = ["pneuma", "study", "run", study, *world_option(world, worlds)]
        words += [word for name in names for word in ("--condition", name)]
        commands.append(shlex.join([*words, "--seeds", listed, "--steps", str(steps)]))
    return commands
