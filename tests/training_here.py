"""Training in this process, for tests of what is made of runs and not of how processes are supervised.

A worker of its own costs seconds before its first step: libraries are imported and programs compiled anew.
What is here does as `training.executors.local` does, with the worker's own code, but for processes, signals
and second tries. `training/test_execute.py` and `training/test_supervision.py` have the real ones.
"""

from __future__ import annotations

import io
import json
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import pytest

from pneuma.config import Run
from pneuma.store.store import Store
from pneuma.training.executors import local
from pneuma.training.executors.base import ExecutorConfig, Job, OnEvent
from pneuma.training.worker import Worker


class _Told(io.StringIO):
    """Takes a worker's lines and hands on their events."""

    def __init__(self, on_event: OnEvent) -> None:
        super().__init__()
        self._on_event = on_event

    def write(self, line: str) -> int:
        self._on_event(json.loads(line))
        return len(line)


def _train_runs(runs: Mapping[str, Run], store: Store, config: ExecutorConfig, on_event: OnEvent) -> None:
    Worker(_Told(on_event), threading.Event()).train(Job(runs, store, config, last_try=True))


@contextmanager
def training_here() -> Iterator[None]:
    """Let commands train in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(local, "train_runs", _train_runs)
        yield
