"""Export of a stored policy to other programs: Stable-Baselines3's .zip, and ONNX.

Policy and its run → bytes of a file, which can be read without Pneuma. Pneuma itself never reads them,
because loading a .zip of Stable-Baselines3 runs the code that is pickled in it.
"""

from __future__ import annotations

import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any
from zipfile import ZipFile

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.vec_env import DummyVecEnv

from pneuma.config import Run, env_config, is_gymnasium_id
from pneuma.engines.gymnasium_env import make_env
from pneuma.engines.normalization import CLIP, EPSILON, Scaling
from pneuma.engines.policy import LEAKY_SLOPE, Layers, Policy
from pneuma.engines.sb3_learners import linear_layers, make_model
from pneuma.env.fields import REWARDS
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError, install_extra
from pneuma.files import MADE_BY

IN_ZIP = ("ppo", "a2c")
"""Algorithms whose policies Stable-Baselines3 can load."""

ONNX_OPSET = 17
ONNX_IR_VERSION = 8
"""The oldest version with all operators used, so that older runtimes can read it."""

FLOAT, DOUBLE = 1, 11
"""ONNX's codes of float32 and float64."""
_ONNX_ACTIVATIONS = {"tanh": "Tanh", "relu": "Relu", "leaky-relu": f"LeakyRelu <alpha = {LEAKY_SLOPE}>"}


# --- Stable-Baselines3 -----------------------------------------------------------------------------


def to_sb3(policy: Policy, run: Run, space: spaces.Box) -> bytes:
    """Encode a policy for the `load` of Stable-Baselines3's `PPO` or `A2C`, with its hyperparameters.

    The optimizer starts afresh, because a stored run does not contain its state. UPGD is replaced by Adam
    with the same betas and epsilon, without weight decay, which works differently. Separate clipping of actor
    and critic is replaced by joint clipping.
    """
    actor, critic = (
        tuple(len(bias) for _, bias in network[:-1]) for network in (policy.actor, policy.critic)
    )
    # separate clipping, or no baseline, would need Pneuma's classes to read the file
    run = replace(run, clip="joint", value_baseline=True)
    run = replace(run, activation=policy.activation, actor=actor, critic=critic)
    if run.optimizer == "upgd":
        run = replace(run, optimizer="adam", weight_decay=0.0)
    spaces_only: gymnasium.Env[np.ndarray, np.int64] = gymnasium.Env()  # for a learner that never trains
    spaces_only.observation_space, spaces_only.action_space = space, _action_space(policy)
    model = make_model(run, DummyVecEnv([lambda: spaces_only]), _extractor(policy.scaling))
    model.num_timesteps = run.steps
    with torch.no_grad():
        if policy.deviation is not None:
            model.policy.log_std.copy_(torch.from_numpy(np.log(policy.deviation)))
        for part, layers in linear_layers(model).items():
            for (weight, bias), module in zip(getattr(policy, part), layers, strict=True):
                module.weight.copy_(torch.from_numpy(weight.T.copy()))  # torch keeps (outputs, inputs)
                module.bias.copy_(torch.from_numpy(bias.copy()))
    file = io.BytesIO()
    model.save(file)
    with ZipFile(file, "a") as archive:
        archive.comment = MADE_BY.encode()
    return file.getvalue()


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
    numbers = {"mean": scaling.mean.tolist(), "deviation": deviation.tolist(), "clip": CLIP}
    return {"features_extractor_class": Normalized, "features_extractor_kwargs": numbers}


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
        raise UserError(f".zip is of {' and '.join(IN_ZIP)}, and not of {run.algorithm}: choose .onnx")
    features = policy.features
    if is_gymnasium_id(run.env):
        env = make_env(run)
        env.close()
        if np.any(getattr(env.action_space, "start", 0)):
            raise UserError(f".zip counts actions from 0; those of {run.env} begin later: choose .onnx")
        seen = env.observation_space
        if isinstance(seen, spaces.Box) and seen.shape == (features,) and seen.dtype == np.float32:
            return seen
        return spaces.Box(-np.inf, np.inf, (features,), np.float32)
    space = Worlds(1, replace(env_config(run), reward=REWARDS[:1])).slot_space
    if space.shape != (features,):
        raise UserError(f"the policy observes {features} features, its environment has {space.shape[0]}")
    return space


# --- ONNX ------------------------------------------------------------------------------------------


def to_onnx(policy: Policy, about: Mapping[str, str], names: Sequence[str] = ()) -> bytes:
    """Return an ONNX model: observation (batch, features) → logits (batch, actions), value (batch,).

    For a network of action values, the only output is action_values (batch, actions). In place of logits
    a policy of continuous actions has mean_action (batch, …), the mean clipped to the action space.

    The graph is written in ONNX's own text form. `torch.onnx.export` takes seconds and would add a trace of
    its calls, with local paths, to every node. `about` goes into the model's metadata, with the names of the
    actions.
    """
    try:
        from onnx import checker, helper, numpy_helper, parser
    except ImportError:
        raise UserError(f".onnx needs onnx: {install_extra('onnx')}, or choose .zip") from None
    lines, numbers, outputs = _graph(policy)
    inputs = f"float[batch, {policy.features}] observation"
    text = "\n".join([f"policy ({inputs}) => ({', '.join(outputs)}) {{", *lines, "}"])
    graph = parser.parse_graph(text)
    graph.initializer.extend(numpy_helper.from_array(array, name) for name, array in numbers.items())
    made = {"producer_name": "pneuma", "doc_string": MADE_BY, "ir_version": ONNX_IR_VERSION}
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", ONNX_OPSET)], **made)
    named = {"actions": json.dumps(names)} if names else {}
    if policy.choices is not None:  # whose logits stand one after another
        named = {"choices": json.dumps(policy.choices.tolist())}
    helper.set_model_props(model, {**about, **named})
    checker.check_model(model)
    return model.SerializeToString(deterministic=True)


def _graph(policy: Policy) -> tuple[list[str], dict[str, np.ndarray], list[str]]:
    """Return a model's operations as text, the numbers that they name, and its outputs."""
    lines: list[str] = []
    numbers: dict[str, np.ndarray] = {}
    seen = "observation"
    if policy.scaling:  # in double precision, as the policy has it
        seen, deviation = "seen", np.sqrt(policy.scaling.variance + EPSILON)
        numbers = {"average": policy.scaling.mean, "deviation": deviation}
        numbers |= {"least": np.array(-CLIP), "most": np.array(CLIP)}
        lines = [
            f"precise = Cast <to = {DOUBLE}> (observation)",
            "centred = Sub (precise, average)",
            "scaled = Div (centred, deviation)",
            "clipped = Clip (scaled, least, most)",
            f"seen = Cast <to = {FLOAT}> (clipped)",
        ]

    def add_layers(part: str, layers: Layers, output: str) -> None:
        operation = _ONNX_ACTIVATIONS[policy.activation]
        before = seen
        for i, (weight, bias) in enumerate(layers):
            name, last = f"{part}_{i}", i == len(layers) - 1
            linear = output if last else f"{name}_linear"
            numbers.update({f"{name}_weight": weight, f"{name}_bias": bias})
            lines.append(f"{linear} = Gemm ({before}, {name}_weight, {name}_bias)")
            if not last:
                lines.append(f"{name} = {operation} ({linear})")
            before = name

    output = "logits" if policy.exploration is None else "action_values"
    add_layers("actor", policy.actor, output)
    outputs = [f"float[batch, {policy.actions}] {output}"]
    if policy.bounds is not None:  # ONNX's `Clip` knows one bound for all numbers
        low, high = policy.bounds.astype(np.float32)
        numbers |= {"shape": np.array([-1, *low.shape]), "low": low, "high": high}
        lines += [
            f"shaped = Reshape ({output}, shape)",
            "above = Max (shaped, low)",
            "mean_action = Min (above, high)",
        ]
        outputs = [f"float[{', '.join(map(str, ['batch', *low.shape]))}] mean_action"]
    if policy.exploration is None:
        add_layers("critic", policy.critic, "values")
        numbers["flat"] = np.array([-1])
        lines.append("value = Reshape (values, flat)")
        outputs.append("float[batch] value")
    return lines, numbers, outputs
