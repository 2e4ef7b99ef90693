"""The runs that claims fixed beforehand: found by their ids, and what hinders a comparison of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

from pneuma.analysis.claims import Claim, ClaimList
from pneuma.analysis.outcomes import QUIET, find_outcome, outcome, reason
from pneuma.analysis.published import published_studies
from pneuma.analysis.run_index import RunIndex
from pneuma.analysis.tables import FinishedRun, StudyData
from pneuma.config import Run, as_settings
from pneuma.study.claimed import training_command
from pneuma.study.origins import processors
from pneuma.study.plan import Cell, Selection, make_plan
from pneuma.study.spec import Study, load_study
from pneuma.study.store import Store

MEND = "train with:"
"""What the part of a reason begins with that names the command."""

RISEN = 0.1
"""The score, of 0 for the random player and 1 for the hunter, above which a run has learned something."""


@dataclass(frozen=True)
class Arm:
    """One arm of a contrast.

    Attributes:
        values: (seeds,) the outcome of each run that counts, in the order of the seeds.
        run_ids: of the same runs.
        blank: why a run has no value; empty where all have one.
        idle: that the arm never rose above the random player, where the outcome supposes that; else empty.
    """

    values: np.ndarray
    run_ids: tuple[str, ...]
    blank: str = ""
    idle: str = ""


class ClaimRuns:
    """Finds claims' runs in a results folder; what was read once is kept."""

    def __init__(self, store: Store, claims: ClaimList) -> None:
        self._store = store
        self._index = RunIndex(store)
        self._claims = claims
        self.study = cache(self._study)
        self._cells_of = cache(self._plan_cells)
        self._data = cache(self._open)
        self._arms: dict[tuple[str, str, str], Arm] = {}

    def hindrance(self, claim: Claim, world: str, a: str, b: str | None) -> str:
        """Say why arms cannot be compared, before any value is looked at; empty where they can."""
        names = [name for name in (a, b) if name is not None]
        runs = [self._cells(claim, world, name)[0].run for name in names]
        if len({replace(run, steps=1, seed=0) for run in runs}) < len(runs):
            return f"A/A: {' and '.join(names)} resolve to the same configuration"
        if len({run.engine for run in runs}) > 1:
            told = ", ".join(f"{name} by {run.engine}" for name, run in zip(names, runs, strict=True))
            return f"engines are mixed: {told}"
        missing = [*filter(None, (self._missing(claim, world, name) for name in names))]
        if not missing:
            return self._machines(claim, world, names)
        command = training_command(self.study(claim.study, world), self._claims.path)
        rest = " --unpublished" if published_studies(self._store) else ""
        return "; ".join([*missing, *([f"{MEND} {command}{rest}"] if command else [])])

    def undefined(self, claim: Claim, world: str) -> str:
        """Say why a claim is not judged in a world at all."""
        if world in self.study(claim.study, "").worlds:
            return f"world not defined: the claim is not about {world}"
        return f"world not defined: the study {claim.study} is not run in {world}"

    def arm(self, claim: Claim, world: str, condition: str) -> Arm:
        """Return an arm whose runs have all finished."""
        key = claim.name, world, condition
        if key not in self._arms:
            self._arms[key] = self._measure(claim, world, condition)
        return self._arms[key]

    def known_ids(self, claim: Claim, world: str, a: str, b: str | None) -> tuple[str, ...]:
        """Return the ids of what runs there are."""
        names = [name for name in (a, b) if name is not None]
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
            for condition in dict.fromkeys((*claim.a, *claim.b))
            for cell in self._cells(claim, world, condition)
        }
        record = _record(self.study(study, world), [*cells.values()])
        records, budget = self._index.of_record(record, curves=False)
        if not any(own.status.finished for own in records.values()):
            return None
        return StudyData(records, {**record, "budget": budget} if budget else record, str(self._store.root))

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
        reached = self._reached(claim, world, condition, cells[0].run)
        if reached:
            return f"budget not reached: {condition} has runs of {reached:,} steps, not of {steps}"
        return f"no runs: {condition}, {len(cells)} seeds of {steps}"

    def _reached(self, claim: Claim, world: str, condition: str, run: Run) -> int:
        """Return the largest budget below the claim's of a run that is finished here; 0 where none is."""
        name = self.study(claim.study, world).name
        record = self._index.record(name) or {"runs": []}
        lower = {
            own["run_id"]: own["run"]["steps"]
            for own in record["runs"]
            if own["condition"] == condition and own["run"]["steps"] < run.steps
        }
        found, _ = self._index.of_record(
            {**record, "study": name, "runs": [own for own in record["runs"] if own["run_id"] in lower]},
            others=False,
        )
        return max((steps for run_id, steps in lower.items() if found[run_id].status.finished), default=0)

    def _machines(self, claim: Claim, world: str, names: list[str]) -> str:
        """Refuse to compare times of different machines, or of one that had other work beside."""
        if find_outcome(claim.outcome).source != "times":
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

    def _measure(self, claim: Claim, world: str, condition: str) -> Arm:
        data = self._data(*self._group(claim, world))
        if data is None:
            raise ValueError(f"claim {claim.name}: no runs of {condition}")
        found = self._finished(claim, world, condition)
        steps = {*claim.steps.values()}
        at_step = float(min(steps)) if len(steps) > 1 else None
        runs = [found[seed] for seed in claim.seeds[condition]]
        unknown = ""
        if claim.only:
            counts = _values(data, runs, claim.only, at_step)
            unknown = _first(condition, runs, np.isnan(counts), lambda run: f"its {claim.only} is not known")
            runs = [run for run, own in zip(runs, counts, strict=True) if own == 1]
            if not runs:
                none = f"no run of {condition} counts: {claim.only} is 0 in all"
                return Arm(np.array([]), (), unknown or none)
        values = _values(data, runs, claim.outcome, at_step)
        # What is never reached is endless: no number to compare, but one to count.
        missing = np.isnan(values) if claim.event else ~np.isfinite(values)
        blank = _first(
            condition, runs, missing,
            lambda run: reason(data, run, claim.outcome, at_step) or f"it never gets to its {claim.outcome}",
        )  # fmt: skip
        idle = _idle(condition, data, runs, at_step) if find_outcome(claim.outcome).supposes_rise else ""
        return Arm(values, tuple(run.run_id for run in runs), unknown or blank, idle)


def _values(data: StudyData, runs: Sequence[FinishedRun], name: str, at_step: float | None) -> np.ndarray:
    """Return an outcome of each run, (runs,)."""
    return np.array([outcome(data, run, name, at_step) for run in runs], float)


def _first(
    condition: str, runs: Sequence[FinishedRun], missing: np.ndarray, told: Callable[[FinishedRun], str]
) -> str:
    """Tell of the first run that something is missing of; empty where none is."""
    if not missing.any():
        return ""
    run = runs[int(missing.argmax())]
    return f"{condition} seed {run.seed}: {told(run)}"


def _idle(condition: str, data: StudyData, runs: Sequence[FinishedRun], at_step: float | None) -> str:
    """Tell of an arm of which half never learns, where an outcome supposes that runs do; empty otherwise."""
    if (_values(data, runs, "best-score", at_step) > RISEN).mean() > 0.5:
        return ""
    return f"arm at floor: half the runs of {condition} or more never score above {RISEN:g}"


def _record(study: Study, cells: list[Cell]) -> dict[str, Any]:
    """Return cells in the form of a study's record."""
    runs = [
        {"condition": cell.condition, "seed": cell.seed, "run_id": cell.run_id, "run": as_settings(cell.run)}
        for cell in cells
    ]
    named = {"study": study.name, "title": study.title, "figure": study.figure, "baseline": study.baseline}
    return {**named, "path": study.own_path, "same": [], "runs": runs}
