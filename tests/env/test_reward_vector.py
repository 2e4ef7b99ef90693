"""Vector rewards: their parts, their space, and the same in every face."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest

from pneuma.config import ENVIRONMENTS
from pneuma.env import MO_ENVIRONMENTS
from pneuma.env.reward import PARTS
from pneuma.env.single import PneumaEnv, PneumaMOEnv

from .arena import ATTACK


def make(name: str, **settings: Any) -> PneumaMOEnv:
    env = gymnasium.make(name, disable_env_checker=True, **settings).unwrapped
    assert isinstance(env, PneumaMOEnv)
    return env


def test_the_parts_are_what_they_are_called(arena: str) -> None:
    env = make(MO_ENVIRONMENTS[0], level=arena)
    env.reset(seed=0)
    players, monsters = env.state.players, env.state.monsters
    players["xp"], players["hp"], players["facing"] = 3, 50, 3
    for index, (x, y) in enumerate([(80.0, 0.0), (-40.0, 0.0), (-200.0, 0.0)]):
        monsters["x"][0, index], monsters["y"][0, index] = x, y
    monsters["hp"][0, 0] = 20
    # A kill (1 XP and 7 HP) before it is noticed, a bite of 7, two notices and one contact.
    assert env.step(np.int64(ATTACK))[1].tolist() == pytest.approx([4, 0.5, 1, 0.07, 2, 1])


@pytest.mark.parametrize(
    ("formula", "plus", "minus"), [("thesis", "xp", "hp"), ("kills", "xp_gained", "hp_lost")]
)
@pytest.mark.parametrize(("name", "world"), list(zip(MO_ENVIRONMENTS, ENVIRONMENTS, strict=True)))
def test_two_parts_make_a_formula_and_none_leaves_its_space(
    name: str, world: str, formula: str, plus: str, minus: str, pit: str
) -> None:
    """In the pit a player is bitten by five monsters and dies, or kills some of them first."""
    settings: dict[str, Any] = {"level": pit, "episode_steps": 40}
    env = make(name, **settings)
    assert env.reward_dim == len(PARTS) == 6
    scalar = PneumaEnv(world, reward=formula, **settings)
    generator = np.random.default_rng(1)
    env.reset(seed=3)
    scalar.reset(seed=3)
    endings = set()
    for _ in range(600):
        action = np.int64(generator.choice([0, 1, 2, 3, ATTACK, ATTACK]))
        _, parts, *over, info = env.step(action)
        _, reward, *_ = scalar.step(action)
        assert isinstance(parts, np.ndarray) and env.reward_space.contains(parts)
        share = parts[PARTS.index(plus)] - parts[PARTS.index(minus)]
        assert share == pytest.approx(reward, abs=1e-5)
        if any(over):
            endings.add(info["ending"])
            env.reset()
            scalar.reset()
    assert "killed" in endings
