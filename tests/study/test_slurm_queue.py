"""What Slurm is asked for, what its answers mean, and how a job takes its signals; no queue is needed."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from pneuma.errors import UserError
from pneuma.study.executors import slurm, slurm_queue
from pneuma.study.executors.base import Place
from pneuma.study.executors.submissions import new_submission
from pneuma.study.store import Store

pytest.importorskip("submitit")

# --- What is asked of the queue ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "minutes"),
    [("90", 90), ("5:00", 5), ("5:01", 6), ("2:30:00", 150), ("1-12", 2160), ("1-0:30", 1470), ("0:30", 1)],
)
def test_times_are_read_as_sbatch_reads_them(text: str, minutes: int) -> None:
    assert slurm_queue.read_minutes(text) == minutes


@pytest.mark.parametrize("text", ["soon", "", "0", "1:2:3:4", "-5"])
def test_what_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(UserError, match="--slurm time="):
        slurm_queue.read_minutes(text)


def test_a_job_asks_for_what_people_say_and_may_always_be_requeued() -> None:
    told = slurm_queue.parameters(
        "mine", {"partition": "short", "mem": "4GB", "reservation": "course"}, 8, True
    )
    assert (told["partition"], told["mem"], told["gpus_per_node"]) == ("short", "4GB", 1)
    assert told["additional_parameters"] == {"requeue": True, "reservation": "course"}
    assert (told["time"], told["array_parallelism"]) == (60, 8)
    with pytest.raises(UserError, match="job_name=x: is set by Pneuma"):
        slurm_queue.parameters("mine", {"job-name": "x"}, 1, False)


def test_an_option_that_sbatch_does_not_have_is_told_with_the_nearest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sbatch = tmp_path / "sbatch"
    sbatch.write_text("#!/bin/sh\necho \"sbatch: unrecognized option '--partitoin=short'\" >&2\nexit 1\n")
    sbatch.chmod(0o755)
    (tmp_path / "srun").symlink_to(sbatch)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    with pytest.raises(UserError) as told:
        slurm_queue.check_submission(tmp_path, {"partitoin": "short"}, False)
    assert str(told.value).startswith(
        "--slurm partitoin=short: sbatch has no such option (did you mean partition?)"
    )


def test_what_is_wrong_without_asking_is_told_before_the_queue_is_asked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(slurm_queue, "check_programs", lambda: None)
    monkeypatch.setattr(slurm_queue, "_answer", lambda *_: pytest.fail("the queue was asked"))
    with pytest.raises(UserError, match="--slurm time=soon"):
        slurm.most_workers(Place("slurm", slurm=(("time", "soon"),)))


def test_a_job_that_nobody_looked_at_yet_has_no_reason_to_wait(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    submission = new_submission(Store(tmp_path / "results"), [["a"], ["b"]], 1)
    lines = [f"{submission.name}|7|{i}|7_{i}|PENDING|({why})" for i, why in enumerate(["None", "Priority"])]
    monkeypatch.setattr(slurm_queue, "_answer", lambda *_: "\n".join(lines))
    found = slurm_queue.jobs_of([submission])
    assert [job.where for job in found.values()] == ["", "(Priority)"]


# --- Signals -------------------------------------------------------------------------------------

_JOB = """
import os, selectors, signal, subprocess, sys, time
from pneuma.study.executors.slurm_job import JobSignals
with JobSignals() as signals:
    child = subprocess.Popen([sys.executable, "-c", "input(); print('lives')"], stdin=-1, stdout=-1)
    for number in (signal.SIGUSR2, signal.SIGTERM, signal.SIGTERM):
        os.kill(child.pid, number)
        os.kill(os.getpid(), number)
    waiting = selectors.DefaultSelector()
    waiting.register(signals.wakeup, selectors.EVENT_READ)
    assert waiting.select(10)
    until = time.monotonic() + 10
    while len(signals.seen) < 2 and time.monotonic() < until:
        time.sleep(0.01)
    print(signals.count, sorted(map(int, signals.seen)), child.communicate(b"x")[0].decode().strip())
"""


def test_a_job_counts_all_signals_as_one_and_its_workers_outlive_them() -> None:
    done = subprocess.run(
        [sys.executable, "-c", _JOB], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout.strip() == f"1 {sorted([signal.SIGUSR2.value, signal.SIGTERM.value])} lives"
