"""How long a study's published runs trained: a small file of its own beside their table.

results/published/STUDY.times.json gives, by run, seconds, what machine they passed on and how much of a core
it gave. The same runs publish the same table whatever the clock said, so the clock has no place in it; and
claims on what a training costs are judged by these seconds, in a clone too. Without it no time is known.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pneuma.analysis.tables import StudyData, told_seconds
from pneuma.study.origins import other_processors
from pneuma.study.store import Store, read_whole, to_json

SCHEMA = 1
_MACHINE = ("system", "cpu", "threads")


def times_path(store: Store, study: str) -> Path:
    """Return where the times of a published study lie."""
    return store.root / "published" / f"{study}.times.json"


def encode_times(data: StudyData, staying: Mapping[str, Any] | None = None) -> bytes:
    """Return seconds and machine of every finished run that tells them.

    Args:
        data: the study.
        staying: what was published before of runs that stay as they are, by run (`read_times`).
    """
    runs = dict(staying or {})
    for run in data.runs:
        about, seconds = data.source.provenance(run), data.source.wall_seconds(run)
        share = data.source.processor_share(run)
        if seconds is not None:
            machine = {key: about[key] for key in _MACHINE if key in about} | other_processors(about)
            shared = {} if share is None else {"processor_share": share}
            runs[run.run_id] = {"wall_seconds": round(seconds, 3), **shared, **machine}
    selected = {run["run_id"]: runs[run["run_id"]] for run in data.record["runs"] if run["run_id"] in runs}
    return to_json({"schema": SCHEMA, "study": data.study, "runs": selected})


def read_times(store: Store, study: str) -> dict[str, dict[str, Any]]:
    """Return what the file tells of each run whose time makes sense; nothing where there is no such file."""
    try:
        told = json.loads(read_whole(times_path(store, study)))["runs"].items()
        return {run_id: about for run_id, about in told if told_seconds(about) is not None}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}
