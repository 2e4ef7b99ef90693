"""The runs that claims fixed beforehand: found by their ids, and what hinders a comparison of them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

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
from pneuma.study.spec import Study, load_study
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


class ClaimRuns:
    """Finds claims' runs in a results folder; what was read once is kept."""

    def __init__(self, store: Store, claims: ClaimList) -> None:
        self._store = store
        self._index = RunIndex(store)
        self._claims = claims
        self.study = cache(self._study)
        self._cells_of = cache(self._plan_cells)
        self._data = cache(self._open)
        self._arms: dict[tuple[str, str, str, str], Arm] = {}

    def hindrance(self, claim: Claim, world: str, outcome: str, names: Sequence[str]) -> str:
        """Say why arms cannot be compared, before any value is looked at; empty where they can."""
        runs = [self._cells(claim, world, name)[0].run for name in names]
        if len({replace(run, steps=1, seed=0) for run in runs}) < len(runs):
            return f"A/A: {' and '.join(names)} resolve to the same configuration"
        if len({run.engine for run in runs}) > 1:
            told = ", ".join(f"{name} by {run.engine}" for name, run in zip(names, runs, strict=True))
            return f"engines are mixed: {told}"
        missing = [*filter(None, (self._missing(claim, world, name) for name in names))]
        if not missing:
            return self._machines(claim, world, outcome, names)
        command = training_command(self.study(claim.study, world), self._claims.path)
        rest = " --unpublished" if published_studies(self._store) else ""
        return "; ".join([*missing, *([f"{TRAIN_WITH} {command}{rest}"] if command else [])])

    def arm(self, claim: Claim, world: str, outcome: str, condition: str) -> Arm:
        """Return an arm whose runs have all finished."""
        key = claim.name, world, outcome, condition
        if key not in self._arms:
            self._arms[key] = self._measure(claim, world, outcome, condition)
        return self._arms[key]

    def known_ids(self, claim: Claim, world: str, names: Sequence[str]) -> tuple[str, ...]:
        """Return the ids of what runs there are."""
        found = [self._finished(claim, world, name).values() for name in names]
        return tuple(run.run_id for runs in found for run in runs)

    # --- Which runs ------------------------------------------------------------------------------

    def _study(self, name: str, world: str) -> Study:
        path = str(self._claims.path.parent / name) if name.endswith(".toml") else name
        return load_study(path, world) if world else load_study(path)

    def _cells(self, claim: Claim, world: str, condition: str) -> tuple[Cell, ...]:
        """Return the cells that a claim fixed for one of its conditions."""
        return self._cells_of(claim.study, world, condition, claim.seeds[condition], claim.steps[condition])

    def _plan_cells(
        self, study: str, world: str, condition: str, seeds: tuple[int, ...], steps: int
    ) -> tuple[Cell, ...]:
        known = self.study(study, world)
        preset = next(iter(known.presets))
        return make_plan(known, Selection(preset, seeds, steps, conditions=(condition,))).cells

    def _group(self, claim: Claim, world: str) -> tuple[str, str, tuple[int, ...]]:
        """Return what claims share whose runs lie on one grid of steps."""
        return claim.study, world, tuple(sorted({*claim.steps.values()}))

    def _open(self, study: str, world: str, steps: tuple[int, ...]) -> StudyData | None:
        """Return the finished runs of all claims on a study with such budgets; None where there is none."""
        group = study, world, steps
        cells = {
            cell.run_id: cell
            for claim in self._claims.claims.values()
            if world in claim.worlds and self._group(claim, world) == group
            for condition in claim.conditions
            for cell in self._cells(claim, world, condition)
        }
        record = _record(self.study(study, world), [*cells.values()])
        records = self._index.of_record(record)
        if not any(own.status.finished for own in records.values()):
            return None
        return StudyData(records, record, str(self._store.root))

    def _finished(self, claim: Claim, world: str, condition: str) -> dict[int, FinishedRun]:
        """Return the finished ones of a condition's runs, by seed."""
        data = self._data(*self._group(claim, world))
        wanted = {cell.run_id for cell in self._cells(claim, world, condition)}
        runs = data.runs if data else []
        return {run.seed: run for run in runs if run.run_id in wanted}

    # --- What hinders ----------------------------------------------------------------------------

    def _missing(self, claim: Claim, world: str, condition: str) -> str:
        """Say which of a condition's fixed runs are not there."""
        cells, found = self._cells(claim, world, condition), self._finished(claim, world, condition)
        if len(found) == len(cells):
            return ""
        steps = f"{cells[0].run.steps:,} steps"
        steps += "".join(f" ({told})" for told in self._index.damaged)
        if found:
            return f"too few seeds: {condition} has {len(found)} of the {len(cells)} fixed ones with {steps}"
        return f"no runs: {condition}, {len(cells)} seeds of {steps}"

    def _machines(self, claim: Claim, world: str, outcome: str, names: Sequence[str]) -> str:
        """Refuse to compare times of different machines, or of one that had other work beside."""
        if all(find_outcome(part).source != "times" for part in outcome.split(MINUS)):
            return ""
        data = self._data(*self._group(claim, world))
        runs = [run for name in names for run in self._finished(claim, world, name).values()]
        found = [run.records.provenance() for run in runs] if data else []
        machines = {(on, str(own.get("threads"))) for own in found for on in processors(own)}
        if len(machines) > 1:
            return "timed on different machines"
        shares = [run.records.processor_share for run in runs] if data else []
        least = min((share for share in shares if share is not None), default=1.0)
        return f"timed beside other work: on {least:.0%} of a core" if least < QUIET else ""

    # --- Values ----------------------------------------------------------------------------------

    def _measure(self, claim: Claim, world: str, name: str, condition: str) -> Arm:
        data = self._data(*self._group(claim, world))
        if data is None:
            raise ValueError(f"claim {claim.name}: no runs of {condition}")
        found = self._finished(claim, world, condition)
        steps = {*claim.steps.values()}
        at_step = float(min(steps)) if len(steps) > 1 else None
        runs = [found[seed] for seed in claim.seeds[condition]]
        reasons = []
        if claim.only:
            counts = _values(data, runs, claim.only, at_step)
            if np.isnan(counts).any():
                seed = runs[int(np.isnan(counts).argmax())].seed
                reasons.append(f"{condition} seed {seed}: its {claim.only} is not known")
            runs = [run for run, own in zip(runs, counts, strict=True) if own == 1]
            if not runs:
                none = f"no run of {condition} counts: {claim.only} is 0 in all"
                return Arm(np.array([]), (), "; ".join(reasons) or none)
        values = _values(data, runs, name, at_step)
        # What is never reached is endless: no number to compare, but one to count.
        missing = np.isnan(values) if claim.event else ~np.isfinite(values)
        if missing.any():
            run = runs[int(missing.argmax())]
            why = next(filter(None, (reason(data, run, part, at_step) for part in name.split(MINUS))), "")
            reasons.append(f"{condition} seed {run.seed}: {why or f'it never gets to its {name}'}")
        if claim.event:
            over = values > claim.event.threshold if claim.event.above else values < claim.event.threshold
            values = over.astype(float)
        learned = _learned(data, found.values(), at_step)
        return Arm(values, tuple(run.run_id for run in runs), reasons[0] if reasons else "", learned)


@dataclass(frozen=True)
class Measure:
    """What judging needs to know of an outcome.

    Attributes:
        bounds: its least and greatest value.
        near: how near to them a run counts as there.
        supposes_rise: whether it tells only of runs that learned something.
        of_play: whether more of it is better play.
    """

    bounds: tuple[float, float]
    near: float
    supposes_rise: bool
    of_play: bool


def measure_of(name: str) -> Measure:
    """Return what judging needs to know of an outcome, or of the difference of two."""
    parts = [find_outcome(part) for part in name.split(MINUS)]
    of_play = all(own.better == "higher" and own.source not in ("times", "signs") for own in parts)
    rise = any(own.supposes_rise for own in parts)
    if len(parts) > 1:
        return Measure((-np.inf, np.inf), 0.0, rise, of_play)
    return Measure(parts[0].bounds, parts[0].alike, rise, of_play)


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


def _record(study: Study, cells: list[Cell]) -> dict[str, Any]:
    """Return cells in the form of a study's record."""
    runs = [
        {"condition": cell.condition, "seed": cell.seed, "run_id": cell.run_id, "run": as_fields(cell.run)}
        for cell in cells
    ]
    named = {"study": study.name, "title": study.title, "figure": study.figure, "baseline": study.baseline}
    return {**named, "path": study.own_path, "same": [], "runs": runs}
