"""Several players in one world: PettingZoo's contract, and who lives and dies when."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from pneuma.env.parallel import PneumaParallelEnv, parallel_env

from .arena import ATTACK, GODOT, RIGHT, THESIS, UP

with warnings.catch_warnings():
    warnings.simplefilter("ignore")  # PettingZoo's tests import PettingZoo's deprecated games
    from pettingzoo.test import api_test, parallel_api_test, parallel_seed_test
    from pettingzoo.utils.conversions import parallel_to_aec

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


@pytest.mark.parametrize("env_id", [THESIS, GODOT])
@pytest.mark.parametrize("players", [1, 2, 8])
def test_pettingzoo_finds_nothing_to_complain_of(env_id: str, players: int, pit: str) -> None:
    parallel_api_test(
        parallel_env(env_id=env_id, players=players, level=pit, episode_steps=60), num_cycles=400
    )


def test_pettingzoo_finds_nothing_to_complain_of_on_the_shipped_level() -> None:
    settings: dict[str, Any] = {"magic": True, "classes": ["tank", "mage", "base"], "observation": "pygame"}
    parallel_api_test(parallel_env(players=3, episode_steps=100, **settings), num_cycles=300)
    parallel_seed_test(lambda: parallel_env(players=3, **settings), num_cycles=200)


def test_its_turn_by_turn_form_passes_pettingzoos_test_too(pit: str) -> None:
    api_test(parallel_to_aec(parallel_env(players=3, level=pit, episode_steps=30)), num_cycles=200)


def play(seed: int, **settings: Any) -> list[bytes]:
    """Return every bit of everything told in an episode of random play, all players' to their ends."""
    env = parallel_env(**settings)
    for index, agent in enumerate(env.possible_agents):
        env.action_space(agent).seed(index)
    told: list[bytes] = []
    observations, infos = env.reset(seed=seed)
    while True:
        for agent in sorted(observations):
            mask = infos[agent].pop("action_mask")
            told += [
                observations[agent].tobytes(),
                mask.tobytes(),
                repr(sorted(infos[agent].items())).encode(),
            ]
        if not env.agents:
            return told
        actions = {agent: env.action_space(agent).sample() for agent in env.agents}
        observations, *ends, infos = env.step(actions)
        told += [repr(end).encode() for end in ends]


@pytest.mark.parametrize("env_id", [THESIS, GODOT])
def test_equal_seeds_give_equal_episodes_to_the_last_bit(env_id: str, pit: str) -> None:
    # In the pit some die early, and the others play on to the time limit.
    settings: dict[str, Any] = {"env_id": env_id, "players": 4, "level": pit, "magic": True}
    plays = [play(5, **settings, episode_steps=150) for _ in range(2)]
    assert plays[0] == plays[1] and len(plays[0]) > 100


# --- Players -------------------------------------------------------------------------------------


@pytest.mark.parametrize("players", [1, 2, 8])
def test_there_are_as_many_agents_as_players(players: int) -> None:
    env = parallel_env(players=players)
    observations, infos = env.reset(seed=0)
    assert env.possible_agents == env.agents == NAMES[:players]
    assert list(observations) == list(infos) == NAMES[:players]
    assert env.state().shape == (players * 60,)
    assert env.state_space.contains(env.state())


def test_each_has_a_class_a_reward_and_a_view_of_its_own() -> None:
    env = parallel_env(players=2, classes=["tank", "mage"], reward=["thesis", "pygame"], scale="raw")
    observations, _ = env.reset(seed=0)
    assert [float(observations[agent][2]) for agent in env.agents] == [150, 70]
    highest = [float(env.observation_space(agent).high[2]) for agent in env.agents]
    assert highest == [150 + 14 * 7, 70 + 14 * 7]  # each kill heals 7 HP, past full ones
    assert not np.array_equal(observations["player_0"][:2], observations["player_1"][:2])
    _, rewards, *_ = env.step(same(env.agents, ATTACK))
    assert rewards == {"player_0": -1.0, "player_1": 1.0}


def test_options_choose_the_first_players_place() -> None:
    env = parallel_env(players=2)
    env.reset(seed=0, options={"start": 5})
    assert env.worlds.players["x"][0].tolist() == [-47, 204]
    with pytest.raises(ValueError, match="places 0 to 5"):
        env.reset(options={"start": 6})


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


def test_whoever_dies_in_the_last_step_is_terminated_and_the_others_truncated(arena: str) -> None:
    env = duel(arena, episode_steps=1)
    _, _, terminations, truncations, infos = env.step(same(env.agents, ATTACK))
    assert terminations == {"player_0": True, "player_1": False, "player_2": False}
    assert truncations == {"player_0": False, "player_1": True, "player_2": True}
    assert [infos[agent]["ending"] for agent in NAMES[:3]] == ["killed", "time-limit", "time-limit"]
    assert env.agents == []


@pytest.mark.parametrize("end_on_clear", [False, True])
def test_clearing_the_level_terminates_all_who_live_if_asked(arena: str, end_on_clear: bool) -> None:
    env = duel(arena, end_on_clear=end_on_clear)
    env.worlds.monsters["hp"][0] = [40, 20, 0, 0]
    env.worlds.worlds["monsters_left"] = 2
    env.step(same(env.agents, ATTACK))  # the first player dies
    env.worlds.monsters["hp"][0, 0] = 0
    env.worlds.worlds["monsters_left"] = 1
    env.worlds.players["busy"] = 0
    put_monster(env, 1, 400.0, -344.0)
    _, _, terminations, truncations, infos = env.step(same(env.agents, ATTACK))
    assert terminations == {"player_1": end_on_clear, "player_2": end_on_clear}
    assert not any(truncations.values())
    assert infos["player_2"].get("kills") == (1 if end_on_clear else None)
    assert infos["player_1"].get("ending") == ("cleared" if end_on_clear else None)


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


def test_actions_of_the_dead_are_ignored(arena: str) -> None:
    env = duel(arena)
    env.step(same(env.agents, ATTACK))
    place = env.worlds.players[["x", "y"]][0, 0].tolist()
    env.step(same(NAMES[:3], RIGHT))
    assert env.worlds.players[["x", "y"]][0, 0].tolist() == place
