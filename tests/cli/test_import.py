"""The study commands over what `pneuma import tensorboard` and `csv` imported."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from PIL import Image

from ..hand_made import write_events, write_table
from .calls import SETTINGS, call, described, printed, refused

FILE = "events.out.tfevents.1700000000.host"
RETURN, LENGTH = "rollout/ep_rew_mean", "rollout/ep_len_mean"


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    folder = tmp_path / "old"
    for number, name in enumerate(("tanh_1", "tanh_2", "relu_1")):
        points = [(tag, 100 * k, k + number / 4) for k in range(1, 11) for tag in (RETURN, LENGTH)]
        write_events(folder / name / FILE, [*points, ("time/fps", 1000, 700.0)])
    return folder


@pytest.fixture
def results(tmp_path: Path, logs: Path) -> Path:
    assert call("import", "tensorboard", logs, "--results", tmp_path / "results")[0] == 0
    return tmp_path / "results"


def test_an_import_is_drawn_and_published_and_drawn_again(
    logs: Path, results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders = [logs / name for name in ("relu_1", "tanh_1", "tanh_2")]
    again = call("import", "tensorboard", *folders, "--results", results)
    assert "3 runs, 63 points; 0 imported now, 3 were stored." in again.out
    monkeypatch.chdir(results.parent)  # a figure tells the folder that it was drawn from
    assert call("study", "plot", "old", "--results", "results")[0] == 0
    assert call("study", "publish", "old", "--results", results)[0] == 0
    clone = tmp_path / "clone" / "results"
    shutil.copytree(results / "published", clone / "published")
    monkeypatch.chdir(clone.parent)
    assert call("study", "plot", "old", "--results", "results")[0] == 0
    for name in ("old.png", "old.svg"):
        assert (clone / "figures" / name).read_bytes() == (results / "figures" / name).read_bytes()


@pytest.mark.usefixtures("unshipped")
def test_a_study_is_compared_with_logs(trained: Path, logs: Path, tmp_path: Path) -> None:
    """In the conditions that both have; the reward behind a log is not known, and its return is compared."""
    at = ("--results", shutil.copytree(trained, tmp_path / "results"))
    printed("import", "tensorboard", logs, *at)
    words = ("study", "compare", "activation", "--with", "old", *SETTINGS)
    told = printed(*words, "--outcome", "final-return", *at)
    rows = [line.split("  ") for line in told.splitlines() if line.startswith(("tanh", "relu"))]
    found = {row[0]: row[-2].strip() or row[-3] for row in rows}
    assert {name: runs.strip() for name, runs in found.items()} == {"tanh": "2 and 2", "relu": "2 and 1"}
    assert "Activation function in the arena" in told or "Activation function, and old" in told
    only = ("--condition", "leaky-relu")
    assert "leaky-relu alone, seeds 0..1, " in refused(*words, *only, *at)


@pytest.mark.usefixtures("unshipped")
def test_of_logs_beside_a_study_the_conditions_that_are_asked_for_are_drawn(
    trained: Path, logs: Path, tmp_path: Path
) -> None:
    at = ("--results", shutil.copytree(trained, tmp_path / "results"))
    printed("import", "tensorboard", logs, *at)
    out = tmp_path / "beside.png"
    printed(
        "study", "plot", "activation", *SETTINGS, "--condition", "tanh", "--beside", "old", "--out", out, *at
    )
    with Image.open(out) as image:
        _, *lines = image.info["Description"].splitlines()
    assert [line.partition(", seeds")[0] for line in lines] == ["activation, tanh", "old, tanh"]


def test_a_table_of_runs_is_compared_with_a_study_in_what_both_have(tmp_path: Path) -> None:
    at = ("--results", tmp_path / "results")
    curves = {(name, seed): {10: 1.0, 20: seed} for name in ("tanh", "relu") for seed in (0, 1)}
    table = write_table(tmp_path / "runs.csv", curves)
    columns = ("--step", "step", "--value", "return", "--condition", "condition", "--seed", "seed")
    printed("import", "csv", table, *columns, *at)
    told = described("study", "compare", "activation", "--with", "runs", "--json", *at)
    assert {row["outcome"] for row in told["comparisons"]} == {"final-return", "auc-return"}
    assert {row["seeds_b"] for row in told["comparisons"]} == {2}
