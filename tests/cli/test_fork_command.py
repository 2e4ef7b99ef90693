"""`pneuma run fork` and `study collapse --fork` as people type them, on small runs that keep checkpoints."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from pneuma.study.store import Store

from .calls import SMALL_RUN, call

STUDY = f"""
title = "Parents"
base = "table-6-2"
keep_checkpoints = 2
{SMALL_RUN}
[conditions.only]
[presets.quick]
seeds = 1
steps = 256
"""


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A results folder with one trained run and its checkpoints, which the last test takes away."""
    folder = tmp_path_factory.mktemp("parents")
    (folder / "parents.toml").write_text(STUDY)
    assert call("study", "run", folder / "parents.toml", "--results", folder / "results", "--quiet")[0] == 0
    return folder / "results"


def _fork(results: Path, *more: str) -> tuple[int, Any, str]:
    (parent,) = {path.parent.parent.name for path in results.glob("runs/*/checkpoints/*")}
    arguments = ("--at", "200", "--seeds", "1", *more, "--results", str(results))
    code, out, err = call("run", "fork", parent[:6], *arguments, "--json")
    return code, json.loads(out) if out else None, err


def _bits(results: Path, names: list[str]) -> Iterator[bytes]:
    for name in names:
        for table in ("metrics.parquet", "episodes.parquet", "evaluations.parquet", "policy.safetensors"):
            yield Store(results).read_file(name, table)


def test_a_fork_is_trained_beside_its_control_drawn_and_trained_to_the_same_bits_again(
    results: Path, tmp_path: Path
) -> None:
    code, document, _ = _fork(results, "--set", "learning_rate=1e-3", "--reset", "critic")
    assert code == 0
    runs = document["runs"]
    assert [(run["condition"], run["seed"], run["status"], run["trained"]) for run in runs] == [
        ("control", 0, "done", True), ("learning_rate=0.001, reset critic", 0, "done", True),
    ]  # fmt: skip
    names = [run["run_id"] for run in runs]
    steps = {
        name: json.loads(Store(results).read_file(name, "run.json"))["run"]["fork_step"] for name in names
    }
    assert set(steps.values()) == {128}  # of four updates the second is kept, nearest before step 200
    first = list(_bits(results, names))
    assert len(set(first[3::4])) == 2, "every fork has a policy of its own"
    again = _fork(results, "--set", "learning_rate=1e-3", "--reset", "critic")[1]
    assert not any(run["trained"] for run in again["runs"])
    for name in names:
        shutil.rmtree(results / "runs" / name)
    assert _fork(results, "--set", "learning_rate=1e-3", "--reset", "critic")[0] == 0
    assert list(_bits(results, names)) == first
    code, out, _ = call(
        "study", "plot", document["study"], "--results", results, "--out", tmp_path / "figures"
    )
    assert code == 0 and document["study"] in out
