"""`pneuma study publish`, and the study commands in a fresh clone, where only published tables are."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from .calls import TINY, Called, as_it_stands, call, printed, refused

pytestmark = pytest.mark.usefixtures("trains_here")


@pytest.fixture
def results(trained: Path, tmp_path: Path) -> Path:
    """A copy of its own, published."""
    results = Path(shutil.copytree(trained, tmp_path / "results"))
    printed("study", "publish", "activation", "--results", results)
    return results


def _publish(results: Path, *options: str, of: str = "activation") -> Called:
    return call("study", "publish", of, *options, "--results", results)


def test_nothing_published_leaves_the_table(results: Path) -> None:
    """Neither runs, nor what a table that cannot be read may have held."""
    path = results / "published" / "activation.parquet"
    whole = path.read_bytes()
    told = refused("study", "publish", "activation", "--condition", "relu", "--results", results)
    assert "has runs that are not of this selection" in told
    assert path.read_bytes() == whole
    path.write_bytes(whole[:-9])
    assert "damaged" in refused("study", "publish", "activation", "--results", results)
    assert path.read_bytes() == whole[:-9]
    path.unlink()
    assert _publish(results).code == 0 and path.read_bytes() == whole


def test_runs_that_another_study_has_published_are_found_in_its_table(results: Path) -> None:
    """Tanh is Table 6.2, which other studies have as a condition of their own."""
    tiny = [part for part in TINY if part not in ("--condition", "tanh", "relu")]
    ours = ["--condition", "table-6-2", "--condition", "lambda-1", "--seeds", "2", *tiny]
    shutil.rmtree(results / "runs")
    for words in (("run", "--unpublished"), ("plan", "--unpublished")):
        called = call("study", words[0], "policy-gradient", *ours, *words[1:], "--results", results)
        assert called.code == 0
    as_it_stands(results, "policy-gradient")
    assert called.out.splitlines()[-1] == "2 published, 2 stored."
    summary = call("study", "summary", "policy-gradient", "--results", results)
    assert summary.err == "Note: 2 of 4 runs of policy-gradient are not here, but published.\n"
    assert _publish(results, of="policy-gradient").code == 0
    shutil.rmtree(results / "runs")
    again = call("study", "summary", "policy-gradient", "--results", results)
    assert again.out == summary.out
    assert again.err == "Note: 4 of 4 runs of policy-gradient are not here, but published.\n"
    (results / "published" / "activation.parquet").write_bytes(b"PAR1")
    again = call("study", "summary", "policy-gradient", "--results", results)
    assert "Note: 2 of 4 runs of policy-gradient are not here, not finished or damaged" in again.err


def test_what_is_published_is_not_trained_where_that_is_asked(results: Path) -> None:
    table = results / "published" / "activation.parquet"
    shutil.rmtree(results / "runs")
    rest = ["activation", *TINY, "--unpublished", "--results", str(results)]
    called = call("study", "run", *rest, "--seeds", "2", "--json")
    assert called.code == 0 and called.document["runs"] == []
    assert "nothing to train" in called.err and "Draw it" not in called.err
    planned = call("study", "plan", *rest, "--seeds", "3", "--json").document["runs"]
    assert [(run["seed"], run["state"]) for run in planned if run["condition"] == "tanh"] == [
        (0, "published"), (1, "published"), (2, "to-train"),
    ]  # fmt: skip
    assert {run["expected_seconds"] for run in planned if run["state"] == "published"} == {None}
    table.write_bytes(table.read_bytes()[:-9])
    assert "activation.parquet: damaged" in call("study", "plan", *rest).err
