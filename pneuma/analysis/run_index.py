"""From a run's id to what is held of it, and from a selection to its data: wherever the runs are.

A results folder's own runs come first, trained there or imported; for those that it lacks, all of them in a
fresh clone, published tables stand in: the study's own, then those of other studies, for a run is the same
run in whichever study it was published.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from pneuma.analysis.frames import StudyData
from pneuma.analysis.published import PublishedTable, published_path, published_studies, read_published
from pneuma.analysis.records import LoggedRecords, Records
from pneuma.errors import UserError
from pneuma.study.store import SCALARS_FILE, Status, Store


class RunIndex:
    """What a results folder holds of runs, by their ids.

    Args:
        store: the folder.
        stored: whether its own runs count, or published tables alone.

    Attributes:
        damaged: of the tables of other studies that were asked for, what is wrong with those that cannot be
            read.
    """

    def __init__(self, store: Store, stored: bool = True) -> None:
        self.store = store
        self.damaged: list[str] = []
        self._stored = stored
        self._runs: dict[str, Records] = {}
        self.table = cache(self._table)
        self._others = cache(self._read_others)

    def __call__(self, run_id: str) -> Records:
        """Return what the folder itself holds of a run; of one that is not there, that it is planned."""
        if run_id not in self._runs:
            status = self.store.status(run_id) if self._stored else Status("planned")
            logged = self._stored and SCALARS_FILE in self.store.file_names(run_id)
            kind = LoggedRecords if logged else Records
            self._runs[run_id] = kind(self.store, run_id, status)
        return self._runs[run_id]

    def record(self, study: str) -> dict[str, Any] | None:
        """Return what a study's name stands for: its latest selection, or else what is published of it.

        Raises:
            UserError: when the published table is damaged.
        """
        own = self.store.selection(study) if self._stored else None
        table = None if own else self.table(study)
        return table.record if table else own

    def of_record(
        self, record: Mapping[str, Any], mixed: bool = True, others: bool = True, curves: bool = True
    ) -> tuple[dict[str, Records], int | None]:
        """Return what is held of every run of a selection, by its id.

        Args:
            record: the selection.
            mixed: whether published runs may stand beside those that are stored.
            others: whether the tables of other studies count too.
            curves: whether these count only where they have all curves that the others have.

        Tables whose curves end at one step add up; of several such steps that counts which gives the most
        runs, and none at which the curves of a run that is here would not have ended.

        Returns:
            The records; and, where some are published, the step at which all curves end.

        Raises:
            UserError: when the study's own table is needed and damaged.
        """
        steps = {run["run_id"]: run["run"]["steps"] for run in record["runs"]}
        found = {run_id: self(run_id) for run_id in steps}
        here = {run_id: own for run_id, own in found.items() if own.status.finished}
        if len(here) == len(found) or (here and not mixed):
            return found, None
        longest = max((steps[run_id] for run_id in here), default=0)
        own = self.table(record["study"])
        tables = [own] if own else []
        if mixed and others and not (own and {*found} <= {*here} | own.finished):
            held = {name for each in (tables or here.values()) for name in each.quantities}
            whole = own.budget if own else max(steps.values())
            tables += [
                each
                for each in self._others()
                if each is not own and (not curves or (each.budget == whole and {*each.quantities} >= held))
            ]
        best: tuple[dict[str, Records], int | None] = found, None
        for budget in sorted({table.budget for table in tables if table.budget >= longest}):
            some = dict(found)
            for table in (each for each in tables if each.budget == budget):
                lacking = {run_id for run_id, each in some.items() if not each.status.finished}
                some |= {run_id: table(run_id) for run_id in lacking & table.finished}
            if _finished(some) > _finished(best[0]):
                best = some, budget
        return best

    def _table(self, study: str) -> PublishedTable | None:
        """Return a study's published table, if it has one.

        Raises:
            UserError: when it is damaged.
        """
        return read_published(self.store, study) if published_path(self.store, study).exists() else None

    def _read_others(self) -> list[PublishedTable]:
        """Return all published tables that can be read."""
        tables = []
        for study in published_studies(self.store):
            try:
                tables += [table] if (table := self.table(study)) else []
            except UserError as error:
                self.damaged.append(str(error))
        return tables


def open_study(
    where: Store | RunIndex,
    record: Mapping[str, Any],
    *,
    mixed: bool = True,
    others: bool = True,
    curves: bool = True,
) -> StudyData:
    """Return the finished runs of a selection, from wherever they are.

    Args:
        where: the results folder.
        record: a selection, as `pneuma.study.execute.selection_record` makes it.
        mixed: which published runs count, as `RunIndex.of_record` has it.
        others: likewise.
        curves: likewise.

    Raises:
        UserError: when no run of the selection has finished, or its published table is damaged.
    """
    index = where if isinstance(where, RunIndex) else RunIndex(where)
    records, budget = index.of_record(record, mixed, others, curves)
    return StudyData(records, {**record, "budget": budget} if budget else record, str(index.store.root))


def open_published(results: Path, names: Sequence[str] | None = None) -> list[StudyData]:
    """Return studies by the published tables of a results folder alone; all when none is named.

    Raises:
        UserError: when one is damaged.
    """
    index = RunIndex(Store(results), stored=False)
    records = {name: index.record(name) for name in names or published_studies(index.store)}
    if missing := [name for name, record in records.items() if record is None]:
        raise UserError(f"{published_path(index.store, missing[0])}: there is no such table")
    return [open_study(index, record) for record in records.values() if record]


def _finished(records: Mapping[str, Records]) -> int:
    return sum(own.status.finished for own in records.values())
