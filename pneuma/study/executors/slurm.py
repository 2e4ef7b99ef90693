"""The Slurm executor: groups of runs are arrays of jobs of a queue, on a results folder that all nodes share.

    groups → job.json → sbatch → `main` on a node: workers, supervised as on this machine → results folder
    this command ← what the queue tells of jobs, and the results folder of runs

The command only submits and watches. It can be left at any moment, and jobs go on. The same command watches
them again, and submits none twice, because a folder beside the results records what was submitted, until all
its runs are finished:

    RESULTS-slurm/NAME/job.json   the groups of runs of the array of that name
                       *.out      what its jobs printed
"""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import cache
from pathlib import Path

from pneuma.config import Run
from pneuma.errors import UserError, counted
from pneuma.study.executors.base import Detached, ExecutorConfig, OnEvent, Queued, read_job, watch, write_job
from pneuma.study.executors.local import Interrupts, Supervisor, prepare_node
from pneuma.study.provenance import SOURCE
from pneuma.study.store import Store

MOST_AT_ONCE = 256
MOST_IN_ARRAY = 1000
"""Slurm's usual MaxArraySize is 1001."""
LOOK_SECONDS = 5.0
"""Seconds between two looks at the queue, as every squeue is work for the controller."""
ANSWER_SECONDS = 8.0
SUBMIT_SECONDS = 60.0
USUAL_MINUTES = "60"
LEAD_SECONDS = 90
"""How long before a job's time is over it goes on to a checkpoint."""
MOST_REQUEUES = 1_000
OWN = ("array", "job_name", "nodes", "ntasks", "ntasks_per_node", "signal", "output", "open_mode")
GPU_OPTIONS = ("gres", "gpus", "gpus_per_node", "gpus_per_task")
NOTE = "job.json"
SIGNALS = (signal.SIGUSR2, signal.SIGTERM)
"""Signals for the end of a job's time, and for the loss of its node or `scancel`."""


def most_workers(how: ExecutorConfig) -> int:
    _options(how)
    if shutil.which("sbatch") is None:
        raise UserError(
            "--executor slurm: there is no sbatch on this machine; give the command where jobs are submitted"
        )
    return MOST_AT_ONCE


def run_groups(
    groups: Iterable[Mapping[str, Run]], store: Store, how: ExecutorConfig, on_event: OnEvent
) -> None:
    """Train each group of runs in a job of its own; see `base`. Refused jobs are a UserError."""
    wanted = [dict(group) for group in groups]
    left, asked = {name for group in wanted for name in group}, how.detach
    try:
        _submit(wanted, store, how)
        if not asked:
            return _watch(left, store, on_event, how)
    except KeyboardInterrupt:
        asked = False
    jobs = {  # of a run that was submitted again, the last
        run: (note.parent.name, place)
        for note, groups in _submitted(store).items()
        for place, group in enumerate(groups)
        for run in left.intersection(group)
    }
    names = ",".join(sorted({name for name, _ in jobs.values()}))
    raise Detached(
        f"Left. {counted(len({*jobs.values()}), 'job')} in Slurm's queue will go on: `pneuma study status` "
        f"shows them, the same command watches them again, `scancel --name={names}` stops them.",
        asked,
    )


# --- On a node ----------------------------------------------------------------------------------------


def main() -> None:
    """Train a group of a job; an argument is the job's file, another the group's number.

    Slurm sends USR2 before a job's time is over, which goes back into the queue then, and TERM when its node
    is taken away or it is cancelled. In both cases runs first go on to a checkpoint.
    """
    job, index = read_job(Path(sys.argv[1])), int(sys.argv[2])
    prepare_node(any(key in GPU_OPTIONS for key, _ in job.how.slurm))
    cores = int(os.environ.get("SLURM_CPUS_PER_TASK", "1"))
    with Interrupts(SIGNALS, most=1) as interrupts:
        Supervisor(job, [index], cores, lambda event: None, interrupts, shares=cores).work()
    _clear_finished(job.store)
    if signal.SIGUSR2 in interrupts.seen and int(os.environ.get("SLURM_RESTART_COUNT", "0")) < MOST_REQUEUES:
        place = f"{os.environ['SLURM_ARRAY_JOB_ID']}_{index}"  # the id of one may be that of the whole array
        subprocess.run(["scontrol", "requeue", place], check=False)
    if interrupts.seen:
        raise SystemExit(128 + signal.SIGTERM)


# --- In the command -----------------------------------------------------------------------------------


def _submit(groups: Sequence[Mapping[str, Run]], store: Store, how: ExecutorConfig) -> None:
    live = queued(store)
    fresh = [{name: run for name, run in group.items() if name not in live} for group in groups]
    fresh = [group for group in fresh if group]
    for array in (fresh[first : first + MOST_IN_ARRAY] for first in range(0, len(fresh), MOST_IN_ARRAY)):
        folder = _folder(store) / f"pneuma-{time.strftime('%Y%m%d-%H%M%S')}-{uuid.uuid4().hex[:6]}"
        try:
            write_job(folder / NOTE, array, store, how)  # before, so that none is forgotten
            _ask(*_sbatch(folder, len(array), how), text=_script(folder, how), seconds=SUBMIT_SECONDS)
        except (UserError, OSError) as error:
            shutil.rmtree(folder, ignore_errors=True)
            raise UserError(f"{error}; no job of these is submitted") from None


def _options(how: ExecutorConfig) -> dict[str, str]:
    """Return the options of sbatch that people give, without `setup`."""
    options = dict(how.slurm)
    if taken := [key for key in OWN if key in options]:
        raise UserError(f"--slurm {taken[0]}={options[taken[0]]}: is set by Pneuma")
    options.pop("setup", "")
    return options


def _sbatch(folder: Path, jobs: int, how: ExecutorConfig) -> list[str]:
    own = {
        "job_name": folder.name,
        "array": f"0-{jobs - 1}%{how.workers}",
        "nodes": "1",
        "ntasks": "1",
        "signal": f"B:USR2@{LEAD_SECONDS}",
        "output": str(folder / "%a.out"),
        "open_mode": "append",
    }
    options = {"requeue": "true", "time": USUAL_MINUTES, **_options(how), **own}
    words = {key.replace("_", "-"): value for key, value in options.items()}
    return [
        "sbatch",
        *(f"--{key}" if value == "true" else f"--{key}={value}" for key, value in words.items()),
    ]


def _script(folder: Path, how: ExecutorConfig) -> str:
    job = [sys.executable, "-P", "-m", "pneuma.study.executors.slurm", str(folder / NOTE)]
    return "\n".join(
        [
            "#!/bin/sh",
            dict(how.slurm).get("setup", ""),
            f"export PYTHONPATH={shlex.quote(str(SOURCE))}${{PYTHONPATH:+:$PYTHONPATH}}",
            f'exec {shlex.join(job)} "$SLURM_ARRAY_TASK_ID"',  # so that signals reach it
            "",
        ]
    )


def _watch(left: set[str], store: Store, on_event: OnEvent, how: ExecutorConfig) -> None:
    jobs: dict[str, Queued] = {}

    def live() -> dict[str, Queued]:
        nonlocal jobs
        with suppress(UserError):  # a busy controller, say: it is asked again
            jobs = queued(store)
        return jobs

    lost = f"its job is gone; what it printed lies in {_folder(store)}, the same command submits it again"
    watch(left, store, on_event, live, LOOK_SECONDS, lost, how.until)


# --- The queue, and what was submitted to it ----------------------------------------------------------


def _folder(store: Store) -> Path:
    root = store.root.resolve()
    return root.parent / f"{root.name}-slurm"


@cache
def _read_groups(note: Path) -> list[list[str]]:
    return [[*group] for group in read_job(note).groups]


def _submitted(store: Store) -> dict[Path, list[list[str]]]:
    """Return the runs of each job of all arrays of which runs are not finished, by the array's file."""
    found = {}
    for note in sorted(_folder(store).glob(f"*/{NOTE}")):
        with suppress(FileNotFoundError):  # a job has just cleared it away
            found[note] = _read_groups(note)
    return found


def _clear_finished(store: Store) -> None:
    """Remove what is noted of arrays whose runs are all finished; the output of failed runs stays."""
    for note, groups in _submitted(store).items():
        if all(store.status(run, quick=True).finished for group in groups for run in group):
            shutil.rmtree(note.parent, ignore_errors=True)


def queued(store: Store) -> dict[str, Queued]:
    """Return where the runs are that are in the queue, by their ids."""
    _clear_finished(store)  # of runs that were finished elsewhere
    arrays = {note.parent.name: groups for note, groups in _submitted(store).items()}
    if not arrays:
        return {}
    runs: dict[str, Queued] = {}
    names = f"--name={','.join(arrays)}"
    for line in _ask("squeue", "--noheader", "--array", names, "--format=%j|%K|%T|%i|%R"):
        name, place, state, job, where = line.split("|", 4)
        runs |= dict.fromkeys(arrays[name][int(place)], Queued(state, job, where))
    return runs


def _ask(*command: str, text: str = "", seconds: float = ANSWER_SECONDS) -> list[str]:
    try:
        answer = subprocess.run(
            command, input=text, capture_output=True, text=True, timeout=seconds, check=True
        ).stdout
    except (OSError, subprocess.SubprocessError) as error:
        reason = " ".join((getattr(error, "stderr", None) or str(error)).split())
        raise UserError(f"--executor slurm: {command[0]} failed on this machine: {reason}") from None
    return [line.strip() for line in answer.splitlines()]


if __name__ == "__main__":
    main()
