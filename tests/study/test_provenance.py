"""What produced a run: every attempt keeps its machine; what is unlike most is marked."""

from __future__ import annotations

import time
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

from pneuma.study.execute import selection_record
from pneuma.study.plan import Selection, make_plan
from pneuma.study.provenance import Attempt, finished_provenance, machine, unusual_origins
from pneuma.study.spec import load_study
from pneuma.study.store import Status, Store, run_document, to_json

from ..cli.calls import described, printed


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


# --- Which were trained on something else than most ---------------------------------------------------

MILAN = {"cpu": "AMD Milan", "device": "cpu", "python": "3.11.7", "packages": {"jax": "0.10.2"}}
XEON = {**MILAN, "cpu": "Intel Xeon"}


def origin(*machines: dict[str, Any], started: str = "2026-01-01", seconds: float = 1.0) -> dict[str, Any]:
    """Return a provenance as it is written: the last machine's facts, and every attempt's."""
    attempts = [{"machine": each} for each in machines]
    return {"started": started, "wall_seconds": seconds, **machines[-1], "attempts": attempts}


def test_what_was_trained_otherwise_than_most_is_marked_in_a_word() -> None:
    newer = {**MILAN, "packages": {"jax": "0.10.3"}}
    told = {
        "a": origin(MILAN),
        "b": origin(MILAN),
        "c": origin(XEON),
        "d": origin(newer),
        "e": origin(MILAN),
        "f": origin({**XEON, "python": "3.12.1"}),
    }
    both = "other processor, other packages"
    assert unusual_origins(told.items()) == {"c": "other processor", "d": "other packages", "f": both}
    assert unusual_origins([("a", origin(MILAN))]) == unusual_origins([]) == {}


def test_a_gpu_is_another_processor_and_so_is_a_way_over_two() -> None:
    gpu = {**MILAN, "device": "gpu: NVIDIA H200"}
    told = {"a": origin(MILAN), "b": origin(MILAN), "c": origin(gpu), "d": origin(XEON, MILAN)}
    assert unusual_origins(told.items()) == {"c": "other processor", "d": "other processor"}


def test_status_tells_the_mark(tmp_path: Path) -> None:
    store = Store(tmp_path)
    selection = Selection(seeds=(0, 1), steps=1000, conditions=("tanh", "relu"))
    plan = make_plan(load_study("activation"), selection)
    for cell, told in zip(plan.cells, (MILAN, MILAN, XEON, MILAN), strict=True):
        files = {"run.json": run_document(cell.run, cell.run_id), "provenance.json": to_json(origin(told))}
        store.save_run(cell.run_id, Status("done", cell.run.steps), files)
    store.save_selection("activation", selection_record(plan))
    odd = plan.cells[2].run_id
    marked = [
        line
        for line in printed("study", "status", "activation", "--results", store.root).splitlines()
        if "than most" in line
    ]
    assert len(marked) == 1 and odd in marked[0] and "(other processor than most)" in marked[0]
    told = described("study", "status", "activation", "--results", store.root, "--json")
    assert told["unlike_most"] == {odd: "other processor"}
