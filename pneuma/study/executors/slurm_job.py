"""What a job of the queue does on its node: train a group of runs, as `local` does, into the shared results.

submitit pickles a `Training` and calls it there. When the job's time is nearly over, Slurm sends USR2: every
run comes to a checkpoint, and the job goes back to the queue, to go on from there. TERM, with which Slurm
announces that it takes the node away or that somebody cancelled the job, brings runs to a checkpoint too.
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import FrameType
from typing import Any, TextIO

from pneuma.config import Run, make_run
from pneuma.study.executors import local
from pneuma.study.executors.base import Event, Supervision
from pneuma.study.executors.interrupts import Interrupts
from pneuma.study.provenance import machine
from pneuma.study.store import Store

TIME_IS_UP = signal.SIGUSR2
STOPPING = (TIME_IS_UP, signal.SIGTERM)
STEP_SECONDS = 2.0
"""How often a job tells how far it is."""


@dataclass(frozen=True)
class Training:
    """A job: plain data on which runs to train and where, in the form that submitit asks for.

    Attributes:
        work: `results`, `events`, `runs` by id, `checkpoint_seconds`, `timeout_seconds`, `keep_checkpoints`,
            and `gpu`: whether the job has one.
    """

    work: Mapping[str, Any]

    def __call__(self) -> None:
        """Train the runs."""
        train(self.work)

    def checkpoint(self) -> Any:
        """Return what submitit is to put back into the queue: the same, as checkpoints lie in the store."""
        return import_module("submitit").helpers.DelayedSubmission(self)


def train(work: Mapping[str, Any]) -> None:
    """Train the runs of a job; leave by `SystemExit` when it was told to stop.

    Raises:
        RuntimeError: when the job's time was over before any run came to a checkpoint.
    """
    _use_cache_of_this_processor()
    if not work["gpu"]:  # where Slurm does not confine jobs, each sees all GPUs of its node
        os.environ["CUDA_VISIBLE_DEVICES"] = ""
    runs = {name: make_run(settings) for name, settings in work["runs"].items()}
    cores = int(os.environ.get("SLURM_CPUS_PER_TASK", "1"))
    how = Supervision(cores, work["checkpoint_seconds"], work["timeout_seconds"], work["keep_checkpoints"])
    signals = JobSignals()
    with open(work["events"], "a", buffering=1, encoding="utf-8") as file:
        teller = Teller(file)
        try:
            local.run_groups(
                _shared_out(runs, cores), Store(Path(work["results"])), how, teller.tell, signals
            )
        except KeyboardInterrupt:
            _leave(signals, teller.progressed)


def _leave(signals: JobSignals, progressed: bool) -> None:
    """End a job that was told to stop; one whose time was up goes back to the queue."""
    if TIME_IS_UP in signals.seen:
        if not progressed:
            raise RuntimeError("no run came to a checkpoint in the job's time: give it more by --slurm time=")
        signal.raise_signal(TIME_IS_UP)  # submitit's own handler queues the job anew, and leaves
    raise SystemExit(128 + signal.SIGTERM)


class Teller:
    """Writes events for who collects them, steps now and then.

    Attributes:
        progressed: whether any run came on.
    """

    def __init__(self, file: TextIO) -> None:
        self._file = file
        self._next = 0.0
        if file.tell():  # what was written before may end within a line, if that job was killed
            file.write("\n")
        self.progressed = False

    def tell(self, event: Event) -> None:
        """Write an event as a line."""
        if event["event"] == "step":
            self.progressed = True
            if time.monotonic() < self._next:
                return
            self._next = time.monotonic() + STEP_SECONDS
        self._file.write(json.dumps(dict(event)) + "\n")


class JobSignals(Interrupts):
    """Counts what stops a job as one interrupt, and keeps it from the job's workers.

    Slurm signals all processes of a job. The signals are blocked, which workers inherit, and taken by a
    thread: so a worker comes to its checkpoint when the supervisor asks it to, instead of dying.

    Attributes:
        seen: the signals that came.
    """

    def __init__(self) -> None:
        super().__init__()
        self.seen: set[int] = set()
        self._over = False

    def __enter__(self) -> JobSignals:
        """Begin to count."""
        self._take(STOPPING)
        signal.pthread_sigmask(signal.SIG_BLOCK, STOPPING)
        threading.Thread(target=self._listen, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        """Give the signals back."""
        self._over = True
        super().__exit__()
        signal.pthread_sigmask(signal.SIG_UNBLOCK, STOPPING)

    def _listen(self) -> None:
        while not self._over:
            self._note(signal.sigwait(STOPPING), None)

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.seen.add(number)
        if not self.count and not self._over:
            self.count = 1
            with suppress(OSError):
                os.write(self._other_end, b"!")


def _shared_out(runs: Mapping[str, Run], cores: int) -> list[dict[str, Run]]:
    """Share a group out to the job's cores."""
    names = list(runs)
    parts = [names[first::cores] for first in range(min(cores, len(names)))]
    return [{name: runs[name] for name in part} for part in parts]


def _use_cache_of_this_processor() -> None:
    """Keep compiled programs apart by processor: nodes of a cluster differ, and often share a home."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    processor = hashlib.sha256(machine(1)["cpu"].encode()).hexdigest()[:8]
    os.environ["XDG_CACHE_HOME"] = str(cache / "pneuma" / "nodes" / processor)
