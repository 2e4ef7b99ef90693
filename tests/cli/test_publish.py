"""`pneuma study publish`, and the study commands in a fresh clone, where only published tables are."""

from __future__ import annotations

import shutil
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from pyarrow.types import is_list

from pneuma.store.locks import run_lock
from pneuma.store.quantities import TRAINING_QUANTITIES

from .calls import SETTINGS, TINY, Called, call, printed

pytestmark = pytest.mark.usefixtures("trains_here", "unshipped")

READ = ("activation", *SETTINGS)


@pytest.fixture
def results(trained: Path, tmp_path: Path) -> Path:
    """A copy of its own, published."""
    results = Path(shutil.copytree(trained, tmp_path / "results"))
    printed("study", "publish", *READ, "--condition", "tanh", "--condition", "relu", "--results", results)
    return results


def _table(results: Path) -> Path:
    (path,) = (results / "published").iterdir()
    return path


def _publish(results: Path, *options: str) -> Called:
    return call("study", "publish", *READ, *options, "--results", results)


def test_what_is_published_stays_in_the_table_and_the_same_runs_give_the_same_bytes(results: Path) -> None:
    path = _table(results)
    whole = path.read_bytes()
    called = _publish(results, "--condition", "relu", "--seeds", "1,")
    assert "1 run from here, 3 as they were published before" in called.out
    assert "other numbers" not in called.err
    assert path.read_bytes() == whole and path.name.startswith("activation-arena-horizon=64-slots=1-")
    shutil.rmtree(results / "runs")
    called = _publish(results)
    assert called.code == 2 and "train some before publishing" in called.err and path.read_bytes() == whole


@pytest.mark.parametrize(("kept", "columns"), [("none", set()), ("return,entropy", {"return", "entropy"})])
def test_a_table_keeps_the_curves_that_are_named(results: Path, kept: str, columns: set[str]) -> None:
    assert _publish(results, "--curves", kept).code == 0
    curves = {column.name.split()[0] for column in pq.read_schema(_table(results)) if is_list(column.type)}
    assert curves & {*TRAINING_QUANTITIES} == columns


def test_a_damaged_table_is_told_and_published_anew(results: Path) -> None:
    path = _table(results)
    whole = path.read_bytes()
    path.write_bytes(whole[:-9])
    called = _publish(results)
    assert called.code == 0 and f"{path}: cannot be read (damaged)" in called.err
    assert path.read_bytes() == whole


def test_what_pneuma_publishes_stays_in_a_table_of_the_same_name(
    results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shipped = Path(shutil.move(results / "published", tmp_path / "shipped"))
    monkeypatch.setattr("pneuma.store.store.shipped_tables", lambda: shipped)
    called = _publish(results, "--condition", "tanh", "--seeds", "0,")
    assert "1 run from here, 3 as they were published before" in called.out
    assert pq.read_table(_table(results)).num_rows == 4


def test_of_two_that_publish_at_once_one_is_told_to_wait(results: Path) -> None:
    path = _table(results)
    whole = path.read_bytes()
    with run_lock(results / ".publishing" / path.stem):
        called = _publish(results)
    assert called.code == 2 and "another command is writing" in called.err and path.read_bytes() == whole
    assert _publish(results).code == 0


def test_what_is_published_is_not_trained_where_that_is_asked(results: Path) -> None:
    table = _table(results)
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
    assert f"{table.name}: cannot be read (damaged)" in call("study", "plan", *rest).err
