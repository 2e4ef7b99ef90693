"""What is known of one run up to a step: its evaluations and its curves, whatever source holds them.

    StudyData, run and step → RunView → one number per run (`pneuma.analysis.outcomes`)

Everything is read from evaluations and from curves on the study's grid, which runs and published tables
hold alike, so that both give the same numbers. A run that diverged has its last recorded values.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pneuma.analysis.frames import FinishedRun, StudyData

SLACK = 1 / 40
"""Share of a step count by which budgets of whole horizons may miss it: half way to the next evaluation."""

Series = tuple[np.ndarray, np.ndarray]
"""Steps and values, (points,) each, steps rising, every value finite."""


@dataclass(frozen=True)
class RunView:
    """A run as it stood at a step.

    Attributes:
        until: agent steps; the run's budget unless a smaller one was asked for.
        since: where means over evaluations begin.
    """

    data: StudyData
    run: FinishedRun
    until: float
    since: float = 0.0

    @property
    def last_step(self) -> float:
        """The last step of which anything is taken into account."""
        return self.until * (1 + SLACK)

    def evaluations(self, column: str) -> Series:
        """Return a column of the evaluations; nothing where there is no such column."""
        if "evaluations" not in self.run.records.tables:
            return _nothing()
        table = self.run.records.table("evaluations")
        if column not in table:
            return _nothing()
        return self._finite(table["step"].to_numpy(float), table[column].to_numpy(float))

    def curve(self, quantity: str) -> Series:
        """Return a training curve's points that have a value; nothing where there is no such quantity."""
        records, grid = self.run.records, self.data.grid
        if quantity not in records.quantities:
            return _nothing()
        return self._finite(grid, records.curve(quantity, self.data.windows[0], grid, self.run.slots))

    def peaks(self, quantity: str) -> Series:
        """Return, for each point, the extreme value of an update since the point before."""
        if quantity not in self.run.records.quantities:
            return _nothing()
        return self._finite(self.data.grid, self.run.records.peaks(quantity, self.data.grid))

    def _finite(self, step: np.ndarray, values: np.ndarray) -> Series:
        kept = np.isfinite(values) & (step <= self.last_step)
        return step[kept], values[kept]


def view(data: StudyData, run: FinishedRun, at_step: float | None = None) -> RunView:
    """Look at a run as it stood at a step, at its own budget where none is given or it is smaller.

    A step is given where runs of unlike budgets are compared. Each was evaluated at even parts of its own, so
    that what they have in common begins at the latest of their first evaluations.
    """
    since = 0.0 if at_step is None else data.latest_first_evaluation
    return RunView(data, run, min(run.budget, at_step or run.budget), since)


def common_step(data: StudyData) -> int | None:
    """Return the largest step count that every run was to reach; None where all budgets are the same.

    Budgets that whole horizons put apart, by less than half the way to an evaluation, are the same. A run
    that diverged was to reach its budget, and has its last values there. Imported logs do not tell what
    their runs were to reach: of these it is what two thirds of them did reach.
    """
    budgets = sorted((run.budget for run in data.runs), reverse=True)
    if budgets[0] <= budgets[-1] * (1 + SLACK):
        return None
    return budgets[math.ceil(len(budgets) * 2 / 3) - 1 if data.averaged_over else -1]


def ends_before(run: FinishedRun, step: float | None) -> bool:
    """Tell whether a run was not to reach a step, so that it has no value there."""
    return step is not None and run.budget * (1 + SLACK) < step


def step_words(data: StudyData) -> str:
    """Say what the common step is, and which runs end before it."""
    if not data.averaged_over:
        return "the most that all runs were to reach"
    short = [f"{run.condition} {run.seed}" for run in data.runs if ends_before(run, common_step(data))]
    left_out = f" (left out, as they end before: {', '.join(short)})" if short else ""
    return f"the most that two thirds of the logs reached{left_out}"


def mean_height(series: Series, until: float) -> float:
    """Return the area under a curve by trapezoids over the steps it spans: its mean height.

    The last value is carried on to `until`, for a run that ended early; NaN without a value.
    """
    step, values = series
    if not len(values):
        return float("nan")
    step, values = np.append(step, max(until, step[-1])), np.append(values, values[-1])
    span = step[-1] - step[0]
    return float(np.trapezoid(values, step) / span) if span > 0 else float(values[0])


def _nothing() -> Series:
    return np.empty(0), np.empty(0)
