"""The random player and the hunter."""

from __future__ import annotations

import numpy as np
import pytest

from pneuma.env.fields import make_env_config
from pneuma.env.players import Hunter, RandomPlayer
from pneuma.env.worlds import Worlds

from .arena import ARENA, GODOT, THESIS


def play_out(worlds: Worlds, player: Hunter | RandomPlayer) -> None:
    """Play every world to its end."""
    while (worlds.worlds["ending"] == 0).any():
        worlds.step(player.act(worlds))


@pytest.mark.parametrize("players", [1, 2])
@pytest.mark.parametrize("env_id", [THESIS, GODOT, ARENA])
def test_hunters_clear_the_level_from_every_start_and_survive(env_id: str, players: int) -> None:
    worlds = Worlds(6, make_env_config({"players": players, "end_on_clear": True, "start": "random"}, env_id))
    worlds.seed(range(6))
    worlds.reset(starts=np.arange(6))
    play_out(worlds, Hunter(worlds))
    assert [worlds.ending(i) for i in range(6)] == ["cleared"] * 6
    assert (worlds.players["hp"] > 0).all()
