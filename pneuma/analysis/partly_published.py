"""The fourth source of a study's data: some of its runs in the results folder, the others in a table.

So it is when a part of a study is trained elsewhere, or when a clone's published runs get company. Each
run is asked of the source that has it. Outcomes are had of all; curves are those that the table has.
Claims, which take their runs from wherever they are, join several tables so, one after the other.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
import pandas as pd

from pneuma.analysis.outcomes import outcome
from pneuma.analysis.published import PublishedRuns
from pneuma.analysis.signs import Stretch
from pneuma.analysis.tables import FinishedRun, Source, StudyData
from pneuma.study.store import Status


class PartlyPublished:
    """Runs that are had already, and those of a published table that are not.

    Args:
        here: the study with the former alone, on the grid of the table.
        published: the table.
        published_ids: the runs that are taken from it.
    """

    what = "the results folder with its published table"

    def __init__(self, here: StudyData, published: PublishedRuns, published_ids: Collection[str]) -> None:
        self._here = here
        self._published = published
        self.published_ids = frozenset(published_ids)
        self.tables = tuple(name for name in published.tables if name in here.tables)
        self.windows = published.windows
        self.averaged_over = published.averaged_over

    def status(self, run_id: str) -> Status:
        """Return how a run stands where it is had from."""
        return self._source(run_id).status(run_id)

    def quantities(self, run: FinishedRun) -> tuple[str, ...]:
        """Return what curves the table has: a line over some of a condition's runs would mislead."""
        held = self._published.quantities(run)
        return tuple(name for name in self._here.source.quantities(run) if name in held)

    def table(self, run: FinishedRun, name: str) -> pd.DataFrame:
        """Return one of a run's tables."""
        return self._source(run.run_id).table(run, name)

    def curve(self, run: FinishedRun, quantity: str, window: str, grid: np.ndarray) -> np.ndarray:
        """Return a run's curve on the grid, (points,), which is the one that the table was published on."""
        return self._source(run.run_id).curve(run, quantity, window, grid)

    def final(self, run: FinishedRun, quantity: str) -> float:
        """Return the mean of a run's last 100 episodes, or its last update's value."""
        return self._source(run.run_id).final(run, quantity)

    def peaks(self, run: FinishedRun, quantity: str, grid: np.ndarray) -> np.ndarray:
        """Return the extreme update since each point before, (points,)."""
        return self._source(run.run_id).peaks(run, quantity, grid)

    def signs(self, run: FinishedRun) -> dict[str, list[Stretch]]:
        """Return where signs of collapse hold."""
        return self._source(run.run_id).signs(run)

    def kept_outcome(self, run: FinishedRun, name: str) -> float | None:
        """Return an outcome that the table keeps, of the other runs by all that is had of them."""
        if run.run_id in self.published_ids:
            return self._published.kept_outcome(run, name)
        return outcome(self._here, run, name) if name in self._published.kept_outcomes else None

    def wall_seconds(self, run: FinishedRun) -> float | None:
        """Return how long a run trained."""
        return self._source(run.run_id).wall_seconds(run)

    def processor_share(self, run: FinishedRun) -> float | None:
        """Return how much of a core a run's training had."""
        return self._source(run.run_id).processor_share(run)

    def provenance(self, run: FinishedRun) -> dict[str, Any]:
        """Return what produced a run."""
        return self._source(run.run_id).provenance(run)

    def _source(self, run_id: str) -> Source:
        return self._published if run_id in self.published_ids else self._here.source
