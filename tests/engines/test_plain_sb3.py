"""The example that compares a plain script of Stable-Baselines3 with both engines."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from typing import Any

import pytest
from stable_baselines3 import PPO

from pneuma.engines.environment import make_vec_env
from pneuma.engines.sb3_learners import make_model

from .test_defaults import settings

PATH = Path(__file__).parents[2] / "studies" / "examples" / "plain_sb3.py"


@pytest.fixture(scope="module")
def example() -> Any:
    spec = importlib.util.spec_from_file_location("plain_sb3", PATH)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("env", ["CartPole-v1", "pneuma/PneumaArena-v0"])
def test_the_plain_script_and_the_engine_have_the_same_settings(example: Any, env: str) -> None:
    run = example.run_of(env, 0, 20_000, "sb3")
    ours = make_model(run, make_vec_env(run))
    assert settings(ours, PPO) == settings(example.plain_learner(env, 0), PPO)


def test_the_plain_script_trains(example: Any) -> None:
    assert example.late_return("CartPole-v1", 0, 512, "plain") > 5
