"""From a run's id to what is held of it, and from a selection to its data: wherever the runs are.

Runs in the results folder come first, whether trained or imported. Missing runs (in a fresh clone, all) are
looked up in published tables: first the study's own, then those of other studies, because a run is the same
in every study. These are the tables in the folder and those that come with Pneuma.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal

from pneuma.analysis.frames import StudyData
from pneuma.analysis.published import PublishedTable, read_published
from pneuma.analysis.records import LoggedRecords, Records
from pneuma.errors import UserError
from pneuma.study.store import SCALARS_FILE, Status, Store

Tables = Literal["all", "own", "none"]
"""Which published tables count beside the runs that are here: all, the study's own, or none."""


class RunIndex:
    """What a results folder holds of runs, by their ids.

    With `stored = False` only published tables are used; with `shipped = False` not those that come with
    Pneuma.

    Attributes:
        damaged: messages on tables of other studies that cannot be read.
    """

    def __init__(self, store: Store, stored: bool = True, shipped: bool = True) -> None:
        self.store = store
        self._shipped = shipped
        self.damaged: list[str] = []
        self._stored = stored
        self._own = cache(self._read_own)
        self.table = cache(self._read_table)
        self._others = cache(self._read_others)

    def of_record(self, record: Mapping[str, Any], tables: Tables = "all") -> dict[str, Records]:
        """Return what is held of every run of a selection, by its id; of others that they are planned."""
        found = {run["run_id"]: self._own(run["run_id"]) for run in record["runs"]}
        if tables != "none":
            table = self.table(record["study"]) if _lacking(found) else None
            _fill(found, [table] if table else [])
        if tables == "all" and _lacking(found):
            _fill(found, self._others())
        return found

    def _read_own(self, run_id: str) -> Records:
        status = self.store.status(run_id) if self._stored else Status("planned")
        logged = self._stored and SCALARS_FILE in self.store.checksums(run_id)
        return (LoggedRecords if logged else Records)(self.store, run_id, status)

    def _read_table(self, study: str) -> PublishedTable | None:
        """Return a study's published table, if it has one."""
        path = self.store.published_path(study, self._shipped)
        return read_published(self.store, study) if path.exists() else None

    def _read_others(self) -> list[PublishedTable]:
        """Return all published tables that can be read."""
        tables = []
        for study in self.store.published(self._shipped):
            try:
                tables += [table] if (table := self.table(study)) else []
            except UserError as error:
                self.damaged.append(str(error))
        return tables


def open_study(where: Store | RunIndex, record: Mapping[str, Any], tables: Tables = "all") -> StudyData:
    """Return the finished runs of a selection, from wherever they are.

    Raises:
        UserError: when no run of the selection has finished, or its published table is damaged.
    """
    index = where if isinstance(where, RunIndex) else RunIndex(where)
    return StudyData(index.of_record(record, tables), record, str(index.store.root))


def join_studies(one: StudyData, other: StudyData) -> StudyData:
    """Return the runs of two studies as one study's; their conditions are called CONDITION, STUDY."""
    runs = [
        {**run, "condition": f"{run['condition']}, {data.study}"}
        for data in (one, other)
        for run in data.record["runs"]
    ]
    about: dict[str, Any] = {
        "title": f"{one.title}, and {other.title}",
        "selection": {},
        "same": [],
        "baseline": None,
    }
    record = {key: value for key, value in one.record.items() if key not in ("budget", "every")}
    return StudyData({**one.index, **other.index}, {**record, **about, "runs": runs})


def open_published(results: Path, names: Sequence[str] | None = None) -> list[StudyData]:
    """Return studies by the published tables of a results folder alone; all when none is named."""
    index = RunIndex(Store(results), stored=False, shipped=False)
    tables = [read_published(index.store, name) for name in names or index.store.published(shipped=False)]
    return [open_study(index, table.record) for table in tables]


def _lacking(found: Mapping[str, Records]) -> set[str]:
    return {run_id for run_id, records in found.items() if not records.status.finished}


def _fill(found: dict[str, Records], tables: Sequence[PublishedTable]) -> None:
    """Put in what tables hold of the runs that are lacking."""
    for table in tables:
        found |= {run_id: table.runs[run_id] for run_id in _lacking(found) & table.finished}
