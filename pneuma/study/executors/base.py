"""The interface of executors, which train groups of runs somewhere and store the results in one store.

study's plan → groups of runs → executor → store

Executors are modules, named in `EXECUTORS` and imported only when needed, as each has its own requirements.
All of them guarantee:

- A run leaves the same files in the store as with `local`, except for its provenance. While it trains, its
  newest checkpoint is there. Files are written whole or not at all.
- The process that trains a run holds its lock in the store. Runs that other processes hold are reported and
  left to them.
- Every run of the groups ends with one `end` event, unless Ctrl-C came.
- A run that crashes, or loses its process or node, is tried once more before it counts as failed, unless a
  user's own code has raised. Slurm requeues jobs whose node is lost.
- After the first Ctrl-C every run goes on to a checkpoint; after the second all stop at once. The same
  command resumes, with this executor or another, and ends with the same bits. If jobs outlive the command, as
  in Slurm's queue, it raises `Detached`.
- Nothing pickled is ever written to the results folder.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any, NamedTuple, Protocol, cast

from pneuma.config import Run
from pneuma.study.store import Status, Store

Event = Mapping[str, Any]
OnEvent = Callable[[Event], None]

LOCAL, RAY, SLURM = "local", "ray", "slurm"
EXECUTORS = {name: f"pneuma.study.executors.{name}" for name in (LOCAL, RAY, SLURM)}
"""The module of every executor."""


@dataclass(frozen=True)
class ExecutorConfig:
    """Where and how runs are trained.

    Attributes:
        workers: how many train at once.
        checkpoint_seconds: between two checkpoints of a run.
        keep_checkpoints: how many of each run to keep for forks.
        logs: folders of TensorBoard logs, by run.
        until: steps at which runs pause, by run: they go on to a checkpoint there; 0 is the end.
        executor: one of `EXECUTORS`.
        address: of a Ray cluster's head, HOST:PORT; None for one of this machine's own.
        slurm: options of sbatch for each job, as pairs of a name and a value.
        detach: whether to leave once jobs are submitted.
    """

    workers: int = 1
    checkpoint_seconds: float = 15.0
    keep_checkpoints: int = 0
    logs: Mapping[str, str] = field(default_factory=dict)
    until: Mapping[str, int] = field(default_factory=dict)
    executor: str = LOCAL
    address: str | None = None
    slurm: tuple[tuple[str, str], ...] = ()
    detach: bool = False


LOCAL_CONFIG = ExecutorConfig()
AGAIN = "the same command submits it again"
"""What is to be done for a run whose job has gone."""


class Detached(KeyboardInterrupt):
    """The command ends while runs go on without it; the message says how to find them.

    Attributes:
        asked: whether the command was left by --detach and not by Ctrl-C.
    """

    def __init__(self, message: str, asked: bool = False) -> None:
        super().__init__(message)
        self.asked = asked


class Executor(Protocol):
    """The functions of an executor's module."""

    def most_workers(self, how: ExecutorConfig) -> int:
        """Return how many runs train at once unless the user says otherwise.

        It fails within ten seconds if the place cannot be reached or cannot train.
        """

    def run_groups(
        self, groups: Iterable[Mapping[str, Run]], store: Store, how: ExecutorConfig, on_event: OnEvent
    ) -> None:
        """Train all groups of runs and pass their events to `on_event`.

        Events are `{"event": "step" | "note" | "status" | "end", "run_id", …}`: a step has a `step`, a
        note and a status a `text`, an end a `status`, a `step` and `trained`, whether it was trained
        here; one that could not be stored a `reason`.

        Raises:
            KeyboardInterrupt: after Ctrl-C, when all workers have ended; `Detached` if they go on.
        """


class Job(NamedTuple):
    """A job that trains runs on another machine.

    Attributes:
        where: its node, or why it has none.
        until: the step at which it pauses a run; 0 is the end.
    """

    state: str
    id: str = ""
    where: str = ""
    until: int = 0

    def __str__(self) -> str:
        return " ".join(filter(None, ("job", self.id, "is", self.state.lower(), self.where)))


def watch(
    left: set[str],
    store: Store,
    on_event: OnEvent,
    live: Callable[[], Mapping[str, Job]],
    seconds: float,
    lost: str,
    until: Mapping[str, int],
) -> None:
    """Report events of runs in jobs until all runs have ended; ended ones are removed from `left`.

    `live` returns the remaining jobs, by the ids of their runs, and is asked every `seconds`. `lost` is
    the reason for a run whose job has ended without results; `until` has the steps at which runs pause.
    """
    jobs: Mapping[str, Job] = dict.fromkeys(left, Job("SUBMITTED"))
    last = {**jobs}
    while left:
        before, jobs = jobs, live()
        last |= jobs
        for name in sorted(left):
            status, job = store.status(name), jobs.get(name, before.get(name))
            if status.finished or job is None:
                left.discard(name)
                ended = status.finished or status.failed or status.name == "killed"
                reason = ""
                if not ended and not 0 < until.get(name, 0) <= status.step:
                    if 0 < last[name].until <= status.step:
                        reason = f"another command's job paused it at step {status.step:,}; {AGAIN}"
                    else:
                        status, reason = Status("killed", status.step), lost
                on_event({**end_event(name, status), "reason": reason})
            elif status.step:
                on_event({"event": "step", "run_id": name, "step": status.step})
            elif job != before.get(name):
                on_event({"event": "status", "run_id": name, "text": str(job)})
        time.sleep(seconds if left else 0)


def end_event(name: str, status: Status) -> Event:
    return {"event": "end", "run_id": name, "status": status.name, "step": status.step, "trained": True}


def load_executor(how: ExecutorConfig) -> Executor:
    return cast(Executor, import_module(EXECUTORS[how.executor]))
