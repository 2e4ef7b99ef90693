"""Executing a plan in real worker processes: what they leave behind, and what is trained when.

One tiny study is trained once for the whole module, in two folders by two ways.
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from pneuma.cli.study_records import study_record
from pneuma.config import Run, as_fields
from pneuma.engines.records import EPISODE_COLUMNS, EVALUATION_COLUMNS, METRIC_COLUMNS
from pneuma.errors import UserError
from pneuma.study.execute import (
    OnProgress,
    Outcome,
    Progress,
    execute,
    groups,
    missing,
    prepare,
    recorded_selection,
)
from pneuma.study.executors import local
from pneuma.study.executors.base import Supervision
from pneuma.study.plan import Plan, Selection, make_plan
from pneuma.study.spec import load_study, studies_folder
from pneuma.study.store import Store, to_json
from pneuma.study.tables import from_parquet

from .tiny import TINY, tiny_plan

RECORDS = ("episodes.parquet", "metrics.parquet", "evaluations.parquet")
FILES = {*RECORDS, "run.json", "provenance.json", "policy.safetensors", "status.json"}


@dataclass(frozen=True)
class Executed:
    """What one call of `execute` was asked and gave."""

    plan: Plan
    store: Store
    outcomes: list[Outcome]
    progress: list[Progress]


def _run(plan: Plan, store: Store, workers: int, on_progress: OnProgress) -> list[Outcome]:
    todo = prepare(plan, store).runs
    return execute(plan, todo, store, Supervision(workers, checkpoint_seconds=0.2), on_progress)


def _missing(plan: Plan, store: Store) -> dict[str, Run]:
    return missing(plan, {cell.run_id: store.status(cell.run_id) for cell in plan.cells})


def _execute(plan: Plan, folder: Path, workers: int) -> Executed:
    store, progress = Store(folder / "results"), list[Progress]()
    return Executed(plan, store, _run(plan, store, workers, progress.append), progress)


# --- Groups ------------------------------------------------------------------------------------------


def test_runs_on_a_gpu_are_grouped_among_themselves(tmp_path: Path) -> None:
    runs = {cell.run_id: cell.run for cell in tiny_plan(tmp_path, seeds=tuple(range(6))).cells}
    one, two, *others = runs
    grouped = groups(runs, Supervision(workers=1, on_gpu=frozenset({one, two})))
    assert [set(group) for group in grouped] == [{one, two}, set(others)]


def test_the_conditions_that_a_file_marks_get_gpus_and_no_other_ids(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plain = tiny_plan(tmp_path)
    path = tmp_path / "marked.toml"
    path.write_text('gpu = ["one"]\n' + TINY.replace("[conditions.other]", "[conditions.other]\ngamma = 0.9"))
    plan, told = make_plan(load_study(str(path)), Selection()), list[Supervision]()
    monkeypatch.setattr(local, "run_groups", lambda groups, store, how, on_event: told.append(how))
    _run(plan, Store(tmp_path / "results"), 1, lambda progress: None)
    marked = {cell.run_id for cell in plan.cells if cell.condition == "one"}
    assert told[0].on_gpu == marked == {cell.run_id for cell in plain.cells}


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


# --- What a run leaves behind --------------------------------------------------------------------


def test_a_run_is_trained_to_its_end(together: Executed) -> None:
    assert [(o.status.name, o.status.step, o.trained) for o in together.outcomes] == [("done", 256, True)] * 4


def test_one_configuration_is_trained_once_for_two_conditions(together: Executed) -> None:
    names = [cell.run_id for cell in together.plan.cells]
    assert len(names) == 4
    assert names[0] == names[1] and names[2] == names[3]
    folders = list((together.store.root / "runs").iterdir())
    assert {folder.name for folder in folders} == {names[0], names[2]}


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


def test_a_run_keeps_its_resolved_configuration(together: Executed) -> None:
    cell = together.plan.cells[0]
    kept = json.loads(together.store.read_file(cell.run_id, "run.json"))
    assert kept == {"schema": 1, "run_id": cell.run_id, "run": as_fields(cell.run)}
    assert kept["run"]["horizon"] == 64


def test_a_run_keeps_what_produced_it(together: Executed) -> None:
    kept = json.loads(together.store.read_file(_run_id(together, 0), "provenance.json"))
    assert {"packages", "commit", "cpu", "threads", "started", "wall_seconds"} <= set(kept)  # design 4
    assert kept["threads"] == 1
    assert {"numpy", "torch", "stable-baselines3"} <= set(kept["packages"])
    assert kept["wall_seconds"] > 0


@pytest.mark.parametrize(
    ("table", "columns"),
    [("episodes", EPISODE_COLUMNS), ("metrics", METRIC_COLUMNS), ("evaluations", EVALUATION_COLUMNS)],
)
def test_the_tables_have_the_columns_of_the_contract(
    together: Executed, table: str, columns: tuple[str, ...]
) -> None:
    assert {tuple(row) for row in _rows(together, 0, table)} == {columns}


def test_every_update_and_evaluation_is_recorded(together: Executed) -> None:
    # 256 steps are 4 horizons of 64; with fewer than 20 updates each one is evaluated
    steps = [64, 128, 192, 256]
    assert [row["step"] for row in _rows(together, 0, "metrics")] == steps
    assert [row["step"] for row in _rows(together, 0, "evaluations")] == steps
    assert all(row["episodes"] == 2 for row in _rows(together, 0, "evaluations"))


def test_an_episode_ends_where_the_lengths_so_far_add_up_to(together: Executed) -> None:
    """One slot: its episodes follow one another without a gap."""
    episodes = _rows(together, 0, "episodes")
    assert [row["episode"] for row in episodes] == list(range(len(episodes)))
    total = 0
    for row in episodes:
        total += row["length"]
        assert row["step"] == total <= 256
        assert row["length"] <= 50
    assert 256 - total < 50  # the one that was cut off by the budget


def test_the_selection_is_recorded(together: Executed) -> None:
    record = together.store.selection("tiny")
    assert record is not None
    expected = [(cell.condition, cell.seed, cell.run_id) for cell in together.plan.cells]
    assert [(run["condition"], run["seed"], run["run_id"]) for run in record["runs"]] == expected
    assert recorded_selection(record) == Selection()
    assert record["same"] == [["one", "other"]]
    assert record["runs"][0]["run"] == as_fields(together.plan.cells[0].run)


def test_progress_reaches_every_cell_and_ends_each_once(together: Executed) -> None:
    ends = [(p.cell.condition, p.cell.seed, p.status, p.step) for p in together.progress if p.status]
    assert sorted(ends) == [
        (condition, seed, "done", 256) for condition in ("one", "other") for seed in (0, 1)
    ]
    steps = [p.step for p in together.progress if not p.status and not p.note]
    assert steps and set(steps) <= {64, 128, 192, 256}


# --- The same run, the same bits -----------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("file", [*RECORDS, "policy.safetensors", "run.json"])
def test_a_run_ends_with_the_same_bits_alone_in_company_and_with_any_number_of_workers(
    together: Executed, alone: tuple[Executed, Executed], seed: int, file: str
) -> None:
    """In the other folder seed 1 was trained alone, and seed 0 by a single worker."""
    name = _run_id(together, seed)
    assert alone[1].store.read_file(name, file) == together.store.read_file(name, file)


def test_different_seeds_end_with_different_bits(together: Executed) -> None:
    first, second = (_run_id(together, seed) for seed in (0, 1))
    for file in (*RECORDS, "policy.safetensors"):
        assert together.store.read_file(first, file) != together.store.read_file(second, file)


# --- What is trained, and when -------------------------------------------------------------------


def test_only_new_seeds_are_trained(alone: tuple[Executed, Executed]) -> None:
    first, second = alone
    assert [(o.cell.seed, o.trained) for o in first.outcomes] == [(1, True)]
    assert [(o.cell.seed, o.trained) for o in second.outcomes] == [(0, True), (1, False)]
    assert {p.cell.seed for p in second.progress} == {0}


def test_a_second_time_nothing_is_trained(together: Executed, workers: list[subprocess.Popen[bytes]]) -> None:
    assert _missing(together.plan, together.store) == {}
    outcomes = _run(together.plan, together.store, 2, lambda _: pytest.fail("something happened"))
    assert [(o.status.name, o.trained) for o in outcomes] == [("done", False)] * 4
    assert workers == []


def test_a_damaged_run_is_trained_again_to_the_same_bits(alone: tuple[Executed, Executed]) -> None:
    executed = alone[0]
    name = _run_id(executed, 1)
    path = executed.store.run_folder(name) / "metrics.parquet"
    whole = path.read_bytes()
    path.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    try:
        (outcome,) = _run(executed.plan, executed.store, 1, lambda _: None)
        assert outcome.trained
        assert path.read_bytes() == whole
    finally:
        path.write_bytes(whole)  # other tests look at this folder too


def test_an_environment_that_cannot_be_made_is_told_before_anything_is_written(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="unknown level 'thesi'.*did you mean thesis"):
        plan = tiny_plan(tmp_path, settings={"level": "thesi"})
        _run(plan, Store(tmp_path / "results"), 1, lambda _: None)
    assert os.listdir(tmp_path) == ["tiny.toml"]


# --- When a worker goes --------------------------------------------------------------------------


def test_a_worker_killed_once_is_tried_again_and_twice_is_told(
    tmp_path: Path, workers: list[subprocess.Popen[bytes]]
) -> None:
    long = 64 * 200  # not over before it is killed
    plan = tiny_plan(tmp_path, seeds=(0,), conditions=("one",), steps=long)
    store, name = Store(tmp_path / "results"), plan.cells[0].run_id
    seen: list[Progress] = []

    def kill_whoever_trains(progress: Progress) -> None:
        seen.append(progress)
        if progress.step:
            os.kill(workers[-1].pid, signal.SIGKILL)

    (outcome,) = _run(plan, store, 1, kill_whoever_trains)
    assert (outcome.status.name, outcome.trained) == ("killed", True)
    assert len(workers) == 2
    assert any("killed by SIGKILL" in progress.note for progress in seen)
    assert seen[-1].status == "killed"
    assert b"killed by SIGKILL" in store.read_file(name, "error.txt")
    assert json.loads(store.read_file(name, "run.json"))["run"] == as_fields(plan.cells[0].run)

    (outcome,) = _run(plan, store, 1, lambda _: None)
    assert (outcome.status.name, outcome.status.step, outcome.trained) == ("done", 64 * 200, True)
    assert {path.name for path in store.run_folder(name).iterdir()} == FILES
    assert len(workers) == 3


def test_a_worker_that_dies_before_it_reads_its_job_is_a_crash(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = tmp_path / "python"
    script.write_text("#!/bin/sh\necho no such interpreter >&2\nexit 3\n")
    script.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(script))
    begin = subprocess.Popen.__init__

    def begin_and_end(process: subprocess.Popen[bytes], *arguments: Any, **options: Any) -> None:
        begin(process, *arguments, **options)
        process.wait()

    monkeypatch.setattr(subprocess.Popen, "__init__", begin_and_end)
    executed = _execute(tiny_plan(tmp_path, conditions=("one",)), tmp_path, workers=1)
    assert [outcome.status.name for outcome in executed.outcomes] == ["crashed", "crashed"]
    error = executed.store.read_file(_run_id(executed, 0), "error.txt")
    assert b"code 3" in error and b"no such interpreter" in error


def test_an_interrupt_ends_the_workers_and_leaves_nothing_half(
    tmp_path: Path, workers: list[subprocess.Popen[bytes]]
) -> None:
    plan = tiny_plan(tmp_path, conditions=("one",), steps=64 * 40)
    store = Store(tmp_path / "results")

    def interrupt(_: Progress) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        _run(plan, store, 2, interrupt)
    assert len(workers) == 2
    assert all(process.poll() is not None for process in workers)
    assert len(_missing(plan, store)) == 2
    left = {path.name for path in (tmp_path / "results").glob("runs/*/[!.]*")}
    assert left <= {"checkpoints", "run.json"}


def test_a_run_whose_numbers_explode_has_diverged_and_not_crashed(tmp_path: Path) -> None:
    """Design section 4: a non-finite parameter is a result, and its records are kept."""
    explosive = {"optimizer": "sgd", "learning_rate": 100, "gradient_limit": None, "epochs": 10}
    plan = tiny_plan(tmp_path, seeds=(0,), conditions=("one",), settings={**explosive, "activation": "relu"})
    executed = _execute(plan, tmp_path, workers=1)
    assert executed.outcomes[0].status.name == "diverged"
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


def test_a_shipped_file_is_shipped_however_its_path_is_given(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(studies_folder().parent)
    assert load_study(f"{studies_folder().name}/activation.toml").own_path is None
