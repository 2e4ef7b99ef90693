"""The runtime estimate from runs like it, and what is kept of the machines that produced a run."""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, cast

import llvmlite.binding
import numpy as np
import pandas as pd
import pytest
from gymnasium.envs.registration import register, registry

from pneuma.config import Run, as_fields, make_run
from pneuma.store.provenance import Attempt, finished_provenance, machine, packages_of, project
from pneuma.store.store import Store
from pneuma.study.identity import run_id
from pneuma.training.executors.local import worker_environment
from pneuma.training.progress import START_SECONDS, expected_seconds, stored_paces

from ..checkout import commit_all
from ..hand_made import save_run

RUN = make_run({"steps": 2560, "horizon": 256})
HERE = {"cpu": machine()["cpu"], "device": "cpu"}
XEON = {"cpu": "Intel Xeon", "device": "cpu"}


def save(store: Store, run: Run, step: int, seconds: float, *machines: dict[str, Any]) -> None:
    """Store a run that took so long for its steps, on the last of some machines."""
    attempts = [{"machine": run_machine, "step": step} for run_machine in machines]
    about = {"wall_seconds": seconds + 9, "training_seconds": seconds, **machines[-1], "attempts": attempts}
    save_run(store, run_id(run), [], [], [], step, fields=as_fields(run), **about)


def test_a_run_like_those_that_ended_takes_as_long_on_such_a_processor(tmp_path: Path) -> None:
    """Runs of another processor, or of two, do not count. A pace is of the steps that were trained."""
    store = Store(tmp_path)
    save(store, replace(RUN, seed=1), 2560, 2560 * 0.004, XEON)
    save(store, replace(RUN, seed=2), 2560, 2560 * 0.9, HERE, XEON)
    save(store, replace(RUN, seed=3), 512, 512 * 0.001, HERE)  # it diverged
    seconds = expected_seconds(stored_paces(store, []), RUN, 1000)
    assert seconds == pytest.approx(START_SECONDS + 1000 * 0.001)
    assert expected_seconds({}, RUN, RUN.steps) is None  # it is unlike all others


# --- What produced a run ---------------------------------------------------------------------------


def target_of_a_worker(*compiling: str) -> str:
    """Return what a worker would keep as its target; it loads numba if that is asked for."""
    code = f"{'; '.join(compiling)}\nfrom pneuma.store.provenance import machine\nprint(machine()['target'])"
    command = [sys.executable, "-c", code]
    return subprocess.check_output(command, env=worker_environment(), text=True).strip()


def test_the_target_is_what_numba_compiles_for_and_variables_are_passed_by_name_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    compiling = "import numba"
    own = target_of_a_worker(compiling)
    assert own.split()[0] == llvmlite.binding.get_host_cpu_name()
    assert target_of_a_worker() == "None"
    monkeypatch.setenv("NUMBA_CPU_NAME", "x86-64")
    monkeypatch.setenv("NUMBA_CPU_FEATURES", "+sse2")
    assert target_of_a_worker(compiling) == own
    monkeypatch.setenv("PNEUMA_PASS", "NUMBA_CPU_NAME,NUMBA_CPU_FEATURES")
    assert target_of_a_worker(compiling) == "x86-64 +sse2 (set by NUMBA_CPU_NAME and NUMBA_CPU_FEATURES)"


def test_a_study_has_its_commit_and_a_run_the_packages_of_its_modules(
    tmp_path: Path,
) -> None:
    study = tmp_path / "within" / "mine.toml"
    study.parent.mkdir()
    study.touch()
    assert project(study) == {"study": "mine.toml"}
    head = commit_all(tmp_path)
    assert project(study)["commit"] == head
    module = study.with_name("own.py")
    module.touch()
    assert project(study)["commit"] == project(study, [study, Path("/etc/hosts")])["commit"] == head
    assert project(study, [module])["commit"] == f"{head}-dirty"  # untracked, as the study itself
    module.rename(new := study.with_name("new.toml"))
    assert project(new)["commit"] == f"{head}-dirty"
    study.write_text("title")
    assert project(study)["commit"] == f"{head}-dirty"
    run = make_run({"env": "CartPole-v1", "wrappers": ["numpy.random:Generator", "NormalizeObservation"]})
    assert packages_of(run) == {"numpy": np.__version__}
    register("Own-v0", entry_point=cast(Any, pd.DataFrame))  # a class, and not its name
    assert packages_of(make_run({"env": "Own-v0"})) == {"pandas": pd.__version__}
    del registry["Own-v0"]


# --- Every attempt keeps its machine -----------------------------------------


def test_every_attempt_keeps_its_machine_and_the_last_one_stands_first() -> None:
    elsewhere = {**machine(), "cpu": "abacus", "commit": "0" * 40}
    began = "2026-01-01T00:00:00+00:00"
    last = Attempt(512).so_far(1024)
    earlier = {**last, "started": began, "wall_seconds": 100.0, "step": 512, "machine": elsewhere}
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
    attempt = Attempt(600)
    clock[0] += 22
    attempt.update(700)
    assert attempt.so_far(700)["training_seconds"] == 22  # compiling and training are not separable yet
    clock[0] += 6
    attempt.update(1000)
    so_far = attempt.so_far(1000)
    assert (so_far["wall_seconds"], so_far["training_seconds"]) == (28, 8)
    before = {**so_far, "started": "then", "wall_seconds": 100.0, "training_seconds": 90.0, "step": 600}
    about = finished_provenance([before, so_far])
    assert (about["wall_seconds"], about["training_seconds"]) == (128, 98)
