"""From a selection to its data: which source holds its runs.

The runs themselves come first. Where none of a selection's is in the results folder, as in a fresh
clone, the study's published table stands in for them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pneuma.analysis.imported_logs import ImportedLogs
from pneuma.analysis.published import published_path, published_studies, read_published
from pneuma.analysis.run_records import RunRecords
from pneuma.analysis.tables import Source, StudyData
from pneuma.study.store import Store

SOURCES: dict[str, Callable[[Store], Source]] = {"runs": RunRecords, "tensorboard": ImportedLogs}
"""What a record's `source` names; one without was made by `pneuma study run`."""


def open_study(store: Store, record: Mapping[str, Any]) -> StudyData:
    """Return the finished runs of a selection, from wherever they are.

    Args:
        store: the results folder.
        record: a selection, as `pneuma.study.execute.selection_record` makes it.

    Raises:
        UserError: when no run of the selection has finished, or a published table is damaged.
    """
    name = record.get("source", "runs")
    if name in SOURCES:
        source = SOURCES[name](store)
        stored = any(source.status(run["run_id"]).finished for run in record["runs"])
        if stored or not published_path(store, record["study"]).exists():
            return StudyData(source, record, str(store.root))
    published = read_published(store, record["study"])
    return StudyData(published, {**record, "budget": published.record["budget"]}, str(store.root))


def open_published(results: Path, names: Sequence[str] | None = None) -> list[StudyData]:
    """Return studies by their published tables in a results folder alone; all when none is named.

    Raises:
        UserError: when one is damaged.
    """
    store = Store(results)
    tables = [read_published(store, name) for name in (names or published_studies(store))]
    return [StudyData(table, table.record, str(results)) for table in tables]
