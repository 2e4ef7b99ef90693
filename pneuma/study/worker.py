"""A worker process: trains one group of runs and writes them to the store.

    python -m pneuma.study.worker < job

The job is one line of JSON. Events go out as lines of JSON: `step` now and then, `end` for every
run. Standard input stays open as a lifeline: when the parent goes, the worker goes.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
import traceback
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TextIO

from pneuma.config import Run, as_settings, make_run
from pneuma.engines.base import (
    EPISODE_COLUMNS,
    EVALUATION_COLUMNS,
    METRIC_COLUMNS,
    Progress,
    Result,
    load_engine,
)
from pneuma.study.identity import run_id
from pneuma.study.provenance import provenance
from pneuma.study.store import Status, Store, to_json
from pneuma.study.tables import to_parquet

REPORT_SECONDS = 0.25
THREADS = 1


def main() -> int:
    """Read the job, train it, report; return the exit code."""
    job = json.loads(sys.stdin.readline())
    threading.Thread(target=_die_with_parent, args=(sys.stdin,), daemon=True).start()
    events = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # whatever a library prints is no event
    runs = [make_run(settings) for settings in job["runs"]]
    return train_group(runs, Store(Path(job["results"])), events)


def train_group(runs: Sequence[Run], store: Store, events: TextIO) -> int:
    """Train runs of equal shapes with their engine; a crash is stored as the end of every one."""
    started, clock = datetime.now(UTC), time.perf_counter()
    reporter = _Reporter(events)
    try:
        results = load_engine(runs[0].engine).train(runs, {}, reporter.update)
    except Exception:
        for run in runs:
            error = traceback.format_exc().encode()
            store.save_run(run_id(run), Status("crashed"), {"run.json": run_file(run), "error.txt": error})
            _send(events, {"event": "end", "run_id": run_id(run), "status": "crashed", "step": 0})
        return 1
    seconds = (time.perf_counter() - clock) / len(results)
    for result in results:
        name = run_id(result.run)
        about = provenance(started, seconds, THREADS)
        store.save_run(name, Status(result.status, result.step), result_files(result, about))
        _send(events, {"event": "end", "run_id": name, "status": result.status, "step": result.step})
    return 0


def run_file(run: Run) -> bytes:
    """Return the contents of run.json."""
    return to_json({"schema": 1, "run_id": run_id(run), "run": as_settings(run)})


def result_files(result: Result, about: Mapping[str, Any]) -> dict[str, bytes]:
    """Return every file of a finished run by name."""
    files = {
        "run.json": run_file(result.run),
        "provenance.json": to_json(about),
        "episodes.parquet": to_parquet(result.records.episodes, EPISODE_COLUMNS),
        "metrics.parquet": to_parquet(result.records.metrics, METRIC_COLUMNS),
        "evaluations.parquet": to_parquet(result.records.evaluations, EVALUATION_COLUMNS),
    }
    if result.policy is not None:
        files["policy.safetensors"] = result.policy.to_bytes()
    return files


class _Reporter:
    """Sends a run's progress, a few times a second at most."""

    def __init__(self, events: TextIO) -> None:
        self._events = events
        self._next = 0.0

    def update(self, progress: Progress) -> bool:
        now = time.monotonic()
        if now >= self._next:
            self._next = now + REPORT_SECONDS
            event = {"event": "step", "run_id": run_id(progress.run), "step": progress.step}
            _send(self._events, event)
        return True


def _send(events: TextIO, event: Mapping[str, Any]) -> None:
    events.write(json.dumps(event) + "\n")


def _die_with_parent(lifeline: TextIO) -> None:
    """Leave at once when the parent's end of the pipe closes."""
    lifeline.read()
    os._exit(1)


if __name__ == "__main__":
    raise SystemExit(main())
