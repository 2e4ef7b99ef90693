"""The Ray executor: groups of runs are tasks of a Ray cluster, on a results folder that all nodes share.

    groups → Ray → `train_here` on a node: workers, supervised as on this machine → results folder
    this command ← the state of runs in the results folder

Pneuma's code is sent to the nodes with the task. The packages that it computes with must be installed there
in the same versions. Without an address, a cluster is started on this machine for the command.
"""

from __future__ import annotations

import os
import signal
import socket
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import chdir, suppress
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from typing import Any

from pneuma.config import Run
from pneuma.errors import UserError, install_extra
from pneuma.store.provenance import CARRIED_CODE, SOURCE, available_cores, code, machine
from pneuma.store.store import Status, Store
from pneuma.training.executors.base import ExecutorConfig, Job, OnEvent, end_event
from pneuma.training.executors.local import Interrupts, Supervisor, prepare_node, say_stopping
from pneuma.training.worker import die_with

JOIN_SECONDS = 5.0
LOOK_SECONDS = 1.0
LOOPBACK = ("localhost", "127.0.0.1", "[::1]")


def most_workers(how: ExecutorConfig) -> int:
    """Return how many runs the cluster's CPUs can train at once. No cluster is started to find out."""
    if find_spec("ray") is None:
        raise UserError(f"--executor ray needs Ray: {install_extra('ray')}")
    if how.address is None:
        return available_cores()
    join(how.address)
    import ray

    room = int(ray.cluster_resources().get("CPU", 0))
    if not room:
        raise UserError("--executor ray: no node of the cluster has a CPU to give")
    return room


def run_groups(
    groups: Iterable[Mapping[str, Run]], store: Store, how: ExecutorConfig, on_event: OnEvent
) -> None:
    """Train each group of runs on a node; see `base`. Raises UserError if one cannot train them."""
    store.root.mkdir(parents=True, exist_ok=True)
    waiting = [*groups]
    left = {name for group in waiting for name in group}
    with Interrupts() as interrupts:
        join(how.address)  # within `Interrupts`: Ctrl-C would break the start of Ray
        if interrupts.count:
            raise KeyboardInterrupt
        import ray

        told = versions(), os.getcwd()
        start = ray.remote(num_cpus=1, max_calls=1, max_retries=1)(train_here).remote
        tasks: dict[Any, Mapping[str, Run]] = {}
        may_restart = how.address is None

        def live() -> dict[str, str]:
            """Return the runs of tasks that have not ended, with where they are, and keep those tasks."""
            nonlocal may_restart
            while waiting and len(tasks) < how.workers:
                group = waiting.pop(0)
                job = Job(group, store, replace(how, workers=1))
                tasks[start(job.to_json(), *told)] = group
            ended = ray.wait([*tasks], num_returns=len(tasks), timeout=0)[0] if tasks else []
            if may_restart and any(map(_lost_with_cluster, ended)):
                may_restart, ended = False, []
                waiting[:0] = tasks.values()
                tasks.clear()
                _restart()
            for task in ended:
                del tasks[task]
                _check(task)
            if interrupts.count:
                _stop([*tasks], interrupts)
                raise KeyboardInterrupt
            return {
                **{name: "job is waiting" for group in waiting for name in group},
                **{name: "job is in the cluster" for group in tasks.values() for name in group},
            }

        try:
            _watch(left, store, on_event, live, how.until)
        finally:
            for task in tasks:
                ray.cancel(task, force=True)


def _watch(
    left: set[str],
    store: Store,
    on_event: OnEvent,
    live: Callable[[], Mapping[str, str]],
    until: Mapping[str, int],
) -> None:
    """Report events of runs in tasks until all runs have ended; ended ones are removed from `left`.

    `live` returns where the remaining runs are, by their ids. A run that is nowhere and has no result is
    lost. `until` has the steps at which runs pause.
    """
    places: Mapping[str, str] = dict.fromkeys(left, "job is submitted")
    while left:
        before, places = places, live()
        for name in sorted(left):
            status, place = store.status(name), places.get(name, before.get(name))
            if status.finished or place is None:
                left.discard(name)
                ended = status.finished or status.failed or status.name == "killed"
                ended = ended or 0 < until.get(name, 0) <= status.step
                told = status if ended else Status("killed", status.step)
                reason = "" if ended else "its node was lost twice"
                on_event({**end_event(name, told), "reason": reason})
            elif status.step:
                on_event({"event": "step", "run_id": name, "step": status.step})
            elif place != before.get(name):
                on_event({"event": "status", "run_id": name, "text": place})
        time.sleep(LOOK_SECONDS if left else 0)


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


def _restart() -> None:
    """Start this machine's own cluster again: one of Ray's processes has died, and all others with it."""
    import ray

    ray.shutdown()
    join.cache_clear()
    join(None)


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
        sent: dict[str, Any] = {"env_vars": {"PYTHONPATH": str(SOURCE)}}  # the compiled library
        resources: dict[str, Any] = {"num_cpus": available_cores(), "_node_ip_address": "127.0.0.1"}
        with chdir(SOURCE):  # Ray lets its processes import from the current folder
            ray.init("local", include_dashboard=False, runtime_env=sent, **resources, **quiet)
        return
    host, _, port = address.rpartition(":")
    try:  # or Ray would try for minutes
        socket.create_connection((host.strip("[]"), int(port)), JOIN_SECONDS).close()
        sent = {"py_modules": [str(SOURCE / "pneuma")], "excludes": ["__pycache__"]}
        with chdir(SOURCE):
            ray.init(address, runtime_env={**sent, "env_vars": {CARRIED_CODE: code()}}, **quiet)
    except Exception as error:  # Ray raises many kinds of errors
        raise UserError(
            f"--address {address}: no cluster can be joined there ({error}); give the address that "
            "`ray start --head` printed, on a machine of the cluster"
        ) from None


# --- On a node ----------------------------------------------------------------------------------------


def train_here(text: str, wanted: Mapping[str, str], folder: str) -> None:
    """Train a job, as JSON, on the node that Ray calls this on, if it has the `wanted` versions.

    Users' rewards and levels are read from `folder`, the command's current one.
    """
    installed, node = versions(), socket.gethostname()
    lacking = [f"{name} {version}" for name, version in wanted.items() if installed.get(name) != version]
    if lacking:
        raise UserError(f"--executor ray: the node {node} lacks {', '.join(lacking)}")
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
        Supervisor([job.runs], job.store, job.how, lambda event: None, interrupts).work()


def versions() -> dict[str, str]:
    """Return the versions that must match between the command and every node, as they can change results."""
    about = machine()
    packages = {name: version for name, version in about["packages"].items() if name != "pneuma"}
    return {"Python": about["python"], **packages}
