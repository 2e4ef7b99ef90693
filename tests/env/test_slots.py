"""Several players as slots: each an environment to learners, idle from its death to its world's end."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from pneuma.env.vector import PneumaVectorEnv
from pneuma.env.worlds import Worlds

from .arena import ATTACK, RIGHT

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
