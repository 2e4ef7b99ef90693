"""The interface of executors, which train runs somewhere and store the results in one store.

study's plan → runs → executor → workers, which get one `Job` after another → store

Executors are modules, named in `EXECUTORS` and imported only when needed, because each has its requirements:

    most_workers(config) the default number of runs that train at once; fails within ten seconds if the
                         machines cannot be reached or cannot train
    train_runs(job, on_event)
                         trains all runs of a job and calls `on_event` with their events: {"event": "step" |
                         "note" | "status" | "end", "run_id", …}; a step has a `step`, a note and a status
                         have a `text`, an end has a `status`, a `step`, `trained`, and, if it failed, a
                         `reason`

All of them guarantee:

- A run leaves the same files in the store as with `local`, except its provenance. While it trains, its newest
  checkpoint is there. Files are written whole or not at all.
- The process that trains a run holds its lock in the store. Runs that other processes hold are waited for.
- Every run ends with one `end` event, except after Ctrl-C.
- If the disk is full, no further run starts, and StorageError is raised when those that train have stopped at
  a checkpoint.
- A run that crashes, or loses its process or node, is tried once more before it counts as failed, unless the
  user's own code raised the error.
- After the first Ctrl-C every run stops at its next checkpoint; after the second all stop at once. When all
  have ended, KeyboardInterrupt is raised. The same command resumes, with any executor, and ends with the same
  bits.
- Nothing pickled is written to the results folder.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from importlib import import_module
from types import ModuleType
from typing import Any

from pneuma.config import Run, as_fields, make_run
from pneuma.store.store import Store

Event = Mapping[str, Any]
OnEvent = Callable[[Event], None]

LOCAL, RAY = "local", "ray"
EXECUTORS = {name: f"pneuma.training.executors.{name}" for name in (LOCAL, RAY)}


@dataclass(frozen=True)
class ExecutorConfig:
    """Where and how runs are trained.

    Attributes:
        workers: how many runs train at once.
        checkpoint_seconds: between two checkpoints of a run.
        logs: folders of TensorBoard logs, by run.
        project: the user's study, for the provenance of runs.
        until: steps at which runs stop with a checkpoint, by run; 0 is the end.
        executor: one of `EXECUTORS`.
        address: HOST:PORT of a Ray cluster's head; None to start a cluster on this machine.
    """

    workers: int = 1
    checkpoint_seconds: float = 15.0
    logs: Mapping[str, str] = field(default_factory=dict)
    until: Mapping[str, int] = field(default_factory=dict)
    project: Mapping[str, str] = field(default_factory=dict)
    executor: str = LOCAL
    address: str | None = None


@dataclass(frozen=True)
class Job:
    """Runs to train, by their ids. Workers and nodes receive it as a line of JSON.

    With `last_try` a crash is final and stored.
    """

    runs: Mapping[str, Run]
    store: Store
    config: ExecutorConfig
    last_try: bool = False

    def to_json(self) -> str:
        config_table = asdict(self.config)
        for option_name in ("logs", "until"):  # of these runs alone
            config_table[option_name] = {
                run_id: value for run_id, value in config_table[option_name].items() if run_id in self.runs
            }
        job_table = {
            "results": str(self.store.root.resolve()),
            "config": config_table,
            "runs": {run_id: as_fields(run) for run_id, run in self.runs.items()},
            "last_try": self.last_try,
        }
        return json.dumps(job_table)

    @classmethod
    def from_json(cls, job_text: str) -> Job:
        job_table = json.loads(job_text)
        runs = {run_id: make_run(fields) for run_id, fields in job_table["runs"].items()}
        return cls(
            runs, Store(job_table["results"]), ExecutorConfig(**job_table["config"]), job_table["last_try"]
        )


def end_event(run_id: str, status: str, step: int = 0, **details: Any) -> Event:
    end = {"event": "end", "run_id": run_id, "status": status, "step": step, "trained": True}
    return {**end, **details}


def load_executor(config: ExecutorConfig) -> ModuleType:
    return import_module(EXECUTORS[config.executor])
