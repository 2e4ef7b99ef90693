"""Learners have all settings of Stable-Baselines3: its defaults, and those of the example's plain script."""

from __future__ import annotations

import inspect
import runpy
from pathlib import Path
from typing import Any

import pytest
from stable_baselines3 import PPO

from pneuma.algorithms import ALGORITHMS
from pneuma.config import make_run
from pneuma.engines.environment import make_vec_env
from pneuma.engines.sb3_learners import make_model
from pneuma.engines.sb3_open import OpenTrainer, learner_class

NOT_COMPARED = {"self", "policy", "env", "seed", "device", "_init_setup_model", "policy_kwargs"}
"""Arguments that every run sets, and one whose effect is compared instead."""
GIVEN = {"env": "CartPole-v1", "engine": "sb3", "evaluation_episodes": 1}
OTHERS: dict[str, dict[str, Any]] = {
    **dict.fromkeys(("sac", "td3", "ddpg", "tqc", "crossq"), {"env": "Pendulum-v1"}),
    "recurrent-ppo": {"policy": "MlpLstmPolicy"},
    "maskable-ppo": {"env": "Masked-v0", "env_module": "tests.engines.own_envs"},
}


def settings(model: Any, kind: type) -> dict[str, Any]:
    """Return all that a learner computes with: its arguments, its networks, and how it descends."""
    values: dict[str, Any] = {"networks": str(model.policy)}
    for name in inspect.signature(kind.__init__).parameters:  # type: ignore[misc]
        if name not in NOT_COMPARED and name in vars(model):
            value = vars(model)[name]
            is_schedule = callable(value) and not isinstance(value, type)
            values[name] = [value(left) for left in (1, 0.5)] if is_schedule else value
    for part in (model.policy, *model.policy.children()):
        if optimizer := getattr(part, "optimizer", None):
            rule = {key: value for key, value in optimizer.param_groups[0].items() if key != "params"}
            values[f"optimizer of {type(part).__name__}"] = type(optimizer), rule
    return values


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_what_nobody_sets_is_the_librarys_default(algorithm: str) -> None:
    run = make_run({"algorithm": algorithm, **GIVEN, **OTHERS.get(algorithm, {})})
    if ALGORITHMS[algorithm].learner:
        learner: Any = OpenTrainer(run).policy().learner
        env = learner.env
    else:
        env = make_vec_env(run)
        learner = make_model(run, env)
    kind = learner_class(run)
    library_learner = kind(run.policy or "MlpPolicy", env, device="cpu")
    expected = settings(library_learner, kind)
    assert {"learning_rate", "gamma", "networks"} < expected.keys() and len(expected) > 10
    assert settings(learner, kind) == expected


EXAMPLE = runpy.run_path(str(Path(__file__).parents[2] / "studies/examples/plain_sb3.py"))


@pytest.mark.parametrize("env", ["CartPole-v1", "pneuma/PneumaArena-v0"])
def test_the_plain_script_and_the_engine_have_the_same_settings(env: str) -> None:
    run = EXAMPLE["run_of"](env, 0, 20_000, "sb3")
    learner = make_model(run, make_vec_env(run))
    assert settings(learner, PPO) == settings(EXAMPLE["plain_learner"](env, 0), PPO)


def test_the_plain_script_trains() -> None:
    assert EXAMPLE["late_return"]("CartPole-v1", 0, 512, "plain") > 5
