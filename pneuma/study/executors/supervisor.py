"""Supervision: workers are kept busy until every run has ended, wherever their processes are.

    groups of runs → `Supervisor` → processes that speak as `pneuma.study.worker` does, one a group → store
                                  ← their events

What crashes is tried once more, what takes too long is stopped, what another process trains is waited for,
and after Ctrl-C every run comes to a checkpoint. The local executor starts processes on this machine, that
for Ray on the nodes of a cluster.
"""

from __future__ import annotations

import math
import selectors
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import IO, Any, Protocol

from pneuma.config import Run, as_fields
from pneuma.errors import UserError
from pneuma.study.compiling import WAITS
from pneuma.study.executors.base import (
    TRIES,
    Event,
    OnEvent,
    Supervision,
    end_event,
    note_event,
    read_event,
    save_end,
)
from pneuma.study.executors.interrupts import Interrupts
from pneuma.study.locks import is_held
from pneuma.study.store import Status, Store

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


@dataclass(frozen=True)
class Death:
    """How a worker's process ended.

    Attributes:
        killed: whether it was killed, and did not end by itself.
        why: in words.
        last_words: what it wrote on standard error.
        refusal: why no worker can be started there, which ends the whole command.
    """

    killed: bool
    why: str
    last_words: bytes = b""
    refusal: UserError | None = None


class Process(Protocol):
    """The process of a worker.

    Attributes:
        waits: how many seconds may go by before it tells anything, and do not count as training.
    """

    waits: float

    @property
    def events(self) -> IO[bytes]:
        """Its lines, in a file that a selector can wait for; it ends when the process does."""

    def ask_to_stop(self) -> None:
        """Let it come to a checkpoint and end."""

    def kill(self) -> None:
        """End it at once."""

    def bury(self) -> Death:
        """Wait until it has gone, let go of its files and return how it ended."""


Start = Callable[[Mapping[str, Any]], Process]
"""Starts a process for a job, the document that `pneuma.study.worker` reads."""


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
    process: Process
    task: _Task
    started: float
    waits: float
    begun: float | None = None
    updated: float | None = None
    slowest_update: float = 0.0
    ended: set[str] = field(default_factory=set)
    crashed: dict[str, Event] = field(default_factory=dict)
    late: dict[str, int] = field(default_factory=dict)
    busy: set[str] = field(default_factory=set)
    asked_to_stop: float | None = None
    timed_out: bool = False

    def note_time(self, event: Event) -> None:
        """Note when its first update came, how long updates take, and whether it waits for something."""
        if event["event"] == "step":
            now = time.monotonic()
            self.begun = self.begun or now
            self.slowest_update = max(self.slowest_update, now - (self.updated or self.started))
            self.updated = now
        elif self.waits:
            self.started = time.monotonic()
        self.waits = WAIT_SECONDS if event.get("text") == WAITS else 0.0

    def deadline(self, seconds: float) -> float:
        """Return when its time is up, counted from its first update."""
        if self.begun is not None:
            return self.begun + seconds
        return self.started + START_SECONDS + seconds + self.waits

    def last_deadline(self) -> float:
        """Return when to stop waiting for a run's checkpoint, which comes between two updates."""
        assert self.asked_to_stop is not None
        return self.asked_to_stop + STOP_UPDATES * self.slowest_update + STOP_SECONDS

    @property
    def final(self) -> bool:
        """Whether a crash is the end of its runs."""
        return self.task.tries >= TRIES

    def ask_to_stop(self) -> None:
        """Ask it, once, to take a checkpoint and end."""
        if self.asked_to_stop is None:
            self.asked_to_stop = time.monotonic()
            self.process.ask_to_stop()


class Supervisor:
    """Keeps workers busy until every group of runs has ended.

    Args:
        groups: of runs, by id.
        store: where workers put them.
        supervision: how many are busy at once, and how long.
        on_event: takes every event.
        interrupts: the first lets every run come to a checkpoint, the second ends all at once.
        start: starts a worker's process.
    """

    def __init__(
        self,
        groups: Iterable[Mapping[str, Run]],
        store: Store,
        supervision: Supervision,
        on_event: OnEvent,
        interrupts: Interrupts,
        start: Start,
    ) -> None:
        self._tasks = deque(_Task(group) for group in groups)
        self._store = store
        self._how = supervision
        self._on_event = on_event
        self._interrupts = interrupts
        self._start_process = start
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
                worker.process.kill()
                worker.process.bury()
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
                worker.ask_to_stop()

    def _start_what_may(self) -> None:
        now = time.monotonic()
        for task in [task for task in self._tasks if task.not_before <= now]:
            if len(self._workers()) >= self._how.workers:
                return
            if task.waits_for_another and is_held(self._store.run_folder(next(iter(task.group)))):
                task.not_before = now + BUSY_SECONDS  # a worker would cost half a second to find that out
                continue
            self._tasks.remove(task)
            process = self._start_process(self._job(task))
            worker = _Worker(process, task, time.monotonic(), process.waits)
            self._selector.register(process.events, selectors.EVENT_READ, worker)

    def _job(self, task: _Task) -> dict[str, Any]:
        return {
            "results": str(self._store.root.resolve()),
            "runs": {name: as_fields(run) for name, run in task.group.items()},
            "checkpoint_seconds": self._how.checkpoint_seconds,
            "keep": self._how.keep_checkpoints,
            "final": task.tries >= TRIES,
        }

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
        first = min(due, default=math.inf)
        return max(0.0, first - now) + 0.01 if first < math.inf else None

    def _end_overdue(self) -> None:
        """Ask runs past their time-out for a checkpoint; kill those that have not come to one in time."""
        if self._how.timeout_seconds is None or self._interrupts.count:
            return
        now = time.monotonic()
        for worker in self._workers():
            if not worker.timed_out and now >= worker.deadline(self._how.timeout_seconds):
                worker.timed_out = True
                worker.ask_to_stop()
            elif worker.timed_out and now >= worker.last_deadline():
                worker.process.kill()

    def _read(self, worker: _Worker) -> None:
        """Take one event line of a worker, or note that it has gone."""
        line = worker.process.events.readline()
        if not line:
            self._selector.unregister(worker.process.events)
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
            self._on_event(note_event(name, "another process trains this run; waiting for it"))

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
        """Reap a worker; see to its runs that were busy, crashed, or went with it.

        Raises:
            UserError: when it could not be started where it was to be.
        """
        death = worker.process.bury()
        if death.refusal:
            raise death.refusal
        lost = [name for name in worker.task.group if name not in worker.ended | worker.busy]
        for name, step in worker.late.items():
            self._end_unsaid(worker, name, Status("timeout", step))
        if not self._interrupts.count:
            self._try_again(worker, worker.busy, worker.task.tries, others=True)
        if worker.final or worker.timed_out or self._interrupts.count:
            for event in worker.crashed.values():
                self._on_event(event)
            for name in lost:
                self._end_lost(worker, name, death)
            return
        tried = {*lost[:1], *worker.crashed}  # a group is trained in its order: the others were not begun
        for name in (*lost, *worker.crashed):
            self._try_again(worker, [name], worker.task.tries + (name in tried))
            if name not in tried:
                continue
            crash = worker.crashed.get(name)
            what = f"crashed ({crash['reason']})" if crash else death.why
            self._on_event(note_event(name, f"{what}; tried once more"))

    def _try_again(self, worker: _Worker, names: Iterable[str], tries: int, others: bool = False) -> None:
        for name in names:  # each alone: one that crashes takes no other along again
            seconds = BUSY_SECONDS if others else 0.0
            self._tasks.append(
                _Task({name: worker.task.group[name]}, tries, time.monotonic() + seconds, others)
            )

    def _end_lost(self, worker: _Worker, name: str, death: Death) -> None:
        """End a run whose worker went without a word of it."""
        if self._interrupts.count:
            return self._on_event(end_event(name, Status("stopped")))
        status = "timeout" if worker.timed_out else "killed" if death.killed else "crashed"
        message = f"{death.why}\n".encode() + death.last_words
        return self._end_unsaid(worker, name, Status(status), message)

    def _end_unsaid(self, worker: _Worker, name: str, status: Status, message: bytes = b"") -> None:
        """Store and tell how a run ended that did not store it itself."""
        save_end(self._store, name, worker.task.group[name], status, message, self._on_event)
        self._on_event(end_event(name, status))
