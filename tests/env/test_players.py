"""The two players that anchor every scale: the random one and the hunter."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pneuma.config import make_env_config
from pneuma.env.players import Hunter, RandomPlayer
from pneuma.env.worlds import Worlds

from .arena import ARENA, GODOT, THESIS


def play_out(worlds: Worlds, player: Hunter | RandomPlayer) -> None:
    """Play every world to its end."""
    while (worlds.worlds["ending"] == 0).any():
        worlds.step(player.act(worlds))


def test_the_random_player_kills_fewer_than_three_on_average() -> None:
    worlds = Worlds(120)
    worlds.seed(range(120))
    worlds.reset(starts=np.arange(120) % 6)
    play_out(worlds, RandomPlayer(np.random.default_rng(0)))
    assert worlds.players["kills"].mean() < 3


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
