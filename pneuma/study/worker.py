"""A worker process: trains one group of runs and writes them to the store.

    python -m pneuma.study.worker < job

The job is one line of JSON: the results folder, the runs by id, how often to take checkpoints. Events
go out as lines of JSON: `step` now and then, `note` for people, `passing` for those who watch, `busy`
where another process holds a run, `end` for every run. Standard input stays open: a line `stop` asks for a
checkpoint and an end, and when it closes, because the parent has gone, the worker goes.
"""

from __future__ import annotations

import ctypes
import json
import os
import signal
import sys
import threading
import time
import traceback
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TextIO

from pneuma.config import Run, make_run
from pneuma.engines.base import Progress, Result, load_engine
from pneuma.engines.checkpoint import CheckpointError
from pneuma.engines.team import policy_files
from pneuma.errors import UserError
from pneuma.study.checkpoints import table_files
from pneuma.study.compiling import FirstCompile, programs_folder
from pneuma.study.identity import run_id
from pneuma.study.provenance import Attempt, finished_provenance
from pneuma.study.resume import Resume
from pneuma.study.store import Status, Store, run_document, to_json

REPORT_SECONDS = 0.25
THREADS = 1


@dataclass(frozen=True)
class Job:
    """What a worker is to do.

    Attributes:
        store: the results folder.
        runs: by id; of equal shapes, so that they share compiled programs.
        checkpoint_seconds: time between two checkpoints of a run.
        keep: how many checkpoints of each run to keep when it has ended.
        final: whether a crash is the runs' end, and not to be tried once more.
    """

    store: Store
    runs: Mapping[str, Run]
    checkpoint_seconds: float = 15.0
    keep: int = 0
    final: bool = True


def main() -> int:
    """Read the job, train it, report; return the exit code."""
    job = json.loads(sys.stdin.readline())
    die_with(job["parent"])
    stop = threading.Event()
    threading.Thread(target=_listen, args=(sys.stdin, stop), daemon=True).start()
    events = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # whatever a library prints is no event
    runs = {name: make_run(settings) for name, settings in job["runs"].items()}
    store = Store(Path(job["results"]))
    what = Job(store, runs, job["checkpoint_seconds"], job["keep"], job["final"])
    return train_group(what, Reporter(events), stop)


class Reporter:
    """Sends events: a run's progress, a few times a second at most, and its end."""

    def __init__(self, events: TextIO) -> None:
        self._events = events
        self._next = 0.0

    def step(self, name: str, step: int) -> None:
        """Tell how far a run is, unless that was told just now."""
        now = time.monotonic()
        if now >= self._next:
            self._next = now + REPORT_SECONDS
            self.send("step", name, step=step)

    def send(self, event: str, name: str, **about: Any) -> None:
        """Send one event of a run."""
        self._events.write(json.dumps({"event": event, "run_id": name, **about}) + "\n")


def train_group(job: Job, reporter: Reporter, stop: threading.Event) -> int:
    """Train runs with their engine, whose compiled programs they share; store each as it ends.

    Runs that another process holds or has finished meanwhile are left out.
    """
    with ExitStack() as locks:
        mine = {}
        for name, run in job.runs.items():
            try:
                free = locks.enter_context(job.store.lock(name))
            except OSError as error:
                reason = f"{job.store.run_folder(name)}: cannot be written ({error.strerror})"
                reporter.send("end", name, status="crashed", step=0, trained=True, reason=reason)
                continue
            if not free:
                reporter.send("busy", name)
            elif (status := job.store.status(name)).finished:
                reporter.send("end", name, status=status.name, step=status.step, trained=False)
            else:
                mine[name] = run
        return _train_all(job, mine, reporter, stop)


def _train_all(job: Job, runs: Mapping[str, Run], reporter: Reporter, stop: threading.Event) -> int:
    """Train runs one after another, so that each is timed, stored and crashes alone; return the exit code."""
    code = 0
    for name, run in runs.items():
        if stop.is_set():
            reporter.send("end", name, status="stopped", step=0, trained=True)
            continue
        try:
            _train(job, name, run, reporter, stop)
        except Exception as error:
            _end_crashed(job, name, run, reporter, error)
            code = 1
    return code


def _train(job: Job, name: str, run: Run, reporter: Reporter, stop: threading.Event) -> None:
    """Train a run to its end, giving up checkpoints that its engine cannot go on from.

    Raises:
        CheckpointError: when there is none left to give up.
    """
    if run_id(run) != name:
        raise RuntimeError("the run's own files (level, characters or reward) changed meanwhile")
    resume = Resume(job.store, name, run, job.checkpoint_seconds, job.keep, reporter.send)
    resume.sweep()
    job.store.write(job.store.run_folder(name) / "run.json", run_document(run, name))  # or fail now
    while True:
        try:
            return _train_once(job.store, name, run, resume, reporter, stop)
        except CheckpointError as error:
            if not resume.give_up(error):
                raise


def _train_once(
    store: Store, name: str, run: Run, resume: Resume, reporter: Reporter, stop: threading.Event
) -> None:
    """Train a run, from its latest checkpoint where there is one, and store how it ended."""
    engine = load_engine(run.engine)  # first, because a checkpoint's device is compared with its own
    start = resume.latest()
    attempt = Attempt(datetime.now(UTC), time.perf_counter(), THREADS, start.step if start else 0)

    def tell(text: str) -> None:
        reporter.send("passing", name, text=text)

    def update(progress: Progress) -> bool:
        nonlocal attempt
        compiling.done()
        attempt = attempt.updated(progress.step)
        reporter.step(name, progress.step)
        stopping = stop.is_set()
        resume.update(progress, attempt, stopping)
        return not stopping

    with FirstCompile(run, programs_folder(), tell, stop) as compiling:
        (result,) = engine.train([run], {0: start} if start else {}, update)
    if result.status != "stopped":
        about = finished_provenance(attempt, resume.history, result.step)
        store.save_run(name, Status(result.status, result.step), result_files(result, name, about))
        resume.finish()
    reporter.send("end", name, status=result.status, step=result.step, trained=True)


def _end_crashed(job: Job, name: str, run: Run, reporter: Reporter, error: Exception) -> None:
    """Tell of a run's crash, and store it if it is final and can be stored."""
    trace = traceback.format_exc().encode()
    reason = str(error) if isinstance(error, UserError) else f"{type(error).__name__}: {error}"
    try:
        if job.final:
            files = {"run.json": run_document(run, name), "error.txt": trace}
            job.store.save_run(name, Status("crashed"), files)
    except UserError as unwritten:
        reason = str(unwritten)
    reporter.send("end", name, status="crashed", step=0, trained=True, reason=reason)


def result_files(result: Result, name: str, about: Mapping[str, Any]) -> dict[str, bytes]:
    """Return every file of a finished run by name."""
    files = {"run.json": run_document(result.run, name), "provenance.json": to_json(about)}
    files |= {f"{table}.parquet": data for table, data in table_files(result.records).items()}
    if result.policy is not None:
        files |= policy_files(result.policy)
    return files


def _listen(lifeline: TextIO, stop: threading.Event) -> None:
    """Heed what the parent says; leave at once when its end of the pipe closes."""
    for line in lifeline:
        if line.strip() == "stop":
            stop.set()
    os._exit(1)


def die_with(parent: int) -> None:
    """Let the system kill this process when its parent goes, even while one long computation runs."""
    if sys.platform != "linux":
        return  # the lifeline must do
    parent_death_signal = 1  # PR_SET_PDEATHSIG of prctl(2)
    ctypes.CDLL(None).prctl(parent_death_signal, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)  # it went before


if __name__ == "__main__":
    raise SystemExit(main())
