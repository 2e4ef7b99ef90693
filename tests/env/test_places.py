"""Places and ways that are wide enough: for the body that begins there, and for the greatest that walks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from pneuma.config import make_env_config
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError

from .arena import Place, begin, write_level

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


def test_the_coast_stops_a_body_unless_it_kills(tmp_path: Path) -> None:
    level = write_level(tmp_path / "level", [(560.0, 0.0)], [(-200.0, -200.0)])  # the coast is at 576
    assert "overlaps the tile in row 10, column 20" in complaint(level=level)
    assert begin(1, level=level, coast="deadly").players["hp"][0, 0] == 100


@pytest.mark.parametrize("column", [3, 0])
def test_a_monster_inside_what_stops_it_is_refused(tmp_path: Path, column: int) -> None:
    # The tree's or the coast's tile ends 8 px inside the monster's body, which reaches 12 px to either side.
    trees = [(3, 10)]
    place = (-640 + 64 * (column + 1) + 4.0, 32.0)
    level = write_level(tmp_path / "level", [(200.0, 200.0)], [place], trees)
    told = (
        f"monster 0 (bamboo) at ({place[0]:g}, 32) has a body of 24 x 50 px, which overlaps the tile in row"
    )
    assert told in complaint(level=level)
    begin(1, level=level, terrain_stops="players")


# --- Bodies in each other ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("starts", "monsters", "told"),
    [
        ([(0.0, 0.0)], [(200.0, 0.0), (33.0, 0.0)],
         "monster 1 (bamboo) at (33, 0) begins inside start place 0 at (0, 0)"),
        ([(0.0, 0.0)], [(200.0, 0.0), (223.0, 49.0)],
         "monster 0 (bamboo) at (200, 0) begins inside monster 1 (bamboo) at (223, 49)"),
        ([(0.0, 0.0), (46.0, 47.0)], [(200.0, 0.0)],
         "start place 0 at (0, 0) begins inside start place 1 at (46, 47)"),
    ],
)  # fmt: skip
def test_bodies_that_begin_inside_each_other_are_refused(
    tmp_path: Path, starts: list[Place], monsters: list[Place], told: str
) -> None:
    """A pixel less and they touch: 34 px to the right of a player, 24 x 50 px for two bamboos, 47 x 48."""
    level = write_level(tmp_path / "level", starts, monsters)
    settings: dict[str, Any] = {"level": level, "players": len(starts)}
    assert complaint(**settings) == f"level {level}: {told}"
    begin(1, **settings, bodies="pass")
    last = starts if len(starts) > 1 else monsters
    last[-1] = (last[-1][0] + 1, last[-1][1])
    begin(1, **{**settings, "level": write_level(tmp_path / "apart", starts, monsters)})


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


def test_more_places_than_a_level_may_have_are_refused_at_once(tmp_path: Path) -> None:
    level = Path(write_level(tmp_path / "level", [(0.0, 0.0)], []))
    (level / "objects.csv").write_text("code,x,y\n" + "400,0,0\n" * 300_000)
    assert complaint(level=str(level)).endswith("more than 1000 start places and monsters are not allowed")
