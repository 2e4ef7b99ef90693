"""All runs of a results folder and of published tables, as one table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import pyarrow as pa

from pneuma.algorithms import find_algorithm
from pneuma.config import Run
from pneuma.errors import UserError
from pneuma.files import stored_file
from pneuma.store.published import Published
from pneuma.store.row_builder import UNKNOWN, stored_row
from pneuma.store.rows import Row, in_one_table
from pneuma.store.store import FINISHED, Identity, Store, checked_listing
from pneuma.store.stored_runs import stored_settings
from pneuma.study.identity import comparable_fields, config_id
from pneuma.study.shipped import list_studies, read_published_file

TABLE_ROWS = 100


class StoredRun(NamedTuple):
    """A row of `RunIndex.frame`; `where` is its published table, or empty if it is stored in the folder."""

    run_id: str
    config_id: str
    seed: int
    steps: int
    status: str
    end: int
    where: str


COLUMNS = list(StoredRun._fields)


class RunIndex:
    """The runs of a results folder and of published tables.

    With `stored = False` only published tables are used; with `shipped = False` not those that come with
    Pneuma.

    Attributes:
        problems: messages about files that cannot be read, and rows that differ from published ones.
    """

    def __init__(self, store: Store, stored: bool = True, shipped: bool = True) -> None:
        self.store = store
        self._stored = stored
        self._shipped = shipped
        self.problems: list[str] = []
        self._rows: dict[str, Row | None] = {}
        self._documents: dict[tuple[str, str], Mapping[str, Any]] = {}
        self._comparable_fields: dict[str, Mapping[str, Any]] = {}

    @cached_property
    def frame(self) -> pd.DataFrame:
        """`COLUMNS` of each run, by its id; a run that finished here replaces a published one."""
        stored_frame = pd.DataFrame(columns=COLUMNS)
        if self._stored:
            stored_frame = pd.DataFrame(self._stored_runs(), columns=COLUMNS)
        frames = [stored_frame]
        if self.tables:
            published_index = pa.concat_tables([table.index for table in self.tables.values()])
            finished_frame = stored_frame[stored_frame["status"].isin(FINISHED)]
            frames += [published_index.to_pandas(use_threads=False), finished_frame]
        run_frame = pd.concat(frames).drop_duplicates("run_id", keep="last")
        return run_frame.set_index("run_id", drop=False).astype({"seed": int, "steps": int, "end": int})

    @cached_property
    def _where(self) -> Mapping[Any, str]:
        return self.frame["where"].to_dict()

    @cached_property
    def tables(self) -> dict[str, Published]:
        tables_by_name = {}
        for table_path in self.store.published(self._shipped):
            try:
                tables_by_name[table_path.stem] = _read_table(table_path)
            except UserError as error:
                self.problems.append(f"{error}; take it from version control again, or publish it again")
        return tables_by_name

    @cached_property
    def _runs_at(self) -> dict[tuple[int, int], list[StoredRun]]:
        runs_at: dict[tuple[int, int], list[StoredRun]] = {}
        for run_values in self.frame.itertuples(index=False, name=None):
            run = StoredRun(*run_values)
            runs_at.setdefault((run.seed, run.steps), []).append(run)
        return runs_at

    def runs_at(self, seed: int, steps: int) -> Sequence[StoredRun]:
        """Return the runs of any configuration with a seed and a budget."""
        return self._runs_at.get((seed, steps), ())

    @cached_property
    def positions(self) -> Mapping[Any, Any]:
        """The positions in the frame of each configuration's runs, of any seed and budget."""
        return self.frame.groupby("config_id").indices

    def engine_of(self, run: Run) -> str:
        """Return the run's engine, or, if it trained no run of the configuration, another one that did."""
        engines = dict.fromkeys([run.engine] + list(find_algorithm(run.algorithm).engines))
        for engine in engines:
            if config_id(replace(run, engine=engine)) in self.positions:
                return engine
        return run.engine

    def listing(self, study_name: str) -> dict[str, Any] | None:
        """Return the record of a study without a file, from here or from its published table."""
        listing = self.store.listing(study_name) if self._stored else None
        if listing is None and study_name in self.tables:
            listing = checked_listing(self.tables[study_name].about.get("listing"), study_name)
        return listing

    def listings(self) -> list[str]:
        """Return the names of studies without a file that are recorded here or published."""
        study_names = set(self.store.listings()) if self._stored else set()
        study_names.update(study_name for study_name in self.tables if self.listing(study_name))
        return sorted(study_names - set(list_studies()))

    def document(self, column: str, run_id: str) -> Mapping[str, Any]:
        """Return the fields or the provenance of a run; empty if they cannot be read."""
        if (column, run_id) not in self._documents:
            self._documents[column, run_id] = self._read_document(column, run_id)
        return self._documents[column, run_id]

    def comparable_fields(self, run: StoredRun) -> Mapping[str, Any]:
        """Return the fields of a run's configuration in comparable form; empty if they cannot be read."""
        if run.config_id not in self._comparable_fields:
            fields = self.document("fields", run.run_id)
            self._comparable_fields[run.config_id] = comparable_fields(fields) if fields else {}
        return self._comparable_fields[run.config_id]

    def _read_document(self, column: str, run_id: str) -> Mapping[str, Any]:
        for table in self.tables.values():
            if run_id in table.row_numbers:
                return table.document(column, run_id)
        if column == "fields":
            return stored_settings(self.store, run_id)
        return self.store.read_document(run_id, "provenance.json")

    def _stored_runs(self) -> list[tuple[Any, ...]]:
        run_rows = []
        for run_id in self.store.runs():
            status = self.store.status(run_id, quick=True)
            if status.identity is None and status.name == "damaged":
                folder = self.store.run_folder(run_id)
                self.problems.append(
                    f"{folder}: its {status.detail} is damaged; run its study again to retrain it"
                )
            identity = status.identity or Identity(UNKNOWN, 0, 0)
            identity_cells = (run_id, identity.config_id, identity.seed, identity.steps)
            run_rows.append(identity_cells + (status.name, status.step, ""))
        return run_rows

    def row(self, run_id: str) -> Row | None:
        """Return the row of a run; None if it cannot be read."""
        if run_id not in self._rows:
            self._rows[run_id] = self._read_row(run_id)
        return self._rows[run_id]

    def rows(self, run_ids: Sequence[str]) -> list[Row | None]:
        """Return the rows of runs, those of the results folder in tables of `TABLE_ROWS`."""
        for first in range(0, len(run_ids), TABLE_ROWS):
            rows = filter(None, map(self.row, run_ids[first : first + TABLE_ROWS]))
            stored_rows = [run_row for run_row in rows if len(run_row.shared_table) == 1]
            if stored_rows:
                self._rows |= {run_row.run_id: run_row for run_row in in_one_table(stored_rows)}
        return [self.row(run_id) for run_id in run_ids]

    def _read_row(self, run_id: str) -> Row | None:
        location, run_row = self._where[run_id], None
        if not location:
            try:
                run_row = stored_row(self.store, run_id)
            except UserError as error:
                self.problems.append(str(error))
        for table in self.tables.values():
            if run_id not in table.row_numbers or location not in ("", str(table.path)):
                continue
            try:
                published_row = table.row(run_id)
            except UserError as error:
                self.problems.append(str(error))
                continue
            if run_row is None:
                return published_row
            if not published_row.same_numbers(run_row):
                self.problems.append(
                    f"{table.path}: its run {run_id} has other numbers here; those here are used"
                )
        return run_row


def _read_table(table_path: Path) -> Published:
    """Read a published table, once in a process until its file changes; all of Pneuma's take 0.3 s."""
    with stored_file(table_path):
        file_stat = table_path.stat()
        return _read_version(table_path, file_stat.st_ino, file_stat.st_mtime_ns, file_stat.st_size)


@lru_cache(maxsize=100)
def _read_version(table_path: Path, *_version: int) -> Published:
    return Published(table_path, read_published_file(table_path))
