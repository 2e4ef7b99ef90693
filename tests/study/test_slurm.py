"""The Slurm executor without a Slurm: jobs run on this machine, a list stands in for squeue."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from pneuma.config import Run, make_run
from pneuma.errors import UserError
from pneuma.study.executors import local, slurm
from pneuma.study.executors.base import LOCAL_CONFIG, Detached, Event, ExecutorConfig
from pneuma.study.identity import run_id
from pneuma.study.store import Status, Store

from ..training import training_here
from .begun import outcome

SETTINGS = {"env": "pneuma/Mailman-v0", "engine": "tabular", "algorithm": "q-learning", "horizon": 10}
HOW = ExecutorConfig(2, executor="slurm")
DETACHED = replace(HOW, detach=True)


def group(*seeds: int, steps: int = 500) -> dict[str, Run]:
    runs = [make_run({**SETTINGS, "steps": steps, "learning_rate": 0.5, "seed": seed}) for seed in seeds]
    return {run_id(run): run for run in runs}


class Queue:
    """In Slurm's place: keeps every array, answers as squeue does; its jobs run here, or do nothing."""

    def __init__(self, runs_jobs: bool) -> None:
        self.submitted: dict[str, list[subprocess.Popen[bytes] | None]] = {}
        self.runs_jobs = runs_jobs
        self.gone = False

    def ask(self, *command: str, text: str = "", seconds: float = 0.0) -> list[str]:
        if command[0] == "sbatch":
            return self.submit(command, text)
        return [
            f"{name}|{i}|RUNNING|7_{i}|node1"
            for name, jobs in self.submitted.items()
            for i, job in enumerate(jobs)
            if not self.gone and not (job and job.poll() is not None)
        ]

    def submit(self, command: Sequence[str], script: str) -> list[str]:
        asked = dict(word.removeprefix("--").split("=", 1) for word in command if "=" in word)
        numbers = range(int(asked["array"].removeprefix("0-").partition("%")[0]) + 1)
        self.submitted[asked["job-name"]] = [
            self.start(script, n) if self.runs_jobs else None for n in numbers
        ]
        return ["Submitted batch job 7"]

    def start(self, script: str, number: int) -> subprocess.Popen[bytes]:
        environment = {**os.environ, "SLURM_ARRAY_TASK_ID": str(number), "SLURM_CPUS_PER_TASK": "2"}
        return subprocess.Popen(["sh", "-c", script], env=environment)


@pytest.fixture
def queue(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Queue:
    queue = Queue(getattr(request, "param", False))
    monkeypatch.setattr(slurm, "_ask", queue.ask)
    monkeypatch.setattr(slurm, "LOOK_SECONDS", 0.05)
    return queue


def train(groups: Sequence[Mapping[str, Run]], store: Store, how: ExecutorConfig = HOW) -> list[Event]:
    events: list[Event] = []
    slurm.run_groups(groups, store, how, events.append)
    return events


def ends(events: Sequence[Event]) -> dict[str, str]:
    return {event["run_id"]: event["status"] for event in events if event["event"] == "end"}


def folders(store: Store) -> list[Path]:
    return list((store.root.parent / "results-slurm").glob("*"))


# --- Submitting and watching -------------------------------------------------------------------------


@pytest.mark.parametrize("queue", [True], indirect=True)
def test_jobs_leave_what_local_leaves_and_none_is_submitted_twice(
    queue: Queue, store: Store, tmp_path: Path
) -> None:
    groups = [group(0, 1), group(2)]
    with pytest.raises(Detached, match="2 jobs in Slurm's queue will go on"):
        train(groups, store, DETACHED)
    assert ends(train(groups, store)) == dict.fromkeys({**groups[0], **groups[1]}, "done")
    (jobs,) = queue.submitted.values()
    assert [job.wait() for job in jobs if job] == [0, 0]

    beside = Store(tmp_path / "beside")
    with training_here():
        local.run_groups(groups, beside, HOW, lambda event: None)
    assert outcome(store.root) == outcome(beside.root)
    assert not folders(store)


def test_a_run_whose_job_went_is_told_and_submitted_by_the_next_command(queue: Queue, store: Store) -> None:
    """Of three in a job, one was stored, one is stored as crashed, and of one nothing is known."""
    runs = group(3, 4, 5)
    with pytest.raises(Detached):
        train([runs], store, DETACHED)
    done, crashed, lost = runs
    assert {job.id for job in slurm.queued(store).values()} == {"7_0"}
    store.save_run(done, Status("done", 500), {"run.json": b"{}"})
    store.save_run(crashed, Status("crashed"), {"run.json": b"{}"})
    queue.gone = True
    events: list[Event] = []
    slurm._watch({*runs}, store, events.append, LOCAL_CONFIG)
    assert ends(events) == {done: "done", crashed: "crashed", lost: "killed"}
    assert "results-slurm" in next(event["reason"] for event in events if event.get("reason"))
    assert folders(store)  # what its job printed tells why
    with pytest.raises(Detached, match="1 job"):
        train([{lost: runs[lost]}], store, DETACHED)
    assert len(queue.submitted) == 2


def test_a_job_asks_for_what_people_say_and_may_always_be_requeued(tmp_path: Path) -> None:
    words = {*slurm._sbatch(tmp_path / "mine", 3, HOW)}
    assert words >= {"--time=60", "--requeue", "--array=0-2%2", "--signal=B:USR2@90", "--job-name=mine"}
    own = (("time", "2:30:00"), ("gres", "gpu:a100:1"), ("exclusive", "true"), ("setup", "module load x"))
    how = replace(HOW, slurm=own)
    asked = {"--time=2:30:00", "--gres=gpu:a100:1", "--exclusive", "--requeue"}
    assert {*slurm._sbatch(tmp_path / "mine", 3, how)} >= asked
    assert "\nmodule load x\nexport PYTHONPATH=" in slurm._script(tmp_path / "mine", how)
    with pytest.raises(UserError, match="job_name=x: is set by Pneuma"):
        slurm.most_workers(replace(HOW, slurm=(("job_name", "x"),)))


def test_jobs_that_sbatch_refuses_leave_nothing(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "sbatch").write_text("#!/bin/sh\necho 'invalid partition' >&2\nexit 1\n")
    (tmp_path / "sbatch").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=os.pathsep)
    with pytest.raises(UserError, match="sbatch failed .* invalid partition; no job"):
        train([group(8)], store)
    assert not folders(store)


# --- A job and its signals ---------------------------------------------------------------------------

_JOB = """
import os, signal, sys, threading, time
from pathlib import Path
from pneuma.study.executors import slurm
from pneuma.study.executors.base import ExecutorConfig, write_job
from pneuma.study.store import Store
from tests.study.test_slurm import group
from tests.study.storm import children

store, numbers = Store(sys.argv[1]), [signal.Signals[name] for name in sys.argv[2:]]

def hit():
    while not list(store.root.glob("runs/*/checkpoints/*")):
        time.sleep(0.05)
    for number in numbers:
        for pid in (*children(os.getpid()), os.getpid()):
            os.kill(pid, number)

how = ExecutorConfig(1, checkpoint_seconds=1000, keep_checkpoints=2)
job = write_job(store.root.parent / "job.json", [group(0, steps=10**9)], store, how)
sys.argv[1:] = [str(job.path), "0"]
threading.Thread(target=hit, daemon=True).start()
slurm.main()
"""


def test_a_job_comes_to_checkpoints_before_it_goes(store: Store) -> None:
    """Slurm signals all processes of a job: workers outlive it, and a second signal ends nothing at once.

    The checkpoint after the first update, which is to be kept, tells when the run is under way.
    """
    scontrol = store.root.parent / "scontrol"
    scontrol.write_text('#!/bin/sh\necho "$@"\n')
    scontrol.chmod(0o755)
    path = f"{scontrol.parent}{os.pathsep}{os.environ['PATH']}"
    told = {"XDG_CACHE_HOME": str(store.root.parent), "SLURM_ARRAY_JOB_ID": "7", "PATH": path}
    environment = {**os.environ, **told}
    done = subprocess.run(
        [sys.executable, "-c", _JOB, str(store.root), "SIGTERM", "SIGUSR2"],
        capture_output=True, text=True, timeout=120, env=environment,
    )  # fmt: skip
    assert (done.returncode, done.stdout.strip()) == (128 + signal.SIGTERM, "requeue 7_0"), done.stderr
    status = store.status(next(iter(group(0, steps=10**9))))
    assert status.name == "partial" and status.step > 10  # an update
