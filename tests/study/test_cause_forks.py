"""Forks of several runs as one study: each change alone, in the order of the control's runs."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.config import Run, make_run
from pneuma.engines.checkpoint import Checkpoint
from pneuma.errors import UserError
from pneuma.study.cause_forks import CAUSES, plan_cause_forks
from pneuma.study.checkpoints import encode, file_name
from pneuma.study.execute import selection_record
from pneuma.study.identity import run_id
from pneuma.study.store import Status, Store, run_document

SMALL: dict[str, object] = {"horizon": 64, "minibatch": 32, "steps": 320, "betas": (0.9, 0.999)}
RAW_RELU = {"activation": "relu", "scale": "raw", "gradient_limit": None, "xp_scope": "forever"}


def stored(store: Store, *checkpoints: int, **settings: object) -> str:
    """Store a finished run that kept checkpoints; return its id."""
    run = make_run({**SMALL, **settings})
    name = run_id(run)
    store.save_run(name, Status("done", run.steps), {"run.json": run_document(run, name)})
    for step in checkpoints:
        data = encode(Checkpoint(step, {}), {})
        store.write(store.run_folder(name) / "checkpoints" / file_name(step, data), data)
    return name


def differing(run: Run, control: Run) -> set[str]:
    return {key for key, value in vars(run).items() if value != getattr(control, key)}


def test_every_condition_changes_one_thing_of_the_control(tmp_path: Path) -> None:
    store = Store(tmp_path)
    parent = stored(store, 64, 128, **RAW_RELU)
    plan = plan_cause_forks(store, "mine", {parent: 150}, [0])
    assert plan.conditions == ("control", *CAUSES)
    runs = {cell.condition: cell.run for cell in plan.cells}
    assert {run.fork_step for run in runs.values()} == {128}
    assert [len(differing(run, runs["control"])) for run in runs.values()] == [0] + [1] * len(CAUSES)
    assert differing(runs["tanh"], runs["control"]) == {"activation"}
    assert runs["reset xp"].fork_reset == "xp"


def test_runs_stand_in_one_order_in_every_condition(tmp_path: Path) -> None:
    store = Store(tmp_path)
    parents = {stored(store, 64, 128, seed=seed): at for seed, at in ((0, 70), (1, 300))}
    plan = plan_cause_forks(store, "mine", parents, [0, 1, 2])
    for condition in plan.conditions:
        own = [cell for cell in plan.cells if cell.condition == condition]
        assert [cell.seed for cell in own] == [0, 1, 2, 3, 4, 5]
        assert [(cell.run.parent, cell.run.fork_step, cell.run.seed) for cell in own] == [
            (parent, step, seed) for parent, step in zip(parents, (64, 128), strict=True) for seed in range(3)
        ]
    assert len({cell.run_id for cell in plan.cells}) == len(plan.cells)


def test_what_changes_nothing_in_a_run_is_left_out_and_said(tmp_path: Path) -> None:
    store = Store(tmp_path)
    plan = plan_cause_forks(store, "mine", {stored(store, 64): 100}, [0])
    left_out = {"tanh", "unit scale", "gradient limit 0.5", "reset xp"}
    assert set(plan.conditions) == {"control", *CAUSES} - left_out
    assert {note.split(":")[0] for note in plan.notes} >= {f"without {name}" for name in left_out}


def test_a_run_without_a_checkpoint_before_its_collapse_is_left_out_and_said(tmp_path: Path) -> None:
    store = Store(tmp_path)
    late, without = stored(store, 256, seed=1), stored(store, seed=2)
    plan = plan_cause_forks(store, "mine", {stored(store, 64): 100, late: 100, without: 100}, [0])
    assert len({cell.run.parent for cell in plan.cells}) == 1
    assert any("first checkpoint" in note for note in plan.notes)
    assert any("kept no checkpoints: remove" in note for note in plan.notes)
    with pytest.raises(UserError, match="kept no checkpoints"):
        plan_cause_forks(store, "mine", {without: 100}, [0])


def test_it_is_recorded_as_a_study_of_its_own(tmp_path: Path) -> None:
    store = Store(tmp_path)
    parent = stored(store, 64, 128)
    plan = plan_cause_forks(store, "mine", {parent: 100}, [0, 1])
    record = selection_record(plan)
    store.save_selection(plan.study.name, record)
    kept = store.selection(plan.study.name)
    assert kept is not None and kept["baseline"] == "control"
    assert plan.study.name.startswith("mine-forks-")
    later = plan_cause_forks(store, "mine", {parent: 200}, [0, 1])
    assert later.study.name != plan.study.name
