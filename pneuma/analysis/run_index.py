"""Which runs there are, and their rows: in the results folder, in its published tables and in Pneuma's own.

    store → RunIndex: run id → Entry; some entries → rows

Of a run that is in several places, the one in the results folder counts if it has finished.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import cache, cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from pneuma.algorithms import ALGORITHM_ENGINES
from pneuma.config import Run
from pneuma.errors import UserError
from pneuma.files import read_whole
from pneuma.study.identity import config_id
from pneuma.study.measure import UNKNOWN, stored_row
from pneuma.study.published import Published
from pneuma.study.rows import Row
from pneuma.study.spec import list_studies
from pneuma.study.store import FINISHED, Identity, Store


class Entry(NamedTuple):
    """A run that is stored or published.

    Attributes:
        steps: agent steps that it was to train.
        status: of `pneuma.study.store.STATUSES`.
        step: agent steps trained.
        table: the published table that has it; None if it is in the results folder.
    """

    run_id: str
    config_id: str
    seed: int
    steps: int
    status: str
    step: int
    table: Path | None = None

    @property
    def finished(self) -> bool:
        return self.status in FINISHED


class RunIndex:
    """The runs of a results folder and of published tables.

    With `stored = False` only published tables are used; with `shipped = False` not those that come with
    Pneuma.

    Attributes:
        problems: messages on what cannot be read, or contradicts itself.
    """

    def __init__(self, store: Store, stored: bool = True, shipped: bool = True) -> None:
        self.store = store
        self._stored = stored
        self._shipped = shipped
        self.problems: list[str] = []
        self.row = cache(self._read_row)

    @cached_property
    def entries(self) -> Mapping[str, Entry]:
        here = {entry.run_id: entry for entry in self._entries_here()} if self._stored else {}
        published = {
            named[0]: Entry._make((*named, table.path))
            for table in self.tables.values()
            for named in table.index
        }
        finished = {name: entry for name, entry in here.items() if entry.finished}
        return {**here, **published, **finished}

    @cached_property
    def tables(self) -> dict[str, Published]:
        return {
            name: table for path in self.store.published(self._shipped) for name, table in self._open(path)
        }

    @cached_property
    def by_configuration(self) -> Mapping[str, list[Entry]]:
        found: dict[str, list[Entry]] = {}
        for entry in self.entries.values():
            found.setdefault(entry.config_id, []).append(entry)
        return found

    def of_run(self, run: Run) -> list[Entry]:
        """Return the entries of a run's configuration, of any seed and budget."""
        return self.by_configuration.get(config_id(run), [])

    def engine_of(self, run: Run) -> str:
        """Return the engine of a run's configuration, or another by which there are runs of it alone."""
        engines = dict.fromkeys([run.engine, *ALGORITHM_ENGINES[run.algorithm]])
        return next((name for name in engines if self.of_run(replace(run, engine=name))), run.engine)

    def rows(self, entries: Iterable[Entry]) -> dict[str, Row]:
        """Return the rows of finished runs, by id; those that cannot be read are among `problems`."""
        found = {entry.run_id: self.row(entry.run_id) for entry in entries if entry.finished}
        return {name: row for name, row in found.items() if row is not None}

    def listing(self, name: str) -> dict[str, Any] | None:
        """Return the record of a study without a file, from here or from its published table."""
        listing = self.store.listing(name) if self._stored else None
        if listing is None and name in self.tables:
            from pneuma.study.documents import checked_listing

            listing = checked_listing(self.tables[name].about.get("listing"), name)
        return listing

    def listings(self) -> list[str]:
        """Return the names of studies without a file that are recorded here or published."""
        listed = (name for name, table in self.tables.items() if table.about.get("listing"))
        here = self.store.listings() if self._stored else ()
        return sorted({*here, *filter(self.listing, listed)} - {*list_studies()})

    def _entries_here(self) -> Iterator[Entry]:
        for run_id in self.store.runs():
            status = self.store.status(run_id, quick=True)
            if status.identity is None and status.name == "damaged":
                folder = self.store.run_folder(run_id)
                self.problems.append(
                    f"{folder}: its {status.detail} is damaged; run its study again to retrain it"
                )
            about = status.identity or Identity(UNKNOWN, 0, 0)
            yield Entry(run_id, about.config_id, about.seed, about.steps, status.name, status.step)

    def _open(self, path: Path) -> Iterator[tuple[str, Published]]:
        try:
            about = path.stat()
            yield path.stem, _read_table(path, about.st_ino, about.st_mtime_ns, about.st_size)
        except (OSError, ValueError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            self.problems.append(
                f"{path}: cannot be read ({reason}); take it from version control again, or publish it anew"
            )

    def _read_row(self, run_id: str) -> Row | None:
        if table := self.entries[run_id].table:
            return next((row for _, row in self._published(run_id, table)), None)
        try:
            row = stored_row(self.store, run_id)
        except UserError as error:
            self.problems.append(str(error))
            return next((row for _, row in self._published(run_id)), None)
        for path, other in self._published(run_id):
            if not other.same_numbers(row):
                self.problems.append(f"{path}: its run {run_id} has other numbers here; those here are used")
        return row

    def _published(self, run_id: str, alone: Path | None = None) -> Iterator[tuple[Path, Row]]:
        """Yield the rows of a run in published tables, or in one of them."""
        for table in self.tables.values():
            if run_id in table.places and alone in (None, table.path):
                try:
                    yield table.path, table.row(run_id)
                except ValueError as error:
                    self.problems.append(f"{table.path}: {error}")


@lru_cache(maxsize=100)
def _read_table(path: Path, *_version: int) -> Published:
    """Read a published table, once in a process until its file changes; all of Pneuma's take 0.3 s."""
    return Published(path, read_whole(path))
