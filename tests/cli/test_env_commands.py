"""`pneuma env …`: what it lists, checks, draws, and refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from PIL import Image

from pneuma.cli import main
from pneuma.env import REGISTERED

Captured = pytest.CaptureFixture[str]


def test_every_registered_environment_is_listed(capsys: Captured) -> None:
    assert main(["env", "list", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert listed["schema"] == 1
    assert [row["id"] for row in listed["environments"]] == list(REGISTERED)
    assert {row["id"]: row["observation"] for row in listed["environments"]}[
        "pneuma/PneumaGodot-v0"
    ] == "(74,)"


@pytest.mark.parametrize("name", ["pneuma/Pneuma-v0", "pneuma/mo-PneumaGodot-v0", "pneuma/Mailman-v0"])
def test_a_shipped_environment_passes_its_checks(name: str, capsys: Captured) -> None:
    assert main(["env", "check", name, "--json"]) == 0
    checks = json.loads(capsys.readouterr().out)["checks"]
    assert len(checks) >= 2
    assert not [row for row in checks if row["problem"]]


def test_a_reward_that_breaks_a_promise_fails_its_check(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    """A reward that counts how often it was called gives two plays of one seed other numbers."""
    (tmp_path / "counting_reward.py").write_text(
        "import numpy as np\ncalls = [0]\n"
        "def pay(events, players, stats):\n    calls[0] += 1\n    return np.full(events.shape, calls[0])\n"
    )
    monkeypatch.chdir(tmp_path)
    assert main(["env", "check", "pneuma/Pneuma-v0", "--set", "reward=counting_reward:pay"]) == 1
    printed = capsys.readouterr().out
    assert "two plays of one seed differ" in printed


def test_a_level_that_cannot_be_played_is_refused(tmp_path: Path, capsys: Captured) -> None:
    (tmp_path / "objects.csv").write_text("code,x,y\n400,0,0\n")
    (tmp_path / "obstacles.csv").write_text("-1,-1\n-1,x\n")
    assert main(["env", "check", "pneuma/Pneuma-v0", "--set", f"level={tmp_path}"]) == 2
    told = capsys.readouterr().err
    assert "obstacles.csv, row 2, column 2" in told
    assert len(told.splitlines()) == 1


def test_the_whole_map_is_drawn(tmp_path: Path) -> None:
    out = tmp_path / "map.png"
    assert main(["env", "render", "pneuma/Pneuma-v0", "--out", str(out)]) == 0
    with Image.open(out) as picture:
        assert picture.size == (912, 800)  # 57 x 50 tiles of 16 pixels


def test_an_episode_is_four_frames_a_step_and_one(tmp_path: Path) -> None:
    out = tmp_path / "run.gif"
    arguments = ["--episode", "--player", "hunter", "--set", "episode_steps=5", "--out", str(out)]
    assert main(["env", "render", "pneuma/Pneuma-v0", *arguments]) == 0
    with Image.open(out) as video:
        assert getattr(video, "n_frames", 1) == 5 * 4 + 1


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["check", "pneuma/Pneuma-v1"], "did you mean pneuma/Pneuma-v0?"),
        (["render", "pneuma/Pneuma-v0", "--out", "map.bmp"], "map.bmp"),
        (["render", "pneuma/Pneuma-v0", "--out", "map.png", "--camera", "mop"], "did you mean map?"),
        (["render", "pneuma/Pneuma-v0", "--out", "map.png", "--player", "nobody"], "--player nobody"),
        (["render", "pneuma/Pneuma-v0", "--out", "map.png", "--set", "clases=tank"], "did you mean classes?"),
    ],
)
def test_a_mistake_is_one_line_and_nothing_is_drawn(
    arguments: list[str], told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["env", *arguments]) == 2
    line = capsys.readouterr().err
    assert told in line
    assert len(line.splitlines()) == 1
    assert not list(tmp_path.iterdir())
