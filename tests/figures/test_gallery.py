"""The pictures of docs/environment.md, and the episodes that they show."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from PIL import Image

from pneuma.study.shipped import shipped_tables
from tools import gallery


@pytest.mark.slow
def test_the_gallery_is_drawn_and_says_where_it_comes_from(tmp_path: Path) -> None:
    *pictures, moving = gallery.draw_gallery(tmp_path)
    assert [path.stem for path in pictures] == [
        f"gallery-{name}" for name in ("worlds", "classes", "spells", "islands", "training")
    ]
    for path in pictures:
        with Image.open(path) as image:
            assert image.info["Description"].startswith("Pneuma: ")
    assert moving.name == "play.gif"


def test_the_recorded_agents_kill_what_the_page_says() -> None:
    recorded = json.loads((shipped_tables() / gallery.RECORDING).read_bytes())["episodes"]
    kills = []
    for episode in recorded:
        worlds, act = gallery.replay(episode)
        while worlds.worlds["ending"][0] == 0:
            worlds.step(act(worlds))
        kills.append(int(worlds.players["kills"][0, 0]))
    assert kills == [2, 14]
