"""Which runs were trained on something else than most."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from pneuma.cli import main
from pneuma.study.execute import selection_record
from pneuma.study.plan import Plan, Selection, make_plan
from pneuma.study.provenance import unusual_origins
from pneuma.study.spec import load_study
from pneuma.study.store import Status, Store, run_document, to_json

MILAN = {"cpu": "AMD Milan", "device": "cpu", "python": "3.11.7", "packages": {"jax": "0.10.2"}}
XEON = {**MILAN, "cpu": "Intel Xeon"}


def origin(*machines: dict[str, Any], started: str = "2026-01-01", seconds: float = 1.0) -> dict[str, Any]:
    """Return a provenance as it is written: the last machine's facts, and every attempt's."""
    attempts = [{"machine": each} for each in machines]
    return {"started": started, "wall_seconds": seconds, **machines[-1], "attempts": attempts}


# --- Marks -------------------------------------------------------------------------------------------


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


# --- Stored studies ----------------------------------------------------------------------------------


@pytest.fixture
def planned() -> Plan:
    return make_plan(
        load_study("activation"), Selection(seeds=(0, 1), steps=1000, conditions=("tanh", "relu"))
    )


def save(store: Store, plan: Plan, origins: list[dict[str, Any]]) -> None:
    """Store the plan's first runs as trained so, and the plan as the study's latest selection."""
    for cell, told in zip(plan.cells, origins, strict=False):
        files = {"run.json": run_document(cell.run, cell.run_id), "provenance.json": to_json(told)}
        store.save_run(cell.run_id, Status("done", cell.run.steps), files)
    store.save_selection(plan.study.name, selection_record(plan))


def test_status_and_show_tell_the_mark(
    tmp_path: Path, planned: Plan, capsys: pytest.CaptureFixture[str]
) -> None:
    save(Store(tmp_path), planned, [origin(MILAN), origin(MILAN), origin(XEON), origin(MILAN)])
    odd = planned.cells[2].run_id
    assert main(["study", "status", "activation", "--results", str(tmp_path)]) == 0
    marked = [line for line in capsys.readouterr().out.splitlines() if "than most" in line]
    assert len(marked) == 1 and odd in marked[0] and "(other processor than most)" in marked[0]
    assert main(["study", "status", "activation", "--results", str(tmp_path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["unlike_most"] == {odd: "other processor"}
    assert main(["run", "show", odd, "--results", str(tmp_path)]) == 0
    assert "other processor than most runs of study activation" in capsys.readouterr().out
    assert main(["run", "show", planned.cells[0].run_id, "--results", str(tmp_path)]) == 0
    assert "than most" not in capsys.readouterr().out
