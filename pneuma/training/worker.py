"""A worker process: trains one group of runs and writes them to the store.

    python -m pneuma.training.worker [--parent PID] [--last-try]

The first line of its standard input is the `Job`, as JSON. With `--last-try` it stores a crash. Events go out
as lines of JSON: `step` at the start and now and then, `note` for users, `status` for those who watch, `busy`
if another process has a run, `end` for every run. With a parent, standard input stays open: after a line
`stop` the worker goes on to a checkpoint and ends. When it closes, because the parent has ended, it ends at
once.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import os
import signal
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any, TextIO

from pneuma.config import Run, is_gymnasium_id
from pneuma.engines.loop import Progress, Result, train_run
from pneuma.engines.records import WORLD_COLUMNS, CheckpointError
from pneuma.errors import OwnCodeError, RunWarning, StorageError, UserError
from pneuma.files import is_storage_problem, to_json
from pneuma.store.checkpoints import RunCheckpoints, table_files
from pneuma.store.locks import LOCK_FILE
from pneuma.store.provenance import Attempt, finished_provenance, packages_of
from pneuma.store.row_builder import cells_of_files
from pneuma.store.rows import encode_row
from pneuma.store.store import ROW_FILE, Status, Store, run_document, run_identity
from pneuma.study.identity import run_id
from pneuma.training.executors.base import LOCAL_CONFIG, ExecutorConfig, Job
from pneuma.training.live import open_log

REPORT_SECONDS = 0.25


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m pneuma.training.worker")
    parser.add_argument("--parent", type=int)
    parser.add_argument("--last-try", action="store_true")
    options = parser.parse_args()
    gc.disable()  # until the first update: imports and compilation make much, and leave it all in use
    if options.parent:
        die_with(options.parent)
    job, stop = Job.from_json(sys.stdin.readline()), threading.Event()
    if options.parent:
        threading.Thread(target=_listen, args=(sys.stdin, stop), daemon=True).start()
    events = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what libraries print is no event
    return Worker(job.store, Reporter(events), stop, job.config, options.last_try).train(job.runs)


class Reporter:
    """Sends events: a run's progress, at most a few times a second, and its end."""

    def __init__(self, events: TextIO) -> None:
        self._events = events
        self._next = 0.0

    def step(self, name: str, step: int) -> None:
        """Report how far a run is, unless it was reported just before."""
        now = time.monotonic()
        if now >= self._next:
            self._next = now + REPORT_SECONDS
            self.send("step", name, step=step)

    def send(self, event: str, name: str, **about: Any) -> None:
        self._events.write(json.dumps({"event": event, "run_id": name, **about}) + "\n")

    def note(self, name: str, text: str) -> None:
        self.send("note", name, text=text)

    def end(self, name: str, status: Status, trained: bool = True, **about: Any) -> None:
        self.send("end", name, status=status.name, step=status.step, trained=trained, **about)


@dataclass
class Worker:
    """Trains runs of equal shapes, one after another; with `last_try` a crash is final and stored."""

    store: Store
    reporter: Reporter
    stop: threading.Event
    config: ExecutorConfig = LOCAL_CONFIG
    last_try: bool = True

    def train(self, runs: Mapping[str, Run]) -> int:
        """Train runs, without those that another process holds or has finished; return the exit code."""
        code = 0
        with ExitStack() as locks:
            for name, run in self._take_locks(runs, locks).items():
                if self.stop.is_set():
                    self.reporter.end(name, Status("stopped"))
                    continue
                try:
                    self._train(name, run)
                except Exception as error:
                    self._end_failed(name, run, error)
                    code = 1
        return code

    def _take_locks(self, runs: Mapping[str, Run], locks: ExitStack) -> dict[str, Run]:
        """Lock and return the runs that this worker can train, and report the others as busy."""
        locked_runs = {}
        for name, run in runs.items():
            try:
                is_free = locks.enter_context(self.store.lock(name))
            except StorageError as error:
                self._end_stopped(name, error)
                continue
            except UserError as error:
                self.reporter.end(name, Status("crashed"), reason=str(error))
                continue
            if not is_free:
                self.reporter.send("busy", name)
                continue
            status = self.store.status(name)
            if status.finished:
                self.store.remove(self.store.run_folder(name) / LOCK_FILE)
                self.reporter.end(name, status, trained=False)
            else:
                locked_runs[name] = run
        return locked_runs

    def _train(self, name: str, run: Run) -> None:
        """Train a run to its end, discarding checkpoints that its engine cannot use.

        Raises:
            CheckpointError: when there is no checkpoint left to discard.
        """
        if run_id(run) != name:
            raise RuntimeError(
                "Pneuma or the run's own files (level, characters, reward, environment, wrappers) changed"
            )
        say = partial(self.reporter.note, name)
        checkpoints = RunCheckpoints(self.store, name, self.config.checkpoint_seconds, say)
        while True:
            try:
                with _first_warning(say) as warning:
                    return self._train_once(name, run, checkpoints, warning)
            except CheckpointError as error:
                if not checkpoints.give_up(error):
                    raise

    def _train_once(self, name: str, run: Run, checkpoints: RunCheckpoints, warning: Sequence[str]) -> None:
        checkpoint = checkpoints.latest()
        first_step = checkpoint.step if checkpoint else 0
        until = self.config.until.get(name) or run.steps
        if until <= first_step < run.steps:
            self.reporter.end(name, Status("stopped", first_step))
            return
        self.reporter.send("step", name, step=first_step)
        begins = f"resumes at step {first_step:,}" if first_step else "begins"
        self.reporter.send("status", name, text=begins)
        attempt = Attempt(first_step)
        log = open_log(self.config.logs.get(name), first_step)

        def update(progress: Progress) -> bool:
            if not gc.isenabled():
                gc.freeze()
                gc.enable()
            attempt.update(progress.step, progress.evaluation_seconds)
            self.reporter.step(name, progress.step)
            is_stopping = self.stop.is_set() or until <= progress.step < run.steps
            log.update(progress)
            checkpoints.update(progress, attempt, is_stopping)
            return not is_stopping

        with closing(log):
            result = train_run(run, update, checkpoint)
        if result.status != "stopped":
            attempts = [*checkpoints.attempts, attempt.so_far(result.step)]
            self._store_result(name, run, result, self._provenance(run, attempts, warning))
            checkpoints.finish()
        self.reporter.end(name, Status(result.status, result.step))

    def _provenance(self, run: Run, attempts: list[dict[str, Any]], warning: Sequence[str]) -> dict[str, Any]:
        provenance = finished_provenance(attempts)
        if warning:
            provenance["warning"] = warning[0]
        if self.config.project:
            provenance["project"] = self.config.project
        provenance["packages"] |= packages_of(run)
        return provenance

    def _store_result(self, name: str, run: Run, result: Result, provenance: Mapping[str, Any]) -> None:
        status = Status(result.status, result.step, identity=run_identity(run))
        files = {"run.json": run_document(run, name), "provenance.json": to_json(provenance)}
        without = WORLD_COLUMNS if is_gymnasium_id(run.env) else ()
        for table, data in table_files(result.records, without).items():
            files[f"{table}.parquet"] = data
        if result.policy is not None:
            files[result.policy.file] = result.policy.to_bytes()
        files[ROW_FILE] = encode_row(cells_of_files(name, status, files))
        self.store.save_run(name, status, files)

    def _end_failed(self, name: str, run: Run, error: Exception) -> None:
        """Report a crash, and store it if it is final."""
        if is_storage_problem(error):
            return self._end_stopped(name, error)
        reason = describe(error)
        final = self.last_try or isinstance(error, OwnCodeError)
        if final:
            try:
                self.store.save_failure(name, run, "crashed", traceback.format_exc())
            except StorageError as unwritten:
                return self._end_stopped(name, unwritten)
            except UserError as unwritten:
                reason = str(unwritten)
        self.reporter.end(name, Status("crashed"), reason=reason, final=final)

    def _end_stopped(self, name: str, error: Exception) -> None:
        """Stop this run, and those after it, because the disk takes nothing more."""
        self.stop.set()
        self.reporter.end(name, Status("stopped"), reason=describe(error), storage=True)


def describe(error: Exception) -> str:
    if isinstance(error, UserError):
        return str(error)
    if isinstance(error, MemoryError):
        return f"memory ran out ({error or 'MemoryError'})"
    return f"{type(error).__name__}: {error}"


@contextmanager
def _first_warning(say: Callable[[str], None]) -> Iterator[list[str]]:
    """Say what training warns of first, and yield it as a list of one text; evaluations warn of it again."""
    texts: list[str] = []
    with warnings.catch_warnings():
        show = warnings.showwarning

        def collect(message: Warning | str, category: type[Warning], *where: Any) -> None:
            if not issubclass(category, RunWarning):
                show(message, category, *where)
            elif not texts:
                texts.append(str(message))
                say(texts[0])

        warnings.showwarning = collect  # type: ignore[assignment]
        warnings.simplefilter("always", RunWarning)
        yield texts


def _listen(lifeline: TextIO, stop: threading.Event) -> None:
    for line in lifeline:
        if line.strip() == "stop":
            stop.set()
    os._exit(1)


def die_with(parent: int) -> None:
    """Let the system kill this process when its parent ends, even during a long computation."""
    if sys.platform != "linux":
        return  # only the lifeline works there
    parent_death_signal = 1  # PR_SET_PDEATHSIG of prctl(2)
    ctypes.CDLL(None).prctl(parent_death_signal, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)  # the parent had already ended


if __name__ == "__main__":
    raise SystemExit(main())
