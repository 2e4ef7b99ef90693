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
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TextIO

from pneuma.config import Run, make_run
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
from pneuma.study.store import Status, Store, run_document, to_json
from pneuma.study.tables import to_parquet

REPORT_SECONDS = 0.25
THREADS = 1


def main() -> int:
    """Read the job, train it, report; return the exit code."""
    job = json.loads(sys.stdin.readline())
    threading.Thread(target=_die_with_parent, args=(sys.stdin,), daemon=True).start()
    events = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # whatever a library prints is no event
    runs = {name: make_run(settings) for name, settings in job["runs"].items()}
    return train_group(runs, Store(Path(job["results"])), events)


def train_group(runs: Mapping[str, Run], store: Store, events: TextIO) -> int:
    """Train runs of equal shapes, given by id, with their engine; store each as it ends.

    A crash is stored as the end of every run that had not ended.
    """
    names = list(runs)
    group = [runs[name] for name in names]
    started, clock = datetime.now(UTC), time.perf_counter()
    reporter = _Reporter(events, dict(zip(group, names, strict=True)))
    waiting = dict(runs)
    try:
        for name, run in runs.items():
            if run_id(run) != name:
                raise RuntimeError("the run's own files (level, characters or reward) changed meanwhile")
        for result in load_engine(group[0].engine).train(group, {}, reporter.update):
            name = reporter.names[result.run]
            about = provenance(started, time.perf_counter() - clock, THREADS)
            store.save_run(name, Status(result.status, result.step), result_files(result, name, about))
            del waiting[name]
            reporter.end(name, result.status, result.step)
    except Exception:
        error = traceback.format_exc().encode()
        for name, run in waiting.items():
            files = {"run.json": run_document(run, name), "error.txt": error}
            store.save_run(name, Status("crashed"), files)
            reporter.end(name, "crashed", 0)
        return 1
    return 0


def result_files(result: Result, name: str, about: Mapping[str, Any]) -> dict[str, bytes]:
    """Return every file of a finished run by name."""
    files = {
        "run.json": run_document(result.run, name),
        "provenance.json": to_json(about),
        "episodes.parquet": to_parquet(result.records.episodes, EPISODE_COLUMNS),
        "metrics.parquet": to_parquet(result.records.metrics, METRIC_COLUMNS),
        "evaluations.parquet": to_parquet(result.records.evaluations, EVALUATION_COLUMNS),
    }
    if result.policy is not None:
        files["policy.safetensors"] = result.policy.to_bytes()
    return files


class _Reporter:
    """Sends events: a run's progress, a few times a second at most, and its end."""

    def __init__(self, events: TextIO, names: Mapping[Run, str]) -> None:
        self.names = names
        self._events = events
        self._next = 0.0

    def update(self, progress: Progress) -> bool:
        now = time.monotonic()
        if now >= self._next:
            self._next = now + REPORT_SECONDS
            self._send(event="step", run_id=self.names[progress.run], step=progress.step)
        return True

    def end(self, name: str, status: str, step: int) -> None:
        self._send(event="end", run_id=name, status=status, step=step)

    def _send(self, **event: Any) -> None:
        self._events.write(json.dumps(event) + "\n")


def _die_with_parent(lifeline: TextIO) -> None:
    """Leave at once when the parent's end of the pipe closes."""
    lifeline.read()
    os._exit(1)


if __name__ == "__main__":
    raise SystemExit(main())
