"""The interface of executors, which train groups of runs somewhere and store the results in one store.

study's plan → groups of runs → a job, a file of JSON → executor → workers, each of a group → store

    {"results": "…", "how": {…}, "groups": [{"RUN_ID": {FIELDS}, …}, …]}

Executors are modules, named in `EXECUTORS` and imported only when needed, as each has its own requirements:

    most_workers(how)    how many runs train at once unless the user says otherwise; it fails within
                         ten seconds if the place cannot be reached or cannot train
    run_groups(groups, store, how, on_event)
                         trains all groups of runs and passes on their events: {"event": "step" | "note" |
                         "status" | "end", "run_id", …}; a step has a `step`, a note and a status a `text`, an
                         end a `status`, a `step` and `trained`; one that could not be stored a `reason`

All of them guarantee:

- A run leaves the same files in the store as with `local`, except for its provenance. While it trains, its
  newest checkpoint is there. Files are written whole or not at all.
- The process that trains a run holds its lock in the store. Runs that other processes hold are reported and
  left to them.
- Every run of the groups ends with one `end` event, unless Ctrl-C came.
- A run that crashes, or loses its process or node, is tried once more before it counts as failed, unless a
  user's own code has raised. Slurm requeues jobs whose node is lost.
- After the first Ctrl-C every run goes on to a checkpoint; after the second all stop at once. When all have
  ended it raises KeyboardInterrupt; if jobs outlive the command, as in Slurm's queue, `Detached`. The same
  command resumes, with this executor or another, and ends with the same bits.
- Nothing pickled is ever written to the results folder.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from pneuma.config import Run, as_fields, make_run
from pneuma.files import create_whole
from pneuma.study.store import Status, Store

Event = Mapping[str, Any]
OnEvent = Callable[[Event], None]

LOCAL, RAY, SLURM = "local", "ray", "slurm"
EXECUTORS = {name: f"pneuma.study.executors.{name}" for name in (LOCAL, RAY, SLURM)}


@dataclass(frozen=True)
class ExecutorConfig:
    """Where and how runs are trained.

    Attributes:
        workers: how many train at once.
        checkpoint_seconds: between two checkpoints of a run.
        keep_checkpoints: how many of each run to keep for forks.
        logs: folders of TensorBoard logs, by run.
        project: the user's study, for the provenance of runs.
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
    project: Mapping[str, str] = field(default_factory=dict)
    executor: str = LOCAL
    address: str | None = None
    slurm: tuple[tuple[str, str], ...] = ()
    detach: bool = False


LOCAL_CONFIG = ExecutorConfig()


@dataclass(frozen=True)
class Job:
    """A job as it is read; `groups` have the fields of runs, by their ids."""

    path: Path
    store: Store
    how: ExecutorConfig
    groups: Sequence[Mapping[str, Mapping[str, Any]]]

    def runs(self, index: int) -> dict[str, Run]:
        """Return the runs of a group, by id."""
        return {name: make_run(fields) for name, fields in self.groups[index].items()}


def write_job(path: Path, groups: Sequence[Mapping[str, Run]], store: Store, how: ExecutorConfig) -> Job:
    fields = [{name: as_fields(run) for name, run in group.items()} for group in groups]
    document = {"results": str(store.root.resolve()), "how": asdict(how), "groups": fields}
    path.parent.mkdir(parents=True, exist_ok=True)
    create_whole(path, json.dumps(document).encode())
    return Job(path, store, how, fields)


def read_job(path: Path) -> Job:
    document = json.loads(path.read_bytes())
    how = document["how"] | {"slurm": tuple(map(tuple, document["how"]["slurm"]))}
    return Job(path, Store(document["results"]), ExecutorConfig(**how), document["groups"])


class Detached(KeyboardInterrupt):
    """The command ends while runs go on without it; the message says how to find them.

    Attributes:
        asked: whether the command was left by --detach and not by Ctrl-C.
    """

    def __init__(self, message: str, asked: bool = False) -> None:
        super().__init__(message)
        self.asked = asked


class Queued(NamedTuple):
    """Where a run is that trains on another machine; `where` is its node, or why it has none."""

    state: str
    id: str = ""
    where: str = ""

    def __str__(self) -> str:
        return " ".join(filter(None, ("job", self.id, "is", self.state.lower(), self.where)))


def watch(
    left: set[str],
    store: Store,
    on_event: OnEvent,
    live: Callable[[], Mapping[str, Queued]],
    seconds: float,
    lost: str,
    until: Mapping[str, int],
) -> None:
    """Report events of runs in jobs until all runs have ended; ended ones are removed from `left`.

    `live` returns where the remaining runs are, by their ids, and is asked every `seconds`. `lost` is the
    reason for a run that is nowhere and has no result; `until` has the steps at which runs pause.
    """
    jobs: Mapping[str, Queued] = dict.fromkeys(left, Queued("SUBMITTED"))
    while left:
        before, jobs = jobs, live()
        for name in sorted(left):
            status, job = store.status(name), jobs.get(name, before.get(name))
            if status.finished or job is None:
                left.discard(name)
                ended = status.finished or status.failed or status.name == "killed"
                ended = ended or 0 < until.get(name, 0) <= status.step
                told = status if ended else Status("killed", status.step)
                on_event({**end_event(name, told), "reason": "" if ended else lost})
            elif status.step:
                on_event({"event": "step", "run_id": name, "step": status.step})
            elif job != before.get(name):
                on_event({"event": "status", "run_id": name, "text": str(job)})
        time.sleep(seconds if left else 0)


def end_event(name: str, status: Status) -> Event:
    return {"event": "end", "run_id": name, "status": status.name, "step": status.step, "trained": True}


def load_executor(how: ExecutorConfig) -> ModuleType:
    return import_module(EXECUTORS[how.executor])
