"""What produced a run: every attempt keeps its machine."""

from __future__ import annotations

import time
from datetime import UTC, datetime

import pytest

from pneuma.study.provenance import Attempt, finished_provenance, machine


def test_every_attempt_keeps_its_machine_and_the_last_ones_is_told_first() -> None:
    elsewhere = {**machine(), "cpu": "abacus", "commit": "0" * 40}
    began = "2026-01-01T00:00:00+00:00"
    earlier = {"started": began, "wall_seconds": 100.0, "step": 512, "machine": elsewhere}
    last = Attempt(512).so_far(1024)
    about = finished_provenance([earlier, last])
    assert about["started"] == began
    assert 100 <= about["wall_seconds"] < 110
    assert {key: about[key] for key in machine()} == machine() == last["machine"]
    assert about["attempts"] == [earlier, last]
    assert last["step"] == 1024 and datetime.fromisoformat(last["started"]).tzinfo == UTC


def test_training_is_timed_at_the_pace_after_the_first_update(monkeypatch: pytest.MonkeyPatch) -> None:
    """20 s of compiling and 2 s of the first 100 steps, then 6 s of 300: 2 s each, so 8 s."""
    clock = [1000.0]
    monkeypatch.setattr(time, "perf_counter", lambda: clock[0])
    own = Attempt(600)
    clock[0] += 22
    own.update(700)
    assert own.so_far(700)["training_seconds"] == 22  # nothing tells them apart yet
    clock[0] += 6
    own.update(1000)
    told = own.so_far(1000)
    assert (told["wall_seconds"], told["training_seconds"]) == (28, 8)
    older = {"started": "then", "wall_seconds": 100.0, "step": 600, "machine": {}}
    about = finished_provenance([older, told])
    assert (about["wall_seconds"], about["training_seconds"]) == (128, 108)
