"""Training in this process, for tests of runs' results, not of the supervision of processes.

A worker needs seconds before its first step, as it imports libraries and compiles. This does as
`training.executors.local` does, with the worker's own code, except for processes, signals and second tries.
`training/test_execute.py` and `training/test_supervision.py` test the real ones.
"""

from __future__ import annotations

import io
import json
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import pytest

from pneuma.training.executors import local
from pneuma.training.executors.base import Job, OnEvent
from pneuma.training.worker import Worker


class _EventStream(io.StringIO):
    """Takes a worker's lines and hands on their events."""

    def __init__(self, on_event: OnEvent) -> None:
        super().__init__()
        self._on_event = on_event

    def write(self, line: str) -> int:
        self._on_event(json.loads(line))
        return len(line)


def _train_runs(job: Job, on_event: OnEvent) -> None:
    Worker(_EventStream(on_event), threading.Event()).train(replace(job, last_try=True))


@contextmanager
def training_here() -> Iterator[None]:
    """Let commands train in this process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(local, "train_runs", _train_runs)
        yield
