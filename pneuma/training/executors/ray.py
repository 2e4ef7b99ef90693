"""The Ray executor: groups of runs are tasks of a Ray cluster, on a results folder that all nodes share.

    groups → Ray → `train_here` on a node: workers, supervised as on this machine → results folder
    this command ← the state of runs in the results folder

Pneuma's code is sent to the nodes. The packages that it computes with must be installed there in the same
versions. Without an address, the command starts a cluster on this machine.
"""

from __future__ import annotations

import math
import os
import signal
import socket
from collections.abc import Mapping
from contextlib import chdir, suppress
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from typing import Any

from pneuma.errors import Hint, UserError, install_command
from pneuma.store.provenance import CARRIED_CODE, SOURCE, available_cores, code, machine
from pneuma.store.store import Status
from pneuma.training.executors.base import RAY, Event, ExecutorConfig, Job, OnEvent, end_event
from pneuma.training.executors.local import Interrupts, Supervisor, prepare_node, print_stopping
from pneuma.training.worker import die_with

MOST_IN_TASK = 8
"""Most runs per task of the cluster, which trains them one after another in one process."""
JOIN_SECONDS = 5.0
LOOK_SECONDS = 1.0
EXECUTOR = Hint("executor", RAY)
LOOPBACK = ("localhost", "127.0.0.1", "[::1]")


def most_workers(config: ExecutorConfig) -> int:
    """Return how many runs the cluster's CPUs can train at once; this does not start a cluster."""
    if find_spec("ray") is None:
        raise UserError(EXECUTOR, f" needs Ray: {install_command('ray')}")
    if config.address is None:
        return available_cores()
    join(config.address)
    import ray

    cpus = int(ray.cluster_resources().get("CPU", 0))
    if not cpus:
        raise UserError(EXECUTOR, ": no node of the cluster has a free CPU")
    return cpus


def train_runs(job: Job, on_event: OnEvent) -> None:
    """Train runs on the nodes of a cluster; see `base`. Raises UserError if one cannot train them."""
    config = job.config
    job.store.root.mkdir(parents=True, exist_ok=True)
    run_ids, group_size = list(job.runs), min(MOST_IN_TASK, math.ceil(len(job.runs) / config.workers))
    jobs = []
    for group_start in range(0, len(run_ids), group_size):
        run_group = {run_id: job.runs[run_id] for run_id in run_ids[group_start : group_start + group_size]}
        jobs.append(replace(job, runs=run_group, config=replace(config, workers=1)))
    with Interrupts() as interrupts:
        join(config.address)  # within `Interrupts`: Ctrl-C would break the start of Ray
        if interrupts.count:
            raise KeyboardInterrupt
        _Tasks(jobs, config, on_event).watch(interrupts)


class _Tasks:
    """Jobs that wait for a node, and the cluster's tasks that train the others."""

    def __init__(self, jobs: list[Job], config: ExecutorConfig, on_event: OnEvent) -> None:
        self._waiting, self._config, self._on_event = jobs, config, on_event
        self._jobs_by_task: dict[Any, Job] = {}
        self._states: dict[str, str] = {}

    def watch(self, interrupts: Interrupts) -> None:
        """Start tasks, and report events of their runs, until all runs have ended.

        Raises:
            UserError: if a node cannot train.
            KeyboardInterrupt: after Ctrl-C, when every run has stopped at a checkpoint.
        """
        import ray

        start_task = ray.remote(num_cpus=1, max_calls=1, max_retries=1)(train_here).remote
        for job in self._waiting:
            self._report(job, "job is waiting")
        try:
            while self._waiting or self._jobs_by_task:
                while self._waiting and len(self._jobs_by_task) < self._config.workers:
                    job = self._waiting.pop(0)
                    self._jobs_by_task[start_task(job.to_json(), versions(), os.getcwd())] = job
                tasks = list(self._jobs_by_task)
                ended_tasks, _ = ray.wait(tasks, num_returns=len(tasks), timeout=LOOK_SECONDS)
                for task in ended_tasks:
                    _check(task)
                    self._report(self._jobs_by_task.pop(task), "")
                for job in self._jobs_by_task.values():
                    self._report(job, "job is in the cluster")
                if interrupts.count:
                    _stop(list(self._jobs_by_task), interrupts)
                    raise KeyboardInterrupt
        finally:
            for task in self._jobs_by_task:
                ray.cancel(task, force=True)

    def _report(self, job: Job, state: str) -> None:
        """Report the steps of a job's runs; with an empty `state` the job has ended."""
        for run_id in job.runs:
            if self._states.get(run_id) == "":
                continue
            status = job.store.status(run_id)
            if status.finished or not state:
                self._states[run_id] = ""
                self._on_event(_end_event(run_id, status, self._config.until.get(run_id, 0)))
                continue
            if status.step:
                self._on_event({"event": "step", "run_id": run_id, "step": status.step})
            elif state != self._states.get(run_id):
                self._on_event({"event": "status", "run_id": run_id, "text": state})
            self._states[run_id] = state


def _end_event(run_id: str, status: Status, pause_step: int) -> Event:
    """Return the end event of a run whose task has ended."""
    is_paused = 0 < pause_step <= status.step
    if status.finished or status.failed or status.name == "killed" or is_paused:
        return end_event(run_id, status.name, status.step)
    return end_event(run_id, "killed", status.step, reason="its node was lost twice")


def _check(task: Any) -> None:
    """Raise the error of a task that cannot train on its node; a lost task is tried again."""
    import ray

    try:
        ray.get(task)
    except (ray.exceptions.RayTaskError, ray.exceptions.RuntimeEnvSetupError) as error:
        cause = getattr(error, "cause", error)
        raise cause if isinstance(cause, UserError) else UserError(EXECUTOR, f": {cause}") from None
    except ray.exceptions.RayError:
        pass


def _stop(tasks: list[Any], interrupts: Interrupts) -> None:
    """Stop tasks at a checkpoint; after another interrupt return at once."""
    import ray

    print_stopping()
    for task in tasks:
        ray.cancel(task)
    while tasks and interrupts.count < 2:
        tasks = ray.wait(tasks, num_returns=len(tasks), timeout=LOOK_SECONDS)[1]


# --- The cluster --------------------------------------------------------------------------------------


@cache
def join(address: str | None) -> None:
    """Join the cluster at an address, or start one on this machine; once per process."""
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"  # Ray reads variables when it is imported
    os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")  # the nodes have their own environments
    if address is None or address.rpartition(":")[0] in LOOPBACK:
        # without this, Ray replaces 127.0.0.1 by the machine's address in its network
        os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")
    import ray
    from ray._private import worker

    if hasattr(worker, "print_to_stdstream"):  # otherwise Ray prints into the output of --json
        worker.print_to_stdstream = lambda *_, **__: None
    quiet_options: dict[str, Any] = {"log_to_driver": False, "logging_level": "CRITICAL"}
    if address is None:
        os.environ.setdefault("RAY_worker_niceness", "0")  # Ray's default is 15
        runtime_env: dict[str, Any] = {"env_vars": {"PYTHONPATH": str(SOURCE)}}
        resources: dict[str, Any] = {"num_cpus": available_cores(), "_node_ip_address": "127.0.0.1"}
        with chdir(SOURCE):  # Ray's processes import from the current folder
            ray.init("local", include_dashboard=False, runtime_env=runtime_env, **resources, **quiet_options)
        return
    host, _, port = address.rpartition(":")
    try:
        # Ray itself would try for minutes
        socket.create_connection((host.strip("[]"), int(port)), JOIN_SECONDS).close()
        runtime_env = {
            "py_modules": [str(SOURCE / "pneuma")],
            "excludes": ["__pycache__"],
            "env_vars": {CARRIED_CODE: code()},
        }
        with chdir(SOURCE):
            ray.init(address, runtime_env=runtime_env, **quiet_options)
    except Exception as error:  # Ray raises many kinds of errors
        raise UserError(
            Hint("address", address),
            f": cannot join a cluster there ({error}); give the address that `ray start --head` printed, "
            "on a machine of the cluster",
        ) from None


# --- On a node ----------------------------------------------------------------------------------------


def train_here(job_text: str, required: Mapping[str, str], current_folder: str) -> None:
    """Train a job on the node that Ray calls this on.

    Args:
        job_text: the job, as JSON.
        required: the versions that the node must have.
        current_folder: the command's, to which paths of users' rewards and levels are relative.

    Raises:
        UserError: if the node has other versions, or does not have the results folder.
    """
    installed, node = versions(), socket.gethostname()
    missing = [f"{name} {version}" for name, version in required.items() if installed.get(name) != version]
    if missing:
        raise UserError(EXECUTOR, f": the node {node} lacks {', '.join(missing)}")
    job = Job.from_json(job_text)
    folders = [job.store.run_folder(name) for name in job.runs]
    if not all((run / "status.json").exists() for run in folders):  # the command has noted all runs there
        raise UserError(
            EXECUTOR, f": the node {node} cannot see {job.store.root}: all nodes must share that folder"
        )
    die_with(os.getppid())  # Ray's own process here
    with suppress(OSError):
        os.chdir(current_folder)
    prepare_node()
    with Interrupts([signal.SIGINT]) as interrupts:  # as `ray.cancel` does
        Supervisor(job, lambda event: None, interrupts).work()


def versions() -> dict[str, str]:
    """Return the versions that must be the same here and on every node, because they can change results."""
    machine_facts = machine()
    packages = {name: version for name, version in machine_facts["packages"].items() if name != "pneuma"}
    return {"Python": machine_facts["python"], **packages}
