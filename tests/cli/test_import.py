"""`pneuma import tensorboard`, and the study commands over what it imported."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from ..hand_made import write_events
from .calls import SETTINGS, call, printed, refused

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


def test_a_log_with_evaluations_of_its_own_is_drawn(tmp_path: Path) -> None:
    """They have no random player; a tag that is called as a column of runs is left out."""
    tags = (RETURN, "eval/success_rate", "eval/condition")
    write_events(tmp_path / "own" / "a_1" / FILE, [(tag, 100 * k, k / 10) for k in (1, 2, 3) for tag in tags])
    at = ("--results", tmp_path / "results")
    printed("import", "tensorboard", tmp_path / "own", *at)
    assert call("study", "plot", "own", "--quantity", "success", *at)[0] == 0


def test_a_log_that_is_left_out_is_not_counted(logs: Path, tmp_path: Path) -> None:
    """Two of three reach step 1,000, where values are compared."""
    (short,) = logs.glob("tanh_2/*")
    short.unlink()
    write_events(short, [(RETURN, 100, 1.0)])
    at = ("--results", tmp_path / "results")
    printed("import", "tensorboard", logs, *at)
    told = printed("study", "summary", "old", *at)
    rows = [line.split("  ") for line in told.splitlines() if line.startswith(("tanh", "relu"))]
    assert {row[0]: next(filter(None, map(str.strip, row[1:]))) for row in rows} == {
        "relu": "1",
        "tanh": "1 of 2",
    }


@pytest.mark.usefixtures("unshipped")
def test_a_study_is_compared_with_logs(trained: Path, logs: Path, tmp_path: Path) -> None:
    """In the conditions that both have; the reward behind a log is not known, and its return is compared."""
    at = ("--results", shutil.copytree(trained, tmp_path / "results"))
    printed("import", "tensorboard", logs, *at)
    told = printed("study", "compare", "activation", "old", *SETTINGS, "--outcome", "final-return", *at)
    rows = [line.split("  ") for line in told.splitlines() if line.startswith(("tanh", "relu"))]
    found = {row[0]: row[-2].strip() or row[-3] for row in rows}
    assert {name: runs.strip() for name, runs in found.items()} == {"tanh": "2 and 2", "relu": "2 and 1"}
    assert "Activation function in the arena" in told or "Activation function, and old" in told
    only = ("--condition", "leaky-relu")
    assert "no runs" in refused("study", "compare", "activation", "old", *only, *SETTINGS, *at)
