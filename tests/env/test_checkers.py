"""The checkers of Gymnasium, Stable-Baselines3 and PettingZoo find nothing in any shipped environment."""

from __future__ import annotations

import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as gymnasiums_check
from stable_baselines3.common.env_checker import check_env as sb3s_check

from pneuma.env import MO_ENVIRONMENTS, REGISTERED
from pneuma.env.parallel import parallel_env
from pneuma.env.worlds import Worlds
from pneuma.env_fields import ENVIRONMENTS, make_env_config

CYCLES = 400
each_world = pytest.mark.parametrize("env_id", ENVIRONMENTS)


@pytest.mark.parametrize("env_id", REGISTERED)
def test_gymnasiums(env_id: str, monkeypatch: pytest.MonkeyPatch) -> None:
    env: Any = gymnasium.make(env_id, disable_env_checker=True).unwrapped
    if env_id in MO_ENVIRONMENTS:
        monkeypatch.setattr(env, "_reward", lambda: 0.0)  # Gymnasium's checker knows no vectors
    gymnasiums_check(env, skip_render_check=True)  # which would open a window


@each_world
def test_stable_baselines3s(env_id: str) -> None:
    sb3s_check(gymnasium.make(env_id, disable_env_checker=True).unwrapped)


@each_world
def test_pettingzoos(env_id: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PettingZoo's tests import deprecated games
        from pettingzoo.test import parallel_api_test, parallel_seed_test
    parallel_api_test(parallel_env(env_id=env_id, players=3), num_cycles=CYCLES)
    parallel_seed_test(lambda: parallel_env(env_id=env_id, players=3), num_cycles=CYCLES)


@each_world
@pytest.mark.parametrize("players", [1, 3])
def test_no_observation_leaves_its_space(env_id: str, players: int) -> None:
    worlds = Worlds(8, make_env_config({"players": players}, env_id))
    worlds.seed(range(8))
    worlds.reset()
    generator = np.random.default_rng(0)
    for _ in range(CYCLES):
        worlds.step(generator.integers(int(worlds.action_space.n), size=worlds.players.shape))
        for player, space in enumerate(worlds.spaces):
            seen = worlds.observations[:, player]
            assert ((seen >= space.low) & (seen <= space.high)).all()
        worlds.reset(worlds.worlds["ending"] != 0)
