"""A study in trouble, through the command that people type, in processes of its own: Ctrl-C,
crashes, a full disk, two commands at once.
"""

from __future__ import annotations

import json
import os
import signal
import time
from pathlib import Path

import pytest

from pneuma.store.store import Store

from .commands import FOR_EVER, begin, wait_until, write_study
from .storm import children, wait_for_end


def checkpoints(folder: Path) -> list[Path]:
    return list((folder / "results").glob("runs/*/checkpoints/*.safetensors"))


# --- Ctrl-C ------------------------------------------------------------------------------------------


def test_after_ctrl_c_every_run_comes_to_a_checkpoint(tmp_path: Path) -> None:
    study = write_study(tmp_path, FOR_EVER, seeds=2)
    process = begin(tmp_path, study, "--workers", "2", "--checkpoint-seconds", "1000")
    wait_until(lambda: len(list(children(process.pid))) == 2)
    wait_until(lambda: len(list((tmp_path / "results").glob("runs/*/.lock"))) == 2)
    for worker in children(process.pid):
        os.kill(worker, signal.SIGTERM)  # as a shutdown or a queue does; only the parent decides
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=240)  # a busy machine compiles for minutes
    assert process.returncode == 130
    assert (
        err.count("Stopping after this step. Press Ctrl-C again to stop at once.") == 1
        and "The same command goes on where every run was stopped" in err
    )
    count = len(checkpoints(tmp_path))  # on a busy machine one run may not have reached its first update
    store = Store(tmp_path / "results")
    states = sorted(store.status(name).name for name in store.runs())
    assert count >= 1 and states == ["partial"] * count + ["planned"] * (2 - count)
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
    start = time.monotonic()
    process.communicate(timeout=60)
    assert process.returncode == 130
    assert time.monotonic() - start < 10  # the update alone takes longer
    assert wait_for_end(workers) < 10


# --- Two at once -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_two_commands_on_one_folder_share_the_work(tmp_path: Path) -> None:
    study = write_study(tmp_path, 64 * 30, seeds=3)
    both = [begin(tmp_path, study, "--workers", "1") for _ in range(2)]
    outputs = [process.communicate(timeout=120) for process in both]
    assert [process.returncode for process in both] == [0, 0], outputs
    rows = [json.loads(out)["runs"] for out, _ in outputs]
    assert all(row["status"] == "done" for command_rows in rows for row in command_rows)
    assert [one["trained"] + other["trained"] for one, other in zip(*rows, strict=True)] == [1, 1, 1]
