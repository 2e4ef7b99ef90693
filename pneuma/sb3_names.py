"""Fields of PPO as Stable-Baselines3 and rl-baselines3-zoo write them, so that these can be pasted.

n_steps = 32 is horizon = 32; learning_rate = "lin_1e-3" is learning_rate = 1e-3 with
learning_rate_schedule = "linear". Arguments of other learners stand in `algorithm_kwargs`, as they are.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Mapping
from typing import Any

from pneuma.config import FIELDS
from pneuma.errors import UserError

NAMES = {
    about.arguments[0]: name
    for name, about in FIELDS.items()
    if about.arguments and (not about.read_by or "ppo" in about.read_by)
}
"""The fields that PPO has by another name."""

PASSED_ON = "algorithm_kwargs"
_ACTIVATIONS = {"nn.Tanh": "tanh", "nn.ReLU": "relu", "nn.LeakyReLU": "leaky-relu"}


def own_fields(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields by Pneuma's own names; values are checked elsewhere."""
    return fields_and_keys(given)[0]


def fields_and_keys(given: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Return fields by Pneuma's own names, and the key that sets each. An error begins with its key."""
    fields: dict[str, Any] = {}
    keys: dict[str, str] = {}
    for key, value in given.items():
        for name, own in _read(key, value).items():
            if name == PASSED_ON and isinstance(own, Mapping) and isinstance(fields.get(name, {}), Mapping):
                own = {**fields.get(name, {}), **own}
            elif name in fields:
                raise UserError(f"{key} and {keys[name]} both set {name}: leave one out")
            fields[name], keys[name] = own, keys.get(name, key)
    return fields, keys


def _read(key: str, value: Any) -> dict[str, Any]:
    if key in NAMES:
        return {NAMES[key]: value}
    if key in _READERS:
        return _READERS[key](key, value)
    return {key: value}


def annealed_from(value: Any) -> float | None:
    """Return the number of lin_3e-4, the zoo's word for a value that falls from there to 0; else None."""
    linear = isinstance(value, str) and re.fullmatch(r"lin_(\d+(\.\d*)?|\.\d+)(e-?\d+)?", value)
    return float(value.removeprefix("lin_")) if linear else None


def _annealed(key: str, value: Any) -> dict[str, Any]:
    first = annealed_from(value)
    return {key: value} if first is None else {key: first, f"{key}_schedule": "linear"}


def _normalized(key: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, bool):
        one_by_one = "normalize_observations and normalize_rewards set one alone"
        raise UserError(f"{key} = {value!r} is not allowed: true or false; {one_by_one}")
    return {"normalize_observations": value, "normalize_rewards": value}


def _perceptron(key: str, value: Any) -> dict[str, Any]:
    return {} if value == "MlpPolicy" else {key: value}


def _passed_on(key: str, value: Any) -> dict[str, Any]:
    """Read an argument that is no field, if it is not at the learner's own default."""
    return {PASSED_ON: {key: value}} if value not in (False, None, -1) else {}


def _networks(key: str, value: Any) -> dict[str, Any]:
    """Read a table, or the zoo's text "dict(net_arch=dict(pi=[64], vf=[64]), activation_fn=nn.ReLU)".

    Networks of pi and vf, and three activations, are fields; all else is passed on to the policy.
    """
    try:
        arguments = read_arguments_text(value) if isinstance(value, str) else {**value}
        own = _layers(arguments.pop("net_arch", None))
        if arguments.get("activation_fn") in _ACTIVATIONS:
            own["activation"] = _ACTIVATIONS[arguments.pop("activation_fn")]
        return {**own, **({PASSED_ON: {key: arguments}} if arguments else {})}
    except (KeyError, TypeError, ValueError, SyntaxError, RecursionError, MemoryError):
        raise UserError(f"{key} = {value!r} is not allowed: a table or dict(…)") from None


def _layers(layers: Any) -> dict[str, Any]:
    """Read net_arch: one list for both networks, or one for each, which older versions put into a list."""
    if layers is None:
        return {}
    if isinstance(layers, list | tuple) and len(layers) == 1 and isinstance(layers[0], Mapping):
        layers = layers[0]
    if not isinstance(layers, Mapping):
        return {"actor": layers, "critic": layers}
    return {"actor": layers["pi"], "critic": layers["vf"]}


def read_arguments_text(text: str) -> Any:
    """Return the arguments that a text such as "dict(net_arch=[64, 64])" has, by name; nothing is called.

    Raises:
        ValueError, KeyError, TypeError, SyntaxError, RecursionError, MemoryError: for any other text.
    """
    return _evaluated(ast.parse(text, mode="eval").body)


def _evaluated(node: ast.expr) -> Any:
    """Evaluate dict(…), {…}, […], numbers and dotted names of an expression; nothing is called."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "dict":
        return {str(word.arg): _evaluated(word.value) for word in node.keywords}
    if isinstance(node, ast.List):
        return [_evaluated(item) for item in node.elts]
    return ast.unparse(node) if isinstance(node, ast.Attribute) else ast.literal_eval(node)


_READERS: dict[str, Callable[[str, Any], dict[str, Any]]] = {
    "learning_rate": _annealed,
    "clip_range": _annealed,
    "normalize": _normalized,
    "policy": _perceptron,
    "policy_kwargs": _networks,
    **dict.fromkeys(("use_sde", "sde_sample_freq", "clip_range_vf"), _passed_on),
}
