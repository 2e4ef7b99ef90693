"""A study in trouble, through the command that people type, in processes of its own: Ctrl-C,
crashes, a full disk, two commands at once.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from pneuma.study.executors.local import one_thread_environment
from pneuma.study.executors.supervisor import STOPPING
from pneuma.study.store import Store

from .begun import FOR_EVER, begin, run, wait_for_words, wait_until, write_study
from .storm import children, wait_for_end


def checkpoints(folder: Path) -> list[Path]:
    return list((folder / "results").glob("runs/*/checkpoints/*.safetensors"))


# --- Ctrl-C ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_after_ctrl_c_every_run_comes_to_a_checkpoint(tmp_path: Path, number: int) -> None:
    study = write_study(tmp_path, FOR_EVER, seeds=2)
    process = begin(tmp_path, study, "--workers", "2", "--checkpoint-seconds", "1000")
    wait_until(lambda: len(list(children(process.pid))) == 2)
    wait_until(lambda: len(list((tmp_path / "results").glob("runs/*/.lock"))) == 2)
    process.send_signal(number)
    out, told = process.communicate(timeout=60)
    assert process.returncode == 130
    assert told.count(STOPPING) == 1 and "The same command goes on where every run was stopped" in told
    begun = len(checkpoints(tmp_path))  # on a busy machine one may not have come to its first update
    store = Store(tmp_path / "results")
    states = sorted(store.status(name).name for name in store.runs())
    assert begun >= 1 and states == ["partial"] * begun + ["planned"] * (2 - begun)
    rows = json.loads(out)["runs"]
    assert sorted(row["status"] for row in rows) == states and not any(row["trained"] for row in rows)


def test_ctrl_c_twice_ends_all_at_once(tmp_path: Path) -> None:
    study = write_study(tmp_path, FOR_EVER, settings="slots = 1000\n")
    process = begin(tmp_path, study)  # 1,000 slots: an update takes long
    wait_until(lambda: list((tmp_path / "results").glob("runs/*/.lock")))
    workers = list(children(process.pid))
    process.send_signal(signal.SIGINT)
    time.sleep(0.2)
    process.send_signal(signal.SIGINT)
    begun = time.monotonic()
    process.communicate(timeout=60)
    assert process.returncode == 130
    assert time.monotonic() - begun < 10  # the update alone takes longer
    assert wait_for_end(workers) < 10


# --- Failures ----------------------------------------------------------------------------------------


REWARD = """\
import numpy as np
calls = 0
def reward(events, players, stats):
    global calls
    calls += 1
    if calls > 100:
        raise ZeroDivisionError("at the hundredth call")
    return np.zeros(events.shape)
"""


def test_a_crash_is_tried_once_more_and_told_with_its_traceback(tmp_path: Path) -> None:
    (tmp_path / "broken.py").write_text(REWARD)
    study = write_study(tmp_path, settings='reward = "broken:reward"')
    code, told, runs = run(tmp_path, study)
    assert (code, runs) == (1, [("crashed", True)])
    assert "tried once more" in told and "at the hundredth call" in told
    store = Store(tmp_path / "results")
    (name,) = store.runs()
    assert b"at the hundredth call" in store.read_file(name, "error.txt")


# --- A full disk -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_on_a_full_disk_the_study_says_so_and_goes_on_when_there_is_room(tmp_path: Path) -> None:
    """A limit on the size of files stands in for the full disk: small ones fit, checkpoints do not."""
    study = write_study(tmp_path)
    run(tmp_path, study)  # compiled code is in its cache now
    for path in (tmp_path / "results" / "runs").glob("*/*"):
        path.unlink()
    code, told, runs = run(tmp_path, study, limit="ulimit -f 20;")  # files of 20 KiB at most
    assert code == 1
    assert "cannot be written" in told
    assert runs == [("crashed", True)]
    code, _, runs = run(tmp_path, study, "--retry-failed")
    assert (code, runs) == (0, [("done", True)])


# --- Two at once -------------------------------------------------------------------------------------


def test_two_commands_on_one_folder_share_the_work(tmp_path: Path) -> None:
    study = write_study(tmp_path, 64 * 30, seeds=3)
    both = [begin(tmp_path, study, "--workers", "1") for _ in range(2)]
    told = [process.communicate(timeout=120) for process in both]
    assert [process.returncode for process in both] == [0, 0], told
    rows = [json.loads(out)["runs"] for out, _ in told]
    assert all(row["status"] == "done" for one in rows for row in one)
    assert [one["trained"] + other["trained"] for one, other in zip(*rows, strict=True)] == [1, 1, 1]


def test_a_lock_dies_with_its_holder(tmp_path: Path) -> None:
    study = write_study(tmp_path, FOR_EVER)
    process = begin(tmp_path, study)
    wait_until(lambda: checkpoints(tmp_path))
    workers = list(children(process.pid))
    store = Store(tmp_path / "results")
    (name,) = store.runs()
    assert store.status(name).name == "running"
    os.kill(process.pid, signal.SIGKILL)
    process.communicate()
    assert wait_for_end(workers) < 2
    wait_until(lambda: store.status(name).name == "partial", 2.0)


def test_a_command_that_waits_for_another_is_stopped_by_one_ctrl_c(tmp_path: Path) -> None:
    study = write_study(tmp_path, FOR_EVER)
    first = begin(tmp_path, study)
    wait_until(lambda: checkpoints(tmp_path))
    second = begin(tmp_path, study)
    wait_for_words(second, "waiting for it")
    second.send_signal(signal.SIGINT)
    assert second.wait(timeout=30) == 130
    first.send_signal(signal.SIGINT)
    first.communicate(timeout=60)
    second.communicate()


def test_a_worker_computes_on_one_thread() -> None:
    """A large product takes no more of the processors' time than passes, whatever else is going on."""
    code = """
import time
import jax, numpy
square = numpy.ones((1024, 1024), numpy.float32)
product = jax.jit(lambda a: a @ a)
product(square).block_until_ready()
wall, own = time.perf_counter(), time.process_time()
for _ in range(20):
    product(square).block_until_ready()
print((time.process_time() - own) / (time.perf_counter() - wall))
"""
    told = subprocess.run(
        [sys.executable, "-c", code], env=one_thread_environment(), capture_output=True, text=True, check=True
    )
    assert float(told.stdout) < 1.2
