"""The example that compares a plain script of Stable-Baselines3 with both engines."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest
from stable_baselines3 import PPO

from pneuma.engines.environment import make_vec_env
from pneuma.engines.sb3_learners import make_model

from .test_defaults import settings

EXAMPLE = runpy.run_path(str(Path(__file__).parents[2] / "studies/examples/plain_sb3.py"))


@pytest.mark.parametrize("env", ["CartPole-v1", "pneuma/PneumaArena-v0"])
def test_the_plain_script_and_the_engine_have_the_same_settings(env: str) -> None:
    run = EXAMPLE["run_of"](env, 0, 20_000, "sb3")
    ours = make_model(run, make_vec_env(run))
    assert settings(ours, PPO) == settings(EXAMPLE["plain_learner"](env, 0), PPO)


def test_the_plain_script_trains() -> None:
    assert EXAMPLE["late_return"]("CartPole-v1", 0, 512, "plain") > 5
