"""Learners, policies and arguments of Stable-Baselines3 that have no fields here."""

from __future__ import annotations

import json
import re
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium import spaces

from pneuma.config import Run, make_run
from pneuma.engines.environment import check_environment
from pneuma.engines.gymnasium_env import make_env, refuse_flat_pictures
from pneuma.engines.loop import train_run
from pneuma.engines.sb3_open import OpenTrainer
from pneuma.errors import UserError
from pneuma.sb3_names import own_fields
from pneuma.study.identity import run_id

SHORT = {"env": "CartPole-v1", "slots": 2, "horizon": 64, "steps": 256, "evaluation_episodes": 2}
PICTURE, NUMBERS = spaces.Box(0, 255, (36, 36, 3), np.uint8), spaces.Box(-1, 1, (3,))
PICTURES = """
import gymnasium, numpy as np

class Pictures(gymnasium.Env):
    observation_space = gymnasium.spaces.Box(0, 255, (36, 36, 3), np.uint8)
    action_space = gymnasium.spaces.Discrete(2)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.left = 20
        return self.observation_space.sample(), {}

    def step(self, action):
        self.left -= 1
        return self.observation_space.sample(), float(action), self.left == 0, False, {}

gymnasium.register("Pictures-v0", Pictures)
"""
COUNTING = """
from stable_baselines3.common.callbacks import BaseCallback

class Counting(BaseCallback):
    steps = 0

    def _on_step(self):
        Counting.steps += 1
        return True
"""


def pasted(**given: Any) -> Run:
    return make_run({**SHORT, **own_fields(given)})


def test_another_learner_trains_is_evaluated_and_repeats() -> None:
    run = make_run({**SHORT, "algorithm": "qr-dqn", "algorithm_kwargs": {"learning_starts": 50}})
    assert run.engine == "sb3"
    check_environment(run)
    first, second = (train_run(run, lambda _: True) for _ in range(2))
    assert (first.status, first.step, first.policy) == ("done", 256, None)
    assert first.records.episodes == second.records.episodes
    lengths = [episode["length"] for episode in first.records.episodes]
    assert 0 < sum(lengths) <= 256 and lengths == [e["return"] for e in first.records.episodes]
    for one, other in zip(first.records.evaluations, second.records.evaluations, strict=True):
        assert one == pytest.approx(other, nan_ok=True) and np.isfinite(one["return"])


def test_arguments_of_ppo_that_are_no_fields_are_passed_on(tmp_path: Path) -> None:
    (tmp_path / "counting.py").write_text(COUNTING)
    run = pasted(
        use_sde=False,
        clip_range_vf=0.2,
        policy_kwargs="dict(ortho_init=False, activation_fn=nn.ELU, net_arch=dict(pi=[8], vf=[8]))",
        callback=f"{tmp_path}/counting.py:Counting",
    )
    assert (run.actor, run.critic) == ((8,), (8,))
    assert json.loads(run.algorithm_kwargs) == {
        "clip_range_vf": 0.2, "policy_kwargs": {"ortho_init": False, "activation_fn": "nn.ELU"},
    }  # fmt: skip
    trainer = OpenTrainer(run)
    assert "ELU" in repr(trainer._model.policy)
    assert trainer._model.clip_range_vf(1.0) == 0.2
    assert train_run(run, lambda _: True).status == "done"


def test_a_policy_for_pictures_sees_pictures(tmp_path: Path) -> None:
    (tmp_path / "pictures.py").write_text(PICTURES)
    given = {**SHORT, "env": "Pictures-v0", "env_module": f"{tmp_path}/pictures.py", "steps": 128}
    flat: tuple[dict[str, Any], ...] = (
        {},
        {"engine": "sb3"},
        {"algorithm": "dqn"},
        {"policy": "MlpLstmPolicy"},
    )
    for own in (*flat, {"algorithm_kwargs": {"vf_coef": 0.4}}):
        run = make_run({**given, **own})
        with pytest.raises(UserError, match=r'pictures, .*: set policy = "CnnPolicy", or wrappers = '):
            check_environment(run)
    check_environment(make_run({**given, "wrappers": ["FlattenObservation"]}))
    run = make_run({**given, "policy": "CnnPolicy", "epochs": 1})
    check_environment(run)
    assert train_run(run, lambda _: True).status == "done"


@pytest.mark.parametrize(
    ("space", "fix"),
    [
        (PICTURE, 'flatten: set policy = "CnnPolicy", or wrappers = ["FlattenObservation"]'),
        (spaces.Dict(seen=PICTURE, speed=NUMBERS), 'flatten: set policy = "MultiInputPolicy", or wrappers'),
        (spaces.Box(0, 255, (36, 36), np.uint8), 'flatten: wrappers = ["FlattenObservation"]'),
        (spaces.Box(0, 255, (128,), np.uint8), ""),  # the memory of an Atari game
        (NUMBERS, ""),
    ],
)
def test_what_counts_as_a_picture_and_what_to_write(space: spaces.Space[Any], fix: str) -> None:
    with pytest.raises(UserError, match=re.escape(fix)) if fix else nullcontext():
        refuse_flat_pictures(make_run({"env": "Pictures-v0"}), space)


def test_wrappers_take_arguments() -> None:
    stacked = {"name": "FrameStackObservation", "stack_size": 4}
    run = make_run({**SHORT, "wrappers": [stacked, "FlattenObservation"]})
    assert run.wrappers[0] == 'gymnasium.wrappers:FrameStackObservation{"stack_size": 4}'
    assert make_run({**SHORT, "wrappers": list(run.wrappers)}) == run  # as a record has them
    assert make_env(run).observation_space.shape == (16,)


def test_what_is_not_used_does_not_move_an_id() -> None:
    assert run_id(pasted(policy="MlpPolicy", use_sde=False, sde_sample_freq=-1)) == run_id(make_run(SHORT))


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"algorithm": "sac"}, "sac in CartPole-v1: .*Discrete"),
        ({"algorithm": "qr-dqn", "algorithm_kwargs": {"tao": 1, "tua": 2}}, "algorithm_kwargs: tao, tua not"),
        ({"policy": "CnnPolicy", "algorithm_kwargs": {"policy_kwargs": {"activation_fn": "no"}}}, "'no'"),
        ({"policy": "NoPolicy"}, "ppo in CartPole-v1: .*NoPolicy"),
    ],
)
def test_what_cannot_learn_is_told_before_training(given: dict[str, Any], told: str) -> None:
    with pytest.raises(UserError, match=told):
        check_environment(make_run({**SHORT, **given}))
