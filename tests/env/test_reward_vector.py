"""Vector rewards: their parts, their space, and the same in every face."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from pneuma.config import ENVIRONMENTS
from pneuma.env import MO_ENVIRONMENTS
from pneuma.env.reward import PARTS
from pneuma.env.single import PneumaEnv, PneumaMOEnv
from pneuma.errors import UserError

from .arena import ATTACK, GODOT, HEAL, STAND


def make(name: str, **settings: Any) -> PneumaMOEnv:
    env = gymnasium.make(name, disable_env_checker=True, **settings).unwrapped
    assert isinstance(env, PneumaMOEnv)
    return env


@pytest.mark.parametrize("name", MO_ENVIRONMENTS)
def test_the_reward_is_an_array_in_its_space(name: str) -> None:
    env = make(name)
    assert env.reward_dim == len(PARTS) == 6
    assert env.reward_space.shape == (6,) and env.reward_space.dtype == np.float32
    env.reset(seed=0)
    reward = env.step(np.int64(STAND))[1]
    assert isinstance(reward, np.ndarray) and reward.shape == (6,) and reward.dtype == np.float32
    assert env.reward_space.contains(reward)


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


@pytest.mark.parametrize("name", MO_ENVIRONMENTS)
@pytest.mark.parametrize("policy", ["random", "fights"])
def test_no_reward_ever_leaves_the_space(name: str, policy: str, pit: str) -> None:
    """In the pit a player is bitten by five monsters and dies, or kills some of them first."""
    env = make(name, level=pit, episode_steps=40)
    generator = np.random.default_rng(0)
    env.reset(seed=0)
    endings = set()
    for _ in range(600):
        fights = policy == "fights" and generator.random() < 0.8
        action = np.int64(ATTACK if fights else generator.integers(5))
        _, reward, terminated, truncated, info = env.step(action)
        assert env.reward_space.contains(reward), (reward, env.reward_space)
        if terminated or truncated:
            endings.add(info["ending"])
            env.reset()
    assert "killed" in endings


def test_who_is_healed_between_two_bites_may_lose_more_than_full_hp(tmp_path: Path, arena: str) -> None:
    """99 HP in the first tick; 20 come back in the fourth, and all 21 go in the sixth: 120 of 100."""
    file = tmp_path / "fierce.toml"
    file.write_text("[monsters.bamboo]\ndamage = 99\n")
    env = make(MO_ENVIRONMENTS[0], level=arena, characters=str(file), magic=True, bite_while_knocked=True)
    env.reset(seed=0)
    env.state.players["busy"] = 3
    monsters = env.state.monsters
    monsters["x"][0, :2], monsters["y"][0, :2] = [-40.0, -75.0], 0.0
    monsters["knocked"][0, 1], monsters["knock_x"][0, 1] = 30, 2.0  # within reach in the sixth tick
    _, reward, terminated, *_ = env.step(np.int64(HEAL))
    assert terminated
    assert reward[PARTS.index("hp_lost")] == pytest.approx(1.2)
    assert env.reward_space.contains(reward)


@pytest.mark.parametrize(
    ("formula", "plus", "minus"), [("thesis", "xp", "hp"), ("kills", "xp_gained", "hp_lost")]
)
@pytest.mark.parametrize(("name", "world"), list(zip(MO_ENVIRONMENTS, ENVIRONMENTS, strict=True)))
def test_two_parts_make_a_formula(
    name: str, world: str, formula: str, plus: str, minus: str, pit: str
) -> None:
    settings: dict[str, Any] = {"level": pit, "episode_steps": 40}
    env = make(name, **settings)
    scalar = PneumaEnv(world, reward=formula, **settings)
    generator = np.random.default_rng(1)
    env.reset(seed=3)
    scalar.reset(seed=3)
    for _ in range(300):
        action = np.int64(generator.choice([0, 1, 2, 3, ATTACK, ATTACK]))
        _, parts, *over, _ = env.step(action)
        _, reward, *_ = scalar.step(action)
        share = parts[PARTS.index(plus)] - parts[PARTS.index(minus)]
        assert share == pytest.approx(reward, abs=1e-5)
        if any(over):
            env.reset()
            scalar.reset()


def test_gymnasium_makes_it_without_a_warning() -> None:
    env = gymnasium.make(MO_ENVIRONMENTS[0])  # a warning would be an error here
    env.reset(seed=0)
    env.step(0)


def test_a_reward_of_another_name_is_refused() -> None:
    for make_it in (make, lambda name, **settings: gymnasium.make_vec(name, num_envs=2, **settings)):
        with pytest.raises(UserError, match="reward = 'kills' is not allowed: vector rewards are always"):
            make_it(MO_ENVIRONMENTS[0], reward="kills")


@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize("name", MO_ENVIRONMENTS)
def test_worlds_side_by_side_pay_what_each_pays_alone(name: str, mode: AutoresetMode, pit: str) -> None:
    settings: dict[str, Any] = {"level": pit, "episode_steps": 40, "start": "random"}
    envs = gymnasium.make_vec(name, num_envs=3, autoreset_mode=mode, **settings)
    singles = [make(name, **settings) for _ in range(3)]
    assert envs.unwrapped.reward_space == singles[0].reward_space  # type: ignore[attr-defined]
    envs.reset(seed=4)
    for i, env in enumerate(singles):
        env.reset(seed=4 + i)
    generator = np.random.default_rng(1)
    over = np.zeros(3, bool)
    ended = 0
    for _ in range(120):
        actions = generator.choice([0, 1, 2, 3, ATTACK, ATTACK], size=3)
        if mode == AutoresetMode.DISABLED and over.any():
            envs.reset(options={"reset_mask": over})
        rewards = envs.step(actions)[1]
        assert rewards.shape == (3, 6) and rewards.dtype == np.float32
        for i, env in enumerate(singles):
            if over[i]:
                env.reset()
                if mode == AutoresetMode.NEXT_STEP:
                    over[i] = False
                    assert not rewards[i].any()
                    continue
            _, expected, terminated, truncated, _ = env.step(actions[i])
            over[i] = terminated or truncated
            ended += int(over[i])
            assert np.array_equal(rewards[i], expected)
    assert ended > 3


def test_godots_xp_of_a_death_is_in_the_vector(pit: str) -> None:
    env = make(MO_ENVIRONMENTS[ENVIRONMENTS.index(GODOT)], level=pit)
    env.reset(seed=0)
    env.state.players["hp"] = 7
    _, reward, terminated, *_ = env.step(np.int64(STAND))
    assert terminated
    assert reward[:3].tolist() == [-1, 0, -1]  # XP -1, no HP, -1 XP gained
