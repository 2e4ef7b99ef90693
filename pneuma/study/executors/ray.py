"""The Ray executor: as the local one, but that the processes of workers are on the nodes of a cluster.

    Supervisor ⇄ NodeProcess ⇄ Ray ⇄ Node ⇄ LocalProcess: the worker → results folder, which all nodes share

Pneuma's code goes to the nodes with the job; the packages that it computes with must be there, in the same
versions. Without an address, a cluster of this machine's own is started for the command.
"""

from __future__ import annotations

import json
import os
import socket
import threading
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cache, partial
from importlib.util import find_spec
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

from pneuma.config import Run
from pneuma.errors import UserError, install_extra
from pneuma.study.executors.base import OnEvent, Supervision
from pneuma.study.executors.local import LocalProcess, prepare_node
from pneuma.study.executors.supervisor import Death, Interrupts, Supervisor
from pneuma.study.provenance import CARRIED_CODE, available_cores, code, machine
from pneuma.study.store import Store
from pneuma.study.worker import die_with

JOIN_SECONDS = 5.0
"""How long a cluster's head may take to answer."""
BURY_SECONDS = 10.0
"""How long Ray may take to tell that a process which was ended has gone."""
LOOPBACK = ("localhost", "127.0.0.1", "[::1]")
CODE = Path(__file__).parents[2]


def most_workers(how: Supervision) -> int:
    """Return how many runs the cluster's CPUs can train at once; one of its own is not started for that.

    Raises:
        UserError: where Ray is not installed, no cluster answers in time, or none of its nodes has a CPU.
    """
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
    groups: Iterable[Mapping[str, Run]], store: Store, how: Supervision, on_event: OnEvent
) -> None:
    """Train every group of runs on some node of the cluster, as the contract says (`base.Executor`).

    Raises:
        KeyboardInterrupt: after Ctrl-C, when every run has come to a checkpoint.
        UserError: when a node is not fit for them.
    """
    join(how.address)
    store.root.mkdir(parents=True, exist_ok=True)
    with Interrupts() as interrupts, NamedTemporaryFile(dir=store.root, prefix=".shared-") as mark:
        start = partial(NodeProcess, Node(versions(), code(), os.getcwd(), mark.name))
        Supervisor(groups, store, how, on_event, interrupts, start).work()
        if interrupts.count:
            raise KeyboardInterrupt


# --- The cluster --------------------------------------------------------------------------------------


@cache
def join(address: str | None) -> None:
    """Join the cluster at an address, or start one of this machine's own; once for a process.

    Raises:
        UserError: when no cluster answers there in time.
    """
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"  # all this before Ray, which reads it when it is loaded
    os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")  # the nodes have their own environments
    if address is None or address.rpartition(":")[0] in LOOPBACK:
        # or Ray takes 127.0.0.1 for the machine's address in its network; it has no option for this
        os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")
    import ray
    from ray._private import worker

    if hasattr(worker, "print_to_stdstream"):  # else Ray writes on standard output, where --json does
        worker.print_to_stdstream = lambda *_, **__: None
    code: dict[str, Any]
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "CRITICAL"}
    if address is None:
        os.environ.setdefault("RAY_worker_niceness", "0")  # 15 else: runs would yield to whatever there is
        code = {"env_vars": {"PYTHONPATH": str(CODE.parent)}}  # it lies here, compiled
        here: dict[str, Any] = {"num_cpus": available_cores(), "_node_ip_address": "127.0.0.1"}
        ray.init("local", include_dashboard=False, runtime_env=code, **here, **quiet)
    else:
        host, _, port = address.rpartition(":")
        try:  # or Ray would try for minutes
            socket.create_connection((host.strip("[]"), int(port)), JOIN_SECONDS).close()
            code = {"py_modules": [str(CODE)], "excludes": ["__pycache__"]}
            ray.init(address, runtime_env=code, **quiet)
        except Exception as error:  # of Ray's there are many kinds
            raise UserError(
                f"--address {address}: no cluster can be joined there ({error}); give the address that "
                "`ray start --head` printed, on a machine of the cluster"
            ) from None


# --- Workers on nodes ---------------------------------------------------------------------------------


@dataclass
class Node:
    """Runs the process of one worker on the node that Ray makes this on.

    Attributes:
        versions, code, folder: of the command, which the node must have, is told, and works in.
        mark: a file in the results folder.
    """

    versions: Mapping[str, str]
    code: str
    folder: str
    mark: str

    def stop(self) -> None:
        """Let the runs come to a checkpoint and end."""
        self._process.ask_to_stop()

    def train(self, job: Mapping[str, Any]) -> Iterator[bytes | Death]:
        """Start the worker; yield its lines, then how it ended.

        Raises:
            UserError: where runs cannot be trained on this node.
        """
        import ray

        node = ray.util.get_node_ip_address()
        here = versions()
        lacking = [f"{name} {own}" for name, own in self.versions.items() if here.get(name) != own]
        if lacking:
            raise UserError(f"--executor ray: the node {node} lacks {', '.join(lacking)}")
        if not Path(self.mark).exists():
            raise UserError(
                f"--executor ray: the node {node} does not see {job['results']}: all must share that folder"
            )
        die_with(os.getppid())  # Ray's own process here
        os.environ[CARRIED_CODE] = self.code
        with suppress(OSError):
            os.chdir(self.folder)  # from which people's own rewards and levels are read
        prepare_node()
        self._process = LocalProcess(job)
        first = {"event": "passing", "run_id": next(iter(job["runs"])), "text": f"starts on the node {node}"}
        yield json.dumps(first).encode() + b"\n"
        yield from (line for line in self._process.events)  # of a generator, which is all that Ray iterates
        yield self._process.bury()


class NodeProcess:
    """The process of a worker on some node, as the supervisor in the command sees it."""

    def __init__(self, node: Node, job: Mapping[str, Any]) -> None:
        import ray

        kind: Any = ray.remote(Node)
        self._node = kind.options(num_cpus=1, max_concurrency=2).remote(**asdict(node))
        told = self._node.train.options(num_returns="streaming").remote(job)
        self._begun = False
        self._death: Death | UserError = Death(True, "its node was lost")
        reader, writer = os.pipe()
        self.events = os.fdopen(reader, "rb", buffering=0)
        self._relaying = threading.Thread(target=self._relay, args=(told, writer), daemon=True)
        self._relaying.start()

    def ask_to_stop(self) -> None:
        """Let it come to a checkpoint and end; one that still waits for a node just ends."""
        if self._begun:
            self._node.stop.remote()
        else:
            self.kill()

    def kill(self) -> None:
        """End it at once, and what it has started with it."""
        import ray

        with suppress(Exception):  # it may be gone, or the whole cluster
            ray.kill(self._node)

    def bury(self) -> Death:
        """Let go of the node and return how the process ended.

        Raises:
            UserError: where runs cannot be trained on the node.
        """
        self.kill()
        self._relaying.join(BURY_SECONDS)
        self.events.close()
        if isinstance(self._death, UserError):
            raise self._death
        return self._death

    def _relay(self, told: Iterable[Any], writer: int) -> None:
        """Write what a node tells into the pipe, to its end."""
        import ray

        with suppress(BrokenPipeError), os.fdopen(writer, "wb", buffering=0) as pipe:
            try:
                for line in map(ray.get, told):
                    self._begun = True
                    if isinstance(line, Death):
                        self._death = line
                    else:
                        pipe.write(line)
            except (ray.exceptions.RayTaskError, ray.exceptions.RuntimeEnvSetupError) as error:
                cause = getattr(error, "cause", error)
                self._death = cause if isinstance(cause, UserError) else UserError(f"--executor ray: {cause}")
            except ray.exceptions.RayError as error:
                self._death = Death(True, "its node was lost", str(error).encode())


def versions() -> dict[str, str]:
    """Return what must be the same in the command and on every node, or bits may differ."""
    here = machine()
    packages = {name: version for name, version in here["packages"].items() if name != "pneuma"}
    return {"Python": here["python"], **packages}
