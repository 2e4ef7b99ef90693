"""A worker: takes a job, reports in lines of JSON, stores how every run ended, and dies with its parent."""

from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime, timedelta, timezone
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.config import Run, as_fields, make_run
from pneuma.engines.base import Engine, OnUpdate, Progress, Result
from pneuma.engines.checkpoint import Checkpoint
from pneuma.engines.policy import Policy, read_policy
from pneuma.engines.records import METRIC_COLUMNS, Records, Row
from pneuma.study import worker
from pneuma.study.executors.local import one_thread_environment
from pneuma.study.identity import run_id
from pneuma.study.provenance import Attempt
from pneuma.study.store import Status, Store
from pneuma.study.tables import from_parquet

RUNS = [make_run({"seed": seed, "steps": 512}) for seed in (0, 1)]
TABLES = {"episodes.parquet", "metrics.parquet", "evaluations.parquet"}


class _Engine:
    """Trains nothing: seed 0 ends well, and seed 1 diverges or breaks the engine."""

    def __init__(self, breaks: bool = False, seconds: float = 0.0) -> None:
        self._breaks = breaks
        self._seconds = seconds

    def train(
        self, runs: Sequence[Run], checkpoints: Mapping[int, Checkpoint], on_update: OnUpdate
    ) -> Iterator[Result]:
        layer = (np.zeros((3, 2), np.float32), np.zeros(2, np.float32))
        metrics: list[Row] = [{**dict.fromkeys(METRIC_COLUMNS, 0.5), "step": 256}]
        for run in runs:
            if not on_update(Progress(run, 256, Records(), lambda: Checkpoint(256, {}))):
                yield Result(run, "stopped", 256, Records(), None)
            elif run.seed == 0:
                time.sleep(self._seconds)
                yield Result(run, "done", 512, Records(), Policy("tanh", (layer,), (layer,)))
            elif self._breaks:
                raise RuntimeError("the engine broke")
            else:
                yield Result(run, "diverged", 256, Records(metrics=metrics), None)


def _train(
    engine: Engine, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> tuple[int, Store, list[dict[str, Any]]]:
    monkeypatch.setattr(worker, "load_engine", lambda _: engine)
    store, events = Store(folder), io.StringIO()
    job = worker.Job(store, {run_id(run): run for run in RUNS})
    code = worker.train_group(job, worker.Reporter(events), threading.Event())
    return code, store, [json.loads(line) for line in events.getvalue().splitlines()]


def test_every_run_of_a_group_is_stored_as_it_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code, store, events = _train(_Engine(), tmp_path, monkeypatch)
    done, diverged = (run_id(run) for run in RUNS)
    assert code == 0
    assert (store.status(done), store.status(diverged)) == (Status("done", 512), Status("diverged", 256))
    assert [event for event in events if event["event"] == "end"] == [
        {"event": "end", "run_id": done, "status": "done", "step": 512, "trained": True},
        {"event": "end", "run_id": diverged, "status": "diverged", "step": 256, "trained": True},
    ]
    assert read_policy(store.read_file(done, "policy.safetensors")).activation == "tanh"


def test_a_diverged_run_keeps_its_records_and_has_no_policy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, store, _ = _train(_Engine(), tmp_path, monkeypatch)
    name = run_id(RUNS[1])
    files = {path.name for path in store.run_folder(name).iterdir()}
    assert files == {*TABLES, "run.json", "provenance.json", "status.json"}
    (row,) = from_parquet(store.read_file(name, "metrics.parquet")).to_pylist()
    assert (row["step"], row["policy_loss"]) == (256, 0.5)


def test_an_engine_that_breaks_is_a_crash_of_the_run_that_it_was_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, store, events = _train(_Engine(breaks=True), tmp_path, monkeypatch)
    assert code == 1
    assert store.status(run_id(RUNS[0])).name == "done"
    assert store.status(run_id(RUNS[1])).name == "crashed"
    error = store.read_file(run_id(RUNS[1]), "error.txt").decode()
    assert error.startswith("Traceback") and error.endswith("RuntimeError: the engine broke\n")
    assert [event["status"] for event in events if event["event"] == "end"] == ["done", "crashed"]


def test_a_run_is_timed_by_itself_and_not_with_those_before_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, store, _ = _train(_Engine(seconds=1.5), tmp_path, monkeypatch)
    told = [json.loads(store.read_file(run_id(run), "provenance.json"))["wall_seconds"] for run in RUNS]
    assert told[0] >= 1.5 > told[1]


def test_what_an_engine_loads_and_compiles_is_no_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second and a half pass before the first update; both of its updates of 256 steps take none."""
    engine = _Engine()
    monkeypatch.setattr(worker, "load_engine", lambda _: engine)
    train = engine.train

    def slow(*arguments: Any) -> Iterator[Result]:
        time.sleep(1.5)
        yield from train(*arguments)

    monkeypatch.setattr(engine, "train", slow)
    _, store, _ = _train(engine, tmp_path, monkeypatch)
    told = json.loads(store.read_file(run_id(RUNS[0]), "provenance.json"))
    assert told["wall_seconds"] >= 1.5 > told["training_seconds"]


def test_after_a_stop_the_runs_that_wait_are_not_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker, "load_engine", lambda _: pytest.fail("a run was begun"))
    events, stop = io.StringIO(), threading.Event()
    stop.set()
    job = worker.Job(Store(tmp_path), {run_id(run): run for run in RUNS})
    assert worker.train_group(job, worker.Reporter(events), stop) == 0
    ends = [json.loads(line) for line in events.getvalue().splitlines()]
    assert [(end["run_id"], end["status"]) for end in ends] == [(run_id(run), "stopped") for run in RUNS]


def test_a_run_whose_own_files_changed_is_not_trained_under_the_old_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(worker, "load_engine", lambda _: _Engine())
    store, events = Store(tmp_path), io.StringIO()
    job = worker.Job(store, {"0123456789abcdef": RUNS[0]})
    assert worker.train_group(job, worker.Reporter(events), threading.Event()) == 1
    assert b"changed meanwhile" in store.read_file("0123456789abcdef", "error.txt")


def test_progress_is_reported_sparingly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two updates within the time between two reports are one."""
    monkeypatch.setattr(worker, "REPORT_SECONDS", 1e3)
    _, _, events = _train(_Engine(), tmp_path, monkeypatch)
    steps = [event for event in events if event["event"] == "step"]
    assert steps == [{"event": "step", "run_id": run_id(RUNS[0]), "step": 256}]


def test_a_worker_leaves_within_seconds_when_its_parent_does(tmp_path: Path) -> None:
    run = make_run(
        {"steps": 10**9, "horizon": 64, "minibatch": 32, "episode_steps": 50, "evaluation_episodes": 1}
    )
    process = subprocess.Popen(
        [sys.executable, "-m", "pneuma.study.worker"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=one_thread_environment(),
    )
    try:
        assert process.stdin is not None and process.stdout is not None
        job = {
            "results": str(tmp_path),
            "runs": {run_id(run): as_fields(run)},
            "checkpoint_seconds": 15.0,
            "keep": 0,
            "final": True,
            "parent": os.getpid(),
        }
        process.stdin.write(json.dumps(job).encode() + b"\n")
        process.stdin.flush()
        events = map(json.loads, process.stdout)
        event = next(event for event in events if event["event"] != "passing")  # it is training
        assert (event["event"], event["run_id"]) == ("step", run_id(run))
        process.stdin.close()
        assert process.wait(timeout=10) != 0
    finally:
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()
    assert Store(tmp_path).status(run_id(run)).name in ("planned", "partial")


def test_a_runs_start_is_told_in_universal_time() -> None:
    noon_in_tokyo = datetime(2024, 5, 1, 12, 0, 0, tzinfo=timezone(timedelta(hours=9)))
    about = Attempt(noon_in_tokyo, time.perf_counter() - 1.5, threads=1).so_far(step=256)
    assert about["started"] == "2024-05-01T03:00:00+00:00"  # Tokyo is nine hours ahead
    assert datetime.fromisoformat(about["started"]).tzinfo == UTC
    assert 1.5 <= about["wall_seconds"] < 60
