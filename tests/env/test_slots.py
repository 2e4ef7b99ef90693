"""What each face alone has: idle slots, players who leave, and episodes as Stable-Baselines3 wants them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor

from pneuma.env.gym import PneumaEnv
from pneuma.env.gym_vector import PneumaVectorEnv
from pneuma.env.pettingzoo import parallel_env
from pneuma.env.sb3 import PneumaVecEnv
from pneuma.env.worlds import Worlds

from .arena import ATTACK, RIGHT
from .test_faces import MODES, N, assert_same, step

IDLE_MASK = [0, 0, 0, 0, 1]


def threaten(worlds: Worlds, player: int) -> None:
    """Give a player 7 HP and put a monster beside it, out of the sword's way."""
    row, monster = worlds.players[0, player], worlds.monsters[0, 0]
    row["hp"], row["facing"] = 7.0, RIGHT
    monster["x"], monster["y"] = row["x"] - 40, row["y"]


# --- Several players as slots --------------------------------------------------------------------


@pytest.mark.parametrize("mode", MODES)
def test_a_slot_whose_player_dies_ends_at_once_and_idles_till_its_world_ends(mode: AutoresetMode) -> None:
    env = PneumaVectorEnv(4, autoreset_mode=mode, players=2, episode_steps=6)
    env.reset(seed=0)
    threaten(env.state, player=1)
    stand = np.full(4, ATTACK)
    observations, rewards, terminated, truncated, infos = env.step(stand)
    assert terminated.tolist() == [False, True, False, False] and not truncated.any()
    assert rewards.tolist() == [-1, 0, -1, -1]
    if mode == AutoresetMode.SAME_STEP:
        assert infos["_final_obs"].tolist() == [False, True, False, False]
        assert infos["final_obs"][1][2] == 0.0 and infos["final_info"]["ending"][1] == "killed"
    else:
        assert infos["_ending"].tolist() == [False, True, False, False]
        assert observations[1, 2] == 0.0 and observations[1, 4] > 0.0  # without HP; it still sees
    for _ in range(4):  # steps 2 to 5
        observations, rewards, terminated, truncated, infos = env.step(stand)
        assert not (terminated | truncated).any() and rewards.tolist() == [-1, 0, -1, -1]
        assert (observations[1] == 0).all() and (observations[[0, 2, 3], 2] > 0).all()
        assert infos["action_mask"][1].tolist() == IDLE_MASK
        assert "ending" not in infos and "final_info" not in infos
    observations, rewards, terminated, truncated, infos = env.step(stand)  # the limit, for all who live
    assert not terminated.any() and truncated.tolist() == [True, False, True, True]
    if mode == AutoresetMode.DISABLED:
        env.reset(options={"reset_mask": truncated})
    elif mode == AutoresetMode.NEXT_STEP:
        _, rewards, terminated, truncated, _ = env.step(stand)  # which resets and does nothing else
        assert rewards.tolist() == [0] * 4 and not (terminated | truncated).any()
    assert (env.state.players["hp"] == 100).all() and (env.state.worlds["steps"] == 0).all()


# --- PettingZoo's face ---------------------------------------------------------------------------


def test_each_has_a_class_a_reward_and_a_view_of_its_own() -> None:
    env = parallel_env(players=2, classes=["tank", "mage"], reward=["thesis", "pygame"], scale="raw")
    observations, _ = env.reset(seed=0)
    assert [float(observations[agent][2]) for agent in env.agents] == [150, 70]
    highest = [float(env.observation_space(agent).high[2]) for agent in env.agents]
    assert highest == [150 + 14 * 7, 70 + 14 * 7]  # each kill heals 7 HP, past full ones
    assert not np.array_equal(observations["player_0"][:2], observations["player_1"][:2])
    _, rewards, *_ = step(env, np.full(2, ATTACK))
    assert rewards == {"player_0": -1.0, "player_1": 1.0}
    with pytest.raises(ValueError, match="action None of player_1"):
        env.step({"player_0": np.int64(ATTACK)})


# --- Stable-Baselines3's face --------------------------------------------------------------------


def pit_actions(generator: np.random.Generator) -> np.ndarray:
    """Return actions under which about every second player stays in the pit and dies."""
    actions = generator.integers(5, size=N)
    return actions if generator.random() < 0.5 else np.full(N, ATTACK)


def test_it_steps_as_a_dummy_vec_env_of_single_environments(pit: str) -> None:
    settings: dict[str, Any] = {"level": pit, "episode_steps": 20}
    ours, theirs = PneumaVecEnv(N, seed=3, **settings), DummyVecEnv([lambda: PneumaEnv(**settings)] * N)
    theirs.seed(3)
    generator = np.random.default_rng(1)
    assert ours.reset().tobytes() == np.asarray(theirs.reset()).tobytes()
    truncated = []
    for _ in range(300):
        actions = pit_actions(generator)
        *told, infos = ours.step(actions)
        *expected, their_infos = theirs.step(actions)
        for our, their in zip(told, expected, strict=True):
            assert_same(our, their)
        for done, info, their_info in zip(told[2], infos, their_infos, strict=True):
            if not done:
                assert info == {}
                continue
            assert np.array_equal(info["terminal_observation"], their_info["terminal_observation"])
            for key in ("TimeLimit.truncated", "ending", "kills", "xp", "hp"):
                assert info[key] == their_info[key], key
            truncated.append(info["TimeLimit.truncated"])
    assert 10 < sum(truncated) < len(truncated) - 10


def test_the_episodes_it_notes_are_those_of_vec_monitor(pit: str) -> None:
    env = PneumaVecEnv(N, seed=0, level=pit, episode_steps=20)
    env.keep_finished = True
    monitor = VecMonitor(env)
    monitor.reset()
    generator = np.random.default_rng(2)
    theirs = []
    for number in range(1, 201):
        *_, infos = monitor.step(pit_actions(generator))
        ended = [(slot, info["episode"]) for slot, info in enumerate(infos) if "episode" in info]
        theirs += [(slot, N * number, episode["l"], episode["r"]) for slot, episode in ended]
    ours = [(e["slot"], e["step"], e["length"], e["return"]) for e in env.finished]
    assert {e["ending"] for e in env.finished} == {"killed", "time-limit"}
    assert len(ours) > 20
    for our, their in zip(ours, theirs, strict=True):
        assert our == pytest.approx(their, abs=1e-3)  # VecMonitor adds in float32
