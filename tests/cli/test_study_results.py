"""The study commands over runs that are really trained: a tiny activation study."""

from __future__ import annotations

import io
import shutil
from pathlib import Path

import pandas as pd
import pytest

from .calls import TINY, Called, call, described, printed

# Design section 2, word for word.
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


# --- run, plan, status ---------------------------------------------------------------------------


def test_only_what_is_missing_is_trained_and_told_as_one_document(results: Path) -> None:
    first = sorted((results / "runs").iterdir())[0]
    shutil.rmtree(first)
    run = ("study", "run", "activation", *TINY, "--seeds", "2", "--results", results)
    called = call(*run, "--json")
    document = called.document
    assert (called.code, document["schema"], document["study"]) == (0, 1, "activation")
    assert [(run["seed"], run["condition"], run["status"]) for run in document["runs"]] == [
        (seed, condition, "done") for seed in (0, 1) for condition in ("tanh", "relu")
    ]
    assert [run["run_id"] for run in document["runs"] if run["trained"]] == [first.name]
    assert "250 steps are rounded up to 256" in called.err
    assert "activation: 4 done; 0 trained now, 4 were stored." in printed(*run)
    assert call(*run, "--quiet") == Called(0, "", "")


def test_status_is_of_the_latest_selection_or_of_one_that_is_named(
    trained: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PNEUMA_RESULTS", str(trained))
    document = described("study", "status", "activation", "--json")
    assert {*document["runs"][0]} == {
        "run_id", "condition", "seed", "status", "step", "published",
    }  # fmt: skip
    assert [(run["seed"], run["status"]) for run in document["runs"]] == [
        (0, "done"), (0, "done"), (1, "done"), (1, "done"),
    ]  # fmt: skip
    runs = described("study", "status", "activation", *TINY, "--seeds", "1,2", "--json")["runs"]
    assert [(run["seed"], run["status"]) for run in runs] == [
        (1, "done"), (1, "done"), (2, "planned"), (2, "planned"),
    ]  # fmt: skip


# --- export --------------------------------------------------------------------------------------


def _export(results: Path, table: str, out: Path, *selection: str) -> bytes:
    how = ("--table", table, "--out", out, *selection, "--results", results)
    printed("study", "export", "activation", *how)
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


def test_all_formats_hold_the_same_rows_in_the_studys_order_seed_by_seed(
    trained: Path, tmp_path: Path
) -> None:
    csv = pd.read_csv(io.BytesIO(_export(trained, "metrics", tmp_path / "x.csv")))
    parquet = pd.read_parquet(io.BytesIO(_export(trained, "metrics", tmp_path / "x.parquet")))
    pd.testing.assert_frame_equal(csv, parquet, check_dtype=False, rtol=1e-12)
    latex = _export(trained, "metrics", tmp_path / "x.tex").decode()
    rows = [line for line in latex.splitlines() if line.endswith(r"\\")]
    assert len(rows) == 1 + 16 and r"run\_id" in rows[0]
    blocks = list(dict.fromkeys(zip(csv["seed"], csv["condition"], strict=True)))
    assert blocks == [(0, "tanh"), (0, "relu"), (1, "tanh"), (1, "relu")]
    assert csv["step"].to_list() == [64, 128, 192, 256] * 4
    own = _export(trained, "episodes", tmp_path / "own.csv", *TINY, "--seeds", "1,")
    assert set(pd.read_csv(io.BytesIO(own))["seed"]) == {1}


def test_curves_are_exported_with_the_window_and_the_band_that_are_named(
    trained: Path, tmp_path: Path
) -> None:
    """At the end of training: what the last hundred episodes of each run returned, least and greatest."""
    looks = ("--window", "trailing-100", "--band", "minmax")
    curves = pd.read_csv(io.BytesIO(_export(trained, "curves", tmp_path / "c.csv", *looks)))
    episodes = pd.read_csv(io.BytesIO(_export(trained, "episodes", tmp_path / "e.csv")))
    returns = curves[(curves["quantity"] == "return") & (curves["step"] == curves["step"].max())]
    assert set(curves["band"]) == {"minmax"}
    for condition in ("tanh", "relu"):
        own = episodes[episodes["condition"] == condition].sort_values(["run_id", "step"])
        means = [own[own["run_id"] == name]["return"][-100:].mean() for name in own["run_id"].unique()]
        found = returns[returns["condition"] == condition][["low", "mean", "high"]].to_numpy(float)[0]
        assert found == pytest.approx([min(means), sum(means) / len(means), max(means)])
