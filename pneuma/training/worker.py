"""A worker process: trains runs one after another and writes them to the store.

    python -m pneuma.training.worker PARENT

It reads one `Job` after another from standard input, each a line of JSON, and prints events as lines of JSON:
`step` at the start and every now and then, `note` for users, `status` for progress displays, `busy` if
another process trains a run, and `end` for every run, after its lock is free. After a line `stop` it stops at
the next checkpoint. After a crash it ends, so that the next run starts in a new process. When standard input
closes it ends: at once if it trains, because then its parent has ended.
"""

from __future__ import annotations

import ctypes
import gc
import json
import os
import queue
import signal
import sys
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from typing import Any, TextIO

from pneuma.config import ENGINES, Run, is_gymnasium_id
from pneuma.engines.loop import Progress, Result, train_run
from pneuma.engines.records import WORLD_COLUMNS, CheckpointError
from pneuma.errors import OwnCodeError, RunWarning, UserError, shortened
from pneuma.files import is_storage_problem, to_json
from pneuma.store.checkpoints import RunCheckpoints, table_files
from pneuma.store.locks import LOCK_FILE
from pneuma.store.provenance import Attempt, finished_provenance, packages_of
from pneuma.store.row_builder import cells_of_files
from pneuma.store.rows import encode_row
from pneuma.store.store import ROW_FILE, Status, Store, run_document, run_identity
from pneuma.study import identity
from pneuma.training.executors.base import Event, Job, end_event
from pneuma.training.live import open_log

REPORT_SECONDS = 0.25


def main() -> int:
    gc.disable()  # until the first update: imports and compilation make many objects, and all stay in use
    die_with(int(sys.argv[1]))
    _ignore_sigterm()
    orders: queue.Queue[str] = queue.Queue()
    stop = threading.Event()
    order_lines = os.fdopen(os.dup(0))
    # an environment's processes must not read orders, and forks close `sys.stdin`, which no thread may hold
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    events = os.fdopen(os.dup(1), "w", buffering=1)
    os.dup2(2, 1)  # what libraries print must not be read as events
    threading.Thread(target=_listen, args=(order_lines, orders, stop), daemon=True).start()
    worker = Worker(events, stop)
    for job_text in iter(orders.get, ""):
        if not worker.train(Job.from_json(job_text)):
            return 1
        orders.task_done()
        gc.collect()  # a learner and its memory of experience may refer to each other
        gc.freeze()
    return 0


class Worker:
    """Trains the runs of jobs, and sends their events."""

    def __init__(self, events: TextIO, stop: threading.Event) -> None:
        self._events, self._stop = events, stop
        self._next_report = 0.0

    def train(self, job: Job) -> bool:
        """Train a job's runs, except those that another process holds; return whether none crashed."""
        self._job, is_sound = job, True
        for run_id, run in job.runs.items():
            last_event = self._last_event(run_id, run)
            self._send(**last_event)
            is_sound = is_sound and last_event.get("status") != "crashed"
        return is_sound

    def _send(self, event: str, run_id: str, **details: Any) -> None:
        self._events.write(json.dumps({"event": event, "run_id": run_id, **details}) + "\n")

    def _last_event(self, run_id: str, run: Run) -> Event:
        """Train a run if it is free and has not finished; return its last event."""
        store = self._job.store
        try:
            with store.lock(run_id) as is_free:
                if not is_free:
                    return {"event": "busy", "run_id": run_id}
                status = store.status(run_id)
                if status.finished:
                    store.remove(store.run_folder(run_id) / LOCK_FILE)
                    return end_event(run_id, status.name, status.step, trained=False)
                if self._stop.is_set():
                    return end_event(run_id, "stopped")
                try:
                    status = self._train(run_id, run)
                    return end_event(run_id, status.name, status.step)
                except Exception as error:
                    if is_storage_problem(error):
                        raise
                    is_final = self._job.last_try or isinstance(error, OwnCodeError)
                    if is_final:
                        store.save_failure(run_id, run, "crashed", traceback.format_exc())
                    return end_event(run_id, "crashed", reason=describe(error), final=is_final)
        except Exception as error:  # it cannot be locked or stored
            if not is_storage_problem(error):
                return end_event(run_id, "crashed", reason=describe(error))
            self._stop.set()  # the disk is full: the next runs cannot be stored, either
            return end_event(run_id, "stopped", reason=describe(error), storage=True)

    def _train(self, run_id: str, run: Run) -> Status:
        """Train a run to its end, from the latest checkpoint that its engine can use; remove the others.

        Raises:
            CheckpointError: when there is no checkpoint left to remove.
        """
        if identity.run_id(run) != run_id:
            raise RuntimeError(
                "Pneuma or the run's own files (level, characters, reward, environment, wrappers) changed"
            )

        def note(message: str) -> None:
            self._send("note", run_id, text=message)

        seconds = self._job.config.checkpoint_seconds
        checkpoints = RunCheckpoints(self._job.store, run_id, seconds, note)
        while True:
            try:
                with _first_warning(note) as warning:
                    return self._train_once(run_id, run, checkpoints, warning)
            except CheckpointError as error:
                if not checkpoints.give_up(error):
                    raise

    def _train_once(
        self, run_id: str, run: Run, checkpoints: RunCheckpoints, warning: Sequence[str]
    ) -> Status:
        executor_config = self._job.config
        checkpoint = checkpoints.latest()
        first_step = checkpoint.step if checkpoint else 0
        pause_step = executor_config.until.get(run_id) or run.trained_steps
        if pause_step <= first_step < run.trained_steps:
            return Status("stopped", first_step)
        self._send("step", run_id, step=first_step)
        beginning = f"resumes at step {first_step:,}" if first_step else "begins"
        self._send("status", run_id, text=beginning)
        attempt = Attempt(first_step, run.device)
        live_log = open_log(executor_config.logs.get(run_id), first_step)

        def update(progress: Progress) -> bool:
            if not gc.isenabled():
                if run.engine == ENGINES[0]:  # the other engine's learners may have a large memory
                    gc.freeze()
                gc.enable()
            attempt.update(progress.step, progress.evaluation_seconds)
            clock = time.monotonic()
            if clock >= self._next_report:
                self._next_report = clock + REPORT_SECONDS
                self._send("step", run_id, step=progress.step)
            is_stopping = self._stop.is_set() or pause_step <= progress.step < run.trained_steps
            live_log.update(progress)
            checkpoints.update(progress, attempt, is_stopping)
            return not is_stopping

        with closing(live_log):
            result = train_run(run, update, checkpoint, self._stop.is_set)
        if result.status != "stopped":
            provenance = finished_provenance([*checkpoints.attempts, attempt.so_far(result.step)])
            if warning:
                provenance["warning"] = warning[0]
            if executor_config.project:
                provenance["project"] = executor_config.project
            provenance["packages"] |= packages_of(run)
            _store_result(self._job.store, run_id, run, result, provenance)
            checkpoints.finish()
        return Status(result.status, result.step)


def _store_result(store: Store, run_id: str, run: Run, result: Result, provenance: Mapping[str, Any]) -> None:
    status = Status(result.status, result.step, identity=run_identity(run))
    files = {"run.json": run_document(run, run_id), "provenance.json": to_json(provenance)}
    without = WORLD_COLUMNS if is_gymnasium_id(run.env) else ()
    for table_name, contents in table_files(result.records, without).items():
        files[f"{table_name}.parquet"] = contents
    if result.policy is not None:
        files[result.policy.file] = result.policy.to_bytes()
    files[ROW_FILE] = encode_row(cells_of_files(run_id, status, files))
    store.save_run(run_id, status, files)


def describe(error: Exception) -> str:
    if isinstance(error, UserError):
        return shortened(str(error))
    if isinstance(error, MemoryError):
        return f"memory ran out ({error or 'MemoryError'})"
    return shortened(f"{type(error).__name__}: {error}")


@contextmanager
def _first_warning(say: Callable[[str], None]) -> Iterator[list[str]]:
    """Print the first `RunWarning` of training, and yield a list with its text; a replay warns again."""
    warning_texts: list[str] = []
    with warnings.catch_warnings():
        show_warning = warnings.showwarning

        def collect(message: Warning | str, category: type[Warning], *location: Any) -> None:
            if not issubclass(category, RunWarning):
                show_warning(message, category, *location)
            elif not warning_texts:
                warning_texts.append(str(message))
                say(warning_texts[0])

        warnings.showwarning = collect  # type: ignore[assignment]
        warnings.simplefilter("always", RunWarning)
        yield warning_texts


def _listen(lines: TextIO, orders: queue.Queue[str], stop: threading.Event) -> None:
    for order in lines:
        if order.strip() == "stop":
            stop.set()
        else:
            orders.put(order)
    if orders.unfinished_tasks:
        os._exit(1)
    orders.put("")


def _ignore_sigterm() -> None:
    """Ignore SIGTERM here, and not in processes that a user's environment starts.

    A shutdown or a queue sends it to all processes, but a worker waits for the order of its parent. Programs
    inherit a mask and an ignored signal, and not a handler; a fork inherits all three. While a process forks,
    the signal waits, so that the fork does not miss one.
    """

    def allow() -> None:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGTERM])

    def allow_and_obey() -> None:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        allow()

    signal.signal(signal.SIGTERM, lambda *_: None)
    os.register_at_fork(
        before=lambda: signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM]),
        after_in_parent=allow,
        after_in_child=allow_and_obey,
    )
    allow()  # the parent has blocked it


def die_with(parent_process: int) -> None:
    """Let the system kill this process when its parent ends, even in a long computation."""
    if sys.platform != "linux":
        return  # there the end of standard input ends it
    parent_death_signal = 1  # PR_SET_PDEATHSIG of prctl(2)
    ctypes.CDLL(None).prctl(parent_death_signal, signal.SIGKILL)
    if os.getppid() != parent_process:
        os._exit(1)  # the parent had already ended


if __name__ == "__main__":
    raise SystemExit(main())
