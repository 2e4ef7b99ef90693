"""docs/environment.md does what it says: its files are written, its Python is run, in order."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from pneuma.env.worlds import Worlds
from pneuma.env_fields import make_env_config

from ..pages import BLOCK

PAGE = Path(__file__).parents[2] / "docs" / "environment.md"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with all the files of the page."""
    for block in BLOCK.finditer(PAGE.read_text(encoding="utf-8")):
        if block["file"]:
            path = tmp_path / block["file"]
            path.parent.mkdir(exist_ok=True)
            path.write_text(block["text"])
    return tmp_path


@pytest.mark.slow
def test_the_pages_python_runs(folder: Path) -> None:
    blocks = BLOCK.finditer(PAGE.read_text(encoding="utf-8"))
    code = [block["text"] for block in blocks if block["language"] == "python" and not block["file"]]
    assert len(code) >= 5
    (folder / "page.py").write_text("\n".join(code))
    command = [sys.executable, "-W", "error", "page.py"]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_pages_level_class_monster_and_weapon_are_what_it_says(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    mine = {"characters": "mine.toml", "classes": "knight"}
    isle = Worlds(1, make_env_config({"level": "isle", **mine}))
    assert isle.level.title == "Two rocks"
    # 8 x 5 tiles of 64 px around the middle: the first tile's centre is at (-224, -128).
    assert isle.level.starts.tolist() == [[-160.0, -64.0]]
    assert isle.level.monsters == (("bamboo", 96.0, 0.0), ("wolf", 160.0, 64.0))
    assert isle.monster_stats["hp"].tolist() == [[60, 60]]
    assert (isle.player_stats["hp"][0], isle.player_stats["damage"][0]) == (200, 35)
