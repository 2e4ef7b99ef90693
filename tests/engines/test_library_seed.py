"""seed_as = "library": a run trains to the bit what a script of Stable-Baselines3 does with that seed."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from sb3_contrib import QRDQN, TRPO, RecurrentPPO
from stable_baselines3 import A2C, DQN, PPO, SAC, TD3
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.utils import LinearSchedule

from pneuma.config import Run, make_run
from pneuma.engines.loop import train_run
from pneuma.engines.policy import Policy
from pneuma.engines.sb3 import extract_policy
from pneuma.engines.sb3_open import LearnedPolicy
from pneuma.env.sb3 import PneumaVecEnv
from pneuma.errors import UserError

from .test_sb3_open import weights

torch.set_num_threads(1)
SEED, STEPS = 7, 384
SHORT: dict[str, Any] = {
    "seed": SEED, "seed_as": "library", "steps": STEPS, "slots": 2, "horizon": 64, "evaluation_episodes": 1,
}  # fmt: skip
ROLLOUT: dict[str, Any] = {"n_steps": 64, "seed": SEED, "device": "cpu"}
REPLAY: dict[str, Any] = {"learning_starts": 50, "buffer_size": 300, "batch_size": 16}
POLE, PENDULUM, ARENA = "CartPole-v1", "Pendulum-v1", "pneuma/PneumaArena-v0"


def vec_env(env_id: str = POLE) -> Any:
    return make_vec_env(env_id, n_envs=2)


def test_ppo_is_that_of_a_script_whose_budget_ends_within_an_update() -> None:
    """Stable-Baselines3's learning rate falls over the budget, and below 0 in the rest of the last update."""
    fields = {"minibatch": 32, "epochs": 2, "steps": 350, "learning_rate": 1e-3}
    run = make_run({**SHORT, "env": POLE, **fields, "learning_rate_schedule": "linear"})
    assert run.engine == "sb3"
    falling = LinearSchedule(1e-3, 0.0, 1.0)
    script = PPO("MlpPolicy", vec_env(), falling, batch_size=32, n_epochs=2, **ROLLOUT).learn(350)
    assert policy_of(run).checksum == extract_policy(script, run).checksum


@pytest.mark.parametrize("algorithm", ["a2c", "trpo", "dqn"])
def test_learners_with_fields_are_those_of_a_script(algorithm: str) -> None:
    run = make_run({**SHORT, "env": POLE, "algorithm": algorithm})
    if algorithm == "dqn":
        replay = {"learning_starts": 50, "buffer_size": 300, "minibatch": 16, "train_every": 4}
        run = make_run({**SHORT, "env": POLE, "algorithm": algorithm, **replay})
        script: Any = DQN("MlpPolicy", vec_env(), seed=SEED, device="cpu", **REPLAY)
    else:
        script = {"a2c": A2C, "trpo": TRPO}[algorithm]("MlpPolicy", vec_env(), **ROLLOUT)
    script.learn(STEPS)
    assert policy_of(run).checksum == extract_policy(script, run).checksum


def test_the_arena_is_that_of_a_script() -> None:
    run = make_run({**SHORT, "env": ARENA, "minibatch": 32, "epochs": 2, "episode_steps": 40})
    checksums = {policy_of(run).checksum}
    worlds = PneumaVecEnv(2, env_id=ARENA, episode_steps=40)
    single_worlds = make_vec_env(lambda: gymnasium.make(ARENA, episode_steps=40), 2)
    for env in (worlds, single_worlds):
        script = PPO("MlpPolicy", env, batch_size=32, n_epochs=2, **ROLLOUT).learn(STEPS)
        checksums.add(extract_policy(script, run).checksum)
    assert len(checksums) == 1


SCRIPTS: dict[str, tuple[str, dict[str, Any], dict[str, Any]]] = {
    "sac": (PENDULUM, {**REPLAY, "train_freq": 2}, {}),
    "td3": (PENDULUM, REPLAY, {}),
    "qr-dqn": (POLE, {**REPLAY, "train_freq": 4}, {}),
    "recurrent-ppo": (POLE, {"batch_size": 32, "n_epochs": 1, "n_steps": 64}, {"policy": "MlpLstmPolicy"}),
    "ppo": (PENDULUM, {"use_sde": True}, {"minibatch": 64}),
}
CLASSES: dict[str, Any] = {"sac": SAC, "td3": TD3, "qr-dqn": QRDQN, "recurrent-ppo": RecurrentPPO, "ppo": PPO}


@pytest.mark.parametrize("algorithm", SCRIPTS)
def test_any_other_learner_is_that_of_a_script(algorithm: str) -> None:
    env, arguments, fields = SCRIPTS[algorithm]
    table, settings = dict(arguments), {**arguments, "seed": SEED, "device": "cpu"}
    if algorithm == "td3":
        table["action_noise"] = {"name": "NormalActionNoise", "sigma": 0.2}
        settings["action_noise"] = NormalActionNoise(np.zeros(1), np.full(1, 0.2))
    if algorithm == "ppo":
        settings["n_steps"] = 64
    run = make_run({**SHORT, "env": env, "algorithm": algorithm, "algorithm_kwargs": table, **fields})
    script = CLASSES[algorithm](fields.get("policy", "MlpPolicy"), vec_env(env), **settings)
    script.learn(STEPS)
    policy = train_run(run, lambda _: True).policy
    assert isinstance(policy, LearnedPolicy)
    assert weights(policy.learner) == weights(script)


def test_only_sb3_has_it_and_other_ids_stay() -> None:
    with pytest.raises(
        UserError, match='"batched" is not allowed: it cannot train a run with seed_as = library'
    ):
        make_run({"engine": "batched", "seed_as": "library"})
    assert make_run({"engine": "sb3", "seed_as": "streams"}) == make_run({"engine": "sb3"})


def policy_of(run: Run) -> Policy:
    policy = train_run(run, lambda _: True).policy
    assert isinstance(policy, Policy)
    return policy
