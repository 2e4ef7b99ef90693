"""A Ray cluster to train on: reached or begun, and found fit for runs before any is sent.

Where no address is given, one of this machine's own is started for the command; it listens on loopback alone
and has no dashboard. Pneuma's code goes to the nodes with the job; the packages that it computes with must be
there already, in the same versions as here, or runs would end with other bits.
"""

from __future__ import annotations

import os
import socket
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import IO, Any

from pneuma.errors import UserError, install_extra
from pneuma.study.cores import available_cores
from pneuma.study.provenance import machine

LISTEN_SECONDS = 2.0
"""How long an address may take to take a connection."""
CONNECT_SECONDS = 5.0
"""How long a cluster may take to let this process join, after that."""
PROBE_SECONDS = 5.0
"""How long nodes may take to tell their versions; one that takes longer tells them before it trains."""
LOOPBACK = ("localhost", "127.0.0.1", "::1")
NODE_LABEL = "ray.io/node-id"
CODE = Path(__file__).parents[2]

Versions = Mapping[str, str]


@dataclass(frozen=True)
class Cluster:
    """A cluster that this process has joined; `where` names it for people."""

    where: str

    def nodes(self) -> list[dict[str, Any]]:
        """Return what Ray tells of every node that is alive."""
        import ray

        return [node for node in ray.nodes() if node["Alive"]]

    def trainers(self) -> list[dict[str, Any]]:
        """Return those that have a CPU to train on; the head, or the command's own, may have none."""
        return [node for node in self.nodes() if node["Resources"].get("CPU", 0.0) >= 1]

    def count(self, resource: str) -> int:
        """Return how many CPUs or GPUs all nodes have together."""
        return int(sum(node["Resources"].get(resource, 0.0) for node in self.nodes()))

    def room(self) -> str:
        """Tell for people how much there is to train on, and on how many nodes."""
        nodes = sum(node["Resources"].get("CPU", 0.0) >= 1 for node in self.nodes())
        kinds = {kind: self.count(kind) for kind in ("CPU", "GPU")}
        counts = [f"{count} {kind}{'s' * (count > 1)}" for kind, count in kinds.items() if count]
        return f"{' and '.join(counts)} on {nodes} node{'s' * (nodes > 1)}"


@cache
def join(address: str | None) -> Cluster:
    """Join the cluster at an address, or start one of this machine's own; once for a process.

    Raises:
        UserError: within ten seconds, when Ray is not installed or nothing fit answers there.
    """
    _prepare_environment(address)
    try:
        import ray
    except ImportError:
        raise UserError(f"--executor ray needs Ray: {install_extra('ray')}") from None
    _silence()
    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "CRITICAL"}
    if address is None:
        own: dict[str, Any] = {"num_cpus": available_cores(), "_node_ip_address": "127.0.0.1"}
        code: dict[str, Any] = {"env_vars": {"PYTHONPATH": str(CODE.parent)}}  # it lies here, compiled
        with _captured_errors():
            ray.init(address="local", include_dashboard=False, runtime_env=code, **own, **quiet)
        return Cluster("this machine")
    _look_for_listener(address)
    code = {"py_modules": [str(CODE)], "excludes": ["__pycache__"]}
    _join_within(CONNECT_SECONDS, address, {"runtime_env": code, **quiet})
    return Cluster(f"the cluster at {address}")


def versions() -> Versions:
    """Return what must be the same on the driver and on every node, or bits may differ."""
    here = machine(1)
    packages = {name: version for name, version in here["packages"].items() if name != "pneuma"}
    return {"Python": here["python"], **packages}


def mismatch(there: Versions, here: Versions | None = None) -> str:
    """Say in what a node's versions differ from this process's; empty where they are the same."""
    own = here or versions()
    differing = [name for name in {**own, **there} if own.get(name) != there.get(name)]
    return ", ".join(
        f"{name} {there.get(name, 'missing')} (here {own.get(name, 'none')})" for name in differing
    )


def refuse_unlike_nodes(cluster: Cluster) -> None:
    """Compare the versions of all nodes that can train with this process's.

    Raises:
        UserError: naming the first node that differs, and in what.
    """
    import ray
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    probe = ray.remote(versions)
    asked = {}
    for node in cluster.trainers():
        there = NodeAffinitySchedulingStrategy(node["NodeID"], soft=False)
        asked[probe.options(num_cpus=0, max_retries=0, scheduling_strategy=there).remote()] = node
    answered, _ = ray.wait([*asked], num_returns=len(asked), timeout=PROBE_SECONDS)
    for answer in answered:
        with suppress(ray.exceptions.RayError):  # a node that went meanwhile trains nothing
            if told := mismatch(ray.get(answer)):
                raise UserError(unlike(asked[answer]["NodeManagerAddress"], told))


def unlike(node: str, told: str) -> str:
    """Return what is said of a node with other versions."""
    return (
        f"--executor ray: the node {node} has {told}; runs would end with other bits: "
        "install the same versions on all nodes (pip install -c constraints.txt …)"
    )


def refuse_lacking_resources(cluster: Cluster, on_gpu: int) -> None:
    """Refuse to wait for ever for what no node of the cluster has.

    Args:
        cluster: that runs are to be trained on.
        on_gpu: how many of the runs want a GPU.

    Raises:
        UserError: naming what is lacking.
    """
    kinds = [node["Resources"] for node in cluster.trainers()]
    if not kinds:
        raise UserError(
            f"--executor ray: {cluster.where} has no node with a free CPU to give; start one with "
            "`ray start --address HOST:PORT --num-cpus N`"
        )
    if on_gpu and not any(kind.get("GPU", 0.0) >= 1 for kind in kinds):
        runs = "1 run wants" if on_gpu == 1 else f"{on_gpu} runs want"
        raise UserError(
            f"--executor ray: {runs} a GPU each and {cluster.where} has no node with one; give the --address "
            "of a cluster that has (`ray start … --num-gpus N`), or take `gpu` out of the study's file"
        )


def read_address(address: str) -> tuple[str, int]:
    """Return host and port.

    Raises:
        UserError: for anything else.
    """
    host, _, port = address.rpartition(":")
    if not host or "/" in host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise UserError(
            f"--address {address}: must be HOST:PORT of the cluster's head node, as in 10.0.0.5:6379"
        )
    return host.strip("[]"), int(port)


# --- Joining ----------------------------------------------------------------------------------------


def _prepare_environment(address: str | None) -> None:
    """Set what Ray reads when it is loaded: it is to tell nobody of its use, and loopback is to stay so."""
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    os.environ.setdefault("RAY_ENABLE_UV_RUN_RUNTIME_ENV", "0")  # the nodes have their own environments
    if address is None:
        os.environ.setdefault(
            "RAY_worker_niceness", "0"
        )  # 15 else: runs would yield to whatever else there is
    if address is None or read_address(address)[0] in LOOPBACK:
        # or Ray takes 127.0.0.1 for the machine's address in its network; it has no option for this
        os.environ.setdefault("RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER", "0")


def _silence() -> None:
    """Keep what Ray has to say of its nodes off standard output, which it has no option for.

    A lost node is told by an event; `--json` promises one document.
    """
    from ray._private import worker

    if hasattr(worker, "print_to_stdstream"):
        worker.print_to_stdstream = lambda *_, **__: None


def _look_for_listener(address: str) -> None:
    try:
        socket.create_connection(read_address(address), timeout=LISTEN_SECONDS).close()
    except (OSError, UnicodeError) as error:  # the latter for what no host can be called
        reason = getattr(error, "strerror", None) or error
        raise UserError(
            f"--address {address}: nothing listens there ({reason}); start a cluster with "
            "`ray start --head`, which prints its address, or leave --address out to use this machine"
        ) from None


def _join_within(seconds: float, address: str, options: Mapping[str, Any]) -> None:
    """Join in a thread that can be left behind: Ray itself waits for minutes.

    Raises:
        UserError: saying why not.
    """
    import ray

    failures: list[BaseException] = []

    def attempt() -> None:
        try:
            ray.init(address=address, **options)
        except BaseException as error:  # SystemExit is one way in which Ray gives up
            failures.append(error)

    with _captured_errors() as errors:
        thread = threading.Thread(target=attempt, daemon=True)
        thread.start()
        thread.join(seconds)
        if not thread.is_alive() and not failures:
            return
        errors.seek(0)
        said = errors.read().decode(errors="replace")
    if thread.is_alive():
        _turn_away_errors()
    raise UserError(f"--address {address}: {_why_not(said, failures)}")


def _why_not(said: str, failures: Sequence[BaseException]) -> str:
    """Return why a cluster could not be joined, from what Ray printed and raised."""
    told = " ".join(str(failures[0]).split()) if failures else ""
    if "Version mismatch" in told:
        return f"{told.split('This process')[0].strip()} Run the command with the same versions"
    if "Unauthenticated" in said:
        return "the cluster wants a token: set RAY_AUTH_MODE=token, with its token in ~/.ray/auth_token"
    if not failures or "connect" in told:
        return (
            "what listens there is no Ray cluster that this machine is part of; give the address that "
            "`ray start --head` printed, and join it here with `ray start --address HOST:PORT --num-cpus 0`"
        )
    return f"Ray cannot join the cluster ({told})"


def _turn_away_errors() -> None:
    """Let only Python's standard error reach people from now on: what is left behind goes on complaining."""
    sys.stderr.flush()
    sys.stderr = os.fdopen(os.dup(2), "w", buffering=1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    os.close(nowhere)


@contextmanager
def _captured_errors() -> Iterator[IO[bytes]]:
    """Keep what Ray's compiled parts print on standard error out of people's sight, to be read here."""
    before = os.dup(2)
    with tempfile.TemporaryFile() as file:
        os.dup2(file.fileno(), 2)
        try:
            yield file
        finally:
            os.dup2(before, 2)
            os.close(before)
