"""The study commands over a tiny study that is really trained and published, on a crash, and on a copy."""

from __future__ import annotations

import io
import shutil
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from pyarrow.types import is_list

from pneuma.store.locks import run_lock
from pneuma.store.published import Published
from pneuma.store.quantities import TRAINING_QUANTITIES
from pneuma.store.row_builder import record_frame
from pneuma.store.series import GRID_POINTS
from pneuma.store.store import Store
from pneuma.study.plan import Query, make_plan
from pneuma.study.spec import load_study

from .calls import SETTINGS, TINY, Called, call, described, printed

# docs/studies.md, word for word.
EPISODES = "condition, seed, run_id, slot, episode, step, return, length, kills, hp, ending"
METRICS = (
    "condition, seed, run_id, step, policy_loss, value_loss, entropy, approx_kl, clip_fraction, grad_norm, "
    "grad_norm_actor, grad_norm_critic, explained_variance, dead_units, "
    "action_0, action_1, action_2, action_3, action_4"
)


@pytest.fixture
def results(trained: Path, tmp_path: Path) -> Path:
    """A copy that a test may change."""
    return Path(shutil.copytree(trained, tmp_path / "results"))


@pytest.mark.usefixtures("trains_here")
def test_only_what_is_missing_is_trained_and_printed_as_one_document(results: Path) -> None:
    first = sorted((results / "runs").iterdir())[0]
    shutil.rmtree(first)
    run = ("study", "run", "activation", *TINY, "--seeds", "2", "--results", results)
    called = call(*run, "--json")
    document = called.document
    assert (called.code, document["schema"]) == (0, 1)
    assert [(run["seed"], run["condition"], run["status"]) for run in document["runs"]] == [
        (seed, condition, "done") for seed in (0, 1) for condition in ("tanh", "relu")
    ]
    assert [run["run_id"] for run in document["runs"] if run["trained"]] == [first.name]
    assert "256 steps are trained, because an update has 64" in called.err
    assert "4 done; 0 trained now, 4 were stored." in printed(*run)
    assert "2 x         250 steps (256 trained)" in printed("study", "plan", *run[2:])
    assert call(*run, "--quiet") == Called(0, "", "")


def _export(results: Path, table: str, out: Path, *selection: str) -> bytes:
    how = ("--table", table, "--out", out, *selection, "--results", results)
    printed("study", "export", "activation", *SETTINGS, *how)
    return out.read_bytes()


def test_an_exported_table_has_exactly_the_documented_columns_and_the_same_bytes_each_time(
    trained: Path, tmp_path: Path
) -> None:
    for table, columns in (("episodes", EPISODES), ("metrics", METRICS)):
        header = _export(trained, table, tmp_path / "x.csv").decode().splitlines()[0]
        assert header == columns.replace(", ", ",")
        frame = pd.read_parquet(io.BytesIO(_export(trained, table, tmp_path / "x.parquet")))
        assert list(frame.columns) == columns.split(", ")
    for form in ("csv", "parquet", "tex"):
        first = _export(trained, "curves", tmp_path / f"first.{form}")
        assert first and _export(trained, "curves", tmp_path / f"second.{form}") == first


@pytest.fixture
def table(results: Path, unshipped: None) -> Path:
    """The published table of these results, in which nothing is shipped."""
    printed("study", "publish", "activation", *TINY[2:], "--results", results)
    (path,) = (results / "published").iterdir()
    return path


def _publish(table: Path, *options: str) -> Called:
    return call("study", "publish", "activation", *SETTINGS, *options, "--results", table.parents[1])


def test_what_is_published_stays_in_the_table_and_the_same_runs_give_the_same_bytes(table: Path) -> None:
    whole = table.read_bytes()
    called = _publish(table, "--condition", "relu", "--seeds", "1,")
    assert "1 run from here, 3 as they were published before" in called.out
    assert "other numbers" not in called.err
    assert table.read_bytes() == whole and table.name.startswith("activation-arena-horizon=64-slots=1-")
    with run_lock(table.parents[1] / ".publishing" / table.stem):
        assert "another command is writing" in (called := _publish(table)).err and called.code == 2
    shutil.rmtree(table.parents[1] / "runs")
    called = _publish(table)
    assert called.code == 2 and "train some before publishing" in called.err and table.read_bytes() == whole


@pytest.mark.parametrize(("kept", "columns"), [("none", set()), ("return,entropy", {"return", "entropy"})])
def test_a_table_keeps_the_curves_that_are_named(table: Path, kept: str, columns: set[str]) -> None:
    assert _publish(table, "--curves", kept).code == 0
    curves = {column.name.split()[0] for column in pq.read_schema(table) if is_list(column.type)}
    assert curves & {*TRAINING_QUANTITIES} == columns


def test_kills_of_training_are_published_as_returns_are(results: Path, table: Path) -> None:
    """A point is the mean of the episodes that ended in the last twentieth, or blank as the return's."""
    published = Published(table, table.read_bytes())
    store = Store(results)
    points = 0
    for row_id, row in published.rows().items():
        assert (row.budget, row.end) == (250, 256)
        assert row.evaluations("step").tolist() == [62, 125, 187, 250]
        episodes = record_frame(store, row_id, "episodes")
        kills, returns = row.curve("kills"), row.curve("return")
        assert np.array_equal(np.isnan(kills), np.isnan(returns)) and len(kills) == GRID_POINTS
        for point in np.flatnonzero(np.isfinite(kills)):
            end, window = row.grid[point], row.budget / 20
            is_inside = (episodes["step"] > end - window) & (episodes["step"] <= end)
            assert kills[point] == pytest.approx(episodes["kills"][is_inside].mean(), abs=1e-2)
            points += 1
    assert points > 0


def test_a_damaged_table_is_reported_and_published_again(table: Path) -> None:
    whole = table.read_bytes()
    table.write_bytes(whole[:-9])
    called = _publish(table)
    assert called.code == 0 and f"{table}: cannot be read (damaged)" in called.err
    assert table.read_bytes() == whole


def test_what_pneuma_publishes_stays_in_a_table_of_the_same_name(
    table: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shipped = Path(shutil.move(table.parent, tmp_path / "shipped"))
    monkeypatch.setattr("pneuma.store.store.shipped_tables", lambda: shipped)
    called = _publish(table, "--condition", "tanh", "--seeds", "0,")
    assert "1 run from here, 3 as they were published before" in called.out
    assert pq.read_table(table).num_rows == 4


def test_what_is_published_is_not_trained_where_that_is_asked(table: Path) -> None:
    shutil.rmtree(table.parents[1] / "runs")
    rest = ["activation", *TINY, "--unpublished", "--results", table.parents[1]]
    called = call("study", "run", *rest, "--seeds", "2", "--json")
    assert called.code == 0 and called.document["runs"] == []
    assert "nothing to train" in called.err and "Draw it" not in called.err
    planned = call("study", "plan", *rest, "--seeds", "3", "--json").document["runs"]
    states = [(run["seed"], run["state"]) for run in planned if run["condition"] == "tanh"]
    assert states == [(0, "published"), (1, "published"), (2, "to-train")]
    assert {run["expected_seconds"] for run in planned if run["state"] == "published"} == {None}
    table.write_bytes(table.read_bytes()[:-9])
    assert f"{table.name}: cannot be read (damaged)" in call("study", "plan", *rest).err


def test_runs_that_another_version_published_are_not_trained_again(tmp_path: Path) -> None:
    """Pneuma's own tables were trained by an older version, and reading commands show them."""
    plan = ("study", "plan", "activation@paper", "--unpublished", "--json", "--results", tmp_path)
    assert {run["state"] for run in described(*plan)["runs"]} == {"published"}


def test_a_crash_is_exit_code_1_with_the_file_of_its_traceback(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = tmp_path / "python"
    script.write_text("#!/bin/sh\necho out of luck >&2\nexit 3\n")
    script.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(script))
    results = tmp_path / "results"
    called = call("study", "run", "activation", "--seeds", "1", "--condition", "tanh", "--results", results)
    assert called.code == 1
    (trace,) = results.glob("runs/*/error.txt")
    assert f"tanh seed 0 crashed: out of luck ({trace})" in called.out
    assert trace.read_text() == "the worker process ended with code 3\nout of luck\n"
    status = call("study", "status", "activation", "--runs", "--json", "--results", results)
    assert (status.code, status.document["runs"][0]["status"]) == (0, "crashed")


def test_a_copy_of_a_shipped_study_plans_the_same_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a plain one, a crossed one, and one with a file of its own beside it."""
    monkeypatch.chdir(tmp_path)
    for name in ("activation", "robustness", "betas-and-units"):
        printed("study", "new", f"my-{name}", "--from", name)
        own, shipped = load_study(f"my-{name}.toml"), load_study(name)
        plans = [make_plan(study, Query(preset="quick")).cells for study in (own, shipped)]
        assert [cell.run_id for cell in plans[0]] == [cell.run_id for cell in plans[1]]
        assert (own.title, own.section, own.about) == (f"my-{name}", "", "")


def test_a_comparison_shows_the_outcomes_of_the_claim_on_it_first() -> None:
    """The claim tanh-better is on tanh and ReLU, whichever is named first; none is on tanh and LeakyReLU."""
    words = ("study", "compare", "activation")
    code, out, _ = call(*words, "relu", "tanh")
    assert code == 0 and "Claims about these conditions: tanh-better" in out
    outcomes = [row["outcome"] for row in described(*words, "relu", "tanh", "--json")["comparisons"]]
    assert outcomes[:2] == ["final-return", "late-share-killed"]
    assert "claim" not in call(*words, "tanh", "leaky-relu").out
