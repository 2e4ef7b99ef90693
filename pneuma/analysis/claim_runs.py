"""The runs that claims fixed beforehand: found by their ids, and what hinders a comparison of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from pneuma.analysis.claims import MINUS, Claim, ClaimList
from pneuma.analysis.frames import FinishedRun, StudyData, view
from pneuma.analysis.outcomes import QUIET, find_outcome, outcome, reason
from pneuma.analysis.published import published_studies
from pneuma.analysis.pvalues import student_tails
from pneuma.analysis.run_index import RunIndex
from pneuma.config import as_fields
from pneuma.study.claimed import training_command
from pneuma.study.plan import Cell, Selection, make_plan
from pneuma.study.provenance import processors
from pneuma.study.spec import load_study
from pneuma.study.store import Store

TRAIN_WITH = "train with:"
"""How the part of a reason begins that names the command."""

FLOOR_LEVEL = 0.05
"""The level of the one-sided test of whether an arm plays better than the random player."""


@dataclass(frozen=True)
class Arm:
    """One arm of a contrast.

    Attributes:
        values: (seeds,) the outcome of each run that counts, in the order of the seeds; 1 or 0 where runs
            with an event are counted.
        run_ids: of the same runs.
        reason: why it cannot be compared: a run has no value.
        learned: whether it is shown to play better than the random player; None where that is not known.
    """

    values: np.ndarray
    run_ids: tuple[str, ...]
    reason: str = ""
    learned: bool | None = None


@dataclass(frozen=True)
class ClaimRuns:
    """The runs that a claim fixed in one world.

    Attributes:
        cells: what was fixed, by condition.
        found: which of these have finished, by condition and in the order of the seeds.
        data: the study that they are read through; None where no run of it has finished.
        mend: how a reason ends where runs are missing: the command that trains them.
        damaged: published tables that could not be read, in which they may be.
    """

    claim: Claim
    world: str
    cells: Mapping[str, tuple[Cell, ...]]
    found: Mapping[str, tuple[FinishedRun, ...]]
    data: StudyData | None
    mend: str
    damaged: Sequence[str]

    def hindrance(self, outcome: str, names: Sequence[str]) -> str:
        """Say why arms cannot be compared, before any value is looked at; empty where they can."""
        runs = [self.cells[name][0].run for name in names]
        if len({replace(run, steps=1, seed=0) for run in runs}) < len(runs):
            return f"A/A: {' and '.join(names)} resolve to the same configuration"
        if len({run.engine for run in runs}) > 1:
            told = ", ".join(f"{name} by {run.engine}" for name, run in zip(names, runs, strict=True))
            return f"engines are mixed: {told}"
        missing = [*filter(None, map(self._missing, names))]
        if missing:
            return "; ".join([*missing, *([self.mend] if self.mend else [])])
        timed = any(find_outcome(part).source == "times" for part in outcome.split(MINUS))
        return self._machines(names) if timed else ""

    def known_ids(self, names: Sequence[str]) -> tuple[str, ...]:
        """Return the ids of what runs there are."""
        return tuple(run.run_id for name in names for run in self.found[name])

    def _missing(self, condition: str) -> str:
        """Say which of a condition's fixed runs are not there."""
        cells, found = self.cells[condition], self.found[condition]
        if len(found) == len(cells):
            return ""
        steps = f"{cells[0].run.steps:,} steps" + "".join(f" ({told})" for told in self.damaged)
        if found:
            return f"too few seeds: {condition} has {len(found)} of the {len(cells)} fixed ones with {steps}"
        return f"no runs: {condition}, {len(cells)} seeds of {steps}"

    def _machines(self, names: Sequence[str]) -> str:
        """Refuse to compare times of different machines, or of one that had other work beside."""
        records = [run.records for name in names for run in self.found[name]]
        told = [own.provenance() for own in records]
        if len({(on, str(own.get("threads"))) for own in told for on in processors(own)}) > 1:
            return "timed on different machines"
        shares = [own.processor_share for own in records if own.processor_share is not None]
        least = min(shares, default=1.0)
        return f"timed beside other work: on {least:.0%} of a core" if least < QUIET else ""

    # --- Values ----------------------------------------------------------------------------------

    def arm(self, name: str, condition: str) -> Arm:
        """Return an outcome of a condition whose runs have all finished."""
        claim, data, runs = self.claim, self.data, [*self.found[condition]]
        assert data is not None
        steps = {*claim.steps.values()}
        at_step = float(min(steps)) if len(steps) > 1 else None
        learned = _learned(data, runs, at_step)
        reasons = []
        if claim.only:
            counts = _values(data, runs, claim.only, at_step)
            unknown = [run.seed for run, own in zip(runs, counts, strict=True) if np.isnan(own)]
            reasons += [f"{condition} seed {seed}: its {claim.only} is not known" for seed in unknown]
            runs = [run for run, own in zip(runs, counts, strict=True) if own == 1]
            if not runs:
                reasons.append(f"no run of {condition} counts: {claim.only} is 0 in all")
        values = _values(data, runs, name, at_step)
        # What is never reached is endless: no number to compare, but one to count.
        missing = np.isnan(values) if claim.event else ~np.isfinite(values)
        for run in (run for run, lacks in zip(runs, missing, strict=True) if lacks):
            why = next(filter(None, (reason(data, run, part, at_step) for part in name.split(MINUS))), "")
            reasons.append(f"{condition} seed {run.seed}: {why or f'it never gets to its {name}'}")
        if claim.event:
            over = values > claim.event.threshold if claim.event.above else values < claim.event.threshold
            values = over.astype(float)
        return Arm(values, tuple(run.run_id for run in runs), reasons[0] if reasons else "", learned)


def find_runs(store: Store, claims: ClaimList) -> Iterator[ClaimRuns]:
    """Yield the runs of every claim of a list in every world that it is about, in the list's order.

    Claims on one study and of the same steps are read through one study, so that their runs lie on one grid.
    """
    index, read_study = RunIndex(store, shipped=False), cache(load_study)

    @cache
    def plan(name: str, world: str, condition: str, seeds: tuple[int, ...], steps: int) -> tuple[Cell, ...]:
        study = read_study(name, world)
        selection = Selection(next(iter(study.presets)), seeds, steps, conditions=(condition,))
        return make_plan(study, selection).cells

    def study_of(claim: Claim) -> str:
        is_path = claim.study.endswith(".toml")
        return str(claims.path.parent / claim.study) if is_path else claim.study

    def group_of(claim: Claim, world: str) -> tuple[str, str, tuple[int, ...]]:
        return study_of(claim), world, tuple(sorted({*claim.steps.values()}))

    def cells_of(claim: Claim, world: str) -> dict[str, tuple[Cell, ...]]:
        return {
            name: plan(study_of(claim), world, name, claim.seeds[name], claim.steps[name])
            for name in claim.conditions
        }

    @cache
    def read(name: str, world: str, steps: tuple[int, ...]) -> StudyData | None:
        """Return the finished runs of all claims on a study with such budgets."""
        group = [own for own in claims.claims.values() if world in own.worlds]
        cells = {
            cell.run_id: cell
            for own in group
            if group_of(own, world) == (name, world, steps)
            for each in cells_of(own, world).values()
            for cell in each
        }
        study = read_study(name, world)
        runs = [
            {"condition": cell.condition, "seed": cell.seed, "run_id": run_id, "run": as_fields(cell.run)}
            for run_id, cell in cells.items()
        ]
        told = {"study": study.name, "title": study.title, "figure": study.figure, "baseline": study.baseline}
        record = {**told, "path": study.own_path, "same": [], "runs": runs}
        records = index.of_record(record)
        if not any(own.status.finished for own in records.values()):
            return None
        return StudyData(records, record, str(store.root))

    rest = " --unpublished" if published_studies(store) else ""
    for claim in claims.claims.values():
        for world in claim.worlds:
            cells, data = cells_of(claim, world), read(*group_of(claim, world))
            finished = {run.run_id: run for run in data.runs} if data else {}
            found = {
                name: tuple(finished[cell.run_id] for cell in own if cell.run_id in finished)
                for name, own in cells.items()
            }
            command = training_command(read_study(study_of(claim), world), claims.path)
            mend = f"{TRAIN_WITH} {command}{rest}" if command else ""
            yield ClaimRuns(claim.in_world(world), world, cells, found, data, mend, index.damaged)


def _values(data: StudyData, runs: Sequence[FinishedRun], name: str, at_step: float | None) -> np.ndarray:
    """Return an outcome of each run, or how far the first of two exceeds the second, (runs,)."""
    first, *second = (
        np.array([outcome(data, run, part, at_step) for run in runs], float) for part in name.split(MINUS)
    )
    return first - second[0] if second else first


def _learned(data: StudyData, runs: Iterable[FinishedRun], at_step: float | None) -> bool | None:
    """Tell whether an arm is shown to play better than the random player, by a one-sided Student's test.

    A run's number is its mean score over all its evaluations, where 0 is the random player. A greatest
    score would be above 0 by chance alone. None where a run has no score.
    """
    every = [view(data, run, at_step).evaluations("score")[1] for run in runs]
    scores = np.array([own.mean() if len(own) else np.nan for own in every])
    if not np.isfinite(scores).all() or scores.size < 2:
        return None
    error = scores.std(ddof=1) / np.sqrt(scores.size)
    p_greater, _ = student_tails(scores.mean(), np.array(error), scores.size - 1)
    return bool(p_greater <= FLOOR_LEVEL) and bool(scores.mean() > 0)
