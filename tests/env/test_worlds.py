"""Worlds: what they refuse; the hunter clears them, and the checkers of other libraries find nothing."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as gymnasiums_check
from stable_baselines3.common.env_checker import check_env as sb3s_check

from pneuma.env.fields import ENVIRONMENTS, make_env_config
from pneuma.env.pettingzoo import parallel_env
from pneuma.env.players import Hunter
from pneuma.env.worlds import Worlds

from .arena import ARENA, GODOT, THESIS, begin


@pytest.mark.parametrize(
    ("asked", "told"),
    [
        (lambda worlds: worlds.step(np.full((2, 1), 5)), "are outside 2 of Discrete"),
        (lambda worlds: worlds.step(np.zeros(3, np.int64)), r"actions \[0 0 0\] are outside 2 of"),
        (lambda worlds: worlds.reset(np.ones(2, np.int64)), "mask: must be booleans of shape"),
        (lambda worlds: worlds.reset(starts=np.array([0, 6])), "start 6 is none of the level's 6"),
    ],
)
def test_what_the_rules_could_not_take_is_refused(asked: Callable[[Worlds], object], told: str) -> None:
    """They look nothing up twice: an index that is too large would read beyond an array."""
    worlds = begin(2)
    before = worlds.worlds.tobytes() + worlds.players.tobytes()
    with pytest.raises(ValueError, match=told):
        asked(worlds)
    assert worlds.worlds.tobytes() + worlds.players.tobytes() == before


@pytest.mark.parametrize("players", [1, 2])
@pytest.mark.parametrize("env_id", [THESIS, GODOT, ARENA])
def test_hunters_clear_the_level_from_every_start_and_survive(env_id: str, players: int) -> None:
    worlds = Worlds(6, make_env_config({"players": players, "end_on_clear": True, "start": "random"}, env_id))
    worlds.seed(range(6))
    worlds.reset(starts=np.arange(6))
    hunter = Hunter(worlds)
    while (worlds.worlds["ending"] == 0).any():
        worlds.step(hunter.act(worlds))
    assert [worlds.ending(i) for i in range(6)] == ["cleared"] * 6
    assert (worlds.players["hp"] > 0).all()


# --- The checkers of Gymnasium, Stable-Baselines3 and PettingZoo ----------------------------------


@pytest.mark.parametrize("env_id", ENVIRONMENTS)
def test_gymnasiums_and_stable_baselines3s_checkers(env_id: str) -> None:
    env: Any = gymnasium.make(env_id, disable_env_checker=True).unwrapped
    if env_id in ENVIRONMENTS:
        sb3s_check(env)
    gymnasiums_check(env)  # in every render mode


TEAM = {"magic": True, "shared_reward": True}


@pytest.mark.parametrize(("env_id", "chosen"), [(THESIS, TEAM), *((env_id, {}) for env_id in ENVIRONMENTS)])
def test_pettingzoos_checker(env_id: str, chosen: dict[str, Any]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PettingZoo's tests import deprecated games
        from pettingzoo.test import parallel_api_test, parallel_seed_test
    parallel_api_test(parallel_env(env_id=env_id, players=3, **chosen), num_cycles=100)
    parallel_seed_test(lambda: parallel_env(env_id=env_id, players=3, **chosen), num_cycles=100)
