"""The example that compares a plain script of Stable-Baselines3 with both engines."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import pytest

from pneuma.engines.environment import make_vec_env
from pneuma.engines.sb3_learners import make_model

PATH = Path(__file__).parents[2] / "studies" / "examples" / "plain_sb3.py"


@pytest.fixture(scope="module")
def example() -> Any:
    spec = importlib.util.spec_from_file_location("plain_sb3", PATH)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def learner_settings(model: Any) -> dict[str, Any]:
    """Return all that Stable-Baselines3's PPO computes with, at the beginning and halfway."""
    plain = (
        "n_steps", "batch_size", "n_epochs", "gamma", "gae_lambda", "ent_coef", "vf_coef", "max_grad_norm",
        "n_envs", "normalize_advantage", "use_sde", "target_kl", "clip_range_vf",
    )  # fmt: skip
    (group,) = model.policy.optimizer.param_groups
    numbers = {name: value for name, value in group.items() if name not in ("params", "lr")}
    return {
        **{name: getattr(model, name) for name in plain},
        **{name: [getattr(model, name)(left) for left in (1, 0.5)] for name in ("lr_schedule", "clip_range")},
        "optimizer": (type(model.policy.optimizer), numbers),
        "networks": str(model.policy).replace("Pneuma", ""),
    }


@pytest.mark.parametrize("env", ["CartPole-v1", "pneuma/PneumaArena-v0"])
def test_the_plain_script_and_the_engine_have_the_same_settings(example: Any, env: str) -> None:
    run = example.run_of(env, 0, 20_000, "sb3")
    assert learner_settings(make_model(run, make_vec_env(run))) == learner_settings(
        example.plain_learner(env, 0)
    )


def test_the_plain_script_trains(example: Any) -> None:
    assert example.late_return("CartPole-v1", 0, 512, "plain") > 5
