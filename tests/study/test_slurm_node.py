"""The Slurm executor on a real Slurm of one node; skipped where its daemons are not installed."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from pneuma.study.executors.local import one_thread_environment

from .begun import outcome, wait_until
from .slurm_node import missing, slurm_node

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(bool(missing()), reason=f"not installed: {', '.join(missing())}"),
]

STUDY = """
title = "Two rates"
base = "table-6-2"
[run]
engine = "sb3"
[conditions.slow]
learning_rate = 1e-4
[conditions.fast]
learning_rate = 3e-4
[presets.quick]
seeds = 2
steps = 12_800
"""
PATIENCE_SECONDS = 300


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    with slurm_node(tmp_path_factory.mktemp("slurm") / "cluster") as environment:
        yield {**one_thread_environment(), **environment}


@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = tmp_path / "rates.toml"
    path.write_text(STUDY)
    return path


def pneuma(words: Sequence[object], environment: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "pneuma", *map(str, words)]
    return subprocess.run(
        command, env=environment, capture_output=True, text=True, timeout=PATIENCE_SECONDS, check=False
    )


def run(study: Path, results: Path, environment: Mapping[str, str], *options: str) -> Any:
    done = pneuma(["study", "run", study, "--results", results, "--json", *options], environment)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)["runs"]


def queue(environment: Mapping[str, str], form: str) -> list[str]:
    asked = ["squeue", "--noheader", "--array", f"--format={form}"]
    return subprocess.run(asked, env=environment, capture_output=True, text=True, check=True).stdout.split()


def checkpointed(results: Path) -> set[str]:
    """Return the runs that have something to go on from."""
    return {path.parent.parent.name for path in results.glob("runs/*/checkpoints/*.safetensors")}


def test_jobs_go_on_when_the_command_is_left_and_when_they_are_requeued_to_the_same_bits(
    cluster: dict[str, str], study: Path, tmp_path: Path
) -> None:
    results = tmp_path / "results"
    slurm = ("--executor", "slurm", "--checkpoint-seconds", "1")
    assert {row["trained"] for row in run(study, results, cluster, *slurm, "--detach")} == {False}
    wait_until(lambda: checkpointed(results), PATIENCE_SECONDS)
    told = json.loads(pneuma(["study", "status", study, "--results", results, "--json"], cluster).stdout)
    assert {job["state"] for job in told["jobs"].values()} <= {"RUNNING", "PENDING"}
    requeued = next(job["job"] for name, job in told["jobs"].items() if name in checkpointed(results))
    subprocess.run(["scontrol", "requeue", requeued], env=cluster, check=True)
    jobs = queue(cluster, "%F")
    rows = run(study, results, cluster, *slurm)
    assert {row["status"] for row in rows} == {"done"}
    assert set(queue(cluster, "%F")) <= set(jobs)  # nothing was submitted twice
    provenance = [json.loads(path.read_text()) for path in results.glob("runs/*/provenance.json")]
    assert any(about["resumes"] for about in provenance)
    assert not [path for path in results.rglob("*") if path.suffix == ".pkl"]

    run(study, tmp_path / "local", cluster, "--quiet")
    assert outcome(results) == outcome(tmp_path / "local")
