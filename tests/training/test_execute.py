"""Executing a plan: what runs leave behind, and what is trained when.

One tiny study is trained for the whole module by two worker processes at once, and in this process.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import pytest

from pneuma.store.store import Status, Store, run_identity
from pneuma.study.plan import Plan
from pneuma.training.execute import CellResult, OnProgress, execute, prepare
from pneuma.training.executors.base import ExecutorConfig

from ..training_here import training_here
from .commands import outcome
from .tiny import tiny_plan


@dataclass(frozen=True)
class Executed:
    """What one call of `execute` was asked and gave."""

    plan: Plan
    store: Store
    results: list[CellResult]
    seeds: list[int]


def _run(plan: Plan, store: Store, workers: int, on_progress: OnProgress) -> list[CellResult]:
    todo = prepare(plan, store)[0]
    return execute(plan, todo, store, ExecutorConfig(workers, checkpoint_seconds=0.2), on_progress)


def _execute(plan: Plan, folder: Path, workers: int) -> Executed:
    store, seeds = Store(folder / "results"), list[int]()
    results = _run(plan, store, workers, lambda cell, event: seeds.append(cell.seed))
    return Executed(plan, store, results, seeds)


@pytest.fixture(scope="module")
def together(tmp_path_factory: pytest.TempPathFactory) -> Executed:
    """Seeds 0 and 1, by two workers at once."""
    folder = tmp_path_factory.mktemp("together")
    return _execute(tiny_plan(folder), folder, workers=2)


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> tuple[Executed, Executed]:
    """Seed 1 alone, then seeds 0 and 1, in this process."""
    folder = tmp_path_factory.mktemp("alone")
    with training_here():
        first = _execute(tiny_plan(folder, seeds=(1,), conditions=("one",)), folder, workers=1)
        return first, _execute(tiny_plan(folder, conditions=("one",)), folder, workers=1)


# --- What a run leaves behind ------------------------------------------------------------------------


def test_one_configuration_is_trained_once_for_two_conditions(together: Executed) -> None:
    assert [(result.status.name, result.status.step, result.trained) for result in together.results] == [
        ("done", 256, True)
    ] * 4
    names = [cell.run_id for cell in together.plan.cells]
    assert names[0] == names[1] and names[2] == names[3]
    assert together.store.runs() == sorted({*names})


# --- The same run, the same bits ---------------------------------------------------------------------


def test_a_run_ends_with_the_same_bits_alone_and_in_company_in_a_worker_and_here(
    together: Executed, alone: tuple[Executed, Executed]
) -> None:
    """In the other folder seed 1 was trained alone, and seed 0 after it in the same process."""
    files = outcome(together.store.root)
    assert files == outcome(alone[1].store.root)
    assert len({*files.values()}) == len(files) == 2 * 6  # no file is as the other seed's


# --- What is trained, and when -----------------------------------------------------------------------


def test_only_what_is_missing_is_trained(together: Executed, alone: tuple[Executed, Executed]) -> None:
    first, second = alone
    assert [(result.cell.seed, result.trained) for result in first.results] == [(1, True)]
    assert [(result.cell.seed, result.trained) for result in second.results] == [(0, True), (1, False)]
    assert {*second.seeds} == {0}
    again = _run(together.plan, together.store, 2, lambda cell, event: pytest.fail("something happened"))
    assert [(result.status.name, result.trained) for result in again] == [("done", False)] * 4


def test_a_planned_run_says_what_it_is_and_a_study_leaves_its_file(tmp_path: Path) -> None:
    """The runs are found again by these; planning once more does not undo what a run has come to."""
    plan, store = tiny_plan(tmp_path), Store(tmp_path / "results")
    for _ in range(2):
        todo, _ = prepare(plan, store)
        statuses = {name: store.status(name) for name in todo}
        assert {n: status.identity for n, status in statuses.items()} == {
            name: run_identity(run) for name, run in todo.items()
        }
    assert {status.name for status in statuses.values()} == {"planned"}
    assert sorted(os.listdir(store.root)) == ["last", "runs", "studies"]
    assert (store.studies / "tiny.toml").read_bytes() == (tmp_path / "tiny.toml").read_bytes()
    first = plan.cells[0].run_id
    store.save_run(first, Status("done", 256), {})
    assert store.status(first).identity == run_identity(plan.cells[0].run)
    assert first not in prepare(plan, store)[0] and store.status(first).finished
