"""What reset and step may be told: slips are refused in a line, what is meant for wrappers is left alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from pneuma.env.parallel import PneumaParallelEnv
from pneuma.env.sb3 import PneumaVecEnv
from pneuma.env.single import PneumaEnv
from pneuma.env.vector import PneumaVectorEnv

FACES: dict[str, Callable[[], Any]] = {
    "single": PneumaEnv,
    "vector": lambda: PneumaVectorEnv(2),
    "parallel": PneumaParallelEnv,
    "learner": lambda: PneumaVecEnv(2),
}
each_face = pytest.mark.parametrize("face", FACES)


def reset(face: str, options: Any) -> Any:
    env: Any = FACES[face]()
    if isinstance(env, PneumaVecEnv):
        env.set_options(options)
        env.reset()
    else:
        env.reset(seed=0, options=options)
    return env


@each_face
@pytest.mark.parametrize(
    ("options", "error", "told"),
    [
        ({"start": 1.5}, TypeError, "integer"),
        ({"start": "first"}, TypeError, "integer"),
        ({"start": 9}, ValueError, "the level has places 0 to 5"),
    ],
)
def test_what_is_no_start_place_is_refused(face: str, options: Any, error: type, told: str) -> None:
    with pytest.raises(error, match=told) as caught:
        reset(face, options)
    assert "\n" not in str(caught.value)


def step(face: str, env: Any, action: Any) -> None:
    """Let the only player, or the first of two worlds, do something."""
    steps = {"single": action, "parallel": {"player_0": action}}
    env.step(steps.get(face, np.array([action, 0])))


@each_face
@pytest.mark.parametrize("action", [-1, 5, 2.5])
def test_what_is_no_action_is_told_with_what_is_one(face: str, action: Any) -> None:
    env = reset(face, {})
    with pytest.raises((TypeError, ValueError)):
        step(face, env, action)


@each_face
def test_stepping_before_the_first_reset_is_refused(face: str) -> None:
    with pytest.raises(ResetNeeded):
        step(face, FACES[face](), 0)
