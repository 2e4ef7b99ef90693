"""The value of a trial: the outcomes of its runs, combined over seeds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pneuma.analysis.outcomes import find_outcome, outcome
from pneuma.search.spec import DEVIATION, OVER_SEEDS, Objective
from pneuma.store.row_builder import row_until, stored_row
from pneuma.store.rows import Row
from pneuma.store.store import Store
from pneuma.study.plan import Cell


def read_rows(store: Store, cells: Sequence[Cell], step: int | None = None) -> list[Row]:
    """Return the rows of runs: as they are at a step, or at their end.

    A run that diverged by that step counts as diverged.
    """
    rows = []
    for cell in cells:
        status = store.status(cell.run_id)
        if step is None or (status.name == "diverged" and status.step <= step):
            rows.append(stored_row(store, cell.run_id))
        else:
            rows.append(row_until(store, cell.run_id, cell.run, step))
    return rows


def trial_value(objective: Objective, rows: Sequence[Row]) -> float:
    """Return the value of a trial in one objective; NaN if a run has no outcome.

    A diverged run counts with the worst possible outcome, or with its last recorded one if there is no bound.
    For a deviation it counts as the greatest possible spread: runs that all diverge would have none.
    """
    low, high = find_outcome(objective.outcome).bounds
    worst = low if objective.direction == "maximize" else high
    diverged = [row.status == "diverged" for row in rows]
    if objective.over_seeds == DEVIATION and any(diverged) and np.isfinite([low, high]).all():
        half_count = len(rows) // 2
        return combine(DEVIATION, np.repeat([low, high], [half_count, len(rows) - half_count]))
    run_values = []
    for row, has_diverged in zip(rows, diverged, strict=True):
        counts_worst = has_diverged and objective.over_seeds != DEVIATION and np.isfinite(worst)
        run_values.append(worst if counts_worst else outcome(row, objective.outcome))
    return combine(objective.over_seeds, np.array(run_values))


def combine(over_seeds: str, run_values: np.ndarray) -> float:
    """Combine the outcomes of a trial's runs, (seeds,); NaN if one has none."""
    if not np.isfinite(run_values).all() or (over_seeds == DEVIATION and len(run_values) < 2):
        return float("nan")
    return float(OVER_SEEDS[over_seeds](run_values))
