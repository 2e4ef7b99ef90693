"""Export of a stored policy as a .zip of Stable-Baselines3.

Policy and its run → bytes of a file, which can be read without Pneuma. Pneuma itself never reads them,
because loading a .zip of Stable-Baselines3 runs the code that is pickled in it.
"""

from __future__ import annotations

import io
from dataclasses import replace
from typing import Any
from zipfile import ZipFile

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import DummyVecEnv

from pneuma.algorithms import OPTIMIZERS
from pneuma.config import CPU, STREAMS, Run, as_fields, env_config, is_gymnasium_id, make_run
from pneuma.engines.gymnasium_env import closed_after, make_env
from pneuma.engines.mlp import layer_widths
from pneuma.engines.normalization import CLIP, EPSILON, Scaling
from pneuma.engines.policy import Policy
from pneuma.engines.sb3_learners import linear_layers, make_model
from pneuma.env.fields import REWARDS
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError
from pneuma.files import MADE_BY

IN_ZIP = ("ppo", "a2c")
"""Algorithms whose policies Stable-Baselines3 can load."""


def to_sb3(policy: Policy, run: Run, space: spaces.Box) -> bytes:
    """Encode a policy for the `load` of Stable-Baselines3's `PPO` or `A2C`, with its hyperparameters.

    The optimizer starts afresh, because a stored run does not contain its state. One that torch lacks is
    replaced by Adam without weight decay. Separate clipping of actor and critic, and advantages without a
    baseline, would need Pneuma's classes to read the file: the library's own are in their place.
    """
    fields = as_fields(run) | {
        "activation": policy.activation,
        "actor": layer_widths(policy.actor)[1:-1].tolist(),
        "critic": layer_widths(policy.critic)[1:-1].tolist(),
        "clip": "joint",
        "device": CPU,
        "seed_as": STREAMS,
        "value_baseline": True,
    }
    if not OPTIMIZERS[run.optimizer].torch_class:
        fields |= {"optimizer": "adam", "weight_decay": 0.0}
    run = make_run(fields)
    spaces_only: gymnasium.Env[np.ndarray, np.int64] = gymnasium.Env()  # the learner is never trained
    spaces_only.observation_space, spaces_only.action_space = space, _action_space(policy)
    model = make_model(run, DummyVecEnv([lambda: spaces_only]), _extractor(policy.scaling))
    model.num_timesteps = run.trained_steps
    with torch.no_grad():
        if policy.deviation is not None:
            model.policy.log_std.copy_(torch.from_numpy(np.log(policy.deviation)))
        for network, layers in linear_layers(model).items():
            for (weight, bias), module in zip(getattr(policy, network), layers, strict=True):
                module.weight.copy_(torch.from_numpy(weight.T.copy()))  # torch keeps (outputs, inputs)
                module.bias.copy_(torch.from_numpy(bias.copy()))
    zip_buffer = io.BytesIO()
    model.save(zip_buffer)
    with ZipFile(zip_buffer, "a") as archive:
        archive.comment = MADE_BY.encode()
    return zip_buffer.getvalue()


def _extractor(scaling: Scaling | None) -> dict[str, Any]:
    """Return the arguments of Stable-Baselines3's policy that put the normalisation before its networks.

    A class within a function goes into the .zip itself, as the byte code of its methods.
    """
    if scaling is None:
        return {}

    class Normalized(FlattenExtractor):
        """Observations as the networks see them: normalised in double precision, and clipped."""

        mean: torch.Tensor
        deviation: torch.Tensor

        def __init__(self, space: spaces.Box, mean: list[float], deviation: list[float], clip: float) -> None:
            super().__init__(space)
            self.register_buffer("mean", torch.tensor(mean, dtype=torch.float64))
            self.register_buffer("deviation", torch.tensor(deviation, dtype=torch.float64))
            self.clip = clip

        def forward(self, observations: torch.Tensor) -> torch.Tensor:
            """Normalise observations: (N, features) -> (N, features) float32."""
            scaled = (super().forward(observations).double() - self.mean) / self.deviation
            return scaled.clamp(-self.clip, self.clip).float()

    deviation = np.sqrt(scaling.variance + EPSILON)
    extractor_arguments = {"mean": scaling.mean.tolist(), "deviation": deviation.tolist(), "clip": CLIP}
    return {"features_extractor_class": Normalized, "features_extractor_kwargs": extractor_arguments}


def _action_space(policy: Policy) -> spaces.Space[Any]:
    if policy.choices is not None:
        return spaces.MultiDiscrete(policy.choices.reshape(-1))
    if policy.bounds is None:
        return spaces.Discrete(policy.actions)
    low, high = policy.bounds
    return spaces.Box(low, high, dtype=low.dtype)


def observation_space(policy: Policy, run: Run) -> spaces.Box:
    """Return a policy's observation space, so that the exported file loads with its environment.

    Rewards do not matter here and are never imported.
    """
    if run.algorithm not in IN_ZIP:
        raise UserError(f"only policies of {' and '.join(IN_ZIP)} can be exported, not of {run.algorithm}")
    features = policy.features
    if is_gymnasium_id(run.env):
        with closed_after(run, make_env(run)) as env:
            pass
        if isinstance(env.action_space, spaces.MultiBinary):
            raise UserError(f"cannot be exported: a .zip has no policy like this for {env.action_space}")
        if np.any(getattr(env.action_space, "start", 0)):
            raise UserError(
                f"cannot be exported: a .zip counts actions from 0, but those of {run.env} begin later"
            )
        observed = env.observation_space
        is_flat = observed.shape == (features,) and observed.dtype == np.float32
        if isinstance(observed, spaces.Box) and is_flat:
            return observed
        return spaces.Box(-np.inf, np.inf, (features,), np.float32)
    space = Worlds(1, replace(env_config(run), reward=REWARDS[:1])).slot_space
    if space.shape != (features,):
        raise UserError(f"the policy observes {features} features, its environment has {space.shape[0]}")
    return space
