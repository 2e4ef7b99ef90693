"""The Slurm executor on a real Slurm of one node; skipped where its daemons are not installed."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pytest

from pneuma.study.executors.local import one_thread_environment

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


def exports(study: Path, results: Path, folder: Path, environment: Mapping[str, str]) -> list[bytes]:
    tables = []
    for table in ("episodes", "metrics", "evaluations", "curves"):
        out = folder / f"{results.name}-{table}.csv"
        words = ["study", "export", study, "--table", table, "--results", results, "--out", out]
        assert pneuma(words, environment).returncode == 0
        tables.append(out.read_bytes())
    return tables


def queue(environment: Mapping[str, str], form: str) -> list[str]:
    asked = ["squeue", "--noheader", "--array", f"--format={form}"]
    return subprocess.run(asked, env=environment, capture_output=True, text=True, check=True).stdout.split()


def wait_until(happened: Callable[[], object]) -> None:
    until = time.monotonic() + PATIENCE_SECONDS
    while not happened():
        assert time.monotonic() < until
        time.sleep(0.2)


def checkpointed(results: Path) -> set[str]:
    """Return the runs that have something to go on from."""
    return {path.parent.parent.name for path in results.glob("runs/*/checkpoints/*.safetensors")}


def test_jobs_go_on_when_the_command_is_left_and_when_they_are_requeued_to_the_same_bits(
    cluster: dict[str, str], study: Path, tmp_path: Path
) -> None:
    results = tmp_path / "results"
    slurm = ("--executor", "slurm", "--checkpoint-seconds", "1")
    assert {row["trained"] for row in run(study, results, cluster, *slurm, "--detach")} == {False}
    wait_until(lambda: checkpointed(results))
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
    alike = zip(
        exports(study, results, tmp_path, cluster),
        exports(study, tmp_path / "local", tmp_path, cluster),
        strict=True,
    )
    assert all(one == other for one, other in alike)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["partition=nope"], "--slurm partition=nope: there is none"),
        (["partiton=main"], "sbatch has no such option (did you mean partition?)"),
        (["mem=900GB"], "Requested node configuration is not available"),
        (["time=5:00:00"], "the queue would never run these jobs"),
    ],
)
def test_jobs_that_cannot_run_are_refused_in_a_line_within_ten_seconds(
    options: list[str], told: str, cluster: dict[str, str], study: Path, tmp_path: Path
) -> None:
    begun = time.monotonic()
    words = ["study", "run", study, "--results", tmp_path / "results", "--executor", "slurm", "--quiet"]
    done = pneuma([*words, *(word for option in options for word in ("--slurm", option))], cluster)
    assert time.monotonic() - begun < 10
    assert done.returncode == 2 and told in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
