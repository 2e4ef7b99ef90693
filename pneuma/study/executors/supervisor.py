"""Supervision: workers are kept busy until every run has ended, wherever their processes are.

    groups of runs → `Supervisor` → processes that speak as `pneuma.study.worker` does, one a group → store
                                  ← their events

What crashes is tried once more, what another process trains is waited for, and after Ctrl-C every run comes
to a checkpoint. The local executor starts processes on this machine, that for Ray on the nodes of a cluster.
"""

from __future__ import annotations

import os
import selectors
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from types import FrameType
from typing import IO, Any, Protocol

from pneuma.config import Run, as_fields
from pneuma.errors import UserError
from pneuma.study.executors.base import Event, OnEvent, Supervision, end_event
from pneuma.study.files import parse_json
from pneuma.study.locks import is_held
from pneuma.study.store import Status, Store

TRIES = 2
"""How often a run is begun or gone on with before a crash counts."""
BUSY_SECONDS = 1.0
"""How long to wait before looking again for a run that another process holds."""
STOPPING = "Stopping after this step; again to stop now."
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupts:
    """Collects signals within a `with` block instead of letting them end it; of the main thread alone.

    Args:
        signals: which.
        most: how many of them count.

    Attributes:
        seen: the signals that came; of SIGHUP, which a closed terminal's shell sends again, at most one.
        wakeup: a file descriptor that can be read from once one has come, for a selector.
    """

    def __init__(self, signals: Iterable[int] = SIGNALS, most: int = 2) -> None:
        self.seen: list[int] = []
        self._signals, self._most = signals, most
        self.wakeup, self._writer = os.pipe()
        os.set_blocking(self._writer, False)
        self._before: dict[int, Any] = {}
        self._woken_before = -1

    @property
    def count(self) -> int:
        """How many came."""
        return min(len(self.seen), self._most)

    def __enter__(self) -> Interrupts:
        """Begin to collect.

        The kernel may hand a signal to a thread of a mathematical library, which does not interrupt the main
        thread's wait: the interpreter's own wake-up does.
        """
        if threading.current_thread() is threading.main_thread():
            for number in self._signals:
                if signal.getsignal(number) != signal.SIG_IGN:  # as `nohup` lets SIGHUP be
                    self._before[number] = signal.signal(number, self._note)
            self._woken_before = signal.set_wakeup_fd(self._writer, warn_on_full_buffer=False)
        return self

    def __exit__(self, *_: object) -> None:
        """Give the signals back."""
        if self._before:
            for number, handler in self._before.items():
                signal.signal(number, handler)
            signal.set_wakeup_fd(self._woken_before)
        os.close(self.wakeup)
        os.close(self._writer)

    def _note(self, number: int, frame: FrameType | None) -> None:
        if number != signal.SIGHUP or not self.seen:
            self.seen.append(number)


@dataclass(frozen=True)
class Death:
    """How a worker's process ended: killed or by itself, why, and what it wrote on standard error."""

    killed: bool
    why: str
    last_words: bytes = b""


class Process(Protocol):
    """The process of a worker."""

    @property
    def events(self) -> IO[bytes]:
        """Its lines, in a file that a selector can wait for; it ends when the process does."""

    def ask_to_stop(self) -> None:
        """Let it come to a checkpoint and end."""

    def kill(self) -> None:
        """End it at once."""

    def bury(self) -> Death:
        """Wait until it has gone, let go of its files and return how it ended.

        Raises:
            UserError: where no worker can be started there, which ends the whole command.
        """


@dataclass
class _Task:
    """Runs by id that one worker is to train, the try, and whether another process was training them."""

    group: Mapping[str, Run]
    tries: int = 1
    busy: bool = False


@dataclass
class _Worker:
    """A process with its task, and the runs of it that ended, crashed or were busy."""

    process: Process
    task: _Task
    ended: set[str] = field(default_factory=set)
    crashed: dict[str, Event] = field(default_factory=dict)
    busy: set[str] = field(default_factory=set)


class Supervisor:
    """Keeps workers busy until every group of runs, by id, has ended.

    The first of `interrupts` lets every run come to a checkpoint, the second ends all at once. `start` starts
    a worker's process for a job, the document that `pneuma.study.worker` reads.
    """

    def __init__(
        self,
        groups: Iterable[Mapping[str, Run]],
        store: Store,
        how: Supervision,
        on_event: OnEvent,
        interrupts: Interrupts,
        start: Callable[[Mapping[str, Any]], Process],
    ) -> None:
        self._tasks = [_Task(group) for group in groups]
        self._store, self._how, self._on_event = store, how, on_event
        self._interrupts, self._heeded = interrupts, 0
        self._start = start
        self._selector = selectors.DefaultSelector()
        self._selector.register(interrupts.wakeup, selectors.EVENT_READ, None)

    def work(self) -> None:
        """Work off all tasks; leaving by an exception ends the workers."""
        try:
            while self._tasks or self._workers():
                self._start_what_may()
                waits = self._tasks and len(self._workers()) < self._how.workers
                for key, _ in self._selector.select(BUSY_SECONDS if waits else None):
                    self._read(key.data) if key.data else os.read(self._interrupts.wakeup, 4096)
                self._heed_interrupts()
        finally:
            for worker in self._workers():
                worker.process.kill()
                with suppress(UserError):
                    worker.process.bury()
            self._selector.close()

    def _workers(self) -> list[_Worker]:
        return [key.data for key in self._selector.get_map().values() if key.data is not None]

    def _heed_interrupts(self) -> None:
        """Ask all workers to stop after the first interrupt, and kill them after the second."""
        count = self._interrupts.count
        if count == self._heeded:
            return
        if not self._heeded:
            with suppress(OSError):  # the terminal was closed
                print(STOPPING, file=sys.stderr, flush=True)
        self._heeded = count
        self._tasks.clear()
        for worker in self._workers():
            worker.process.kill() if count > 1 else worker.process.ask_to_stop()

    def _start_what_may(self) -> None:
        for task in [*self._tasks]:
            if len(self._workers()) >= self._how.workers:
                return
            if task.busy and is_held(self._store.run_folder(next(iter(task.group)))):
                continue  # a worker would cost half a second to find that out
            self._tasks.remove(task)
            job = {
                "results": str(self._store.root.resolve()),
                "runs": {name: as_fields(run) for name, run in task.group.items()},
                "checkpoint_seconds": self._how.checkpoint_seconds,
                "keep": self._how.keep_checkpoints,
                "last_try": task.tries == TRIES,
                "logs": {name: folder for name, folder in self._how.logs.items() if name in task.group},
            }
            worker = _Worker(self._start(job), task)
            self._selector.register(worker.process.events, selectors.EVENT_READ, worker)

    def _read(self, worker: _Worker) -> None:
        """Take one event line of a worker, or note that it has gone."""
        line = worker.process.events.readline()
        if not line:
            self._selector.unregister(worker.process.events)
            self._bury(worker)
            return
        try:
            event = parse_json(line)
            name, kind = event["run_id"], event["event"]
            worker.task.group[name]
        except (ValueError, KeyError, TypeError):
            worker.process.kill()  # it has gone astray; reading on finds its end
            return
        if kind == "busy":
            worker.busy.add(name)
            if not worker.task.busy:
                lock = self._store.run_folder(name) / ".lock"
                self._note(name, f"another process trains this run; waiting for it to let go of {lock}")
        elif kind == "end" and event["status"] == "crashed":  # judged when the worker's lock has gone
            worker.crashed[name] = event
        else:
            if kind == "end":
                worker.ended.add(name)
            self._on_event(event)

    def _bury(self, worker: _Worker) -> None:
        """Reap a worker; see to its runs that were busy, crashed, or went with it.

        Raises:
            UserError: when it could not be started where it was to be.
        """
        death = worker.process.bury()
        group, tries = worker.task.group, worker.task.tries
        silent = [name for name in group if name not in {*worker.ended, *worker.busy, *worker.crashed}]
        begun = {*silent[:1], *worker.crashed}  # a group is trained in its order
        if not self._interrupts.count:
            self._tasks += [_Task({name: group[name]}, tries, busy=True) for name in worker.busy]
        for name in (*silent, *worker.crashed):
            crash = worker.crashed.get(name)
            if self._interrupts.count:
                self._on_event(crash or end_event(name, Status("stopped")))
            elif name not in begun:
                self._tasks.append(_Task({name: group[name]}, tries))
            elif tries < TRIES:  # alone: one that crashes takes no other along again
                self._tasks.append(_Task({name: group[name]}, tries + 1))
                why = f"crashed ({crash['reason']})" if crash else death.why
                self._note(name, f"{why}; tried once more")
            elif crash:
                self._on_event(crash)
            else:
                self._end_lost(name, group[name], death)

    def _end_lost(self, name: str, run: Run, death: Death) -> None:
        """Store and report how a run ended whose worker went without a word, unless another trains it now."""
        status = "killed" if death.killed else "crashed"
        try:
            with self._store.lock(name) as mine:
                if mine:
                    words = death.last_words.decode(errors="replace")
                    self._store.save_failure(name, run, status, f"{death.why}\n{words}")
        except (UserError, OSError) as error:
            self._note(name, str(error))
        self._on_event(end_event(name, Status(status)))

    def _note(self, name: str, text: str) -> None:
        self._on_event({"event": "note", "run_id": name, "text": text})
