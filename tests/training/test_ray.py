"""The Ray executor: the same bytes as the local one when a node is lost; and what is refused."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from pneuma.config import make_run
from pneuma.errors import UserError
from pneuma.store.store import Store
from pneuma.training.executors import ray
from pneuma.training.executors.base import ExecutorConfig, Job
from pneuma.training.executors.local import worker_environment

from .commands import begin, end_commands, hold, outcome, wait_until, write_study

pytest.importorskip("ray")


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Any]:
    """A cluster of two nodes of one CPU each: its address, and the process of each node."""
    process = subprocess.Popen(
        [sys.executable, str(Path(__file__).with_name("ray_nodes.py")), "2"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=worker_environment(),
        text=True,
        start_new_session=True,
    )
    assert process.stdin and process.stdout
    try:
        yield json.loads(process.stdout.readline())
    finally:
        end_commands()
        process.stdin.close()
        with suppress(subprocess.TimeoutExpired):
            process.wait(timeout=60)
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.stdout.close()


def checkpoint_folders(folder: Path) -> set[Path]:
    return {path.parent for path in (folder / "results").glob("runs/*/checkpoints/*.safetensors")}


def test_a_node_that_does_not_see_the_results_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="cannot see /shared/results: all nodes must share that folder"):
        job = Job({"a0" * 8: make_run({})}, Store("/shared/results"), ExecutorConfig())
        ray.train_here(job.to_json(), ray.versions(), str(tmp_path))


@pytest.mark.slow
def test_a_study_that_loses_a_node_ends_with_the_bytes_of_a_local_one(tmp_path: Path, cluster: Any) -> None:
    study = write_study(tmp_path, steps=64 * 300, seeds=2, settings=f'reward = "{hold(tmp_path)}"')
    process = begin(tmp_path, study, "--executor", "ray", "--address", cluster["address"])
    wait_until(lambda: len(checkpoint_folders(tmp_path)) == 2, seconds=480)  # nodes compile first
    os.kill(cluster["nodes"][0], signal.SIGKILL)
    (tmp_path / "hold").unlink()
    output, errors = process.communicate(timeout=300)
    assert process.returncode == 0, errors
    assert {run["status"] for run in json.loads(output)["runs"]} == {"done"}
    assert not checkpoint_folders(tmp_path)
    (tmp_path / "results").rename(tmp_path / "away")
    local = begin(tmp_path, study)
    assert local.communicate(timeout=120) and local.returncode == 0
    assert outcome(tmp_path / "away") == outcome(tmp_path / "results")
