"""From a selection to its data: which source holds its runs.

The runs themselves come first. For those of a selection that are not in the results folder, all of them
in a fresh clone, the study's published table stands in.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

from pneuma.analysis.imported_logs import ImportedLogs
from pneuma.analysis.partly_published import PartlyPublished
from pneuma.analysis.published import PublishedRuns, published_path, published_studies, read_published
from pneuma.analysis.run_records import RunRecords
from pneuma.analysis.tables import Source, StudyData
from pneuma.study.store import Store

SOURCES: dict[str, Callable[[Store], Source]] = {"runs": RunRecords, "tensorboard": ImportedLogs}
"""What a record's `source` names; one without was made by `pneuma study run`."""


def open_study(store: Store, record: Mapping[str, Any], *, mixed: bool = True) -> StudyData:
    """Return the finished runs of a selection, from wherever they are.

    Args:
        store: the results folder.
        record: a selection, as `pneuma.study.execute.selection_record` makes it.
        mixed: whether published runs may stand beside those that are here; of all there is then what
            published tables keep.

    Raises:
        UserError: when no run of the selection has finished, or a published table is damaged.
    """
    name = record.get("source", "runs")
    if name in SOURCES:
        source = SOURCES[name](store)
        stored = any(source.status(run["run_id"]).finished for run in record["runs"])
        if stored or not published_path(store, record["study"]).exists():
            data = StudyData(source, record, str(store.root))
            return _completed(store, data) if mixed else data
    published = read_published(store, record["study"])
    return StudyData(published, {**record, "budget": published.record["budget"]}, str(store.root))


def beside(
    store: Store, record: Mapping[str, Any], here: Collection[str]
) -> tuple[PublishedRuns, list[str]] | None:
    """Return a study's published table with those of a selection's runs that it can add to others.

    None where there is no such run, or where its curves end before those others do.

    Args:
        store: the results folder.
        record: the selection.
        here: the ids of its runs that are finished without the table.

    Raises:
        UserError: when the table is damaged.
    """
    steps = {run["run_id"]: run["run"]["steps"] for run in record["runs"]}
    whole = {*steps} <= {*here}
    if whole or record.get("source", "runs") != "runs" or not published_path(store, record["study"]).exists():
        return None
    published = read_published(store, record["study"])
    added = [run_id for run_id in steps if run_id not in here and run_id in published.finished]
    budget = max((steps[run_id] for run_id in here), default=0)
    return (published, added) if added and published.head["budget"] >= budget else None


def open_published(results: Path, names: Sequence[str] | None = None) -> list[StudyData]:
    """Return studies by their published tables in a results folder alone; all when none is named.

    Raises:
        UserError: when one is damaged.
    """
    store = Store(results)
    tables = [read_published(store, name) for name in (names or published_studies(store))]
    return [StudyData(table, table.record, str(results)) for table in tables]


def _completed(store: Store, data: StudyData) -> StudyData:
    """Return a study with those runs of its published table that are not here, if any can be added."""
    found = beside(store, data.record, {run.run_id for run in data.runs})
    if found is None:
        return data
    published, run_ids = found
    record, where = {**data.record, "budget": published.head["budget"]}, str(store.root)
    source = PartlyPublished(StudyData(data.source, record, where), published, run_ids)
    return StudyData(source, record, where)
