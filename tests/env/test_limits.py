"""Time limits: the world's own, and Gymnasium's around it."""

from __future__ import annotations

from typing import Any

import gymnasium
import pytest
from gymnasium.wrappers import TimeLimit

TEXT, GODOT, VECTORS = "pneuma/Pneuma-v0", "pneuma/PneumaGodot-v0", "pneuma/mo-PneumaArena-v0"


def ending(env: Any) -> tuple[int, bool, bool, dict[str, Any]]:
    """Attack until an episode ends; return how it did."""
    env.reset(seed=0)
    for step in range(1, 3000):
        _, _, terminated, truncated, info = env.step(4)
        if terminated or truncated:
            return step, terminated, truncated, info
    raise AssertionError


@pytest.mark.parametrize("name", [TEXT, GODOT, VECTORS])
def test_gymnasium_puts_no_limit_of_its_own_around_a_world(name: str) -> None:
    env = gymnasium.make(name)
    while isinstance(env, gymnasium.Wrapper):
        assert not isinstance(env, TimeLimit)
        env = env.env


@pytest.mark.parametrize("steps", [7, 1200])
def test_a_limit_is_the_worlds_own(steps: int, arena: str) -> None:
    found, terminated, truncated, info = ending(gymnasium.make(TEXT, level=arena, episode_steps=steps))
    assert (found, terminated, truncated, info["ending"]) == (steps, False, True, "time-limit")


def test_a_limit_that_terminates_does_not_truncate(arena: str) -> None:
    assert ending(gymnasium.make(GODOT, level=arena, episode_steps=7))[:3] == (7, True, False)
