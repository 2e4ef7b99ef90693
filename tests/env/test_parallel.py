"""Several players in one world: PettingZoo's contract, and who lives and dies when."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from pneuma.env.parallel import PneumaParallelEnv, parallel_env

from .arena import ATTACK, RIGHT, UP

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # PettingZoo's tests import PettingZoo's deprecated games
    from pettingzoo.test import parallel_api_test, parallel_seed_test

NAMES = [f"player_{i}" for i in range(8)]
Told = tuple[Any, ...]


def same(agents: list[str], action: int) -> dict[str, np.int64]:
    return {agent: np.int64(action) for agent in agents}


def put(env: PneumaParallelEnv, player: int, x: float, y: float, hp: float = 100.0) -> None:
    """Put a player somewhere with so many HP, facing up."""
    row = env.worlds.players[0, player]
    row["x"], row["y"], row["hp"], row["facing"] = x, y, hp, UP


def put_monster(env: PneumaParallelEnv, monster: int, x: float, y: float) -> None:
    row = env.worlds.monsters[0, monster]
    row["x"], row["y"] = x, y


def duel(arena: str, **settings: Any) -> PneumaParallelEnv:
    """Return three players: the first is bitten to death at once, the second when the monster arrives."""
    env = parallel_env(players=3, level=arena, **settings)
    env.reset(seed=0)
    put(env, 0, -300.0, -60.0, hp=7)
    put(env, 1, -80.0, 0.0, hp=7)
    put(env, 2, 400.0, -300.0)
    put_monster(env, 0, -300.0, 0.0)
    return env


# --- PettingZoo's contract -----------------------------------------------------------------------


def test_pettingzoo_finds_nothing_to_complain_of_on_the_shipped_level() -> None:
    settings: dict[str, Any] = {"magic": True, "classes": ["tank", "mage", "base"], "observation": "pygame"}
    parallel_api_test(parallel_env(players=3, episode_steps=100, **settings), num_cycles=300)
    parallel_seed_test(lambda: parallel_env(players=3, **settings), num_cycles=200)


# --- Players -------------------------------------------------------------------------------------


def test_each_has_a_class_a_reward_and_a_view_of_its_own() -> None:
    env = parallel_env(players=2, classes=["tank", "mage"], reward=["thesis", "pygame"], scale="raw")
    observations, _ = env.reset(seed=0)
    assert [float(observations[agent][2]) for agent in env.agents] == [150, 70]
    highest = [float(env.observation_space(agent).high[2]) for agent in env.agents]
    assert highest == [150 + 14 * 7, 70 + 14 * 7]  # each kill heals 7 HP, past full ones
    assert not np.array_equal(observations["player_0"][:2], observations["player_1"][:2])
    _, rewards, *_ = env.step(same(env.agents, ATTACK))
    assert rewards == {"player_0": -1.0, "player_1": 1.0}


def test_what_is_handed_out_is_not_overwritten() -> None:
    env = parallel_env(players=2)
    first, _ = env.reset(seed=0)
    kept = {agent: observation.copy() for agent, observation in first.items()}
    state = env.state()
    copy = state.copy()
    env.step(same(env.agents, RIGHT))
    assert all(np.array_equal(first[agent], kept[agent]) for agent in first)
    assert np.array_equal(state, copy)


# --- Death ---------------------------------------------------------------------------------------


def test_players_leave_one_after_another(arena: str) -> None:
    env = duel(arena)
    observations, rewards, terminations, truncations, infos = env.step(same(env.agents, ATTACK))
    assert terminations == {"player_0": True, "player_1": False, "player_2": False}
    assert not any(truncations.values())
    assert rewards == {"player_0": 0.0, "player_1": -0.07, "player_2": -1.0}
    last = {key: value for key, value in infos["player_0"].items() if key != "action_mask"}
    assert last == {"ending": "killed", "kills": 0, "xp": 0.0, "hp": 0.0}
    assert set(infos["player_1"]) == set(infos["player_2"]) == {"action_mask"}
    assert observations["player_0"][2] == 0.0 and observations["player_0"][4] > 0.0  # HP; still sees
    assert env.agents == ["player_1", "player_2"]
    steps = 0
    while "player_1" in env.agents:
        observations, rewards, terminations, truncations, infos = env.step(same(env.agents, ATTACK))
        assert set(observations) == set(rewards) == set(terminations) == set(truncations) == set(infos)
        assert "player_0" not in observations
        steps += 1
    assert steps == 7  # as in test_worlds: the monster arrives in tick 64
    assert terminations == {"player_1": True, "player_2": False}
    assert env.agents == ["player_2"]


def test_the_survivors_episode_is_truncated_at_the_time_limit(arena: str) -> None:
    env = duel(arena, episode_steps=3)
    for _ in range(2):
        env.step(same(env.agents, ATTACK))
    _, _, terminations, truncations, infos = env.step(same(env.agents, ATTACK))
    assert terminations == {"player_1": False, "player_2": False}
    assert truncations == {"player_1": True, "player_2": True}
    assert {info["ending"] for info in infos.values()} == {"time-limit"}
    assert env.agents == []


def test_the_last_ones_death_ends_the_episode(arena: str) -> None:
    env = duel(arena)
    put(env, 1, -330.0, -60.0, hp=7)
    put(env, 2, -270.0, -60.0, hp=7)
    _, _, terminations, truncations, infos = env.step(same(env.agents, ATTACK))
    assert all(terminations.values()) and not any(truncations.values())
    assert {info["ending"] for info in infos.values()} == {"killed"}
    assert env.agents == []
    with pytest.raises(ResetNeeded):
        env.step({})


def test_a_living_player_without_an_action_is_named() -> None:
    env = parallel_env(players=2)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="action None of player_1"):
        env.step({"player_0": np.int64(ATTACK)})
