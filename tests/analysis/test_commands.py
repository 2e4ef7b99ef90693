"""`pneuma study summary` and `collapse` over records made by hand: people's text, JSON, mistakes."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.config import make_run
from pneuma.study.identity import run_id
from pneuma.study.store import Store, run_document

from ..cli.calls import described, printed, refused
from .collapse_records import BUDGET, HORIZON, healthy, learning, one_action, save_run, study_record


@pytest.fixture
def results(tmp_path: Path) -> Path:
    store = Store(tmp_path / "results")
    cells = {("relu", 0): "a0" * 8, ("relu", 1): "a1" * 8, ("tanh", 0): "b0" * 8, ("tanh", 1): "b1" * 8}
    for own in cells.values():
        save_run(store, own, healthy(), learning())
    save_run(store, "a1" * 8, one_action(61), learning())
    store.save_selection("mine", study_record(cells))
    return store.root


def test_collapse_lists_runs_with_onset_and_signs_and_counts_them(results: Path) -> None:
    lines = printed("study", "collapse", "mine", "--results", results).splitlines()
    assert lines[0].split("  ")[-1] == "update 61, step 6,100: no entropy, one action, dead units"
    assert "a1" * 8 in lines[0]
    assert lines[1].endswith("1 of 2 runs collapsed, 95 % interval 1% to 99%")
    assert lines[2].endswith("0 of 2 runs collapsed, 95 % interval 0% to 84%")
    assert lines[3:] == []  # nothing to fork from
    Store(results).write(Store(results).run_folder("a1" * 8) / "checkpoints" / "one", b"")
    assert printed("study", "collapse", "mine", "--results", results).splitlines() == [
        *lines, f"To show the cause: pneuma study collapse mine --fork --results {results}"
    ]  # fmt: skip
    assert printed("study", "collapse", "mine", "--quiet", "--results", results).splitlines() == lines


def test_collapse_as_json(results: Path) -> None:
    document = described("study", "collapse", "mine", "--json", "--results", results)
    assert document["schema"] == 1
    assert [run["onset_update"] for run in document["runs"]] == [None, 61, None, None]
    assert [row["collapsed"] for row in document["incidence"]] == [1, 0]


def test_a_condition_without_a_value_is_said_to_have_none(tmp_path: Path) -> None:
    store, cells = Store(tmp_path / "results"), {("sound", 0): "a0" * 8, ("gone", 0): "b0" * 8}
    save_run(store, "a0" * 8, healthy(), learning())
    save_run(store, "b0" * 8, healthy(), learning(), end=400)  # evaluated from 500 on
    store.save_selection("mine", study_record(cells))
    lines = printed("study", "summary", "mine", "--results", store.root).splitlines()
    place = lines.index("final-share-killed: monsters killed, last evaluation")
    early = "the run diverged at step 400 has no value of its evaluations to take final-share-killed from"
    assert lines[place + 2] == f"  gone   n = 0   {early}"


def test_summary_in_words_and_as_json(results: Path) -> None:
    out = printed("study", "summary", "mine", "--results", results)
    assert "final-share-killed: monsters killed, last evaluation" in out
    assert "median never" not in out and "collapsed 0.50" in out
    rows = described("study", "summary", "mine", "--json", "--results", results)["summary"]
    assert rows[0] == {
        "condition": "relu", "outcome": "runs", "statistic": "count", "value": 2.0, "low": None, "high": None,
        "interval": "none", "runs": 2,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--fork",), "holds no configuration"),
        (("--fork", "--run", "b0b0"), "--run b0b0: is no collapsed run of study mine; there are a1a1a1a1"),
        (("--fork", "--out", "figures"), "--out: does not go with --fork"),
        (("--workers", "2"), "--workers: goes with --fork alone"),
        (("--fork-seeds", "4"), "--fork-seeds: goes with --fork alone"),
        (("--fork", "--condition", "tanh"), "none of its 2 runs collapsed, so there is nothing to fork"),
    ],
)
def test_what_cannot_be_forked_is_said_in_one_line(
    results: Path, arguments: tuple[str, ...], message: str
) -> None:
    assert message in refused("study", "collapse", "mine", *arguments, "--results", results)


def test_a_collapsed_run_with_a_reward_of_its_owners_is_forked_if_trusted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own_reward.py").write_text("def gain(events, players, stats): return events['xp_gained']\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    store = Store(tmp_path / "results")
    run = make_run({"reward": "own_reward:gain", "horizon": HORIZON, "steps": BUDGET})
    name = run_id(run)
    save_run(store, name, one_action(61), learning(), configuration=run_document(run, name))
    store.save_selection("mine", study_record({("own", 0): name}))
    fork = ("study", "collapse", "mine", "--fork", "--results", store.root)
    assert "would run the reward own_reward:gain; --trust allows it" in refused(*fork)
    assert "kept no checkpoints" in refused(*fork, "--trust")  # which is the next thing looked at


@pytest.mark.parametrize("form", ["csv", "parquet", "latex", "markdown"])
def test_the_summary_can_be_exported(results: Path, tmp_path: Path, form: str) -> None:
    paths = [tmp_path / name for name in ("one", "two")]
    for path in paths:
        options = ("--table", "summary", "--format", form, "--out", path, "--results", results)
        printed("study", "export", "mine", *options)
    assert paths[0].read_bytes() == paths[1].read_bytes()
