"""The study commands over runs that are really trained: a tiny activation study, once for the module."""

from __future__ import annotations

import io
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
import pytest

from pneuma.study.checkpoints import file_name

from .calls import Called, call

CLI = Path(__file__).parents[2] / "cli.py"
SETTINGS = ("horizon=64", "minibatch=32", "epochs=1", "evaluation_episodes=2", "episode_steps=50")
TINY = [
    "--steps", "250",  # 4 horizons of 64 are 256
    "--condition", "tanh",
    "--condition", "relu",
    *(part for setting in SETTINGS for part in ("--set", setting)),
]  # fmt: skip

# Design section 2, word for word.
EPISODES = "condition, seed, run_id, slot, episode, step, return, length, kills, hp, ending"
METRICS = (
    "condition, seed, run_id, step, policy_loss, value_loss, entropy, approx_kl, clip_fraction, grad_norm, "
    "grad_norm_actor, grad_norm_critic, explained_variance, dead_units, "
    "action_0, action_1, action_2, action_3, action_4"
)


@dataclass(frozen=True)
class Trained:
    """A results folder with two conditions of two seeds, and what the two runs of the study said."""

    results: Path
    first: Called
    second: Called


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Trained:
    results = tmp_path_factory.mktemp("trained") / "results"
    first = call("study", "run", "activation", *TINY, "--seeds", "1", "--json", "--results", results)
    second = call("study", "run", "activation", *TINY, "--seeds", "2", "--results", results)
    return Trained(results, first, second)


# --- run -----------------------------------------------------------------------------------------


def test_run_gives_one_document_and_tells_people_on_standard_error(trained: Trained) -> None:
    assert trained.first.code == 0
    document = trained.first.document
    assert {key: document[key] for key in ("schema", "study")} == {"schema": 1, "study": "activation"}
    assert [{k: run[k] for k in run if k != "run_id"} for run in document["runs"]] == [
        {"condition": condition, "seed": 0, "status": "done", "trained": True}
        for condition in ("tanh", "relu")
    ]
    assert len({run["run_id"] for run in document["runs"]}) == 2
    assert "250 steps are rounded up to 256" in trained.first.err


def test_one_seed_more_trains_only_the_new_runs(trained: Trained) -> None:
    assert trained.second.code == 0
    assert "activation: 4 done; 2 trained now, 2 were stored." in trained.second.out


def test_run_again_trains_nothing(trained: Trained) -> None:
    again = call("study", "run", "activation", *TINY, "--seeds", "2", "--json", "--results", trained.results)
    assert again.code == 0
    assert [(run["status"], run["trained"]) for run in again.document["runs"]] == [("done", False)] * 4


def test_a_quiet_run_says_nothing_when_all_is_well(trained: Trained) -> None:
    again = call("study", "run", "activation", *TINY, "--seeds", "2", "--quiet", "--results", trained.results)
    assert again == Called(0, "", "")


def test_the_folder_can_be_named_by_the_environment(
    trained: Trained, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PNEUMA_RESULTS", str(trained.results))
    assert len(call("study", "status", "activation", "--json").document["runs"]) == 4


# --- plan, status --------------------------------------------------------------------------------


def test_plan_tells_what_is_stored_and_what_is_not(trained: Trained) -> None:
    called = call(
        "study", "plan", "activation", *TINY, "--seeds", "3", "--json", "--results", trained.results
    )
    document = called.document
    assert (called.code, document["schema"], document["study"]) == (0, 1, "activation")
    assert [set(run) for run in document["runs"]] == [
        {"run_id", "condition", "seed", "state", "expected_seconds"}
    ] * 6
    assert [run["state"] for run in document["runs"]] == ["stored"] * 4 + ["to-train"] * 2
    assert [run["seed"] for run in document["runs"]] == [0, 0, 1, 1, 2, 2]


def test_a_plan_says_in_what_the_conditions_differ(trained: Trained) -> None:
    called = call("study", "plan", "activation", *TINY, "--seeds", "3", "--results", trained.results)
    assert "Conditions differ in activation: tanh (tanh); relu (relu)" in called.out
    assert "4 stored, 2 to train." in called.out


@pytest.mark.parametrize(
    ("text", "seeds"), [("3,5,8", [3, 5, 8]), ("7,", [7]), ("2", [0, 1]), ("1", [0]), ("5, 3", [5, 3])]
)
def test_seeds_are_a_count_or_a_list(text: str, seeds: list[int], tmp_path: Path) -> None:
    called = call(
        "study",
        "plan",
        "activation",
        "--condition",
        "tanh",
        "--seeds",
        text,
        "--json",
        "--results",
        tmp_path,
    )
    assert [run["seed"] for run in called.document["runs"]] == seeds


def test_status_is_of_the_latest_selection(trained: Trained) -> None:
    called = call("study", "status", "activation", "--json", "--results", trained.results)
    document = called.document
    assert (called.code, document["schema"], document["study"]) == (0, 1, "activation")
    assert [set(run) for run in document["runs"]] == [
        {"run_id", "condition", "seed", "status", "step", "published", "trained"}
    ] * 4
    assert {(run["condition"], run["seed"], run["status"], run["trained"]) for run in document["runs"]} == {
        (condition, seed, "done", False) for condition in ("tanh", "relu") for seed in (0, 1)
    }


def test_status_of_a_selection_of_its_own(trained: Trained) -> None:
    called = call(
        "study", "status", "activation", *TINY, "--seeds", "1,2", "--json", "--results", trained.results
    )
    runs = [(run["seed"], run["status"]) for run in called.document["runs"]]
    assert runs == [(1, "done"), (1, "done"), (2, "planned"), (2, "planned")]


def test_status_for_people_counts_and_lists(trained: Trained) -> None:
    called = call("study", "status", "--results", trained.results)
    lines = called.out.splitlines()
    assert lines[0] == "activation: 4 done"
    assert len(lines) == 5
    assert len({line.index(" seed ") for line in lines[1:]}) == 1


def test_a_damaged_record_stands_in_no_other_studys_way(trained: Trained, tmp_path: Path) -> None:
    results = Path(shutil.copytree(trained.results, tmp_path / "results"))
    (results / "studies" / "clip-range.json").write_text("{", encoding="utf-8")
    told = "clip-range.json: damaged; `pneuma study run clip-range` writes it anew.\n"
    for command, shown in (("status", "activation: 4 done"), ("plot", "fig-6-5.png")):
        called = call("study", command, "--results", results)
        assert called.code == 0 and shown in called.out
        assert called.err.startswith("Note: ") and called.err.endswith(told)
        assert call("study", command, "clip-range", "--results", results).code == 2
    (results / "studies" / "activation.json").unlink()
    called = call("study", "status", "--results", results)
    assert (called.code, called.out) == (2, "") and told[:-2] in called.err


def test_status_tells_how_far_a_run_is_that_was_killed(trained: Trained, tmp_path: Path) -> None:
    results = Path(shutil.copytree(trained.results, tmp_path / "results"))
    killed, nothing = sorted((results / "runs").iterdir())[:2]
    for folder in (killed, nothing):
        shutil.rmtree(folder)
        (folder / "checkpoints").mkdir(parents=True)
    (killed / "checkpoints" / file_name(1024, b"")).touch()
    lines = call("study", "status", "--results", results).out.splitlines()
    ends = dict(line.split(maxsplit=3)[3].split("  ", 1) for line in lines[1:])
    assert ends.pop(killed.name) == "partial  at step 1,024"
    assert ends.pop(nothing.name) == "planned"
    assert list(ends.values()) == ["done", "done"]


# --- plot ----------------------------------------------------------------------------------------


def test_plot_writes_into_the_results_unless_told_otherwise(trained: Trained, tmp_path: Path) -> None:
    results = Path(shutil.copytree(trained.results, tmp_path / "results"))
    called = call("study", "plot", "--results", results)
    assert called.code == 0
    assert sorted(os.listdir(results / "figures")) == ["fig-6-5.png", "fig-6-5.svg", "index.json"]
    out = tmp_path / "out"
    called = call(
        "study", "plot", "activation", "--results", results, "--out", out, "--format", "pdf", "--json"
    )
    assert called.document == {"schema": 1, "figures": [str(out / "fig-6-5.pdf")]}
    assert (out / "fig-6-5.pdf").read_bytes().startswith(b"%PDF")


# --- export --------------------------------------------------------------------------------------


def _export(trained: Trained, table: str, form: str, out: Path, *selection: str) -> bytes:
    called = call(
        "study", "export", "activation", "--table", table, "--format", form, "--out", out, *selection,
        "--results", trained.results,
    )  # fmt: skip
    assert called.code == 0
    return out.read_bytes()


@pytest.mark.parametrize(("table", "columns"), [("episodes", EPISODES), ("metrics", METRICS)])
def test_an_exported_table_has_exactly_the_documented_columns(
    trained: Trained, table: str, columns: str, tmp_path: Path
) -> None:
    header = _export(trained, table, "csv", tmp_path / "x.csv").decode().splitlines()[0]
    assert header == columns.replace(", ", ",")
    frame = pd.read_parquet(io.BytesIO(_export(trained, table, "parquet", tmp_path / "x.parquet")))
    assert list(frame.columns) == columns.split(", ")


@pytest.mark.parametrize("table", ["episodes", "metrics", "evaluations", "curves"])
@pytest.mark.parametrize("form", ["csv", "parquet", "latex"])
def test_exporting_twice_gives_the_same_bytes(
    trained: Trained, table: str, form: str, tmp_path: Path
) -> None:
    first = _export(trained, table, form, tmp_path / "first")
    assert _export(trained, table, form, tmp_path / "second") == first
    assert first


def test_all_formats_hold_the_same_rows(trained: Trained, tmp_path: Path) -> None:
    csv = pd.read_csv(io.BytesIO(_export(trained, "metrics", "csv", tmp_path / "x.csv")))
    parquet = pd.read_parquet(io.BytesIO(_export(trained, "metrics", "parquet", tmp_path / "x.parquet")))
    latex = _export(trained, "metrics", "latex", tmp_path / "x.tex").decode()
    assert len(csv) == len(parquet) == 2 * 2 * 4  # conditions, seeds, updates
    pd.testing.assert_frame_equal(csv, parquet, check_dtype=False, rtol=1e-12)
    rows = [line for line in latex.splitlines() if line.endswith(r"\\")]
    assert len(rows) == 1 + 16
    assert r"run\_id" in rows[0]


def test_curves_are_exported_with_the_window_and_the_band_that_are_named(
    trained: Trained, tmp_path: Path
) -> None:
    """At the end of training: what the last hundred episodes of each run returned, least and greatest."""
    looks = ("--window", "trailing-100", "--band", "minmax")
    curves = pd.read_csv(io.BytesIO(_export(trained, "curves", "csv", tmp_path / "c", *looks)))
    episodes = pd.read_csv(io.BytesIO(_export(trained, "episodes", "csv", tmp_path / "e")))
    returns = curves[(curves["quantity"] == "return") & (curves["step"] == curves["step"].max())]
    assert set(curves["band"]) == {"minmax"}
    for condition in ("tanh", "relu"):
        own = episodes[episodes["condition"] == condition].sort_values(["run_id", "step"])
        means = [own[own["run_id"] == name]["return"][-100:].mean() for name in own["run_id"].unique()]
        found = returns[returns["condition"] == condition][["low", "mean", "high"]].to_numpy(float)[0]
        assert found == pytest.approx([min(means), sum(means) / len(means), max(means)])


@pytest.mark.parametrize("option", [("--window", "trailing-100"), ("--band", "se")])
def test_looks_of_curves_go_with_no_other_table(
    trained: Trained, tmp_path: Path, option: tuple[str, str]
) -> None:
    arguments = ("study", "export", "activation", "--table", "episodes", "--out", tmp_path / "e.csv")
    called = call(*arguments, *option, "--results", trained.results)
    assert called.code == 2 and f"{' '.join(option)}: goes with --table curves alone" in called.err


def test_rows_come_in_the_studys_order_seed_by_seed(trained: Trained, tmp_path: Path) -> None:
    frame = pd.read_csv(io.BytesIO(_export(trained, "metrics", "csv", tmp_path / "x.csv")))
    blocks = list(dict.fromkeys(zip(frame["seed"], frame["condition"], strict=True)))
    assert blocks == [(0, "tanh"), (0, "relu"), (1, "tanh"), (1, "relu")]
    assert frame["step"].to_list() == [64, 128, 192, 256] * 4


def test_a_selection_exports_only_its_own_runs(trained: Trained, tmp_path: Path) -> None:
    data = _export(trained, "episodes", "csv", tmp_path / "x.csv", *TINY, "--seeds", "1,")
    assert set(pd.read_csv(io.BytesIO(data))["seed"]) == {1}


def test_actions_of_every_update_add_up(trained: Trained, tmp_path: Path) -> None:
    frame = pd.read_csv(io.BytesIO(_export(trained, "metrics", "csv", tmp_path / "x.csv")))
    shares = frame[[f"action_{i}" for i in range(5)]]
    assert shares.sum(axis=1).to_numpy() == pytest.approx(1)
    assert (shares.to_numpy() * 64 % 1 == 0).all()  # each a count of 64 steps


def test_exporting_to_a_folder_is_refused_in_one_line(trained: Trained, tmp_path: Path) -> None:
    called = call(
        "study",
        "export",
        "activation",
        "--table",
        "episodes",
        "--out",
        tmp_path,
        "--results",
        trained.results,
    )
    assert (called.code, called.out) == (2, "")
    (line,) = called.err.splitlines()
    assert line.startswith("pneuma: --out ")
    assert os.listdir(tmp_path) == []


# --- summary -------------------------------------------------------------------------------------


def test_a_summary_tells_of_what_is_asked_for_or_why_there_is_none(trained: Trained) -> None:
    asked = ("final-died", "steps-to:0.125", "q-overestimation", "collapse-step", "wall-seconds")
    options = [part for name in asked for part in ("--outcome", name)]
    told = call("study", "summary", "activation", *options, "--results", trained.results)
    assert told.code == 0
    blocks = [block.splitlines() for block in told.out.split("\n\n")[1:]]
    assert [block[0].partition(": ")[0] for block in blocks[:-1]] == list(asked)
    assert "until 12.5% of the monsters" in blocks[1][0]
    assert blocks[2][1].endswith(
        "n = 0   the run has no value of its evaluations to take q-overestimation from"
    )
    assert blocks[3][2].endswith("n = 0   the run never collapsed")
    assert "P(better" in blocks[0][1] and "P(better" not in "".join(blocks[4])
    document = call("study", "summary", "activation", *options[:2], "--json", "--results", trained.results)
    outcomes = {row["outcome"] for row in document.document["summary"]}
    assert outcomes == {"runs", "diverged", "collapsed", "final-died"}
    wrong = call("study", "summary", "activation", "--outcome", "final-dead", "--results", trained.results)
    assert wrong.code == 2 and "did you mean final-died?" in wrong.err and wrong.err.count("\n") == 1
