"""A worker: takes a job, reports in lines of JSON, stores how every run ended, and dies with its parent."""

from __future__ import annotations

import errno
import io
import json
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import pytest

from pneuma.config import Run, make_run
from pneuma.engines.loop import OnUpdate, Progress, Result
from pneuma.engines.policy import Policy, read_sound_policy
from pneuma.engines.records import METRIC_COLUMNS, Checkpoint, Records, Row
from pneuma.errors import OwnCodeError, UserError
from pneuma.store.row_builder import row_until, stored_row
from pneuma.store.rows import decode_row
from pneuma.store.store import Status, Store, run_identity
from pneuma.store.tables import from_parquet
from pneuma.study.identity import run_id
from pneuma.training import worker
from pneuma.training.executors.base import ExecutorConfig, Job
from pneuma.training.executors.local import worker_environment

from ..engines.trained import run_of

RUNS = [make_run({"seed": seed, "steps": 512, "horizon": 256}) for seed in (0, 1)]
FIRST, SECOND = map(run_id, RUNS)
TABLES = {"episodes.parquet", "metrics.parquet", "evaluations.parquet"}

HERE = ExecutorConfig()


class _Engine:
    """Trains nothing: seed 0 ends well, and seed 1 diverges or breaks the engine."""

    def __init__(self, breaks: bool = False) -> None:
        self._breaks = breaks

    def train(self, run: Run, on_update: OnUpdate, *_: object) -> Result:
        actor, critic = (((np.zeros((3, n), np.float32), np.zeros(n, np.float32)),) for n in (2, 1))
        metrics: list[Row] = [{**dict.fromkeys(METRIC_COLUMNS, 0.5), "step": 256}]
        for step in (256, 512):
            if not on_update(Progress(step, Records(), lambda: Checkpoint(256, {}))):
                return Result("stopped", step, Records(), None)
        if run.seed == 0:
            return Result("done", 512, Records(), Policy("tanh", actor, critic))
        if self._breaks:
            raise RuntimeError("the engine broke")
        return Result("diverged", 256, Records(metrics=metrics), None)


def _train(
    engine: _Engine, folder: Path, monkeypatch: pytest.MonkeyPatch, config: ExecutorConfig = HERE
) -> tuple[bool, Store, list[dict[str, Any]]]:
    monkeypatch.setattr(worker, "train_run", engine.train)
    store, events = Store(folder), io.StringIO()
    job = Job({run_id(run): run for run in RUNS}, store, config, last_try=True)
    is_sound = worker.Worker(events, threading.Event()).train(job)
    return is_sound, store, [json.loads(line) for line in events.getvalue().splitlines()]


def test_every_run_of_a_group_is_stored_as_it_ended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    is_sound, store, events = _train(_Engine(), tmp_path, monkeypatch)
    assert is_sound
    assert (store.status(FIRST), store.status(SECOND)) == (Status("done", 512), Status("diverged", 256))
    assert [event for event in events if event["event"] == "end"] == [
        {"event": "end", "run_id": FIRST, "status": "done", "step": 512, "trained": True},
        {"event": "end", "run_id": SECOND, "status": "diverged", "step": 256, "trained": True},
    ]
    assert read_sound_policy(store.read_file(FIRST, "policy.safetensors")).activation == "tanh"
    files = {path.name for path in store.run_folder(SECOND).iterdir()}
    assert files == {*TABLES, "run.json", "provenance.json", "row.arrow", "status.json"}
    _, _, events = _train(_Engine(), tmp_path, monkeypatch)
    assert [event["trained"] for event in events] == [False, False]
    assert files == {path.name for path in store.run_folder(SECOND).iterdir()}  # no lock is left either
    (row,) = from_parquet(store.read_file(SECOND, "metrics.parquet")).to_pylist()
    assert (row["step"], row["policy_loss"]) == (256, 0.5)
    assert [store.status(run_id(run)).identity for run in RUNS] == [run_identity(run) for run in RUNS]
    rows = [decode_row(store.read_file(name, "row.arrow")) for name in (FIRST, SECOND)]
    assert [(row.run_id, row.status, row.seed, row.budget, row.end) for row in rows] == [
        (FIRST, "done", 0, 512, 512),
        (SECOND, "diverged", 1, 512, 256),
    ]
    assert {row.config_id for row in rows} == {run_identity(RUNS[0]).config_id}
    policy = read_sound_policy(store.read_file(FIRST, "policy.safetensors"))
    assert [row.policy for row in rows] == [policy.checksum, None]


def test_a_pause_within_an_update_has_the_row_that_the_finished_run_has_at_that_step(tmp_path: Path) -> None:
    """Six updates of 64 steps for a budget of 350, whose third evaluation of six is at 175."""
    run = run_of(steps=350)
    store, name = Store(tmp_path), run_id(run)
    trainer = worker.Worker(io.StringIO(), threading.Event())
    for _ in range(2):  # the second time it is there already
        assert trainer.train(Job({name: run}, store, ExecutorConfig(until={name: 175}), last_try=True))
        assert store.status(name) == Status("partial", 192)
    paused = row_until(store, name, run, 175)
    assert trainer.train(Job({name: run}, store, HERE, last_try=True))
    whole, at_pause = stored_row(store, name), row_until(store, name, run, 175)
    assert (whole.budget, whole.end, paused.budget, paused.end) == (350, 384, 175, 175)
    assert paused.evaluations("step").tolist() == [58, 116, 175]
    assert whole.evaluations("step").tolist() == [58, 116, 175, 233, 291, 350]
    assert paused.same_numbers(at_pause) and whole.grid[-1] == 350
    for quantity in ("return", "entropy", "kills"):
        np.testing.assert_array_equal(paused.curve(quantity), at_pause.curve(quantity))
        assert np.isfinite(whole.curve(quantity)[-1])


def test_an_engine_that_breaks_is_a_crash_of_the_run_that_it_was_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    is_sound, store, events = _train(_Engine(breaks=True), tmp_path, monkeypatch)
    assert not is_sound
    assert (store.status(FIRST).name, store.status(SECOND).name) == ("done", "crashed")
    error = store.read_file(SECOND, "error.txt").decode()
    assert error.startswith("Traceback") and error.endswith("RuntimeError: the engine broke\n")
    assert [event["status"] for event in events if event["event"] == "end"] == ["done", "crashed"]


def test_a_run_is_not_trained_under_an_id_that_its_files_no_longer_give(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its level, say, was edited after the plan was made: its numbers would be those of another run."""
    monkeypatch.setattr(worker, "train_run", _Engine().train)
    store, events = Store(tmp_path), io.StringIO()
    job = Job({"a0" * 8: RUNS[0]}, store, HERE, last_try=True)
    assert not worker.Worker(events, threading.Event()).train(job)
    (event,) = map(json.loads, events.getvalue().splitlines())
    assert event["status"] == store.status("a0" * 8).name == "crashed"
    assert "own files (level, characters, reward, environment, wrappers) changed" in event["reason"]


def test_an_endless_error_is_a_message_of_usual_length() -> None:
    for error in (RuntimeError("a" * 5_000_000), UserError("a" * 5_000_000)):
        assert len(worker.describe(error)) == 4_003


@pytest.mark.parametrize("breaks", [False, True])
def test_a_full_disk_stops_the_run_and_those_after_it_and_makes_none_a_crash(
    breaks: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """At its last write, or when the engine's crash is stored."""

    def fail(descriptor: int) -> NoReturn:
        raise OSError(errno.ENOSPC, "No space left on device")

    engine = _Engine(breaks)
    monkeypatch.setattr(os, "fsync", fail)
    _, store, events = _train(engine, tmp_path, monkeypatch)
    ends = [event for event in events if event["event"] == "end"]
    assert [event["status"] for event in ends] == ["stopped", "stopped"]
    assert ends[0]["storage"] and "(No space left on device)" in ends[0]["reason"]
    assert str(store.run_folder(FIRST)) in ends[0]["reason"]
    assert [store.status(name).name for name in (FIRST, SECOND)] == ["planned", "planned"]


@pytest.mark.parametrize(
    ("error", "statuses", "final"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), ["stopped", "planned"], None),
        (OwnCodeError("by the corridor"), ["crashed", "crashed"], True),
        (RuntimeError("the engine broke"), ["crashed", "planned"], False),
    ],
)
def test_what_is_tried_again(
    error: Exception, statuses: list[str], final: bool | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All but what a user's own code raised; a full disk is no crash, though that could be stored."""

    def fail(*_: object) -> NoReturn:
        raise error

    monkeypatch.setattr(worker, "train_run", fail)
    store, events = Store(tmp_path), io.StringIO()
    worker.Worker(events, threading.Event()).train(Job({FIRST: RUNS[0]}, store, HERE))
    *_, end = map(json.loads, events.getvalue().splitlines())
    assert [end["status"], store.status(FIRST).name] == statuses
    assert end.get("final") is final


def test_a_machine_without_tensorboard_trains_all_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "torch.utils.tensorboard", None)
    config = ExecutorConfig(logs={FIRST: str(tmp_path / "logs")})
    is_sound, store, _ = _train(_Engine(), tmp_path, monkeypatch, config)
    assert is_sound and store.status(FIRST) == Status("done", 512)


def test_a_worker_ends_within_seconds_after_its_parent(tmp_path: Path) -> None:
    run = make_run({"steps": 10**9})
    job = Job({run_id(run): run}, Store(tmp_path), HERE)
    process = subprocess.Popen(
        [sys.executable, "-m", "pneuma.training.worker", str(os.getpid())],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=worker_environment(),
    )
    try:
        assert process.stdin is not None and process.stdout is not None
        process.stdin.write(job.to_json().encode() + b"\n")
        process.stdin.flush()
        assert any(json.loads(line).get("step", 0) > 0 for line in process.stdout)  # it is training
        process.stdin.close()
        assert process.wait(timeout=10) != 0
    finally:
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()
    assert Store(tmp_path).status(run_id(run)).name in ("planned", "partial")
