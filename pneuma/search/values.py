"""The values of trials: outcomes of their runs as a search counts them, combined over seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pneuma.analysis.outcomes import find_outcome, outcome
from pneuma.search.spec import OVER_SEEDS, Objective, Search
from pneuma.store.row_builder import row_until, stored_row
from pneuma.store.rows import Row
from pneuma.store.store import Store
from pneuma.study.plan import Cell


@dataclass(frozen=True)
class Outcomes:
    """Reads outcomes of stored runs as a search counts them."""

    search: Search
    store: Store

    def read(self, cell: Cell, name: str) -> float:
        """Return an outcome of a finished run; NaN if it has none."""
        return counted_outcome(self.search, stored_row(self.store, cell.run_id), name)

    def read_early(self, cell: Cell, name: str, steps: Sequence[int]) -> list[float]:
        """Return an outcome as it is at steps before the run's end, in their order; NaN if there is none."""
        status = self.store.status(cell.run_id)
        healthy = [step for step in steps if status.name != "diverged" or step < status.step]
        rows = (row_until(self.store, cell.run_id, cell.run, step) for step in healthy)
        values = [outcome(row, name) for row in rows]
        return values + [self.read(cell, name) for _ in steps[len(healthy) :]]

    def diverged(self, cell: Cell) -> bool:
        return self.store.status(cell.run_id).name == "diverged"


def counted_outcome(search: Search, run: Row, name: str) -> float:
    """Return an outcome of a run as a search counts it.

    A diverged run counts with the worst possible value of the outcome, or with its last recorded value if the
    outcome has no bound.
    """
    if run.status == "diverged":
        minimized = any(
            (one.outcome, one.direction) == (name, "minimize") and one.over_seeds != "deviation"
            for one in search.sought
        )
        worst = find_outcome(name).bounds[minimized]
        if np.isfinite(worst):
            return float(worst)
    return outcome(run, name)


def objective_value(objective: Objective, values: np.ndarray, diverged: bool) -> float:
    """Return the value of runs in one objective from their outcomes, (seeds,), and whether some diverged.

    Runs that all diverge have no spread, which would look good. They count with the greatest possible spread,
    if the outcome is bounded.
    """
    bounds, half = find_outcome(objective.outcome).bounds, len(values) // 2
    if objective.over_seeds == "deviation" and np.isfinite(bounds).all() and diverged:
        return over_seeds("deviation", np.repeat(bounds, [half, len(values) - half]))
    return over_seeds(objective.over_seeds, values)


def over_seeds(name: str, values: np.ndarray) -> float:
    """Combine the outcomes of a trial's runs, (seeds,); NaN if one has none."""
    if not np.isfinite(values).all() or (name == "deviation" and len(values) < 2):
        return float("nan")
    return float(OVER_SEEDS[name](values))
