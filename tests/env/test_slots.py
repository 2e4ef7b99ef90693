"""Several players as slots: each an environment to learners, idle from its death to its world's end."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from pneuma.config import make_env_config
from pneuma.env.parallel import PneumaParallelEnv
from pneuma.env.sb3 import PneumaVecEnv
from pneuma.env.vector import PneumaVectorEnv
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError

from .arena import ATTACK, GODOT, RIGHT, THESIS

MODES = list(AutoresetMode)
IDLE_MASK = [0, 0, 0, 0, 1]


def endanger(worlds: Worlds, world: int, player: int) -> None:
    """Put a monster beside a player with 7 HP who faces the other way."""
    row, monster = worlds.players[world, player], worlds.monsters[world, 0]
    row["hp"], row["facing"] = 7, RIGHT
    monster["x"], monster["y"] = row["x"] - 40, row["y"]


def two_worlds(mode: AutoresetMode, **settings: Any) -> PneumaVectorEnv:
    """Return two worlds of two players each, as four slots."""
    env = PneumaVectorEnv(4, autoreset_mode=mode, players=2, **settings)
    env.reset(seed=0)
    return env


def stand(env: PneumaVectorEnv) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
    return env.step(np.full(env.num_envs, ATTACK))


# --- Which slot is whom --------------------------------------------------------------------------


def test_slot_i_is_player_i_modulo_players_of_world_i_over_players() -> None:
    env = PneumaVectorEnv(6, players=3)
    observations, infos = env.reset(seed=4)
    assert observations.shape == (6, 60) and infos["action_mask"].shape == (6, 5)
    for world in range(2):
        alone = Worlds(1, make_env_config({"players": 3}))
        alone.seed([4 + world])
        alone.reset()
        for player in range(3):
            assert np.array_equal(observations[3 * world + player], alone.observations[0, player])


@pytest.mark.parametrize(("slots", "players"), [(3, 2), (1, 2), (8, 3), (0, 1), (-2, 2)])
def test_slots_that_are_no_multiple_of_the_players_are_refused(slots: int, players: int) -> None:
    with pytest.raises(UserError) as caught:
        PneumaVectorEnv(slots, players=players)
    assert str(caught.value).startswith(
        f"num_envs = {slots} is not allowed: a multiple of the {players} players"
    )


def test_a_seed_for_each_world_not_for_each_slot() -> None:
    env = PneumaVectorEnv(4, players=2)
    env.reset(seed=[3, 8])
    assert env.state.worlds["key"][0] != env.state.worlds["key"][1]
    with pytest.raises(ValueError, match="4 seeds for 2 worlds"):
        env.reset(seed=[1, 2, 3, 4])


def test_every_slot_observes_within_the_batchs_space() -> None:
    """The classes differ, and with them the greatest HP, in raw points."""
    for classes in (["base", "tank"], ["tank", "base"]):
        env = PneumaVectorEnv(4, players=2, classes=classes, scale="raw")
        observations, _ = env.reset(seed=0)
        assert env.observation_space.contains(observations)
        learner = PneumaVecEnv([0], env.state.config)
        for observation in learner.reset():
            assert learner.observation_space.contains(observation)


# --- Death and idleness --------------------------------------------------------------------------


@pytest.mark.parametrize("mode", MODES)
def test_a_slot_whose_player_dies_ends_at_once_and_idles_till_its_world_ends(mode: AutoresetMode) -> None:
    env = two_worlds(mode, episode_steps=6)
    endanger(env.state, 0, 1)
    observations, rewards, terminated, truncated, infos = stand(env)
    assert terminated.tolist() == [False, True, False, False] and not truncated.any()
    assert rewards.tolist() == [-1, 0, -1, -1]
    if mode == AutoresetMode.SAME_STEP:
        assert infos["_final_obs"].tolist() == [False, True, False, False]
        assert infos["final_obs"][1][2] == 0.0
        assert infos["final_info"]["ending"][1] == "killed"
    else:
        assert infos["_ending"].tolist() == [False, True, False, False]
        assert observations[1, 2] == 0.0 and observations[1, 4] > 0.0  # without HP; it still sees
    for _ in range(4):  # steps 2 to 5
        observations, rewards, terminated, truncated, infos = stand(env)
        assert not (terminated | truncated).any()
        assert rewards.tolist() == [-1, 0, -1, -1]
        assert (observations[1] == 0).all() and (observations[[0, 2, 3], 2] > 0).all()
        assert infos["action_mask"][1].tolist() == IDLE_MASK
        assert "ending" not in infos and "final_info" not in infos
    observations, rewards, terminated, truncated, infos = stand(env)  # the time limit, for all who live
    assert not terminated.any() and truncated.tolist() == [True, False, True, True]
    assert rewards.tolist() == [-1, 0, -1, -1]
    if mode == AutoresetMode.DISABLED:
        env.reset(options={"reset_mask": truncated})
    elif mode == AutoresetMode.NEXT_STEP:
        observations, rewards, terminated, truncated, _ = stand(env)  # which resets and does nothing else
        assert rewards.tolist() == [0] * 4 and not (terminated | truncated).any()
    assert (env.state.players["hp"] == 100).all() and (env.state.worlds["steps"] == 0).all()
    observations, rewards, *_ = stand(env)
    assert rewards.tolist() == [-1] * 4 and (observations[:, 2] == 1).all()


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_when_the_last_player_dies_its_world_begins_anew_and_the_other_plays_on(mode: AutoresetMode) -> None:
    env = two_worlds(mode)
    endanger(env.state, 0, 0)
    stand(env)
    endanger(env.state, 0, 1)
    _, _, terminated, *_ = stand(env)
    assert terminated.tolist() == [False, True, False, False]  # slot 0 has ended before
    if mode == AutoresetMode.NEXT_STEP:
        stand(env)
    assert (env.state.players["hp"] == 100).all()
    other = 2 if mode == AutoresetMode.SAME_STEP else 3
    assert env.state.worlds["steps"].tolist() == [0, other]


def test_both_slots_of_a_world_may_end_in_one_step() -> None:
    env = two_worlds(AutoresetMode.SAME_STEP)
    endanger(env.state, 1, 0)
    env.state.players[1, 1] = env.state.players[1, 0]
    _, _, terminated, _, infos = stand(env)
    assert terminated.tolist() == [False, False, True, True]
    assert infos["final_info"]["ending"].tolist()[2:] == ["killed", "killed"]


def test_a_reset_mask_of_one_slot_resets_its_whole_world() -> None:
    env = two_worlds(AutoresetMode.DISABLED)
    stand(env)
    env.reset(options={"reset_mask": np.array([False, True, False, False])})
    assert env.state.worlds["steps"].tolist() == [0, 1]


def test_every_death_ends_a_slot_exactly_once(pit: str) -> None:
    """Law: a slot's endings are as many as its player's deaths and its world's ends while it lived."""
    env = PneumaVectorEnv(
        12, autoreset_mode=AutoresetMode.SAME_STEP, players=3, level=pit, episode_steps=40, reward="pygame"
    )
    env.reset(seed=0)
    generator = np.random.default_rng(0)
    idle = np.zeros(12, np.bool_)
    deaths = 0
    for _ in range(600):
        observations, rewards, terminated, truncated, infos = env.step(generator.integers(5, size=12))
        over = terminated | truncated
        assert not (over & idle).any()
        assert (rewards[idle] == 0).all() and (rewards[~idle & ~terminated] > 0).all()
        anew = np.repeat(env.state.worlds["steps"] == 0, 3)
        assert (over | idle)[anew].all()
        idle = (idle | over) & ~anew
        assert (infos["action_mask"][idle & ~over] == IDLE_MASK).all()
        assert (observations[idle & ~over] == 0).all()
        assert np.array_equal(idle, (env.state.players["hp"] <= 0).ravel())
        deaths += int(terminated.sum())
    assert deaths > 50


# --- As PettingZoo's face has it -----------------------------------------------------------------


@pytest.mark.parametrize("env_id", [THESIS, GODOT])
def test_slots_live_through_what_agents_do(env_id: str, pit: str) -> None:
    settings: dict[str, Any] = {"level": pit, "players": 3, "episode_steps": 60}
    slots = PneumaVectorEnv(3, env_id, AutoresetMode.DISABLED, **settings)
    agents = PneumaParallelEnv(env_id, **settings)
    generator = np.random.default_rng(1)
    early = 0
    for episode in range(10):
        first, _ = slots.reset(seed=episode)
        told, _ = agents.reset(seed=episode)
        assert all(np.array_equal(first[i], told[f"player_{i}"]) for i in range(3))
        while agents.agents:
            actions = generator.choice([0, 1, 2, 3, ATTACK, ATTACK], size=3)
            observations, rewards, terminated, truncated, infos = slots.step(actions)
            here = {agent: actions[int(agent[-1])] for agent in agents.agents}
            their, their_rewards, ends, cuts, their_infos = agents.step(here)
            for agent in their:
                slot = int(agent[-1])
                assert np.array_equal(observations[slot], their[agent])
            assert slots.observation_space.contains(observations)  # zeros of idle slots among them
            for agent in their:
                slot = int(agent[-1])
                assert rewards[slot] == their_rewards[agent]
                assert (terminated[slot], truncated[slot]) == (ends[agent], cuts[agent])
                assert np.array_equal(infos["action_mask"][slot], their_infos[agent]["action_mask"])
                if ends[agent] or cuts[agent]:
                    assert infos["ending"][slot] == their_infos[agent]["ending"]
                    assert infos["xp"][slot] == their_infos[agent]["xp"]
            early += sum(ends.values()) * (slots.state.worlds["ending"][0] == 0)
    assert early > 3


# --- Stable-Baselines3 ---------------------------------------------------------------------------


def test_stable_baselines3_has_slots_of_players_too() -> None:
    env = PneumaVecEnv([0, 1], make_env_config({"players": 2, "episode_steps": 4}))
    env.keep_finished = True
    assert env.num_envs == 4 and env.reset().shape == (4, 60)
    endanger(env.state, 0, 0)
    stand = np.full(4, ATTACK)
    _, rewards, dones, infos = env.step(stand)
    assert dones.tolist() == [True, False, False, False] and rewards.tolist() == [0, -1, -1, -1]
    assert infos[0]["terminal_observation"][2] == 0.0 and infos[0]["episode"] == {"r": 0.0, "l": 1}
    for _ in range(2):
        observations, rewards, dones, infos = env.step(stand)
        assert isinstance(observations, np.ndarray) and (observations[0] == 0).all()
        assert rewards.tolist() == [0, -1, -1, -1] and not dones.any() and infos == [{}] * 4
        assert env.action_masks()[0].tolist() == [False] * 4 + [True]
    _, rewards, dones, infos = env.step(stand)
    assert dones.tolist() == [False, True, True, True]  # idle slots have ended before
    assert infos[0] == {} and infos[1]["episode"] == {"r": -4.0, "l": 4} and infos[1]["TimeLimit.truncated"]
    env.step(stand)
    assert [(e["slot"], e["length"]) for e in env.finished] == [(0, 1), (1, 4), (2, 4), (3, 4)]
    for _ in range(3):
        env.step(stand)
    assert [(e["slot"], e["length"], e["return"]) for e in env.finished[4:]] == [
        (0, 4, -4.0), (1, 4, -4.0), (2, 4, -4.0), (3, 4, -4.0),
    ]  # fmt: skip
