"""The random player and the hunter, and the ways that the hunter finds."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pneuma.env.players import Hunter, RandomPlayer
from pneuma.env.ways import Body, Ways
from pneuma.env.worlds import Worlds
from pneuma.env_fields import make_env_config

from .arena import ARENA, DOWN, GODOT, LEFT, RIGHT, THESIS, UP, begin


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
        (THESIS, "random:test:1", 1),
        (THESIS, "random:test:0", 2),
        pytest.param(THESIS, "random:test:4", 1, marks=pytest.mark.slow),
        pytest.param(THESIS, "random:test:5", 2, marks=pytest.mark.slow),
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


# --- Ways over a level ----------------------------------------------------------------------------

BODY = Body(23.5, 24.0, -1.5, 2.0)
REACH = 40.0


@pytest.mark.parametrize("coast", ["wall", "deadly"])
def test_steps_lead_where_the_rules_lead(coast: str) -> None:
    """From random places of a random level, hundreds of steps in every direction."""
    count = 2000
    worlds = begin(count, level="random:test:3", coast=coast, bodies="pass")
    ways = Ways(worlds.levels, BODY, int(worlds.settings["player_stops"][0]), coast == "deadly")
    generator = np.random.default_rng(0)
    for _ in range(30):  # away from the start places, to walls and shores
        worlds.step(generator.integers(4, size=(count, 1)))
    for action in (DOWN, LEFT, UP, RIGHT):
        before = worlds.players[:, 0].copy()
        worlds.step(np.full((count, 1), action))
        for old, new in zip(before, worlds.players[:, 0], strict=True):
            if old["hp"] > 0 and old["busy"] == 0:
                there = ways.step(0, (float(old["x"]), float(old["y"])), action, REACH)
                drowned = new["hp"] <= 0 and coast == "deadly"
                assert there == (None if drowned else (float(new["x"]), float(new["y"])))
