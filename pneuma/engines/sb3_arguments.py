"""The arguments of a learner of Stable-Baselines3's kind, from `algorithm_kwargs` of a run.

Numbers, texts and lists are passed on as they are. What TOML cannot contain is written as in
rl-baselines3-zoo: "lin_7e-4" is a schedule, "nn.ELU" a class, "dict(net_arch=[64])" a dictionary. A class of
a user's own is "module:Class". Action noise is a table with the name of its class, or the zoo's noise_type
and noise_std.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import stable_baselines3
import torch
from gymnasium import spaces
from stable_baselines3.common import buffers, noise, torch_layers
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.sb2_compat import rmsprop_tf_like
from stable_baselines3.common.utils import LinearSchedule

from pneuma.engines.gymnasium_env import errors_from, load_class
from pneuma.errors import UserError
from pneuma.sb3_names import (
    CALLBACK,
    WRONG_TEXT,
    ZOO_NOISE,
    annealed_from,
    own_classes,
    read_arguments_text,
    takes_classes,
)

TUPLES = ("train_freq", "betas")
"""Arguments that must be tuples."""
CLASSES_OF = (torch.nn, torch.optim, torch_layers, buffers, rmsprop_tf_like, stable_baselines3)
"""Modules in which a class is looked up by its name."""
BASES: dict[str, type] = {
    CALLBACK: BaseCallback,
    "features_extractor_class": torch_layers.BaseFeaturesExtractor,
    "optimizer_class": torch.optim.Optimizer,
    "activation_fn": torch.nn.Module,
}
"""What a class must be, by the argument that names it."""
NOISE = tuple(ZOO_NOISE.values())


def read_arguments(argument_table: Mapping[str, Any], action_space: spaces.Space[Any]) -> dict[str, Any]:
    """Return a learner's arguments, from a table of `algorithm_kwargs`."""
    if "noise_type" in argument_table or "noise_std" in argument_table:
        argument_table = _with_action_noise(argument_table)
    return {name: _read(name, argument, action_space) for name, argument in argument_table.items()}


def _with_action_noise(argument_table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table with action noise in place of the zoo's two keys."""
    arguments = dict(argument_table)
    noise_type, deviation = arguments.pop("noise_type", None), arguments.pop("noise_std", None)
    if (
        str(noise_type) not in ZOO_NOISE
        or not isinstance(deviation, int | float)
        or "action_noise" in arguments
    ):
        problem = f"noise_type = {noise_type!r} and noise_std = {deviation!r} are not allowed"
        kinds = " or ".join(ZOO_NOISE)
        raise UserError(f"algorithm_kwargs: {problem}: {kinds}, a number, and no action_noise beside them")
    return {**arguments, "action_noise": {"name": ZOO_NOISE[noise_type], "sigma": deviation}}


def _read(argument_name: str, argument: Any, action_space: spaces.Space[Any]) -> Any:
    if isinstance(argument, str):
        return _read_text(argument_name, argument, action_space)
    if argument_name == "action_noise" and isinstance(argument, Mapping):
        return _action_noise(argument, action_space)
    if isinstance(argument, Mapping):
        return read_arguments(argument, action_space)
    if argument_name in TUPLES and isinstance(argument, list):
        return tuple(argument)
    return argument


def _read_text(argument_name: str, argument_text: str, action_space: spaces.Space[Any]) -> Any:
    if takes_classes(argument_name):
        return find_class(argument_name, argument_text)
    first_value = annealed_from(argument_text)
    if first_value is not None:
        return LinearSchedule(first_value, 0.0, 1.0)
    if not argument_text.startswith("dict("):
        return argument_text
    try:
        argument_table = read_arguments_text(argument_text)
    except WRONG_TEXT:
        raise UserError(
            f"algorithm_kwargs: {argument_name} = {argument_text!r} is not allowed: a table or dict(…)"
        ) from None
    if own_classes(json.dumps(argument_table)):  # trust and ids know those in tables alone
        problem = f"algorithm_kwargs: {argument_name} = {argument_text!r} is not allowed"
        raise UserError(f"{problem}: write a class of your own in a table, {{ … }}, not in a text")
    return read_arguments(argument_table, action_space)


def find_class(argument_name: str, class_text: str) -> Any:
    """Return a class of torch or Stable-Baselines3 by its name, or one of a user's own by `module:Class`."""
    wanted = f"algorithm_kwargs: {argument_name} = {class_text!r}"
    found: Any = None
    if ":" in class_text:
        with errors_from(wanted):
            found = load_class(class_text)
    else:
        class_name = class_text.rpartition(".")[2]
        for module in CLASSES_OF:
            candidate = getattr(module, class_name, None)
            if isinstance(candidate, type):
                found = candidate
                break
        if found is None:
            own = "your own is module:Class"
            raise UserError(f"{wanted}: is not a class of torch or Stable-Baselines3; {own}")
    base = BASES.get(argument_name, object)
    if not isinstance(found, type) or not issubclass(found, base):
        raise UserError(f"{wanted}: must be a class of {base.__name__}'s kind")
    return found


def _action_noise(noise_table: Mapping[str, Any], action_space: spaces.Space[Any]) -> noise.ActionNoise:
    """Return action noise; its mean (0 if left out) and deviation are one number, or one a dimension."""
    if noise_table.get("name") not in NOISE:
        allowed = f"a table with the name {' or '.join(NOISE)}, and sigma"
        raise UserError(f"algorithm_kwargs: action_noise = {dict(noise_table)} is not allowed: {allowed}")
    arguments: dict[str, Any] = {"mean": 0.0, **noise_table}
    noise_class = getattr(noise, arguments.pop("name"))
    for argument in arguments.keys() & {"mean", "sigma"}:
        arguments[argument] = np.full(action_space.shape or (), arguments[argument], float)
    action_noise: noise.ActionNoise = noise_class(**arguments)
    return action_noise
