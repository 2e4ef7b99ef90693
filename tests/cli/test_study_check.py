"""`pneuma study check` over a tiny study that is really trained, published, and trained again."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from pneuma.analysis.check import choose_runs
from pneuma.api import check_study
from pneuma.cli import STOPPED
from pneuma.config import ENGINE_VERSIONS
from pneuma.store.index import RunIndex
from pneuma.store.provenance import machine
from pneuma.store.published import Published, encode_published
from pneuma.store.rows import COLUMN_TYPES, Row
from pneuma.store.store import Store
from pneuma.study.plan import Query
from pneuma.training.executors import local

from ..hand_made import save_listing
from .calls import TINY, Called, call, described, finish_study, printed, refused

pytestmark = pytest.mark.usefixtures("trains_here", "unshipped")


SETTINGS = {
    "horizon": 64, "slots": 1, "minibatch": 32, "epochs": 1, "evaluation_episodes": 2, "episode_steps": 50,
}  # fmt: skip
"""As `calls.SETTINGS`, for Python."""


@pytest.fixture
def scratch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of temporary folders."""
    folder = tmp_path / "scratch"
    folder.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(folder))
    return folder


@pytest.fixture
def table(trained: Path, tmp_path: Path, scratch: Path) -> Path:
    """The published table of four runs, in a results folder without anything else."""
    results = Path(shutil.copytree(trained, tmp_path / "results"))
    printed("study", "publish", "activation", *TINY[2:], "--results", results)
    for folder in ("runs", "last"):
        shutil.rmtree(results / folder)
    (path,) = (results / "published").iterdir()
    return path


def words_of(table: Path, *options: object) -> list[object]:
    return ["study", "check", "activation", *TINY, "--seeds", "2", *options, "--results", table.parents[1]]


def check(table: Path, *options: object) -> Called:
    return call(*words_of(table, *options))


def contents(results: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in results.rglob("*") if path.is_file()}


def edit(table: Path, change: Callable[[Row], dict[str, Any]], only: str = "") -> None:
    """Change cells of the runs of a published table, or of one run, and write a checksum that is right."""
    published = Published(table, table.read_bytes())
    rows = []
    for row in published.rows().values():
        cells = row.table
        for column, cell in (change(row) if only in ("", row.run_id) else {}).items():
            array = pa.array([cell], COLUMN_TYPES.get(column, row.table[column].type))
            cells = cells.set_column(cells.column_names.index(column), column, array)
        rows.append(replace(row, shared_table=cells, row_index=0))
    table.write_bytes(encode_published(rows, {"study": "activation"}))


def set_seconds(table: Path, seconds: dict[tuple[str, int], float | None]) -> None:
    """Change the recorded seconds of runs, by activation and seed; None is unknown."""

    def change(row: Row) -> dict[str, Any]:
        provenance = {key: value for key, value in row.provenance.items() if not key.endswith("_seconds")}
        known_seconds = seconds[row.fields["activation"], row.seed]
        if known_seconds is not None:
            provenance["training_seconds"] = known_seconds
        return {"provenance": json.dumps(provenance)}

    edit(table, change)


# --- Runs that are the same ------------------------------------------------------------------------


def test_published_runs_have_the_same_bits_and_no_trace_is_left(table: Path, scratch: Path) -> None:
    """The results folder may be read-only."""
    before = contents(table.parents[1])
    table.parent.chmod(0o500)
    table.parents[1].chmod(0o500)
    code, out, err = check(table)
    table.parents[1].chmod(0o700)
    table.parent.chmod(0o700)
    assert code == 0
    title, _, _, *run_lines = out.splitlines()
    assert title == "2 of 2 runs: the same bits."
    assert {line.split()[0] for line in run_lines[:2]} == {"tanh", "relu"}
    assert all(line.endswith("250    the same bits") for line in run_lines[:2])
    assert f"Compiled here for {machine()['target']}." in run_lines
    assert "not compared: grad_norm_actor" in out  # a table keeps only some curves
    told, *rest = err.splitlines()
    assert "tanh seed" in told and "relu seed" in told and f"on one core ({machine()['cpu']})." in told
    assert any(line.startswith("Training 2 runs") for line in rest) and "2/2 runs ended" in rest[-1]
    assert contents(table.parents[1]) == before and os.listdir(scratch) == []


def test_the_shortest_runs_are_trained_one_of_each_condition_first(table: Path) -> None:
    """Those whose time is unknown come last, and identical conditions count once."""
    set_seconds(table, {("tanh", 0): 3.0, ("tanh", 1): 2.0, ("relu", 0): None, ("relu", 1): 70.0})

    def chosen(count: int) -> tuple[list[str], str]:
        query = Query("activation", seeds=(0, 1), steps=250, conditions=("tanh", "relu"), settings=SETTINGS)
        runs = choose_runs(RunIndex(Store(table.parents[1]), stored=False), query, count)
        return [f"{cell.condition} {cell.seed}" for cell in runs.plan.cells], runs.notes[0]

    names, told = chosen(9)
    assert names == ["tanh 1", "relu 1", "tanh 0", "relu 0"]
    assert f"75 s before, on one core ({machine()['cpu']}), without 1 run whose time was not recor" in told
    names, told = chosen(1)
    assert names == ["tanh 1"] and "This took 2 s before" in told
    set_seconds(table, dict.fromkeys([("tanh", 0), ("tanh", 1), ("relu", 0), ("relu", 1)]))
    names, told = chosen(2)
    assert names == ["tanh 0", "relu 0"] and told.endswith("How long this took was not recorded.")


def test_a_document_and_a_call_from_python_have_the_same_answer(table: Path) -> None:
    document = described(*words_of(table, "--runs", 1, "--json"))
    (run,) = document["runs"]
    assert (run["same"], run["differences"], run["quantity"], run["steps"]) == (True, 0, None, 250)
    assert (document["same_bits"], document["published_runs"], document["by_earlier_version"]) == (1, 4, 0)
    assert document["machines"] == [] and document["compiled_for"] == [machine()["target"]]
    set_seconds(table, dict.fromkeys([("tanh", 0), ("tanh", 1), ("relu", 0), ("relu", 1)]))
    answer = check_study(
        "activation@paper", table.parents[1], runs=9, seeds=[1], steps=250, conditions=["tanh", "relu"],
        settings=SETTINGS, quiet=True,
    )  # fmt: skip
    assert (
        answer.is_same and [*answer.table["seed"]] == [1, 1] and answer.title == "2 of 2 runs: the same bits."
    )


# --- Runs that differ ------------------------------------------------------------------------------


def other_return(row: Row) -> dict[str, Any]:
    """Return the row's curve of returns with its last point changed by its last bit."""
    curve = np.array(row.cell("return budget-5%"), np.float32)
    curve[-1] = np.nextafter(curve[-1], np.float32(np.inf))
    packages = {**row.provenance["packages"], "numpy": "0.1"}
    provenance = {**row.provenance, "cpu": "An abacus", "packages": packages}
    return {"return budget-5%": curve.tolist(), "provenance": json.dumps(provenance)}


def test_an_edited_row_is_exit_code_1_with_the_first_number_and_both_machines(
    table: Path, scratch: Path
) -> None:
    (first, second) = [run["run_id"] for run in described(*words_of(table, "--json"))["runs"]]
    edit(table, other_return, only=first)
    code, out, _ = check(table)
    lines = out.splitlines()
    assert code == 1 and lines[0] == "1 of 2 runs: the same bits; 1 with other bits."
    (named,) = (line for line in lines if first in line)
    (same,) = (line for line in lines if second in line)
    assert "differs first in Return in training (budget-5%) at step 250: " in named
    assert same.endswith("the same bits")
    machine_lines = [line.split("  ") for line in lines if "An abacus" in line or " 0.1 " in line]
    texts = [[cell.strip() for cell in line if cell] for line in machine_lines]
    assert [line[2:] for line in texts] == [
        ["processor", "An abacus", machine()["cpu"]],
        ["numpy", "0.1", np.__version__],
    ]
    document = check(table, "--json").document
    (run,) = (run for run in document["runs"] if not run["same"])
    assert run["differences"] == 1 and run["published"] != run["here"]
    assert np.float32(run["published"]) == np.nextafter(np.float32(run["here"]), np.float32(np.inf))
    assert [row["fact"] for row in document["machines"]] == ["processor", "system", "numpy"]
    assert os.listdir(scratch) == []


def test_another_policy_is_named_where_no_number_differs_even_if_the_run_is_stored(
    trained: Path, table: Path
) -> None:
    shutil.copytree(trained / "runs", table.parents[1] / "runs")
    edit(table, lambda row: {"policy": "0" * 16})
    code, out, _ = check(table, "--runs", 1)
    assert code == 1 and "Checksum of the policy: 0000000000000000 published, " in out


# --- Runs that cannot be compared ------------------------------------------------------------------


def test_runs_of_an_earlier_version_are_counted_and_not_compared(
    table: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def older(row: Row) -> dict[str, Any]:
        is_relu = row.fields["activation"] == "relu"
        return {"run_id": f"{row.seed:016}", "config_id": "f" * 16} if is_relu else {}

    edit(table, older)
    code, out, err = check(table, "--runs", 9)
    assert code == 0 and out.startswith("2 of 2 runs: the same bits.")
    assert "Note: 2 published runs by an earlier version, which trained otherwise: not compared." in err
    monkeypatch.setitem(ENGINE_VERSIONS, "batched", 99)
    assert "4 published runs, all by an earlier version" in refused(*words_of(table))


def test_what_cannot_be_checked_is_one_line(
    table: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    results = table.parents[1]
    message = refused("study", "check", "activation", "--results", results)
    assert message.startswith("nothing to check, because none of these runs is published: activation in the")
    assert "preset paper: 0 of 90 runs." in message
    save_listing(Store(results), {("a", 0): "a0" * 8})
    assert "study mine: its runs were imported" in refused("study", "check", "mine", "--results", results)
    assert "did you mean activation" in refused("study", "check", "activaton", "--results", results)
    assert "--runs 0: must be" in refused(*words_of(table, "--runs", 0))
    with monkeypatch.context() as patch:
        patch.setattr(tempfile, "tempdir", str(tmp_path / "nowhere"))
        assert "no temporary folder can be written: let the variable TMPDIR name" in refused(*words_of(table))
    edit(table, lambda row: {"signs": "[]"})
    assert f"{table}: cannot be read" in refused(*words_of(table))
    table.write_bytes(table.read_bytes()[:-9])
    message = refused(*words_of(table))
    assert "none of these runs is published" in message and "cannot be read (damaged)" in message


OWN = """\
title = "Mine"
[run]
env = "CartPole-v1"
[conditions.resumable]
engine = "sb3"
[conditions.compiled]
engine = "batched"
[conditions.its-own]
algorithm = "qr-dqn"
algorithm_kwargs = { learning_starts = 50 }
[presets.paper]
seeds = 1
steps = 2_048
"""


def test_what_is_promised_of_other_engines_is_said_first(tmp_path: Path, store: Store) -> None:
    study = tmp_path / "mine.toml"
    study.write_text(OWN)
    finish_study(store, str(study), preset="paper")
    printed("study", "publish", study, "--results", store.root)
    index = RunIndex(store, stored=False)
    _, *notes = choose_runs(index, Query(str(study)), 9).notes
    assert notes == [
        "Note: resumable seed 0 is trained by sb3, whose bits may differ between processors and versions of "
        "PyTorch.",
        "Note: its-own seed 0 is trained by qr-dqn with arguments of its own, whose bits Pneuma does not "
        "promise.",
    ]


def test_a_stop_leaves_nothing_behind(table: Path, scratch: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def stop(*_: object) -> None:
        assert os.listdir(scratch) != []
        raise KeyboardInterrupt

    monkeypatch.setattr(local, "train_runs", stop)
    assert check(table).code == STOPPED
    assert os.listdir(scratch) == []


def test_a_run_that_does_not_finish_is_one_line(
    table: Path, scratch: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise RuntimeError("out of luck")

    monkeypatch.setattr("pneuma.training.worker.train_run", fail)
    code, out, err = check(table, "--runs", 1)
    assert (code, out) == (2, "")
    assert err.endswith("crashed, so nothing was compared: RuntimeError: out of luck\n")
    assert os.listdir(scratch) == []
