"""What keeps the compiled rules, which check no index, inside their arrays."""

from __future__ import annotations

from pathlib import Path

import pytest

from pneuma.config import make_env_config
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError

from .arena import ATTACK, DOWN, monster_at, play, stage
from .oracle_maps import Map


def small_level(folder: Path, start: tuple[float, float], monster: tuple[str, float, float]) -> str:
    return Map(14, 14, tile=24.0, shore=0, starts=(start,), monsters=(monster,)).write(folder)


@pytest.mark.parametrize(
    ("start", "monster", "who"),
    [
        ((168.0, 335.0), ("bamboo", 100.0, 100.0), "start place 0"),
        ((168.0, 168.0), ("raccoon", 20.0, 168.0), "monster 0 (raccoon)"),
    ],
)
def test_a_body_that_reaches_beyond_the_grid_is_refused(
    tmp_path: Path, start: tuple[float, float], monster: tuple[str, float, float], who: str
) -> None:
    level = small_level(tmp_path, start, monster)
    with pytest.raises(UserError) as refused:
        Worlds(1, make_env_config({"level": level}))
    assert who in str(refused.value) and "beyond the grid" in str(refused.value)


def test_on_the_smallest_tiles_nobody_leaves_the_grid(tmp_path: Path) -> None:
    level = small_level(tmp_path, (168.0, 310.0), ("bamboo", 100.0, 100.0))
    worlds = Worlds(1, make_env_config({"level": level}))
    worlds.seed([0])
    worlds.reset()
    for _ in range(20):
        play(worlds, DOWN)
    assert worlds.players["y"][0, 0] == 14 * 24 - 26  # flush with the edge


def test_a_monster_all_but_at_the_hilt_stays_there(arena: str) -> None:
    """1e-200 squared is 0: dividing by that distance would make its place not a number."""
    worlds = stage(arena, (1e-200, 0.0), players=((12.0, -52.0),), facing=DOWN, still=True)
    play(worlds, ATTACK)
    assert worlds.events["hits"][0, 0] == 1
    assert monster_at(worlds) == (1e-200, 0.0)
