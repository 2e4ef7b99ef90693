"""What `execute` finds and leaves: after Ctrl-C, and of checkpoints that a study keeps."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from pneuma.cli import study_run
from pneuma.engines.base import checkpoint_steps
from pneuma.study.checkpoints import file_name
from pneuma.study.execute import prepare
from pneuma.study.executors.base import Supervision
from pneuma.study.plan import Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Status, Store, run_document

from .tiny import TINY, tiny_plan

# --- Ctrl-C ------------------------------------------------------------------------------------------


def test_what_had_ended_before_ctrl_c_is_told_as_trained_and_what_is_published_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plan, store = tiny_plan(tmp_path, seeds=(0, 1, 2), conditions=("one",)), Store(tmp_path / "results")
    first, second, elsewhere = plan.cells
    plan = replace(plan, published=frozenset({elsewhere.run_id}))

    def stop(*_: object) -> None:
        store.save_run(first.run_id, Status("done", 640), {"run.json": run_document(first.run, first.run_id)})
        raise KeyboardInterrupt

    monkeypatch.setattr("pneuma.study.execute.execute", stop)
    code = study_run.train(plan, store, Supervision(1), retry_failed=False, json=True, quiet=True)
    rows = [
        (row["seed"], row["status"], row["trained"]) for row in json.loads(capsys.readouterr().out)["runs"]
    ]
    assert (code, rows) == (130, [(0, "done", True), (1, "planned", False)])


# --- Checkpoints that the study keeps ----------------------------------------------------------------


def test_runs_that_a_study_without_checkpoints_began_or_trained_are_told(tmp_path: Path) -> None:
    """Kept are those after the first, fourth and seventh of ten updates."""
    path, store = tmp_path / "tiny.toml", Store(tmp_path / "results")
    path.write_text("keep_checkpoints = 3\n" + TINY)
    plan = make_plan(load_study(str(path)), Selection(seeds=(0, 1, 2, 3), steps=640))
    whole, begun, ended, _ = [cell for cell in plan.cells if cell.condition == "one"]
    steps = sorted(checkpoint_steps(whole.run, 3))
    for cell, own in ((whole, steps[:-1]), (begun, steps[1:3]), (ended, steps[1:])):
        for step in own:
            store.write(store.run_folder(cell.run_id) / "checkpoints" / file_name(step, b""), b"")
    for cell in (whole, ended):
        store.save_run(cell.run_id, Status("done", 640), {"run.json": run_document(cell.run, cell.run_id)})
    (note,) = prepare(plan, store).notes
    assert note.startswith(
        f"2 stored runs without all checkpoints that this study keeps: to fork one, as {begun.run_id}"
    )
