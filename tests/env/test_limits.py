"""What Gymnasium calls `max_episode_steps` is the world's own limit."""

from __future__ import annotations

import copy
from typing import Any

import gymnasium
import pytest
from gymnasium.wrappers import TimeLimit

from pneuma.errors import UserError

TEXT, GODOT, VECTORS = "pneuma/Pneuma-v0", "pneuma/PneumaGodot-v0", "pneuma/mo-PneumaArena-v0"


def ending(env: Any) -> tuple[int, bool, bool, dict[str, Any]]:
    """Attack until an episode ends; return how it did."""
    env.reset(seed=0)
    for step in range(1, 3000):
        _, _, terminated, truncated, info = env.step(4)
        if terminated or truncated:
            return step, terminated, truncated, info
    raise AssertionError


@pytest.mark.parametrize(("name", "steps"), [(TEXT, 1000), (GODOT, 7500), (VECTORS, 1000)])
def test_a_spec_tells_the_limit_of_its_world(name: str, steps: int) -> None:
    assert gymnasium.spec(name).max_episode_steps == steps
    env = gymnasium.make(name)
    assert env.spec is not None and env.spec.max_episode_steps == steps
    while isinstance(env, gymnasium.Wrapper):
        assert not isinstance(env, TimeLimit)
        env = env.env


@pytest.mark.parametrize("steps", [7, 1200])
@pytest.mark.parametrize("named", ["max_episode_steps", "episode_steps"])
def test_a_limit_is_the_worlds_own(named: str, steps: int, arena: str) -> None:
    given: dict[str, Any] = {"level": arena, named: steps}
    env = gymnasium.make(TEXT, **given)
    found, terminated, truncated, info = ending(env)
    assert (found, terminated, truncated, info["ending"]) == (steps, False, True, "time-limit")
    assert env.spec is not None and env.spec.max_episode_steps == steps
    assert ending(gymnasium.make(copy.deepcopy(env.spec)))[0] == steps
    assert ending(copy.deepcopy(env))[0] == steps


def test_a_limit_that_terminates_does_not_truncate(arena: str) -> None:
    assert ending(gymnasium.make(GODOT, level=arena, max_episode_steps=7))[:3] == (7, True, False)


@pytest.mark.parametrize("given", [{"max_episode_steps": 7}, {"episode_steps": 7}])
@pytest.mark.parametrize("mode", [None, "sync"])
def test_vectors_of_worlds_take_the_same_limit(mode: str | None, given: dict[str, Any], arena: str) -> None:
    envs = gymnasium.make_vec(TEXT, num_envs=2, vectorization_mode=mode, level=arena, **given)
    envs.reset(seed=0)
    cut = [envs.step([4, 4])[3].tolist() for _ in range(7)]
    assert cut == [[False, False]] * 6 + [[True, True]]
    envs.close()


def test_two_limits_are_refused() -> None:
    for make in (gymnasium.make, gymnasium.make_vec):
        with pytest.raises(UserError, match="max_episode_steps = 7 and episode_steps = 8 are one field"):
            make(TEXT, max_episode_steps=7, episode_steps=8)
