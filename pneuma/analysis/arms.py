"""Arms: the runs that a claim fixed in a world → one value per run, or why they cannot be compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pneuma.analysis.claims import MINUS, Claim
from pneuma.analysis.frames import SLACK, FinishedRun, StudyData, view
from pneuma.analysis.outcomes import QUIET, find_outcome, have_one_return, is_return, outcome, reason
from pneuma.analysis.pvalues import student_tails
from pneuma.study.plan import Cell
from pneuma.study.provenance import processors

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
        mend: the end of a reason if runs are missing, with the command that trains them.
        damaged: published tables that could not be read, and may contain them.
    """

    claim: Claim
    world: str
    cells: Mapping[str, tuple[Cell, ...]]
    data: StudyData | None
    mend: str
    damaged: Sequence[str]

    def found(self, condition: str) -> list[FinishedRun]:
        return self.data.of_condition(condition) if self.data else []

    def hindrance(self, outcome: str, names: Sequence[str]) -> str:
        """Return why arms cannot be compared, before any value is read; empty if they can."""
        runs = [self.cells[name][0].run for name in names]
        if len({replace(run, steps=1, seed=0) for run in runs}) < len(runs):
            return f"A/A: {' and '.join(names)} resolve to the same configuration"
        if len({run.engine for run in runs}) > 1:
            engines = ", ".join(f"{name} by {run.engine}" for name, run in zip(names, runs, strict=True))
            return f"engines are mixed: {engines}"
        if missing := [*filter(None, map(self._missing, names))]:
            return "; ".join([*missing, self.mend])
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
        return f"timed beside other work: on {least:.0%} of a core" if least < QUIET else ""

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
