"""How long a study's published runs trained: a small file of its own beside their table.

results/published/STUDY.times.json gives, by run, seconds and what machine they passed on. The same runs
publish the same table whatever the clock said, so the clock has no place in it; and claims on what a
training costs are judged by these seconds, in a clone too. Without the file the times are not known.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from pneuma.analysis.tables import StudyData, told_seconds
from pneuma.study.store import Store, to_json

SCHEMA = 1
_MACHINE = ("system", "cpu", "threads")


def times_path(store: Store, study: str) -> Path:
    """Return where the times of a published study lie."""
    return store.root / "published" / f"{study}.times.json"


def encode_times(data: StudyData) -> bytes:
    """Return seconds and machine of every finished run that tells them."""
    runs: dict[str, dict[str, Any]] = {}
    for run in data.runs:
        about, seconds = data.source.provenance(run), data.source.wall_seconds(run)
        if seconds is not None:
            machine = {key: about[key] for key in _MACHINE if key in about}
            runs[run.run_id] = {"wall_seconds": round(seconds, 3), **machine}
    return to_json({"schema": SCHEMA, "study": data.study, "runs": runs})


def read_times(store: Store, study: str) -> dict[str, float]:
    """Return the seconds of a published study's runs; none where there is no file, or it makes no sense."""
    try:
        told = json.loads(times_path(store, study).read_bytes())["runs"].items()
        seconds = {run_id: told_seconds(about) for run_id, about in told}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}
    return {run_id: found for run_id, found in seconds.items() if found is not None}
