"""`pneuma study publish`, and the study commands in a fresh clone, where only published tables are."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from pneuma.cli.study_records import run_states, study_record
from pneuma.study.store import Store

from .calls import call

SETTINGS = ("horizon=64", "minibatch=32", "epochs=1", "evaluation_episodes=2", "episode_steps=50")
TINY = [
    "--steps", "256",
    "--condition", "tanh",
    "--condition", "relu",
    *(part for setting in SETTINGS for part in ("--set", setting)),
]  # fmt: skip


def _export(results: Path, table: str, out: Path, *selection: str) -> bytes:
    called = call(
        "study", "export", "activation", "--table", table, "--out", out, *selection, "--results", results
    )
    assert called.code == 0
    return out.read_bytes()


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A results folder with two conditions of two seeds."""
    results = tmp_path_factory.mktemp("trained") / "results"
    assert call("study", "run", "activation", *TINY, "--seeds", "2", "--results", results).code == 0
    return results


@pytest.fixture(scope="module")
def clone(trained: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A results folder that holds only what was published."""
    assert call("study", "publish", "activation", "--results", trained).code == 0
    clone = tmp_path_factory.mktemp("clone")
    shutil.move(trained / "published", clone / "published")
    return clone


def test_publishing_says_where_and_how_much(trained: Path, tmp_path: Path) -> None:
    results = Path(shutil.copytree(trained, tmp_path / "results"))
    document = call("study", "publish", "activation", "--json", "--results", results).document
    path = results / "published" / "activation.parquet"
    assert document == {
        "schema": 1,
        "study": "activation",
        "file": str(path),
        "bytes": path.stat().st_size,
        "runs": 4,
        "staying": 0,
        "of_other_studies": 0,
        "leaving": 0,
    }


def test_what_was_published_and_is_gone_here_stays(trained: Path, tmp_path: Path) -> None:
    """As on a second machine that has the table and trains another part of the study."""
    results = Path(shutil.copytree(trained, tmp_path / "results"))
    call("study", "publish", "activation", "--results", results)
    files = sorted((results / "published").iterdir())
    before = [path.read_bytes() for path in files]
    for folder in sorted((results / "runs").iterdir())[:3]:
        shutil.rmtree(folder)
    called = call("study", "publish", "activation", "--results", results)
    assert "1 runs from here, 3 as they were published before;" in called.out and not called.err
    assert [path.read_bytes() for path in files] == before
    files[0].write_bytes(files[0].read_bytes()[:-9])
    called = call("study", "publish", "activation", "--results", results)
    assert called.code == 2 and "publish the runs that are here alone in its place by --replace" in called.err


def test_published_curves_leave_the_table_only_where_that_is_asked_for(trained: Path, tmp_path: Path) -> None:
    results = Path(shutil.copytree(trained, tmp_path / "results"))
    publish = ("study", "publish", "activation", "--results", results, "--curves")
    assert call(*publish, "return,entropy").code == 0
    path = results / "published" / "activation.parquet"
    whole = path.read_bytes()
    called = call(*publish, "length,return")
    assert called.code == 2 and "curves of entropy are published, and --curves leaves them out" in called.err
    assert path.read_bytes() == whole
    assert call(*publish, "length,return,entropy").code == 0
    assert call(*publish, "none", "--replace").code == 0
    assert len(path.read_bytes()) < len(whole)


def test_a_table_that_cannot_be_read_is_written_over_only_where_that_is_asked_for(
    trained: Path, tmp_path: Path
) -> None:
    """All selected runs are here, but what else it held nobody can tell."""
    results = Path(shutil.copytree(trained, tmp_path / "results"))
    call("study", "publish", "activation", "--results", results)
    path = results / "published" / "activation.parquet"
    whole = path.read_bytes()
    path.write_bytes(whole[:-9])
    assert call("study", "publish", "activation", "--results", results).code == 2
    assert path.read_bytes() == whole[:-9]
    assert call("study", "publish", "activation", "--replace", "--results", results).code == 0
    assert path.read_bytes() == whole


def test_where_all_is_published_there_is_nothing_to_train_and_still_a_document(
    clone: Path, tmp_path: Path
) -> None:
    results = Path(shutil.copytree(clone, tmp_path / "results"))
    options = ["--seeds", "2", "--unpublished", "--json", "--results", str(results)]
    called = call("study", "run", "activation", *TINY, *options)
    assert called.code == 0 and called.document == {"schema": 1, "study": "activation", "runs": []}
    assert "nothing to train" in called.err and "Draw it" not in called.err


def test_a_damaged_record_does_not_give_way_to_the_published_one_unsaid(clone: Path, tmp_path: Path) -> None:
    results = Path(shutil.copytree(clone, tmp_path / "results"))
    assert not call("study", "status", "activation", "--results", results).err
    (results / "studies").mkdir()
    (results / "studies" / "activation.json").write_text("{")
    called = call("study", "status", "activation", "--results", results)
    assert called.code == 0 and "activation.json is damaged; what is published" in called.err


def test_a_table_and_a_document_do_not_share_standard_output(clone: Path) -> None:
    called = call(
        "study", "export", "activation", "--table", "curves", "--out", "-", "--json", "--results", clone
    )
    assert called.code == 2 and "name a file by --out" in called.err


def test_runs_that_another_study_has_published_are_taken_from_its_table(
    trained: Path, tmp_path: Path
) -> None:
    """Tanh is Table 6.2, which other studies have as a condition of their own."""
    results = tmp_path / "results"
    published = results / "published"
    tiny = [part for part in TINY if part not in ("--condition", "tanh", "relu")]
    ours = ["--condition", "table-6-2", "--condition", "lambda-1", "--seeds", "2", *tiny]
    assert call("study", "run", "policy-gradient", *ours, "--results", results).code == 0
    assert call("study", "publish", "policy-gradient", "--results", results).code == 0
    whole = [path.read_bytes() for path in sorted(published.iterdir())]
    shutil.rmtree(published)
    both = Path(shutil.copytree(trained, tmp_path / "both"))
    assert call("study", "publish", "activation", "--results", both).code == 0
    shutil.copytree(both / "published", published)
    for folder in (both / "runs").iterdir():
        shutil.rmtree(results / "runs" / folder.name, ignore_errors=True)
    called = call("study", "publish", "policy-gradient", "--results", results)
    assert "2 runs from here, 2 of other studies;" in called.out and not called.err
    table, times = sorted(published.glob("policy-gradient.*"))
    assert table.read_bytes() == whole[0]
    assert json.loads(times.read_bytes())["runs"].keys() == json.loads(whole[1])["runs"].keys()


def test_a_study_is_judged_and_drawn_from_its_runs_here_and_its_published_ones(
    trained: Path, tmp_path: Path
) -> None:
    results = Path(shutil.copytree(trained, tmp_path / "results"))
    call("study", "publish", "activation", "--results", results)
    whole = call("study", "summary", "activation", "--results", results)
    curves = _export(results, "curves", tmp_path / "whole.csv")
    gone = sorted((results / "runs").iterdir())[0]
    shutil.rmtree(gone)
    part = call("study", "summary", "activation", "--results", results)
    note = "Note: 1 of 4 runs of activation are not here, but taken from its table.\n"
    assert (part.out, part.err) == (whole.out, note)
    assert _export(results, "curves", tmp_path / "part.csv") == curves
    assert call("study", "collapse", "activation", "--results", results).err == note
    episodes = ("export", "--table", "episodes", "--out", tmp_path / "episodes.csv")
    for command in (episodes, ("trajectories", "--episodes", "1")):
        left_out = call("study", command[0], "activation", *command[1:], "--results", results)
        assert left_out.code == 0 and left_out.err.startswith(
            "Note: 1 of 4 runs of activation are not here, not"
        )
    store = Store(results)
    record = study_record(store, "activation", None)
    assert sorted((state.status, state.published) for state in run_states(store, record)) == [
        *[("done", False)] * 3,
        ("done", True),
    ]
    told = call("study", "status", "activation", "--results", results).out
    assert "3 done" in told and "1 done as published" in told.splitlines()[0]
    (results / "studies" / "activation.json").unlink()
    record = study_record(store, "activation", None)
    assert [(state.status, state.published) for state in run_states(store, record)] == [("done", True)] * 4


def test_what_is_published_is_not_trained_where_that_is_asked(trained: Path, tmp_path: Path) -> None:
    results = Path(shutil.copytree(trained, tmp_path / "results"))
    assert call("study", "publish", "activation", "--results", results).code == 0
    table = results / "published" / "activation.parquet"
    whole = table.read_bytes()
    shutil.rmtree(results / "runs")
    rest = ["activation", *TINY, "--unpublished", "--results", str(results)]
    more = [*rest, "--seeds", "3"]
    planned = call("study", "plan", *more, "--json").document["runs"]
    assert [(run["seed"], run["state"]) for run in planned if run["condition"] == "tanh"] == [
        (0, "published"),
        (1, "published"),
        (2, "to-train"),
    ]
    assert {run["expected_seconds"] for run in planned if run["state"] == "published"} == {None}
    called = call("study", "run", *more)
    assert called.code == 0 and "activation: 2 done; 2 trained now, 0 were stored." in called.out
    assert "Note: 4 runs are published, and not trained;" in called.err
    assert len([*(results / "runs").iterdir()]) == 2
    summary = call("study", "summary", "activation", "--results", results)
    assert summary.err == "Note: 4 of 6 runs of activation are not here, but taken from its table.\n"
    assert call("study", "publish", "activation", "--results", results).code == 0
    assert call("study", "plan", *more).out.splitlines()[-1] == "2 stored, 4 published."
    assert table.read_bytes() != whole
    told = call("study", "run", *rest, "--until-decided")
    assert (told.code, "--unpublished: --until-decided trains what it judges" in told.err) == (2, True)
    table.write_bytes(whole[:-9])
    assert "activation.parquet: damaged" in call("study", "run", *more).err


def test_a_damaged_table_of_another_study_is_told_and_passed_over(trained: Path, tmp_path: Path) -> None:
    results = Path(shutil.copytree(trained, tmp_path / "results"))
    shutil.rmtree(sorted((results / "runs").iterdir())[0])
    (results / "published").mkdir()
    (results / "published" / "other.parquet").write_bytes(b"PAR1")
    called = call("study", "publish", "activation", "--results", results)
    assert called.code == 0 and "3 runs from here;" in called.out
    assert "other.parquet: damaged" in called.err and "its runs are not taken from it" in called.err


def test_published_runs_never_leave_unnoticed(trained: Path, tmp_path: Path) -> None:
    results = Path(shutil.copytree(trained, tmp_path / "results"))
    call("study", "publish", "activation", "--results", results)
    table = results / "published" / "activation.parquet"
    whole = table.read_bytes()
    called = call("study", "publish", "activation", "--condition", "relu", "--results", results)
    assert called.code == 2 and "2 published runs are not in this selection" in called.err
    assert table.read_bytes() == whole
    part = ("--condition", "relu", "--replace", "--results", results)
    assert call("study", "publish", "activation", *part).code == 0
    assert len(table.read_bytes()) < len(whole)


def test_a_fresh_clone_draws_the_same_figure(trained: Path, clone: Path, tmp_path: Path) -> None:
    for name, folder in (("ours", trained), ("theirs", clone)):
        assert call("study", "plot", "activation", "--results", folder, "--out", tmp_path / name).code == 0
    for name in ("fig-6-5.png", "fig-6-5.svg"):
        assert (tmp_path / "ours" / name).read_bytes() == (tmp_path / "theirs" / name).read_bytes()


@pytest.mark.parametrize("table", ["curves", "evaluations"])
@pytest.mark.parametrize("selection", [(), ("--seeds", "1,"), ("--condition", "relu")])
def test_a_fresh_clone_exports_the_same_tables(
    trained: Path, clone: Path, table: str, selection: tuple[str, ...], tmp_path: Path
) -> None:
    ours = _export(trained, table, tmp_path / "ours.csv", *selection)
    assert _export(clone, table, tmp_path / "theirs.csv", *selection) == ours


def test_curves_that_a_rounded_table_lacks_with_a_window_are_told_and_left_out(
    trained: Path, tmp_path: Path
) -> None:
    """A rounded table keeps returns alone as the thesis's figures average them."""
    results = Path(shutil.copytree(trained, tmp_path / "results"))
    assert call("study", "publish", "activation", "--round", "--results", results).code == 0
    shutil.rmtree(results / "runs")
    command = ("study", "export", "activation", "--table", "curves", "--window", "trailing-100")
    called = call(*command, "--out", tmp_path / "c.csv", "--results", results)
    told = "length, kills, hp: not held with the window trailing-100, and left out"
    assert called.code == 0 and told in called.err
    quantities = {line.split(",")[1] for line in (tmp_path / "c.csv").read_text().splitlines()[1:]}
    assert quantities == {"return", "share_killed"}


@pytest.mark.parametrize("table", ["episodes", "metrics"])
def test_what_is_not_published_is_refused_in_one_line(clone: Path, table: str) -> None:
    called = call("study", "export", "activation", "--table", table, "--out", "-", "--results", clone)
    (line,) = called.err.splitlines()
    wanted = f"pneuma: study activation: the published table holds no {table}; there are evaluations, curves"
    assert (called.code, line) == (2, wanted)


def test_what_is_published_is_found_by_a_whole_selection(trained: Path, clone: Path) -> None:
    """The run ids of the plan are looked up in the table."""
    called = call("study", "plot", "activation", *TINY, "--seeds", "2", "--results", clone, "--json")
    assert called.code == 0
    longer = call("study", "plot", "activation", "--steps", "9_000", "--results", clone)
    assert longer.code == 2
    assert "no run of this selection of study activation has finished" in longer.err


def test_publishing_without_the_runs_is_refused(clone: Path) -> None:
    called = call("study", "publish", "activation", "--results", clone)
    assert called.code == 2
    assert "its runs are not in" in called.err


def test_a_damaged_table_is_refused_in_one_line(clone: Path, tmp_path: Path) -> None:
    results = Path(shutil.copytree(clone, tmp_path / "results"))
    path = results / "published" / "activation.parquet"
    path.write_bytes(path.read_bytes()[:-9])
    called = call("study", "plot", "activation", "--results", results)
    (line,) = called.err.splitlines()
    assert (called.code, line.startswith(f"pneuma: {path}: damaged")) == (2, True)


def test_the_states_of_runs_are_told_from_the_table(trained: Path, clone: Path) -> None:
    for folder in (trained, clone):
        store = Store(folder)
        states = run_states(store, study_record(store, "activation", None))
        seeds = [(state.run["seed"], state.status) for state in states]
        assert seeds == [(0, "done")] * 2 + [(1, "done")] * 2
        assert {state.step for state in states} == {states[0].run["run"]["steps"]}
