"""Places and ways that are wide enough: for the body that begins there, and for the greatest that walks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.config import make_env_config
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError

from .arena import DOWN, LEFT, RIGHT, UP, begin, play, write_level

GIANT = """
[players.giant]
hp = 100
energy = 60
attack = 0
magic = 4
speed = 300
body = [100, 100]
weapon = "blade"
invulnerable = 0.0
energy_recovery = 0.6
"""
WALLS = [(12, 10), (10, 12)]
"""Tiles to the right of, and below, the tile (10, 10) and its neighbours: x and y from 128 to 192."""


@pytest.fixture
def giant(tmp_path: Path) -> str:
    (tmp_path / "giant.toml").write_text(GIANT)
    return str(tmp_path / "giant.toml")


def complaint(**settings: Any) -> str:
    with pytest.raises(UserError) as caught:
        Worlds(1, make_env_config(settings))
    assert "\n" not in str(caught.value)
    return str(caught.value)


# --- Where a body begins -------------------------------------------------------------------------


def test_a_start_place_inside_an_obstacle_is_refused(tmp_path: Path) -> None:
    """In the inner corner of two obstacles, each 8 px into the body: no step would ever get it out."""
    walls = [(11, 10), (10, 11)]  # from x = 64, and from y = 64
    level = write_level(tmp_path / "level", [(300.0, 300.0), (48.5, 48.0)], [(-200.0, -200.0)], walls)
    told = (
        "start place 1 at (48.5, 48) has a body of 47 x 48 px, which overlaps the tile in row 11, column 12"
    )
    assert complaint(level=level) == f"level {level}: {told}: it would be stuck there"


def test_touching_is_no_overlap(tmp_path: Path) -> None:
    walls = [(11, 10), (10, 11)]
    level = write_level(tmp_path / "level", [(40.5, 40.0)], [(-200.0, -200.0)], walls)
    worlds = begin(1, level=level)
    play(worlds, RIGHT, DOWN)
    assert (worlds.players["x"][0, 0], worlds.players["y"][0, 0]) == (40.5, 40.0)
    play(worlds, LEFT, UP)
    assert (worlds.players["x"][0, 0], worlds.players["y"][0, 0]) == (0.5, 0.0)


def test_the_coast_stops_a_body_unless_it_kills(tmp_path: Path) -> None:
    level = write_level(tmp_path / "level", [(560.0, 0.0)], [(-200.0, -200.0)])  # the coast is at 576
    assert "overlaps the tile in row 10, column 20" in complaint(level=level)
    assert begin(1, level=level, coast="deadly").players["hp"][0, 0] == 100


def test_each_of_several_players_must_fit(tmp_path: Path, giant: str) -> None:
    level = write_level(tmp_path / "level", [(90.0, 0.0)], [(-200.0, -200.0)], WALLS)  # 38 px to the left
    begin(1, level=level)
    told = complaint(level=level, characters=giant, classes=["base", "giant"], players=2)
    assert "start place 0 at (90, 0) has a body of 100 x 100 px, which overlaps" in told


# --- Where a body walks --------------------------------------------------------------------------


def corridor(tmp_path: Path, tiles: int) -> str:
    """Return a level whose halves are joined by a corridor of so many tiles."""
    walls = [(10, row) for row in range(20) if not 9 <= row < 9 + tiles]
    return write_level(tmp_path / f"corridor{tiles}", [(-300.0, 0.0)], [(300.0, 0.0)], walls)


def test_a_body_wider_than_the_way_is_refused(tmp_path: Path, giant: str) -> None:
    begin(1, level=corridor(tmp_path, 1))
    level = corridor(tmp_path, 1)
    told = complaint(level=level, characters=giant, classes="giant")
    assert told.endswith("walled in or off the land, for a body of 100 x 100 px")
    begin(1, level=corridor(tmp_path, 2), characters=giant, classes="giant")


def test_a_way_that_is_let_pass_can_be_walked(tmp_path: Path, giant: str) -> None:
    """The giant walks from one half to the other, in the middle of the two tiles."""
    worlds = begin(1, level=corridor(tmp_path, 2), characters=giant, classes="giant")
    worlds.monster_stats["damage"] = 0.0
    play(worlds, *[RIGHT] * 20)
    assert worlds.players["x"][0, 0] > 300


def test_a_random_level_stays_as_it_is_for_whom_it_holds(giant: str) -> None:
    for number in range(10):
        settings: dict[str, Any] = {"level": f"random:train:{number}"}
        usual = Worlds(1, make_env_config(settings)).level
        large = Worlds(1, make_env_config({**settings, "characters": giant, "classes": "giant"})).level
        assert np.array_equal(large.terrain, usual.terrain)
        assert np.array_equal(large.starts, usual.starts)


def test_a_random_level_is_refused_to_whom_it_does_not_hold(tmp_path: Path) -> None:
    (tmp_path / "colossus.toml").write_text("[players.base]\nbody = [400, 300]\n")
    told = complaint(level="random:train:0", characters=str(tmp_path / "colossus.toml"))
    assert told == "level random:train:0: a body of 400 x 300 px cannot walk everywhere"
