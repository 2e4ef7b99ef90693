"""The Ray executor: the same bytes as the local one, whatever becomes of the nodes; and what is refused."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

from pneuma.errors import UserError
from pneuma.study.executors import ray
from pneuma.study.executors.local import one_thread_environment
from pneuma.study.store import Store

from .begun import begin as begin_locally
from .begun import end_begun, outcome, wait_until, write_study
from .begun import run as run_locally
from .storm import children, wait_for_end

pytest.importorskip("ray")

NODES = Path(__file__).with_name("ray_nodes.py")


@dataclass(frozen=True)
class Nodes:
    """A cluster: its address, and the process of every node."""

    address: str
    nodes: tuple[int, ...]


def start_nodes(count: int) -> tuple[subprocess.Popen[str], Nodes]:
    process = subprocess.Popen(
        [sys.executable, str(NODES), str(count)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=one_thread_environment(),
        text=True,
        start_new_session=True,
    )
    assert process.stdout
    told = json.loads(process.stdout.readline())
    return process, Nodes(told["address"], tuple(told["nodes"]))


def end_nodes(process: subprocess.Popen[str]) -> None:
    assert process.stdin and process.stdout
    process.stdin.close()
    with suppress(subprocess.TimeoutExpired):
        process.wait(timeout=60)
    with suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.stdout.close()


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Nodes]:
    """Two nodes of one CPU each, which have compiled what the tests train."""
    process, nodes = start_nodes(2)
    folder = tmp_path_factory.mktemp("compiled")
    try:
        first = begin(folder, write_study(folder), "--address", nodes.address)
        assert first.wait(timeout=240) == 0
        yield nodes
    finally:
        end_begun()
        end_nodes(process)


def begin(
    folder: Path, study: Path, *options: str, environment: Mapping[str, str] | None = None
) -> subprocess.Popen[str]:
    return begin_locally(folder, study, "--executor", "ray", *options, environment=environment)


def checkpoint_folders(folder: Path) -> set[Path]:
    return {path.parent for path in (folder / "results").glob("runs/*/checkpoints/*.safetensors")}


# --- The same bytes ----------------------------------------------------------------------------------


def test_a_run_on_a_cluster_of_its_own_leaves_the_same_files(tmp_path: Path) -> None:
    study = write_study(tmp_path)
    process = begin(tmp_path, study)
    out, told = process.communicate(timeout=120)
    assert process.returncode == 0, told
    assert [run["status"] for run in json.loads(out)["runs"]] == ["done"]
    (tmp_path / "results").rename(tmp_path / "away")
    assert run_locally(tmp_path, study)[0] == 0
    assert outcome(tmp_path / "away") == outcome(tmp_path / "results")
    assert outcome(tmp_path / "results")


@pytest.mark.slow
def test_after_ctrl_c_every_run_has_a_checkpoint_and_goes_on_here(tmp_path: Path, cluster: Nodes) -> None:
    study = write_study(tmp_path, steps=64 * 1500, seeds=2)
    process = begin(tmp_path, study, "--address", cluster.address)
    store = Store(tmp_path / "results")
    wait_until(lambda: len(checkpoint_folders(tmp_path)) == 2, seconds=240)
    process.send_signal(signal.SIGINT)
    out, told = process.communicate(timeout=60)
    assert process.returncode == 130, told
    stored = [(run["status"], run["trained"]) for run in json.loads(out)["runs"]]
    assert stored == [("partial", False)] * 2
    assert "The same command goes on where every run was stopped" in told
    assert {store.status(name).name for name in store.runs()} == {"partial"}
    code, told, _ = run_locally(tmp_path, study)
    assert code == 0
    assert told.count("goes on from step") == 2
    assert "it may end with other bits" not in told
    stopped = outcome(tmp_path / "results")
    (tmp_path / "results").rename(tmp_path / "stopped")
    assert run_locally(tmp_path, study)[0] == 0
    assert stopped == outcome(tmp_path / "results")


# --- Refusals ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_an_address_where_something_else_listens_is_refused_before_anything_is_written(
    tmp_path: Path,
) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        address = f"127.0.0.1:{other.getsockname()[1]}"
        process = begin(tmp_path, write_study(tmp_path), "--address", address)
        out, told = process.communicate(timeout=60)
    (line,) = told.splitlines()
    assert (process.returncode, out) == (2, "")
    assert (
        f"pneuma: --address {address}: no cluster can be joined there" in line and "ray start --head" in line
    )
    assert not (tmp_path / "results").exists()


@pytest.mark.slow
def test_a_cluster_that_is_not_fit_is_refused(tmp_path: Path, cluster: Nodes) -> None:
    """Its nodes lack a version that the command has; then a GPU."""
    other = tmp_path / "other" / "pyarrow-99.0.dist-info"
    other.mkdir(parents=True)
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: pyarrow\nVersion: 99.0\n")
    path = os.pathsep.join([str(other.parent), one_thread_environment()["PYTHONPATH"]])
    study = write_study(tmp_path)
    process = begin(tmp_path, study, "--address", cluster.address, environment={"PYTHONPATH": path})
    out, told = process.communicate(timeout=60)
    assert (process.returncode, out) == (2, "") and "lacks pyarrow 99.0, which the command has" in told
    study.write_text("gpu = true\n" + study.read_text())
    process = begin(tmp_path, study, "--address", cluster.address)
    out, told = process.communicate(timeout=60)
    assert (process.returncode, out) == (2, "") and "has a GPU to give" in told and "--num-gpus" in told


def test_a_node_that_does_not_see_the_results_folder_is_refused(tmp_path: Path) -> None:
    command = ray.Command(ray.versions(), "", str(tmp_path), str(tmp_path / "elsewhere"))
    with pytest.raises(UserError, match="does not see /shared/results: all must share that folder"):
        next(ray.Node().train({"results": "/shared/results"}, False, command))


@pytest.mark.slow
def test_a_command_that_is_killed_leaves_nothing_training(tmp_path: Path) -> None:
    process = begin(tmp_path, write_study(tmp_path, steps=64 * 10_000_000))
    wait_until(lambda: checkpoint_folders(tmp_path), seconds=120)
    left = [*descendants(process.pid)]
    training = [pid for pid in left if "pneuma.study.worker" in command_of(pid) or "Node" in command_of(pid)]
    assert len(training) == 2
    process.kill()
    process.communicate(timeout=60)
    assert wait_for_end(training) < 30
    for pid in left:  # two of Ray's own wait some minutes more for its head
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def command_of(pid: int) -> str:
    return Path(f"/proc/{pid}/cmdline").read_text()


def descendants(pid: int) -> Iterator[int]:
    for child in children(pid):
        yield child
        yield from descendants(child)


# --- A node is lost: last, because the others need both ------------------------------------------------


@pytest.mark.slow
def test_a_study_that_loses_a_node_ends_with_the_bytes_of_a_local_one(tmp_path: Path, cluster: Nodes) -> None:
    study = write_study(tmp_path, steps=64 * 1500, seeds=2)
    process = begin(tmp_path, study, "--address", cluster.address)
    wait_until(lambda: len(checkpoint_folders(tmp_path)) == 2, seconds=240)
    os.kill(cluster.nodes[0], signal.SIGKILL)
    out, told = process.communicate(timeout=300)
    assert process.returncode == 0, told
    assert "its node was lost; tried once more" in told and "goes on from step" in told
    assert [run["status"] for run in json.loads(out)["runs"]] == ["done", "done"]
    assert not checkpoint_folders(tmp_path)
    (tmp_path / "results").rename(tmp_path / "away")
    assert run_locally(tmp_path, study)[0] == 0
    assert outcome(tmp_path / "away") == outcome(tmp_path / "results")
