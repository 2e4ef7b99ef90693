"""The Slurm executor: groups of runs are jobs of a queue, on a results folder that all nodes share.

    groups → arrays of jobs, by submitit → `Training` on a node: the local executor → results folder
    this command ← what the queue tells of jobs, and the results folder of runs

The command only submits and watches. It can be left at any moment, and jobs go on. The same command watches
them again, and submits none twice, because a folder beside the results records what was submitted:

    RESULTS-slurm/NAME/groups.json   the runs of each of the jobs of that name, and where each pauses
                       jobs/         submitit's files: pickled jobs, and what they printed
"""

from __future__ import annotations

import json
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
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

from pneuma.config import Run
from pneuma.errors import UserError, counted, install_extra
from pneuma.files import replace_files, to_json
from pneuma.study.executors.base import AGAIN, Detached, ExecutorConfig, Job, OnEvent, watch
from pneuma.study.executors.local import Interrupts, Supervisor, prepare_node
from pneuma.study.locks import is_held, run_lock
from pneuma.study.provenance import SOURCE
from pneuma.study.store import Store

MOST_AT_ONCE = 256
MOST_IN_ARRAY = 1000
"""Slurm's usual MaxArraySize is 1001."""
LOOK_SECONDS = 5.0
"""Seconds between two looks at the queue, as every squeue is work for the controller."""
ANSWER_SECONDS = 8.0
"""Seconds that Slurm's programs may take to answer."""
USUAL_MINUTES = "60"
"""Of a job; submitit needs a limit."""
MOST_REQUEUES = 1_000
"""Likewise."""
OWN = ("array", "job_name", "nodes", "ntasks_per_node", "signal")
"""Options that Pneuma sets itself."""
GPU_OPTIONS = ("gres", "gpus", "gpus_per_node", "gpus_per_task")
"""Options that give a job a GPU."""
NOTE = "groups.json"
SIGNALS = (signal.SIGUSR2, signal.SIGTERM)
"""Signals for the end of a job's time, and for the loss of its node or `scancel`."""


def most_workers(how: ExecutorConfig) -> int:
    _executor(Path("unused"), "unused", how)
    return MOST_AT_ONCE


def run_groups(
    groups: Iterable[Mapping[str, Run]], store: Store, how: ExecutorConfig, on_event: OnEvent
) -> None:
    """Train each group of runs in a job of its own; see `base.Executor`. Refused jobs are a UserError."""
    wanted = [dict(group) for group in groups]
    left, asked = {name for group in wanted for name in group}, how.detach
    try:
        if wanted:
            _submit(wanted, store, how)
        if not asked or not wanted:
            return _watch(left, store, on_event, how)
    except KeyboardInterrupt:
        asked = False
    jobs = [name for name, groups in _noted(store).items() for group in groups if not left.isdisjoint(group)]
    raise Detached(
        f"Left. {counted(len(jobs), 'job')} in Slurm's queue will go on: `pneuma study status` shows them, "
        f"the same command watches them again, `scancel --name={','.join(sorted({*jobs}))}` stops them.",
        asked,
    )


# --- On a node ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Training:
    """A job, in the form that submitit asks for: it is pickled, and called on a node.

    Before a job's time is over Slurm sends USR2, and submitit puts the job back into the queue. TERM means
    that its node is taken away, or that it is cancelled. In both cases runs first go on to a checkpoint.
    """

    runs: Mapping[str, Run]
    store: Store
    how: ExecutorConfig

    def __call__(self) -> None:
        prepare_node(any(key in GPU_OPTIONS for key, _ in self.how.slurm))
        cores = int(os.environ.get("SLURM_CPUS_PER_TASK", "1"))
        shares = [dict([*self.runs.items()][first::cores]) for first in range(min(cores, len(self.runs)))]
        how = replace(self.how, workers=cores)
        with Interrupts(SIGNALS, most=1) as interrupts:
            Supervisor(shares, self.store, how, lambda event: None, interrupts).work()
        if signal.SIGUSR2 in interrupts.seen:
            signal.raise_signal(signal.SIGUSR2)  # submitit's, which puts the job back into the queue
        if interrupts.seen:
            raise SystemExit(128 + signal.SIGTERM)

    def checkpoint(self) -> Any:
        """Return the job to put back into the queue: this one, as its checkpoints are in the store."""
        return import_module("submitit").helpers.DelayedSubmission(self)


# --- In the command -----------------------------------------------------------------------------------


def _submit(groups: Sequence[Mapping[str, Run]], store: Store, how: ExecutorConfig) -> None:
    """Submit groups, without runs that are in the queue already."""
    live = _put_away(store)
    fresh = [{name: run for name, run in group.items() if name not in live} for group in groups]
    fresh = [group for group in fresh if group]
    for array in (fresh[first : first + MOST_IN_ARRAY] for first in range(0, len(fresh), MOST_IN_ARRAY)):
        name = f"pneuma-{time.strftime('%Y%m%d-%H%M%S')}-{uuid.uuid4().hex[:6]}"
        folder, shared = _folder(store) / name, Store(store.root.resolve())
        executor = _executor(folder / "jobs", name, how)
        note = [{run: how.until.get(run, 0) for run in group} for group in array]
        try:
            with run_lock(folder):
                replace_files(folder, {NOTE: to_json(note)})  # before, so that none is forgotten
                executor.submit_array([Training(group, shared, how) for group in array])
        except Exception as error:  # submitit raises many kinds; it has printed sbatch's message
            shutil.rmtree(folder, ignore_errors=True)
            raise UserError(f"--executor slurm: jobs are not submitted: {error}") from None


def _watch(left: set[str], store: Store, on_event: OnEvent, how: ExecutorConfig) -> None:
    jobs: dict[str, Job] = {}

    def live() -> dict[str, Job]:
        nonlocal jobs
        with suppress(UserError):  # a busy controller, say: it is asked again
            jobs = queued(store)
        return jobs

    printed = f"what it printed lies in {_folder(store)}, {AGAIN}"
    watch(left, store, on_event, live, LOOK_SECONDS, f"its job is gone; {printed}", how.until)
    with suppress(UserError):  # remaining files are removed next time
        _put_away(store)


# --- The queue, and what was submitted to it ----------------------------------------------------------


def _folder(store: Store) -> Path:
    root = store.root.resolve()
    return root.parent / f"{root.name}-slurm"


def _noted(store: Store) -> dict[str, list[dict[str, int]]]:
    """Return the runs of all submitted jobs that were not cleared away yet, by the name of their array.

    Each run has the step at which its job pauses it; 0 is the end.
    """
    noted = {}
    for note in sorted(_folder(store).glob(f"*/{NOTE}")):
        with suppress(FileNotFoundError):  # another command has cleared it away
            noted[note.parent.name] = json.loads(note.read_bytes())
    return noted


def _put_away(store: Store) -> dict[str, Job]:
    """Clear away submissions that are not in the queue, which is returned; output of failed runs stays."""
    before = {name: runs for name, runs in _noted(store).items() if not is_held(_folder(store) / name)}
    live = queued(store)  # asked afterwards: what others submit meanwhile stays
    for name, groups in before.items():
        runs = {run for group in groups for run in group}
        if runs.isdisjoint(live):
            (_folder(store) / name / NOTE).unlink(missing_ok=True)
            if all(store.status(run).finished for run in runs):
                shutil.rmtree(_folder(store) / name, ignore_errors=True)
    return live


def queued(store: Store) -> dict[str, Job]:
    """Return the queued and running jobs, by the ids of their runs."""
    noted = _noted(store)
    if not noted:
        return {}
    jobs: dict[str, Job] = {}
    names = f"--name={','.join(noted)}"
    for line in _ask("squeue", "--noheader", "--array", names, "--format=%j|%K|%T|%i|%R"):
        name, place, state, job, where = line.split("|", 4)
        group = noted[name][int(place) if place.isdecimal() else 0]  # a single job is no array
        jobs |= {run: Job(state, job, where, until) for run, until in group.items()}
    return jobs


def _executor(folder: Path, name: str, how: ExecutorConfig) -> Any:
    options = {key: True if text == "true" else text for key, text in how.slurm}
    if taken := [key for key in OWN if key in options]:
        raise UserError(f"--slurm {taken[0]}={options[taken[0]]}: is set by Pneuma")
    path = f"export PYTHONPATH={shlex.quote(str(SOURCE))}${{PYTHONPATH:+:$PYTHONPATH}}"
    cores = "export SRUN_CPUS_PER_TASK=${SLURM_CPUS_PER_TASK:-1}"  # since 22.05 srun asks anew
    setup = [path, cores, str(options.pop("setup", ""))]
    try:
        executor = import_module("submitit").SlurmExecutor(
            folder, max_num_timeout=MOST_REQUEUES, python=f"{shlex.quote(sys.executable)} -P"
        )
    except ImportError:
        raise UserError(f"--executor slurm needs submitit: {install_extra('slurm')}") from None
    except RuntimeError as error:
        raise UserError(f"--executor slurm: {error}; give the command where jobs are submitted") from None
    usual = {"requeue": True, "time": USUAL_MINUTES}
    parameters = {"job_name": name, "array_parallelism": how.workers, "setup": setup}
    executor.update_parameters(**parameters, additional_parameters={**usual, **options})
    return executor


def _ask(*command: str) -> list[str]:
    """Return the lines that a Slurm program prints."""
    try:
        answer = subprocess.run(
            command, capture_output=True, text=True, timeout=ANSWER_SECONDS, check=True
        ).stdout
    except (OSError, subprocess.SubprocessError) as error:
        reason = " ".join((getattr(error, "stderr", None) or str(error)).split())
        raise UserError(f"--executor slurm: {command[0]} does not answer on this machine: {reason}") from None
    return [line.strip() for line in answer.splitlines()]
