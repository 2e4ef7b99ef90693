"""Executing a plan in real worker processes: what they leave behind, and what is trained when.

One tiny study is trained once for the whole module, in two folders by two ways.
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import pytest

from pneuma.cli import study_run
from pneuma.cli.study_records import study_record
from pneuma.config import as_settings
from pneuma.engines.records import EPISODE_COLUMNS, EVALUATION_COLUMNS, METRIC_COLUMNS
from pneuma.errors import UserError
from pneuma.study.execute import (
    CellProgress,
    CellResult,
    OnProgress,
    execute,
    groups,
    prepare,
    recorded_selection,
)
from pneuma.study.executors import local
from pneuma.study.executors.base import Supervision
from pneuma.study.plan import Plan, Selection, make_plan
from pneuma.study.spec import load_study
from pneuma.study.store import Status, Store, run_document, to_json
from pneuma.study.tables import from_parquet

from .tiny import TINY, tiny_plan

COLUMNS = {"episodes": EPISODE_COLUMNS, "metrics": METRIC_COLUMNS, "evaluations": EVALUATION_COLUMNS}
RECORDS = tuple(f"{table}.parquet" for table in COLUMNS)
FILES = {*RECORDS, "run.json", "provenance.json", "policy.safetensors", "status.json"}


@dataclass(frozen=True)
class Executed:
    """What one call of `execute` was asked and gave."""

    plan: Plan
    store: Store
    results: list[CellResult]
    progress: list[CellProgress]


def _run(plan: Plan, store: Store, workers: int, on_progress: OnProgress) -> list[CellResult]:
    todo = prepare(plan, store).runs
    return execute(plan, todo, store, Supervision(workers, checkpoint_seconds=0.2), on_progress)


def _execute(plan: Plan, folder: Path, workers: int) -> Executed:
    store, progress = Store(folder / "results"), list[CellProgress]()
    return Executed(plan, store, _run(plan, store, workers, progress.append), progress)


@pytest.fixture(scope="module")
def together(tmp_path_factory: pytest.TempPathFactory) -> Executed:
    """Seeds 0 and 1, by two workers at once."""
    folder = tmp_path_factory.mktemp("together")
    return _execute(tiny_plan(folder), folder, workers=2)


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> tuple[Executed, Executed]:
    """Seed 1 alone, then seeds 0 and 1, by one worker."""
    folder = tmp_path_factory.mktemp("alone")
    first = _execute(tiny_plan(folder, seeds=(1,), conditions=("one",)), folder, workers=1)
    return first, _execute(tiny_plan(folder, conditions=("one",)), folder, workers=1)


@pytest.fixture
def workers(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[subprocess.Popen[bytes]]]:
    """Every process that the local executor starts, in order."""
    started: list[subprocess.Popen[bytes]] = []
    begin = subprocess.Popen.__init__

    def note(process: subprocess.Popen[bytes], *arguments: Any, **options: Any) -> None:
        begin(process, *arguments, **options)
        started.append(process)

    monkeypatch.setattr(subprocess.Popen, "__init__", note)
    yield started
    for process in started:
        assert process.poll() is not None, "a worker outlived its executor"


def _rows(executed: Executed, seed: int, table: str) -> list[dict[str, Any]]:
    name = _run_id(executed, seed)
    return list(from_parquet(executed.store.read_file(name, f"{table}.parquet")).to_pylist())


def _run_id(executed: Executed, seed: int) -> str:
    return next(cell.run_id for cell in executed.plan.cells if cell.seed == seed)


# --- Groups ------------------------------------------------------------------------------------------


def test_the_conditions_that_a_file_marks_get_gpus_among_themselves_and_no_other_ids(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain, path, told = tiny_plan(tmp_path), tmp_path / "marked.toml", list[Supervision]()
    path.write_text('gpu = ["one"]\n' + TINY.replace("[conditions.other]", "[conditions.other]\ngamma = 0.9"))
    plan = make_plan(load_study(str(path)), Selection())
    monkeypatch.setattr(local, "run_groups", lambda groups, store, how, on_event: told.append(how))
    _run(plan, Store(tmp_path / "results"), 1, lambda progress: None)
    marked = {cell.run_id for cell in plan.cells if cell.condition == "one"}
    assert told[0].on_gpu == marked == {cell.run_id for cell in plain.cells}
    runs = {cell.run_id: replace(cell.run, engine="batched") for cell in plan.cells}
    assert [set(group) for group in groups(runs, told[0])] == [marked, {*runs} - marked]


# --- What a run leaves behind ------------------------------------------------------------------------


def test_one_configuration_is_trained_once_for_two_conditions(together: Executed) -> None:
    assert [(own.status.name, own.status.step, own.trained) for own in together.results] == [
        ("done", 256, True)
    ] * 4
    names = [cell.run_id for cell in together.plan.cells]
    assert names[0] == names[1] and names[2] == names[3]
    assert together.store.runs() == sorted({*names})


def test_every_file_is_there_with_its_checksum(together: Executed) -> None:
    for seed in (0, 1):
        folder = together.store.run_folder(_run_id(together, seed))
        files = {path.name: path.read_bytes() for path in folder.iterdir()}
        assert set(files) == FILES
        sealed = json.loads(files.pop("status.json"))
        status = {key: value for key, value in sealed.items() if key != "sha256"}
        assert sealed["sha256"] == hashlib.sha256(to_json(status)).hexdigest()
        assert status["files"] == {name: hashlib.sha256(data).hexdigest() for name, data in files.items()}
        assert (status["schema"], status["status"], status["step"]) == (1, "done", 256)


def test_a_run_keeps_its_configuration_and_what_produced_it(together: Executed) -> None:
    cell = together.plan.cells[0]
    kept = json.loads(together.store.read_file(cell.run_id, "run.json"))
    assert kept == {"schema": 1, "run_id": cell.run_id, "run": as_settings(cell.run)}
    about = json.loads(together.store.read_file(cell.run_id, "provenance.json"))
    assert {"packages", "commit", "cpu", "started"} <= set(about)
    assert about["threads"] == 1 and about["wall_seconds"] > 0
    assert {"numpy", "torch", "stable-baselines3"} <= set(about["packages"])


def test_every_update_episode_and_evaluation_is_recorded(together: Executed) -> None:
    """256 steps are 4 horizons of 64; with fewer than 20 updates each is evaluated.

    Episodes of the one slot follow one another without a gap, but for the one that the budget cut off.
    """
    tables = {name: _rows(together, 0, name) for name in COLUMNS}
    assert {name: {tuple(row) for row in rows} for name, rows in tables.items()} == {
        name: {columns} for name, columns in COLUMNS.items()
    }
    steps = [64, 128, 192, 256]
    assert [row["step"] for row in tables["metrics"]] == steps
    assert [(row["step"], row["episodes"]) for row in tables["evaluations"]] == [(step, 2) for step in steps]
    total = 0
    for i, row in enumerate(tables["episodes"]):
        total += row["length"]
        assert (row["episode"], row["step"]) == (i, total) and row["length"] <= 50
    assert 256 - 50 < total <= 256


def test_the_selection_is_recorded(together: Executed) -> None:
    record = together.store.selection("tiny")
    assert record is not None
    expected = [(cell.condition, cell.seed, cell.run_id) for cell in together.plan.cells]
    assert [(run["condition"], run["seed"], run["run_id"]) for run in record["runs"]] == expected
    assert recorded_selection(record) == Selection()
    assert record["same"] == [["one", "other"]]
    assert record["runs"][0]["run"] == as_settings(together.plan.cells[0].run)


def test_progress_reaches_every_cell_and_ends_each_once(together: Executed) -> None:
    ends = [(p.cell.condition, p.cell.seed, p.status, p.step) for p in together.progress if p.status]
    assert sorted(ends) == [
        (condition, seed, "done", 256) for condition in ("one", "other") for seed in (0, 1)
    ]
    steps = {p.step for p in together.progress if not p.status and not p.note}
    assert 0 in steps and steps <= {0, 64, 128, 192, 256}


# --- The same run, the same bits ---------------------------------------------------------------------


def test_a_run_ends_with_the_same_bits_alone_in_company_and_with_any_number_of_workers(
    together: Executed, alone: tuple[Executed, Executed]
) -> None:
    """In the other folder seed 1 was trained alone, and seed 0 by a single worker."""
    for file in (*RECORDS, "policy.safetensors", "run.json"):
        here, there = (
            [own.store.read_file(_run_id(together, seed), file) for seed in (0, 1)]
            for own in (together, alone[1])
        )
        assert here == there and here[0] != here[1], file


# --- What is trained, and when -----------------------------------------------------------------------


def test_only_what_is_missing_is_trained(
    together: Executed, alone: tuple[Executed, Executed], workers: list[subprocess.Popen[bytes]]
) -> None:
    first, second = alone
    assert [(own.cell.seed, own.trained) for own in first.results] == [(1, True)]
    assert [(own.cell.seed, own.trained) for own in second.results] == [(0, True), (1, False)]
    assert {p.cell.seed for p in second.progress} == {0}
    again = _run(together.plan, together.store, 2, lambda _: pytest.fail("something happened"))
    assert [(own.status.name, own.trained) for own in again] == [("done", False)] * 4
    assert workers == []


def test_a_damaged_run_is_trained_again_to_the_same_bits(alone: tuple[Executed, Executed]) -> None:
    executed = alone[0]
    path = executed.store.run_folder(_run_id(executed, 1)) / "metrics.parquet"
    whole = path.read_bytes()
    path.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    try:
        (result,) = _run(executed.plan, executed.store, 1, lambda _: None)
        assert result.trained
        assert path.read_bytes() == whole
    finally:
        path.write_bytes(whole)  # other tests look at this folder too


def test_an_environment_that_cannot_be_made_is_told_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="unknown level 'thesi'.*did you mean thesis"):
        plan = tiny_plan(tmp_path, settings={"level": "thesi"})
        _run(plan, Store(tmp_path / "results"), 1, lambda _: None)
    assert os.listdir(tmp_path) == ["tiny.toml"]


# --- When a worker goes ------------------------------------------------------------------------------


def test_a_worker_killed_once_is_tried_again_and_twice_is_told(
    tmp_path: Path, workers: list[subprocess.Popen[bytes]]
) -> None:
    plan = tiny_plan(tmp_path, seeds=(0,), conditions=("one",), steps=64 * 200)  # not over before
    store, name = Store(tmp_path / "results"), plan.cells[0].run_id
    seen: list[CellProgress] = []

    def kill_whoever_trains(progress: CellProgress) -> None:
        seen.append(progress)
        if progress.step:
            os.kill(workers[-1].pid, signal.SIGKILL)

    (result,) = _run(plan, store, 1, kill_whoever_trains)
    assert (result.status.name, result.trained, len(workers)) == ("killed", True, 2)
    assert any("killed by SIGKILL" in progress.note for progress in seen)
    assert seen[-1].status == "killed"
    assert b"killed by SIGKILL" in store.read_file(name, "error.txt")

    (result,) = _run(plan, store, 1, lambda _: None)
    assert (result.status.name, result.status.step, result.trained) == ("done", 64 * 200, True)
    assert {path.name for path in store.run_folder(name).iterdir()} == FILES


def test_an_interrupt_ends_the_workers_and_leaves_nothing_half(
    tmp_path: Path, workers: list[subprocess.Popen[bytes]]
) -> None:
    plan = tiny_plan(tmp_path, conditions=("one",), steps=64 * 40)
    store = Store(tmp_path / "results")

    def interrupt(_: CellProgress) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        _run(plan, store, 2, interrupt)
    assert len(workers) == 2 and all(process.poll() is not None for process in workers)
    assert len(prepare(plan, store).runs) == 2
    left = {path.name for path in (tmp_path / "results").glob("runs/*/[!.]*")}
    assert left <= {"checkpoints", "run.json"}


def test_what_had_ended_before_ctrl_c_is_told_as_trained_and_what_is_published_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plan, store = tiny_plan(tmp_path, seeds=(0, 1, 2), conditions=("one",)), Store(tmp_path / "results")
    first, _, elsewhere = plan.cells
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


def test_a_run_whose_numbers_explode_has_diverged_and_not_crashed(tmp_path: Path) -> None:
    """A parameter that is not finite is a result, and its records are kept."""
    explosive = {"optimizer": "sgd", "learning_rate": 100, "gradient_limit": None, "epochs": 10}
    plan = tiny_plan(tmp_path, seeds=(0,), conditions=("one",), settings={**explosive, "activation": "relu"})
    executed = _execute(plan, tmp_path, workers=1)
    assert executed.results[0].status.name == "diverged"
    assert tuple(_rows(executed, 0, "metrics")[0]) == METRIC_COLUMNS


def test_files_of_one_name_do_not_share_their_records(tmp_path: Path) -> None:
    """The record is kept by the file's name alone, and would show one file's runs for the other's."""
    paths = [tmp_path / folder / "mine.toml" for folder in ("a", "b")]
    for path in paths:
        path.parent.mkdir()
        path.write_text(TINY)
    first, second = (make_plan(load_study(str(path)), Selection()) for path in paths)
    store = Store(tmp_path / "results")
    prepare(first, store)
    prepare(first, store)
    with pytest.raises(UserError, match="are of .*a/mine.toml; give the file another name"):
        prepare(second, store)
    with pytest.raises(UserError, match="are of .*a/mine.toml"):
        study_record(store, str(paths[1]), None)
    paths[0].rename(tmp_path / "moved.toml")  # or it was this one all along
    prepare(second, store)
    assert study_record(store, str(paths[1]), None)["path"] == str(paths[1])
