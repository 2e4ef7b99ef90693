"""What produced a run: every attempt keeps its machine, and differences between two are reported."""

from __future__ import annotations

import os
import sys
import time
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from pneuma.study import provenance
from pneuma.study.provenance import Attempt, _read_cpu, differences, finished_provenance, machine


def attempt(start: int = 0) -> Attempt:
    """Return one that begins at noon in Tokyo, which is nine hours ahead."""
    noon = datetime(2026, 1, 2, 12, tzinfo=timezone(timedelta(hours=9)))
    return Attempt(noon, time.perf_counter(), threads=1, start=start)


def test_every_attempt_keeps_its_machine_and_the_last_ones_is_told_first() -> None:
    elsewhere = {**machine(1), "cpu": "abacus", "commit": "0" * 40}
    began = "2026-01-01T00:00:00+00:00"
    earlier = {"started": began, "wall_seconds": 100.0, "step": 512, "machine": elsewhere}
    about = finished_provenance(attempt(), {"attempts": [earlier], "resumes": [{"step": 512}]}, 1024)
    assert about["started"] == began
    assert 100 <= about["wall_seconds"] < 110
    assert {key: about[key] for key in machine(1)} == machine(1)
    first, last = about["attempts"]
    assert first == earlier
    assert (last["started"], last["step"], last["machine"]) == ("2026-01-02T03:00:00+00:00", 1024, machine(1))
    assert datetime.fromisoformat(last["started"]).tzinfo == UTC


def test_training_is_timed_at_the_pace_after_the_first_update(monkeypatch: pytest.MonkeyPatch) -> None:
    """20 s of compiling and 2 s of the first 100 steps, then 6 s of 300: 2 s each, so 8 s."""
    clock = [1000.0]
    monkeypatch.setattr(time, "perf_counter", lambda: clock[0])
    own = attempt(start=600)
    clock[0] += 22
    own = own.updated(700)
    assert own.so_far(700)["training_seconds"] == 22  # nothing tells them apart yet
    clock[0] += 6
    told = own.updated(1000).so_far(1000)
    assert (told["wall_seconds"], told["training_seconds"]) == (28, 8)
    older = {"started": "then", "wall_seconds": 100.0, "step": 600, "machine": {}}
    about = finished_provenance(own, {"attempts": [older], "resumes": []}, 1000)
    assert (about["wall_seconds"], about["training_seconds"]) == (128, 108)


def test_what_else_ran_on_the_core_shows(monkeypatch: pytest.MonkeyPatch) -> None:
    """6 s pass after the first update, of which the process had the core for 4.5."""
    clock, used = [1000.0], [10.0]
    monkeypatch.setattr(time, "perf_counter", lambda: clock[0])
    monkeypatch.setattr(time, "process_time", lambda: used[0])
    own = attempt().updated(100)
    assert own.so_far(100)["processor_share"] is None
    clock[0], used[0] = clock[0] + 6, used[0] + 4.5
    told = own.so_far(400)
    assert told["processor_share"] == 0.75
    quiet = {**told, "processor_share": 0.99}
    assert finished_provenance(own, {"attempts": [quiet], "resumes": []}, 400)["processor_share"] == 0.75
    older = {key: value for key, value in told.items() if key != "processor_share"}
    assert finished_provenance(own, {"attempts": [older], "resumes": []}, 400)["processor_share"] is None


def test_a_gpu_is_told_by_its_name_and_apart_from_a_processor(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "jax", raising=False)
    before = machine(1)
    assert before["device"] == "cpu"
    gpu = SimpleNamespace(device_kind="Abacus 3000")
    monkeypatch.setitem(
        sys.modules, "jax", SimpleNamespace(default_backend=lambda: "gpu", devices=lambda: [gpu])
    )
    assert differences(before) == ["device (cpu, now gpu: Abacus 3000)"]


@pytest.mark.parametrize(
    ("commit", "told"), [("b" * 40, "bbbbbbb"), ("a" * 40 + "-dirty", "aaaaaaa-dirty"), (None, "none")]
)
def test_another_commit_is_told_by_its_first_digits(
    commit: str | None, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(provenance, "_commit", lambda: "a" * 40)
    here = machine(1)
    assert differences(here) == []
    assert differences({**here, "commit": commit}) == [f"commit ({told}, now aaaaaaa)"]


@pytest.mark.parametrize("earlier", [{}, {"packages": 3, "threads": "x"}, {"packages": ["torch"]}])
def test_untrusted_nonsense_only_differs(earlier: dict[str, Any]) -> None:
    assert any(told.startswith("torch (none, now ") for told in differences(earlier))


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            "processor\t: 0\nmodel name\t: AMD EPYC: 7\n\nprocessor\t: 1\nmodel name\t: another\n",
            "AMD EPYC: 7",
        ),
        (
            "processor\t: 0\nFeatures\t: fp asimd\nCPU implementer\t: 0x41\nCPU architecture: 8\n"
            "CPU variant\t: 0x3\nCPU part\t: 0xd0c\nCPU revision\t: 1\n\nprocessor\t: 1\n",
            "ARM implementer 0x41, part 0xd0c, variant 0x3, revision 1",
        ),
        ("processor\t: 0\n", ""),
    ],
)
def test_a_processor_is_told_apart_by_its_model_or_on_arm_by_its_numbers(text: str, told: str) -> None:
    assert _read_cpu(text) == told


@pytest.mark.parametrize(
    ("told", "expected"), [("max 100000\n", 8), ("150000 100000\n", 2), ("900000 100000\n", 8), ("1 0", 8)]
)
def test_a_container_may_have_fewer_cores_than_its_machine(
    told: str, expected: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "cpu.max").write_text(told)
    monkeypatch.setattr(provenance, "QUOTA", tmp_path / "cpu.max")
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    assert provenance.available_cores() == expected
