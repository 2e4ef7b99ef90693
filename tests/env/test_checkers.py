"""The checkers of Gymnasium, Stable-Baselines3 and PettingZoo find nothing in any shipped environment."""

from __future__ import annotations

import warnings
from typing import Any

import gymnasium
import pytest
from gymnasium.utils.env_checker import check_env as gymnasiums_check
from stable_baselines3.common.env_checker import check_env as sb3s_check

from pneuma.env import MO_ENVIRONMENTS, REGISTERED
from pneuma.env.fields import ENVIRONMENTS
from pneuma.env.pettingzoo import parallel_env

CYCLES = 100
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


TEAM = {"magic": True, "dash": True, "second_weapon": "lance", "tokens": 3, "shared_reward": True}


@pytest.mark.parametrize(
    ("env_id", "chosen"), [*((env_id, {}) for env_id in ENVIRONMENTS), (ENVIRONMENTS[0], TEAM)]
)
def test_pettingzoos(env_id: str, chosen: dict[str, Any]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PettingZoo's tests import deprecated games
        from pettingzoo.test import parallel_api_test, parallel_seed_test
    parallel_api_test(parallel_env(env_id=env_id, players=3, **chosen), num_cycles=CYCLES)
    parallel_seed_test(lambda: parallel_env(env_id=env_id, players=3, **chosen), num_cycles=CYCLES)
