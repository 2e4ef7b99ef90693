"""The local executor: one fresh process for each group of runs, a few at a time.

A process of its own can be killed alone and shares no state with its neighbours. It is pinned to
one thread, so that workers do not fight over cores and results do not depend on their number.
"""

from __future__ import annotations

import json
import os
import selectors
import signal
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from pneuma.config import Run, as_settings
from pneuma.errors import UserError
from pneuma.study.compiling import WAITS
from pneuma.study.cores import available_cores
from pneuma.study.executors.base import TRIES, Event, OnEvent, Place, Supervision, read_event
from pneuma.study.executors.interrupts import Interrupts
from pneuma.study.locks import is_held
from pneuma.study.store import Status, Store, run_document

BUSY_SECONDS = 1.0
"""How long to wait before asking again for a run that another process holds."""
START_SECONDS = 300.0
"""How long a worker may take to its first update before its time-out begins all the same: the biggest
networks take about a minute."""
WAIT_SECONDS = 600.0
"""How long it may take besides where it waits for what another compiles."""
STOP_SECONDS = 30.0
"""How long a run past its time-out may take to come to a checkpoint, besides its update."""
STOP_UPDATES = 10.0
"""How many times as long as the slowest update before that one may take; it may be evaluated as well."""
_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def one_thread_environment() -> dict[str, str]:
    """Return environment variables for a child that computes on one thread and imports this code."""
    source = str(Path(__file__).parents[3])  # on the child's path even when Pneuma is not installed
    path = os.pathsep.join(filter(None, [source, os.environ.get("PYTHONPATH", "")]))
    cache = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    own = {
        "NPROC": "1",  # the size of XLA's pool of threads; its flags alone no longer hold that
        "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1 "
        "--xla_gpu_deterministic_ops=true",
        "JAX_DEFAULT_MATMUL_PRECISION": "highest",  # float32 on a GPU too, whose default is less
        "XLA_PYTHON_CLIENT_PREALLOCATE": "false",  # workers share a GPU
        "JAX_COMPILATION_CACHE_DIR": str(Path(cache) / "pneuma" / "jax"),  # compiled once for all workers
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "PYTHONPATH": path,
    }
    return {**os.environ, **dict.fromkeys(_ONE_THREAD, "1"), **own}


def most_workers(place: Place) -> int:
    """Return how many runs may train at once where nobody says it: one a core."""
    return available_cores()


def check(runs: Mapping[str, Run], supervision: Supervision) -> str:
    """Refuse nothing: whatever can be planned can be trained here."""
    return ""


def run_groups(
    groups: Iterable[Mapping[str, Run]],
    store: Store,
    supervision: Supervision,
    on_event: OnEvent,
    interrupts: Interrupts | None = None,
) -> None:
    """Train every group of runs in processes of their own, as the contract says (`base.Executor`).

    The first interrupt lets every run come to a checkpoint, the second ends all at once. They are Ctrl-C,
    unless others are given.

    Raises:
        KeyboardInterrupt: after one, when every worker has gone.
    """
    with interrupts or Interrupts() as counted:
        _Supervisor(groups, store, supervision, on_event, counted).work()
        if counted.count:
            raise KeyboardInterrupt


@dataclass
class _Task:
    """A group of runs that waits to be trained, from some time on.

    Attributes:
        group: the runs, by id.
        tries: how often they have been tried, this time counted.
        not_before: on the monotonic clock.
        waits_for_another: whether it is a single run that another process was training.
    """

    group: Mapping[str, Run]
    tries: int = 1
    not_before: float = 0.0
    waits_for_another: bool = False


@dataclass
class _Worker:
    process: subprocess.Popen[bytes]
    task: _Task
    errors: IO[bytes]
    started: float
    begun: float | None = None
    updated: float | None = None
    slowest_update: float = 0.0
    waits: bool = False
    ended: set[str] = field(default_factory=set)
    crashed: dict[str, Event] = field(default_factory=dict)
    late: dict[str, int] = field(default_factory=dict)
    busy: set[str] = field(default_factory=set)
    asked_to_stop: float | None = None
    timed_out: bool = False

    def note_time(self, event: Event) -> None:
        """Note when its first update came, how long updates take, and whether it waits for a program."""
        if event["event"] == "step":
            now = time.monotonic()
            self.begun = self.begun or now
            self.slowest_update = max(self.slowest_update, now - (self.updated or self.started))
            self.updated = now
        elif self.waits:
            self.started = time.monotonic()
        self.waits = event.get("text") == WAITS

    def deadline(self, seconds: float) -> float:
        """Return when its time is up, counted from its first update."""
        if self.begun is not None:
            return self.begun + seconds
        return self.started + START_SECONDS + seconds + (WAIT_SECONDS if self.waits else 0.0)

    def last_deadline(self) -> float:
        """Return when to stop waiting for a run's checkpoint, which comes between two updates."""
        assert self.asked_to_stop is not None
        return self.asked_to_stop + STOP_UPDATES * self.slowest_update + STOP_SECONDS

    @property
    def final(self) -> bool:
        """Whether a crash is the end of its runs."""
        return self.task.tries >= TRIES

    @property
    def events(self) -> IO[bytes]:
        assert self.process.stdout is not None
        return self.process.stdout


class _Supervisor:
    """Keeps workers busy until every task has ended."""

    def __init__(
        self,
        groups: Iterable[Mapping[str, Run]],
        store: Store,
        supervision: Supervision,
        on_event: OnEvent,
        interrupts: Interrupts,
    ) -> None:
        self._tasks = deque(_Task(group) for group in groups)
        self._store = store
        self._how = supervision
        self._on_event = on_event
        self._interrupts = interrupts
        self._told_busy: set[str] = set()
        self._selector = selectors.DefaultSelector()
        self._selector.register(interrupts.wakeup, selectors.EVENT_READ, None)

    def work(self) -> None:
        """Work off all tasks; leaving by an exception ends the workers."""
        try:
            while self._tasks or self._workers():
                self._start_what_may()
                for key, _ in self._selector.select(self._patience()):
                    self._read(key.data) if key.data else self._interrupts.wake()
                self._end_overdue()
                self._heed_interrupts()
        finally:
            for worker in self._workers():
                _kill(worker)
            self._selector.close()

    def _workers(self) -> list[_Worker]:
        return [key.data for key in self._selector.get_map().values() if key.data is not None]

    def _heed_interrupts(self) -> None:
        if self._interrupts.count:
            self._tasks.clear()
        for worker in self._workers():
            if self._interrupts.count > 1:
                worker.process.kill()
            elif self._interrupts.count:
                _ask_to_stop(worker)

    def _start_what_may(self) -> None:
        now = time.monotonic()
        for task in [task for task in self._tasks if task.not_before <= now]:
            if len(self._workers()) >= self._how.workers:
                return
            if task.waits_for_another and is_held(self._store.run_folder(next(iter(task.group)))):
                task.not_before = now + BUSY_SECONDS  # a worker would cost half a second to find that out
                continue
            self._tasks.remove(task)
            worker = _start(task, self._store, self._how)
            self._selector.register(worker.events, selectors.EVENT_READ, worker)

    def _patience(self) -> float | None:
        """Return how long nothing but an event can be of interest, in seconds."""
        if self._interrupts.count:
            return None
        now = time.monotonic()
        due = []
        for worker in self._workers():
            if worker.timed_out:
                due.append(worker.last_deadline())
            elif self._how.timeout_seconds is not None:
                due.append(worker.deadline(self._how.timeout_seconds))
        if len(self._workers()) < self._how.workers:
            due += [task.not_before for task in self._tasks]
        return max(0.0, min(due) - now) + 0.01 if due else None

    def _end_overdue(self) -> None:
        """Ask runs past their time-out for a checkpoint; kill those that have not come to one in time."""
        if self._how.timeout_seconds is None or self._interrupts.count:
            return
        now = time.monotonic()
        for worker in self._workers():
            if not worker.timed_out and now >= worker.deadline(self._how.timeout_seconds):
                worker.timed_out = True
                _ask_to_stop(worker)
            elif worker.timed_out and now >= worker.last_deadline():
                worker.process.kill()

    def _read(self, worker: _Worker) -> None:
        """Take one event line of a worker, or note that it has gone."""
        line = worker.events.readline()
        if not line:
            self._selector.unregister(worker.events)
            self._bury(worker)
            return
        event = read_event(line)
        if event is None or event["run_id"] not in worker.task.group:
            worker.process.kill()  # it has gone astray; reading on finds its end
        elif event["event"] == "busy":
            self._wait_for_another(worker, event["run_id"])
        elif event["event"] == "end":
            self._end(worker, event)
        else:
            worker.note_time(event)
            self._on_event(event)

    def _wait_for_another(self, worker: _Worker, name: str) -> None:
        """Note that another process holds a run, and say so the first time."""
        worker.busy.add(name)
        if name not in self._told_busy:
            self._told_busy.add(name)
            text = "another process trains this run; waiting for it"
            self._on_event({"event": "note", "run_id": name, "text": text})

    def _end(self, worker: _Worker, event: Event) -> None:
        """Take the end of a run; crashes and time-outs are judged when the worker, and its lock, has gone."""
        name, status = event["run_id"], event["status"]
        worker.ended.add(name)
        if status == "crashed":
            worker.crashed[name] = event
        elif status == "stopped" and worker.timed_out:
            worker.late[name] = event["step"]
        else:
            self._on_event(event)

    def _bury(self, worker: _Worker) -> None:
        """Reap a worker; see to its runs that were busy, crashed, or went with it."""
        code = worker.process.wait()
        _close(worker)
        worker.errors.seek(0)
        last_words = worker.errors.read()
        worker.errors.close()
        lost = [name for name in worker.task.group if name not in worker.ended | worker.busy]
        for name, step in worker.late.items():
            self._save_end(worker, name, Status("timeout", step), b"")
            self._on_event(
                {"event": "end", "run_id": name, "status": "timeout", "step": step, "trained": True}
            )
        if not self._interrupts.count:
            self._try_again(worker, worker.busy, worker.task.tries, others=True)
        if worker.final or worker.timed_out or self._interrupts.count:
            for event in worker.crashed.values():
                self._on_event(event)
            for name in lost:
                self._end_lost(worker, name, code, last_words)
            return
        tried = {*lost[:1], *worker.crashed}  # a group is trained in its order: the others were not begun
        for name in (*lost, *worker.crashed):
            self._try_again(worker, [name], worker.task.tries + (name in tried))
            if name not in tried:
                continue
            crash = worker.crashed.get(name)
            what = f"crashed ({crash['reason']})" if crash else f"the worker process {_reason(code)}"
            self._on_event({"event": "note", "run_id": name, "text": f"{what}; tried once more"})

    def _try_again(self, worker: _Worker, names: Iterable[str], tries: int, others: bool = False) -> None:
        for name in names:  # each alone: one that crashes takes no other along again
            seconds = BUSY_SECONDS if others else 0.0
            self._tasks.append(
                _Task({name: worker.task.group[name]}, tries, time.monotonic() + seconds, others)
            )

    def _end_lost(self, worker: _Worker, name: str, code: int, last_words: bytes) -> None:
        """End a run whose worker went without a word of it."""
        if self._interrupts.count:
            status = "stopped"
        else:
            status = "timeout" if worker.timed_out else "killed" if code < 0 else "crashed"
            message = f"the worker process {_reason(code)}\n".encode() + last_words
            self._save_end(worker, name, Status(status), message)
        self._on_event({"event": "end", "run_id": name, "status": status, "step": 0, "trained": True})

    def _save_end(self, worker: _Worker, name: str, status: Status, message: bytes) -> None:
        """Store how a run ended, unless another process has taken it over by now."""
        files = {"run.json": run_document(worker.task.group[name], name)}
        try:
            with self._store.lock(name) as mine:
                if mine:
                    self._store.save_run(name, status, {**files, "error.txt": message} if message else files)
        except (UserError, OSError) as error:
            self._on_event({"event": "note", "run_id": name, "text": str(error)})


def _start(task: _Task, store: Store, how: Supervision) -> _Worker:
    errors = tempfile.TemporaryFile()  # noqa: SIM115 (closed when the worker is buried)
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "pneuma.study.worker"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=errors,
        env=one_thread_environment(),
        start_new_session=True,  # Ctrl-C reaches the parent alone
        bufsize=0,
    )
    job = {
        "results": str(store.root.resolve()),
        "runs": {name: as_settings(run) for name, run in task.group.items()},
        "checkpoint_seconds": how.checkpoint_seconds,
        "keep": how.keep_checkpoints,
        "final": task.tries >= TRIES,
        "parent": os.getpid(),
    }
    assert process.stdin is not None
    with suppress(BrokenPipeError):  # it is gone already: reading from it will tell
        process.stdin.write(json.dumps(job).encode() + b"\n")
    return _Worker(process, task, errors, time.monotonic())


def _ask_to_stop(worker: _Worker) -> None:
    """Ask a worker, once, to take a checkpoint and end."""
    if worker.asked_to_stop is None:
        worker.asked_to_stop = time.monotonic()
        assert worker.process.stdin is not None
        with suppress(BrokenPipeError):
            worker.process.stdin.write(b"stop\n")


def _reason(code: int) -> str:
    if code >= 0:
        return f"ended with code {code}"
    name = signal.Signals(-code).name
    hint = " (by hand, or by the system when memory ran out)" if name == "SIGKILL" else ""
    return f"was killed by {name}{hint}"


def _kill(worker: _Worker) -> None:
    worker.process.kill()
    worker.process.wait()
    _close(worker)
    worker.errors.close()


def _close(worker: _Worker) -> None:
    for pipe in (worker.process.stdin, worker.process.stdout):
        if pipe is not None:
            pipe.close()
