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
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from pneuma.config import Run, as_settings
from pneuma.study.store import Status, Store, run_document

Event = Mapping[str, Any]
OnEvent = Callable[[Event], None]

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def available_cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def one_thread_environment() -> dict[str, str]:
    """Return environment variables for a child that computes on one thread and imports this code."""
    source = str(Path(__file__).parents[3])  # on the child's path even when Pneuma is not installed
    path = os.pathsep.join(filter(None, [source, os.environ.get("PYTHONPATH", "")]))
    return {**os.environ, **dict.fromkeys(_ONE_THREAD, "1"), "PYTHONPATH": path}


def run_groups(groups: Iterable[Mapping[str, Run]], store: Store, workers: int, on_event: OnEvent) -> None:
    """Train every group of runs by id, `workers` at a time; hand every event of theirs to `on_event`.

    Events are `{"event": "step" | "end", "run_id", "step", …}`; an end has a `status`. Leaving by
    an exception (Ctrl-C among them) ends the workers.
    """
    waiting = list(groups)[::-1]
    selector = selectors.DefaultSelector()
    try:
        while waiting or selector.get_map():
            while waiting and len(selector.get_map()) < workers:
                worker = _start(waiting.pop(), store)
                selector.register(worker.events, selectors.EVENT_READ, worker)
            for key, _ in selector.select():
                _read(key.data, selector, store, on_event)
    finally:
        for key in list(selector.get_map().values()):
            _kill(key.data)
        selector.close()


@dataclass
class _Worker:
    process: subprocess.Popen[bytes]
    group: Mapping[str, Run]
    errors: IO[bytes]
    ended: set[str]

    @property
    def events(self) -> IO[bytes]:
        assert self.process.stdout is not None
        return self.process.stdout


def _start(group: Mapping[str, Run], store: Store) -> _Worker:
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
        "runs": {name: as_settings(run) for name, run in group.items()},
    }
    assert process.stdin is not None
    with suppress(BrokenPipeError):  # it is gone already: reading from it will tell
        process.stdin.write(json.dumps(job).encode() + b"\n")
    return _Worker(process, group, errors, set())


def _read(worker: _Worker, selector: selectors.BaseSelector, store: Store, on_event: OnEvent) -> None:
    """Take one event line of a worker, or note that it has gone."""
    line = worker.events.readline()
    if not line:
        selector.unregister(worker.events)
        _bury(worker, store, on_event)
        return
    try:
        event = json.loads(line)
    except ValueError:
        worker.process.kill()  # it has gone astray; reading on finds its end
        return
    if event["event"] == "end":
        worker.ended.add(event["run_id"])
    on_event(event)


def _bury(worker: _Worker, store: Store, on_event: OnEvent) -> None:
    """Reap a worker; runs that it did not report on have crashed with it."""
    code = worker.process.wait()
    _close(worker)
    worker.errors.seek(0)
    last_words = worker.errors.read()
    worker.errors.close()
    status = "killed" if code < 0 else "crashed"
    for name, run in worker.group.items():
        if name in worker.ended:
            continue
        message = f"the worker process {_reason(code)}\n".encode() + last_words
        files = {"run.json": run_document(run, name), "error.txt": message}
        store.save_run(name, Status(status), files)
        on_event({"event": "end", "run_id": name, "status": status, "step": 0})


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
