"""The arguments of a learner of Stable-Baselines3's kind, from `algorithm_kwargs` of a run.

Numbers, texts and lists are handed on as they are. What a file cannot hold is written as rl-baselines3-zoo
writes it: "lin_7e-4" is a schedule, "nn.ELU" a class, "dict(net_arch=[64])" a dictionary. Action noise is a
table with the name of its class.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import stable_baselines3
import torch
from gymnasium import spaces
from stable_baselines3.common import buffers, noise, torch_layers
from stable_baselines3.common.sb2_compat import rmsprop_tf_like
from stable_baselines3.common.utils import LinearSchedule

from pneuma.errors import UserError
from pneuma.sb3_names import WRONG_TEXT, annealed_from, read_arguments_text

TUPLES = ("train_freq", "betas")
"""Arguments for which a list does not do."""
CLASSES_OF = (torch.nn, torch.optim, torch_layers, buffers, rmsprop_tf_like, stable_baselines3)
"""Where a class is looked up by its name. None of a user's own modules, as the name may be untrusted."""
NOISE = ("NormalActionNoise", "OrnsteinUhlenbeckActionNoise")


def read_arguments(table: Mapping[str, Any], action_space: spaces.Space[Any]) -> dict[str, Any]:
    """Return a learner's arguments, from a table of `algorithm_kwargs`."""
    return {name: _read(name, value, action_space) for name, value in table.items()}


def _read(name: str, value: Any, action_space: spaces.Space[Any]) -> Any:
    if isinstance(value, str):
        return _read_text(name, value, action_space)
    if name == "action_noise" and isinstance(value, Mapping):
        return _action_noise(value, action_space)
    if isinstance(value, Mapping):
        return read_arguments(value, action_space)
    if name in TUPLES and isinstance(value, list):
        return tuple(value)
    return value


def _read_text(name: str, text: str, action_space: spaces.Space[Any]) -> Any:
    if name == "activation_fn" or name.endswith("_class"):
        return _find_class(name, text)
    first = annealed_from(text)
    if first is not None:
        return LinearSchedule(first, 0.0, 1.0)
    if not text.startswith("dict("):
        return text
    try:
        table = read_arguments_text(text)
    except WRONG_TEXT:
        raise UserError(f"algorithm_kwargs: {name} = {text!r} is not allowed: a table or dict(…)") from None
    return read_arguments(table, action_space)


def _find_class(name: str, text: str) -> type:
    class_name = text.rpartition(".")[2]
    for module in CLASSES_OF:
        candidate = getattr(module, class_name, None)
        if isinstance(candidate, type):
            return candidate
    raise UserError(f"algorithm_kwargs: {name} = {text!r}: is not a class of torch or Stable-Baselines3")


def _action_noise(table: Mapping[str, Any], action_space: spaces.Space[Any]) -> noise.ActionNoise:
    """Return action noise; its mean (0 if left out) and deviation are one number, or one a dimension."""
    if table.get("name") not in NOISE:
        allowed = f"a table with the name {' or '.join(NOISE)}, and sigma"
        raise UserError(f"algorithm_kwargs: action_noise = {dict(table)} is not allowed: {allowed}")
    arguments: dict[str, Any] = {"mean": 0.0, **table}
    noise_class = getattr(noise, arguments.pop("name"))
    for key in arguments.keys() & {"mean", "sigma"}:
        arguments[key] = np.full(action_space.shape or (), arguments[key], float)
    action_noise: noise.ActionNoise = noise_class(**arguments)
    return action_noise
