"""Several players in one world: PettingZoo's contract, and who lives and dies when."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

from pneuma.env.parallel import PneumaParallelEnv, parallel_env
from pneuma.errors import UserError

from .arena import ATTACK, GODOT, RIGHT, THESIS, UP, begin, bits

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
@pytest.mark.parametrize("players", range(1, 9))
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


def test_different_seeds_give_different_episodes() -> None:
    plays = {tuple(play(seed, players=2, episode_steps=60)) for seed in range(12)}
    assert len(plays) == 6  # by start place: nothing else is random in the world


def test_seeding_again_begins_the_same_world_again() -> None:
    env = parallel_env(players=2)
    runs = []
    for _ in range(2):
        first = env.reset(seed=3)[0]
        later = [env.reset()[0] for _ in range(8)]
        runs.append([told[agent].tobytes() for told in (first, *later) for agent in NAMES[:2]])
    assert runs[0] == runs[1] and len(set(runs[0])) > 4


def test_unseeded_environments_differ() -> None:
    keys = set()
    for _ in range(2):
        env = parallel_env()
        env.reset()
        keys.add(int(env.worlds.worlds["key"][0]))
    assert len(keys) == 2


def test_the_world_is_that_of_its_seed() -> None:
    env = parallel_env(players=3)
    worlds = begin(1, seed=9, players=3)
    env.reset(seed=9)
    generator = np.random.default_rng(0)
    for _ in range(200):
        if not env.agents:
            break
        actions = generator.integers(5, size=(1, 3))
        worlds.step(actions)
        observations, rewards, *_ = env.step({agent: actions[0, int(agent[-1])] for agent in env.agents})
        for agent in observations:
            assert np.array_equal(observations[agent], worlds.observations[0, int(agent[-1])])
            assert rewards[agent] == worlds.events["reward"][0, int(agent[-1])]
    assert bits(env.worlds.players, env.worlds.monsters) == bits(worlds.players, worlds.monsters)


# --- Players -------------------------------------------------------------------------------------


@pytest.mark.parametrize("players", range(1, 9))
def test_there_are_as_many_agents_as_players(players: int) -> None:
    env = parallel_env(players=players)
    observations, infos = env.reset(seed=0)
    assert env.possible_agents == env.agents == NAMES[:players]
    assert list(observations) == list(infos) == NAMES[:players]
    assert env.state().shape == (players * 60,)
    assert env.state_space.contains(env.state())


def test_a_whole_number_of_players_may_be_a_float_as_for_the_other_faces() -> None:
    assert parallel_env(players=2.0).possible_agents == NAMES[:2]


@pytest.mark.parametrize("players", [0, 9, -1])
def test_other_numbers_of_players_are_refused(players: int) -> None:
    with pytest.raises(UserError, match=f"players = {players} is not allowed"):
        parallel_env(players=players)


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


def test_an_action_out_of_range_is_refused() -> None:
    env = parallel_env(players=2)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="player_1 is outside"):
        env.step({"player_0": np.int64(0), "player_1": np.int64(5)})


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


def test_stepping_before_the_first_reset_is_refused() -> None:
    env = parallel_env(players=2)
    with pytest.raises(ResetNeeded):
        env.step(same(env.possible_agents, ATTACK))


def test_a_living_player_without_an_action_is_named() -> None:
    env = parallel_env(players=2)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="no action for player_1"):
        env.step({"player_0": np.int64(ATTACK)})


def test_actions_of_the_dead_are_ignored(arena: str) -> None:
    env = duel(arena)
    env.step(same(env.agents, ATTACK))
    place = env.worlds.players[["x", "y"]][0, 0].tolist()
    env.step(same(NAMES[:3], RIGHT))
    assert env.worlds.players[["x", "y"]][0, 0].tolist() == place


def test_a_reset_brings_everybody_back(arena: str) -> None:
    env = duel(arena)
    env.step(same(env.agents, ATTACK))
    observations, _ = env.reset()
    assert env.agents == NAMES[:3]
    assert [float(observations[agent][2]) for agent in env.agents] == [1, 1, 1]
    _, _, terminations, *_ = env.step(same(env.agents, ATTACK))
    assert not any(terminations.values())
