"""Every face saves and restores: a world put back goes on there as the saved one would have."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode

from pneuma.env.saving import Snapshot
from pneuma.env.sb3 import PneumaVecEnv
from pneuma.env.single import PneumaEnv
from pneuma.env.vector import PneumaVectorEnv

from .arena import ATTACK

STEPS = 30


def plan(seed: int, *shape: int) -> np.ndarray:
    return np.random.default_rng(seed).choice([0, 1, 2, 3, ATTACK, ATTACK], size=shape)


def story(env: PneumaEnv, actions: np.ndarray) -> list[bytes]:
    """Play a single environment through its endings; return all that it says."""
    told = []
    for action in actions:
        observation, reward, terminated, truncated, info = env.step(action)
        told.append(observation.tobytes() + repr((reward, terminated, truncated, info)).encode())
        if terminated or truncated:
            told.append(env.reset()[0].tobytes())
    return told


def saved_in(env: PneumaEnv, steps: int, seed: int = 0) -> Snapshot:
    """Play an environment for some steps of its first episode and save it."""
    env.reset(seed=seed, options={"start": 0})
    for action in plan(seed, steps):
        env.step(action)
    return env.save()


# --- The single face -----------------------------------------------------------------------------


def test_a_single_environment_goes_on_as_it_would_have(pit: str) -> None:
    env = PneumaEnv(level=pit, episode_steps=STEPS)
    saved = saved_in(env, 5)
    seen = env.state.observations[0, 0].copy()
    told = story(env, plan(1, 100))
    for again in (env, PneumaEnv(level=pit, episode_steps=STEPS)):  # the second was never reset
        observation, info = again.restore(pickle.loads(pickle.dumps(saved)))
        assert np.array_equal(observation, seen) and info["action_mask"].shape == (5,)
        assert story(again, plan(1, 100)) == told


# --- The vector face -----------------------------------------------------------------------------


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_world_put_back_at_its_end_begins_again_as_the_mode_has_it(mode: AutoresetMode, pit: str) -> None:
    single = PneumaEnv(level=pit, episode_steps=3)
    saved = saved_in(single, 3)
    first = single.reset()[0]
    env = PneumaVectorEnv(2, autoreset_mode=mode, level=pit, episode_steps=3)
    env.reset(seed=0)
    observations, _ = env.restore(1, saved)
    if mode == AutoresetMode.DISABLED:
        with pytest.raises(ValueError, match="reset_mask"):
            env.step(np.zeros(2, np.int64))
        observations, _ = env.reset(options={"reset_mask": np.array([False, True])})
    elif mode == AutoresetMode.NEXT_STEP:
        observations, rewards, terminated, truncated, _ = env.step(np.zeros(2, np.int64))
        assert not (rewards[1] or terminated[1] or truncated[1])
    assert np.array_equal(observations[1], first)


def test_the_other_worlds_must_have_begun(pit: str) -> None:
    saved = saved_in(PneumaEnv(level=pit), 2)
    for env in (PneumaVectorEnv(2, level=pit), PneumaVecEnv(2, level=pit)):
        with pytest.raises(ResetNeeded, match="the other worlds"):
            env.restore(0, saved)
    with pytest.raises(ResetNeeded, match="the other worlds"):
        PneumaVectorEnv(2, autoreset_mode="Disabled").reset(options={"reset_mask": np.array([True, False])})
    PneumaVectorEnv(1, level=pit).restore(0, saved)


# --- Stable-Baselines3's face --------------------------------------------------------------------


def test_a_learners_episode_counts_from_its_beginning(pit: str) -> None:
    env = PneumaVecEnv(2, seed=1, level=pit, episode_steps=STEPS)
    env.reset()
    for actions in plan(0, 6, 2):
        env.step(actions)
    seen = env.restore(0, env.save(1))
    assert np.array_equal(seen[0], seen[1])
    endings = 0
    for actions in plan(1, 100, 1):
        observations, rewards, dones, infos = env.step(np.repeat(actions, 2))
        assert np.array_equal(observations[0], observations[1])  # type: ignore[index]
        assert rewards[0] == rewards[1] and dones[0] == dones[1]
        assert infos[0].get("episode") == infos[1].get("episode")
        endings += int(dones[0])
    assert endings > 3
