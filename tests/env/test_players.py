"""The two players that anchor every scale: the random one and the hunter."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pneuma.config import make_env_config
from pneuma.env.players import Hunter, RandomPlayer
from pneuma.env.worlds import Worlds

from .arena import (
    ARENA,
    GODOT,
    THESIS,
    begin,
    monster_hp,
    write_level,
)


def play_out(worlds: Worlds, player: Hunter | RandomPlayer) -> None:
    """Play every world to its end."""
    while (worlds.worlds["ending"] == 0).any():
        worlds.step(player.act(worlds))


# --- The random player ---------------------------------------------------------------------------


def test_the_random_player_chooses_every_action_equally_often() -> None:
    worlds = Worlds(5000)
    counts = np.bincount(RandomPlayer(np.random.default_rng(0)).act(worlds)[:, 0], minlength=5)
    # 1000 of each expected; chi-square with 4 degrees of freedom is above 18.5 once in a thousand.
    assert ((counts - 1000) ** 2 / 1000).sum() < 18.5


def test_the_random_player_kills_fewer_than_three_on_average() -> None:
    worlds = Worlds(120)
    worlds.seed(range(120))
    worlds.reset(starts=np.arange(120) % 6)
    play_out(worlds, RandomPlayer(np.random.default_rng(0)))
    assert worlds.players["kills"].mean() < 3


# --- The hunter ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("env_id", "level", "players"),
    [
        *((env_id, "thesis", players) for env_id in (THESIS, GODOT, ARENA) for players in (1, 2)),
        *((THESIS, f"random:test:{number}", 1) for number in (1, 4)),
        *((THESIS, f"random:test:{number}", 2) for number in (0, 5)),
    ],
)
def test_hunters_clear_the_level_from_every_start_and_survive(env_id: str, level: str, players: int) -> None:
    settings: dict[str, Any] = {"level": level, "players": players, "end_on_clear": True, "start": "random"}
    worlds = Worlds(6, make_env_config(settings, env_id))
    worlds.seed(range(6))
    worlds.reset(starts=np.arange(6))
    play_out(worlds, Hunter(worlds))
    assert [worlds.ending(i) for i in range(6)] == ["cleared"] * 6
    assert (worlds.players["hp"] > 0).all()


def test_the_hunter_does_not_drown() -> None:
    worlds = Worlds(6, make_env_config({"level": "random:test:3", "coast": "deadly"}))
    worlds.seed(range(6))
    worlds.reset(starts=np.arange(6))
    play_out(worlds, Hunter(worlds))
    assert (worlds.players["hp"] > 0).all()


def test_the_hunter_walks_around_a_monster_that_waits_behind_a_tree(tmp_path: Path) -> None:
    """Awake and held up by the tree, it never comes into reach: striking at it would go on for ever."""
    level = write_level(tmp_path / "tree", [(-32.0, 32.0)], [(100.0, 32.0)], [(10, 10)])
    worlds = begin(1, level=level)
    hunter = Hunter(worlds)
    for _ in range(150):
        worlds.step(hunter.act(worlds))
    assert monster_hp(worlds) == 0


def test_every_world_is_hunted_as_if_it_were_alone() -> None:
    company = Worlds(6)
    company.seed(range(6))
    company.reset(starts=np.arange(6))
    hunter = Hunter(company)
    for _ in range(300):
        company.step(hunter.act(company))
    for start in range(6):
        alone = Worlds(1)
        alone.seed([start])
        alone.reset(starts=np.array([start]))
        hunter = Hunter(alone)
        for _ in range(300):
            alone.step(hunter.act(alone))
        assert np.array_equal(alone.players["x"][0], company.players["x"][start])
        assert np.array_equal(alone.players["kills"][0], company.players["kills"][start])
