"""The Ray executor: the same bytes as the local one, whatever becomes of the nodes; and what is refused."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

from pneuma.config import make_run
from pneuma.errors import UserError
from pneuma.store.store import Store
from pneuma.training.executors import ray
from pneuma.training.executors.base import ExecutorConfig, Job
from pneuma.training.executors.local import worker_environment

from .commands import begin, end_commands, hold, outcome, wait_until, write_study

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
        env=worker_environment(),
        text=True,
        start_new_session=True,
    )
    assert process.stdout
    cluster = json.loads(process.stdout.readline())
    return process, Nodes(cluster["address"], tuple(cluster["nodes"]))


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
        first = begin(folder, write_study(folder), "--executor", "ray", "--address", nodes.address)
        assert first.wait(timeout=240) == 0
        yield nodes
    finally:
        end_commands()
        end_nodes(process)


def checkpoint_folders(folder: Path) -> set[Path]:
    return {path.parent for path in (folder / "results").glob("runs/*/checkpoints/*.safetensors")}


# --- Refusals ----------------------------------------------------------------------------------------


def test_a_node_that_does_not_see_the_results_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="cannot see /shared/results: all nodes must share that folder"):
        job = Job({"a0" * 8: make_run({})}, Store("/shared/results"), ExecutorConfig())
        ray.train_here(job.to_json(), ray.versions(), str(tmp_path))


# --- Lost nodes: the other one last, because the tests before need both --------------------------------


@pytest.mark.slow
def test_a_study_that_loses_a_node_ends_with_the_bytes_of_a_local_one(tmp_path: Path, cluster: Nodes) -> None:
    study = write_study(tmp_path, steps=64 * 300, seeds=2, settings=f'reward = "{hold(tmp_path)}"')
    process = begin(tmp_path, study, "--executor", "ray", "--address", cluster.address)
    wait_until(lambda: len(checkpoint_folders(tmp_path)) == 2, seconds=240)
    os.kill(cluster.nodes[0], signal.SIGKILL)
    (tmp_path / "hold").unlink()
    out, err = process.communicate(timeout=300)
    assert process.returncode == 0, err
    assert {run["status"] for run in json.loads(out)["runs"]} == {"done"}
    assert not checkpoint_folders(tmp_path)
    (tmp_path / "results").rename(tmp_path / "away")
    local = begin(tmp_path, study)
    assert local.communicate(timeout=120) and local.returncode == 0
    assert outcome(tmp_path / "away") == outcome(tmp_path / "results")
