"""The Ray executor: groups of runs are tasks of a Ray cluster, on a results folder that all nodes share.

    groups → Ray → `train_here` on a node: workers, supervised as on this machine → results folder
    this command ← the state of runs in the results folder

Pneuma's code is sent to the nodes with the task. The packages that it computes with must be installed there
in the same versions. Without an address, a cluster is started on this machine for the command.
"""

from __future__ import annotations

import math
import os
import signal
import socket
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import chdir, suppress
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from typing import Any

from pneuma.config import Run
from pneuma.errors import UserError, install_extra
from pneuma.store.provenance import CARRIED_CODE, SOURCE, available_cores, code, machine
from pneuma.store.store import Status, Store
from pneuma.training.executors.base import Event, ExecutorConfig, Job, OnEvent, end_event
from pneuma.training.executors.local import Interrupts, Supervisor, prepare_node, say_stopping
from pneuma.training.worker import die_with

MOST_IN_TASK = 8
"""Most runs per task of the cluster, which trains them one after another in one process."""
JOIN_SECONDS = 5.0
LOOK_SECONDS = 1.0
LOOPBACK = ("localhost", "127.0.0.1", "[::1]")


def most_workers(config: ExecutorConfig) -> int:
    """Return how many runs the cluster's CPUs can train at once. No cluster is started to find out."""
    if find_spec("ray") is None:
        raise UserError(f"--executor ray needs Ray: {install_extra('ray')}")
    if config.address is None:
        return available_cores()
    join(config.address)
    import ray

    cpus = int(ray.cluster_resources().get("CPU", 0))
    if not cpus:
        raise UserError("--executor ray: no node of the cluster has a CPU to give")
    return cpus


def train_runs(runs: Mapping[str, Run], store: Store, config: ExecutorConfig, on_event: OnEvent) -> None:
    """Train runs on the nodes of a cluster; see `base`. Raises UserError if one cannot train them."""
    store.root.mkdir(parents=True, exist_ok=True)
    names, count = list(runs), min(MOST_IN_TASK, math.ceil(len(runs) / config.workers))
    groups = []
    for start in range(0, len(names), count):
        groups.append({name: runs[name] for name in names[start : start + count]})
    with Interrupts() as interrupts:
        join(config.address)  # within `Interrupts`: Ctrl-C would break the start of Ray
        if interrupts.count:
            raise KeyboardInterrupt
        tasks = _Tasks(groups, store, config, interrupts)
        try:
            _watch(runs, store, on_event, tasks.advance, config.until)
        finally:
            tasks.cancel()


class _Tasks:
    """The groups of runs that wait, and the cluster's tasks that train others."""

    def __init__(
        self,
        groups: Sequence[Mapping[str, Run]],
        store: Store,
        config: ExecutorConfig,
        interrupts: Interrupts,
    ) -> None:
        import ray

        self._waiting = list(groups)
        self._store, self._config, self._interrupts = store, config, interrupts
        self._start = ray.remote(num_cpus=1, max_calls=1, max_retries=1)(train_here).remote
        self._group_by_task: dict[Any, Mapping[str, Run]] = {}
        self._may_restart = config.address is None

    def advance(self) -> dict[str, str]:
        """Start waiting groups, and forget tasks that have ended; return where the other runs are, by id.

        Raises:
            UserError: if a node is not fit to train.
            KeyboardInterrupt: after Ctrl-C, when every run has come to a checkpoint.
        """
        self._start_waiting()
        ended = self._ended_tasks()
        if self._may_restart and any(_lost_with_cluster(task) for task in ended):
            self._restart_cluster()
        else:
            for task in ended:
                del self._group_by_task[task]
                _check(task)
        if self._interrupts.count:
            _stop(list(self._group_by_task), self._interrupts)
            raise KeyboardInterrupt
        places = {name: "job is waiting" for group in self._waiting for name in group}
        for group in self._group_by_task.values():
            places.update(dict.fromkeys(group, "job is in the cluster"))
        return places

    def cancel(self) -> None:
        import ray

        for task in self._group_by_task:
            ray.cancel(task, force=True)

    def _start_waiting(self) -> None:
        while self._waiting and len(self._group_by_task) < self._config.workers:
            group = self._waiting.pop(0)
            job = Job(group, self._store, replace(self._config, workers=1))
            task = self._start(job.to_json(), versions(), os.getcwd())
            self._group_by_task[task] = group

    def _ended_tasks(self) -> list[Any]:
        import ray

        tasks = list(self._group_by_task)
        if not tasks:
            return []
        ended, _ = ray.wait(tasks, num_returns=len(tasks), timeout=0)
        return list(ended)

    def _restart_cluster(self) -> None:
        """Start this machine's own cluster again: one of Ray's processes has died, and all others with it."""
        import ray

        self._may_restart = False
        self._waiting = [*self._group_by_task.values(), *self._waiting]
        self._group_by_task.clear()
        ray.shutdown()
        join.cache_clear()
        join(None)


def _watch(
    names: Iterable[str],
    store: Store,
    on_event: OnEvent,
    advance: Callable[[], Mapping[str, str]],
    until: Mapping[str, int],
) -> None:
    """Report events of runs in tasks until all runs have ended.

    Args:
        names: of the runs.
        store: where their results are kept.
        on_event: is called with each event.
        advance: returns where the runs are that have not ended, by their ids. A run that is nowhere and has
            no result is lost.
        until: the steps at which runs pause.
    """
    remaining = set(names)
    places: Mapping[str, str] = dict.fromkeys(remaining, "job is submitted")
    while remaining:
        places_before, places = places, advance()
        for name in sorted(remaining):
            status = store.status(name)
            place = places.get(name, places_before.get(name))
            if status.finished or place is None:
                remaining.remove(name)
                on_event(_end_event(name, status, until.get(name, 0)))
            elif status.step:
                on_event({"event": "step", "run_id": name, "step": status.step})
            elif place != places_before.get(name):
                on_event({"event": "status", "run_id": name, "text": place})
        if remaining:
            time.sleep(LOOK_SECONDS)


def _end_event(name: str, status: Status, pause_step: int) -> Event:
    """Return the event of the end of a run that has no task any more."""
    is_paused = 0 < pause_step <= status.step
    if status.finished or status.failed or status.name == "killed" or is_paused:
        return {**end_event(name, status), "reason": ""}
    return {**end_event(name, Status("killed", status.step)), "reason": "its node was lost twice"}


def _check(task: Any) -> None:
    """Stop if a task ended because its node is not fit to train. A lost task is no problem."""
    import ray

    try:
        ray.get(task)
    except (ray.exceptions.RayTaskError, ray.exceptions.RuntimeEnvSetupError) as error:
        cause = getattr(error, "cause", error)
        raise cause if isinstance(cause, UserError) else UserError(f"--executor ray: {cause}") from None
    except ray.exceptions.RayError:
        pass


def _lost_with_cluster(task: Any) -> bool:
    import ray

    try:
        ray.get(task)
    except ray.exceptions.RayError as error:
        return isinstance(error, ray.exceptions.LocalRayletDiedError)
    return False


def _stop(tasks: list[Any], interrupts: Interrupts) -> None:
    """Ask tasks to stop at a checkpoint; after another interrupt, end them at once."""
    import ray

    say_stopping()
    for task in tasks:
        ray.cancel(task)
    while tasks and interrupts.count < 2:
        tasks = ray.wait(tasks, num_returns=len(tasks), timeout=LOOK_SECONDS)[1]


# --- The cluster --------------------------------------------------------------------------------------


@cache
def join(address: str | None) -> None:
    """Join the cluster at an address, or start one on this machine; once per process."""
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"  # all this before Ray, which reads it when it is loaded
    os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")  # the nodes have their own environments
    if address is None or address.rpartition(":")[0] in LOOPBACK:
        # or Ray takes 127.0.0.1 for the machine's address in its network; it has no option for this
        os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")
    import ray
    from ray._private import worker

    if hasattr(worker, "print_to_stdstream"):  # else Ray writes on standard output, where --json does
        worker.print_to_stdstream = lambda *_, **__: None
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "CRITICAL"}
    if address is None:
        os.environ.setdefault("RAY_worker_niceness", "0")  # 15 else: runs would yield to whatever there is
        runtime: dict[str, Any] = {"env_vars": {"PYTHONPATH": str(SOURCE)}}  # the compiled library
        resources: dict[str, Any] = {"num_cpus": available_cores(), "_node_ip_address": "127.0.0.1"}
        with chdir(SOURCE):  # Ray lets its processes import from the current folder
            ray.init("local", include_dashboard=False, runtime_env=runtime, **resources, **quiet)
        return
    host, _, port = address.rpartition(":")
    try:  # or Ray would try for minutes
        socket.create_connection((host.strip("[]"), int(port)), JOIN_SECONDS).close()
        runtime = {
            "py_modules": [str(SOURCE / "pneuma")],
            "excludes": ["__pycache__"],
            "env_vars": {CARRIED_CODE: code()},
        }
        with chdir(SOURCE):
            ray.init(address, runtime_env=runtime, **quiet)
    except Exception as error:  # Ray raises many kinds of errors
        raise UserError(
            f"--address {address}: no cluster can be joined there ({error}); give the address that "
            "`ray start --head` printed, on a machine of the cluster"
        ) from None


# --- On a node ----------------------------------------------------------------------------------------


def train_here(text: str, required: Mapping[str, str], folder: str) -> None:
    """Train a job on the node that Ray calls this on.

    Args:
        text: the job, as JSON.
        required: the versions that the node must have.
        folder: the command's current one, from which users' rewards and levels are read.

    Raises:
        UserError: if the node has other versions, or does not see the results folder.
    """
    installed, node = versions(), socket.gethostname()
    missing = [f"{name} {version}" for name, version in required.items() if installed.get(name) != version]
    if missing:
        raise UserError(f"--executor ray: the node {node} lacks {', '.join(missing)}")
    job = Job.from_json(text)
    folders = [job.store.run_folder(name) for name in job.runs]
    if not all((run / "status.json").exists() for run in folders):  # the command has noted all runs there
        raise UserError(
            f"--executor ray: the node {node} does not see {job.store.root}: all must share that folder"
        )
    die_with(os.getppid())  # Ray's own process here
    with suppress(OSError):
        os.chdir(folder)
    prepare_node()
    with Interrupts([signal.SIGINT]) as interrupts:  # as `ray.cancel` does
        Supervisor(job.runs, job.store, job.config, lambda event: None, interrupts).work()


def versions() -> dict[str, str]:
    """Return the versions that must match between the command and every node, as they can change results."""
    about = machine()
    packages = {name: version for name, version in about["packages"].items() if name != "pneuma"}
    return {"Python": about["python"], **packages}
