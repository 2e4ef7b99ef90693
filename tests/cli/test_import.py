"""The study commands over what `pneuma import tensorboard` and `csv` imported."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from PIL import Image

from ..hand_made import write_events
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
    assert f"Storing 3 runs as the study old in {results}." in again.err  # before it takes time
    monkeypatch.chdir(results.parent)  # a figure contains the folder that it was drawn from
    assert call("study", "plot", "old", "--results", "results")[0] == 0
    assert call("study", "publish", "old", "--results", results)[0] == 0
    clone = tmp_path / "clone" / "results"
    shutil.copytree(results / "published", clone / "published")
    monkeypatch.chdir(clone.parent)
    assert call("study", "plot", "old", "--results", "results")[0] == 0
    for name in ("old.png", "old.svg"):
        assert (clone / "figures" / name).read_bytes() == (results / "figures" / name).read_bytes()


def test_two_conditions_of_logs_are_compared_in_what_they_have_and_not_trained(results: Path) -> None:
    compared = described("study", "compare", "old", "tanh", "relu", "--results", results, "--json")
    assert [row["outcome"] for row in compared["comparisons"]] == ["final-return", "auc-return"]
    message = refused("study", "run", "old", "--results", results)
    assert message == "study old: its runs were imported and cannot be trained"


@pytest.mark.usefixtures("unshipped")
def test_logs_are_compared_and_drawn_with_a_study_in_what_both_have(
    trained: Path, logs: Path, tmp_path: Path
) -> None:
    """The conditions of both; the reward behind a log is not known, and its return is compared."""
    at = ("--results", shutil.copytree(trained, tmp_path / "results"))
    printed("import", "tensorboard", logs, *at)
    words = ("study", "compare", "activation", "--with", "old", *SETTINGS, *at)
    comparisons = described(*words, "--outcome", "final-return", "--json")["comparisons"]
    runs = {row["a"]: (row["seeds_a"], row["seeds_b"]) for row in comparisons}
    assert runs == {"tanh, activation": (2, 2), "relu, activation": (2, 1)}
    called = call(*words, "--json")
    assert {row["outcome"] for row in called.document["comparisons"]} == {"final-return", "auc-return"}
    own = "Note: returns average different episodes: mean of the last 5 % of the budget at each point"
    assert f"{own} (activation) and mean of the last 100 episodes (old)." in called.err
    assert "leaky-relu alone, seeds 0..1, " in refused(*words, "--condition", "leaky-relu")
    plot = ("study", "plot", "activation", *SETTINGS, "--condition", "tanh", "--beside", "old")
    lines_of_counts = call(*plot, "--out", tmp_path / "beside.png", *at).err
    assert "old, tanh alone: 2 of 2 runs." in lines_of_counts  # of 3, as those of relu are not drawn
    with Image.open(tmp_path / "beside.png") as image:
        _, *lines = image.info["Description"].splitlines()
    assert [line.partition(", seeds")[0] for line in lines] == ["activation, tanh", "old, tanh"]
