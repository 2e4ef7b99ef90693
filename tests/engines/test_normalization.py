"""Normalised observations and rewards are those of Stable-Baselines3's VecNormalize, wherever they go."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from pneuma.config import Run, slot_seeds
from pneuma.engines.gymnasium_env import GymnasiumSlots
from pneuma.engines.normalization import Scaling
from pneuma.engines.policy import Policy
from pneuma.engines.sb3 import extract_policy
from pneuma.engines.sb3_learners import make_model

from .trained import NORMALIZED, run_of, train_once


def normalized(**fields: Any) -> Run:
    return run_of(**{"env": "CartPole-v1", "slots": 2, "horizon": 32, "gamma": 0.9, **NORMALIZED, **fields})


def vec_normalize(run: Run) -> Any:
    """Return Stable-Baselines3's own, seeded as the run's slots are."""
    plain = DummyVecEnv([lambda: gymnasium.make(run.env)] * run.slots)
    plain._seeds = [seed % 2**31 for seed in slot_seeds(run)]
    return VecNormalize(plain, gamma=run.gamma)


@pytest.mark.parametrize("env", ["CartPole-v1", "Pendulum-v1"])
def test_slots_show_and_pay_what_vec_normalize_does(env: str) -> None:
    run = normalized(env=env, engine="sb3", slots=3)
    slots, vec_env = GymnasiumSlots(run, slot_seeds(run), training=True), vec_normalize(run)
    observations, ends, generator = vec_env.reset(), 0, np.random.default_rng(0)
    for _ in range(450):
        np.testing.assert_array_equal(slots.observations, observations)
        continuous = env == "Pendulum-v1"
        actions = generator.random((3, 1), np.float32) if continuous else generator.integers(2, size=3)
        slots.step(actions)
        observations, expected_rewards, dones, infos = vec_env.step(actions)
        np.testing.assert_allclose(slots.rewards, expected_rewards, rtol=1e-6)
        for slot in np.flatnonzero(dones):
            np.testing.assert_array_equal(slots.terminal[slot], infos[slot]["terminal_observation"])
            ends += 1
    assert ends == len(slots.finished) >= 6
    assert {row["return"] for row in slots.finished} != {0.0}
    assert slots.scaling is not None
    np.testing.assert_array_equal(slots.scaling.mean, vec_env.obs_rms.mean)


def test_the_engine_trains_as_stable_baselines3_does_with_vec_normalize_and_schedules() -> None:
    linear = {"learning_rate_schedule": "linear", "clip_range_schedule": "linear"}
    run = normalized(engine="sb3", **linear)
    vec_env = vec_normalize(run)
    model = make_model(run, vec_env)
    model.learn(run.steps)
    policy, expected = train_once(run)[0].policy, extract_policy(model, run)
    assert isinstance(policy, Policy)
    np.testing.assert_equal((policy.actor, policy.critic), (expected.actor, expected.critic))
    np.testing.assert_equal(
        vars(policy.scaling), {"mean": vec_env.obs_rms.mean, "variance": vec_env.obs_rms.var}
    )


def test_a_scaling_worked_out_by_hand_clips_at_ten() -> None:
    scaling = Scaling(np.array([1.0, 0.0]), np.array([4.0, 1.0]))
    np.testing.assert_allclose(scaling(np.array([[5.0, -99.0]], np.float32)), [[2.0, -10.0]], rtol=1e-6)


def test_a_policy_carries_the_statistics_of_the_last_rollout_and_records_are_as_paid() -> None:
    result, checkpoints = train_once(normalized())
    assert isinstance(result.policy, Policy) and result.policy.scaling is not None
    saved = checkpoints[-1].arrays
    np.testing.assert_array_equal(result.policy.scaling.mean, saved["worlds/observed_mean"])
    assert saved["worlds/observed_count"] == pytest.approx(384 + 2, abs=1e-3)
    returns = [row["return"] for row in result.records.episodes]
    assert returns == [float(row["length"]) for row in result.records.episodes]  # CartPole pays 1 a step
