"""Fields of PPO by their names in Stable-Baselines3 and rl-baselines3-zoo, so that settings can be pasted.

n_steps = 32 is horizon = 32; learning_rate = "lin_1e-3" is learning_rate = 1e-3 with
learning_rate_schedule = "linear". The arguments of other learners are in `algorithm_kwargs`, unchanged.
"""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Callable, Mapping
from typing import Any

from pneuma.config import ACTIVATIONS, FIELDS
from pneuma.errors import UserError


def _names_of_ppo() -> dict[str, str]:
    own_names = {}
    for field_name, declaration in FIELDS.items():
        if declaration.arguments and (not declaration.read_by or "ppo" in declaration.read_by):
            own_names[declaration.arguments[0]] = field_name
    return own_names


NAMES = _names_of_ppo()
"""Fields that PPO has by another name, by that name."""
ALGORITHM_KWARGS, CALLBACK = "algorithm_kwargs", "callback"
ZOO_NOISE = {"normal": "NormalActionNoise", "ornstein-uhlenbeck": "OrnsteinUhlenbeckActionNoise"}
"""Action noise, by its name in the zoo."""
_ACTIVATIONS = {f"nn.{torch_class}": activation for activation, torch_class in ACTIVATIONS.items()}
WRONG_TEXT = (KeyError, TypeError, ValueError, SyntaxError, RecursionError, MemoryError)
"""Exceptions of `read_arguments_text`."""


def own_fields(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields by Pneuma's own names; their values are not checked here."""
    fields, _ = fields_and_keys(settings)
    return fields


def fields_and_keys(settings: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Return fields by Pneuma's own names, and the key that sets each. An error begins with its key."""
    fields: dict[str, Any] = {}
    keys_by_field: dict[str, str] = {}
    for key, setting in settings.items():
        for field_name, value in _translate(key, setting).items():
            earlier = fields.get(field_name, {})
            if field_name == ALGORITHM_KWARGS and isinstance(earlier, Mapping) and isinstance(value, Mapping):
                value = {**earlier, **value}
            elif field_name in fields:
                raise UserError(f"{key} and {keys_by_field[field_name]} both set {field_name}: leave out one")
            fields[field_name] = value
            keys_by_field.setdefault(field_name, key)
    return fields, keys_by_field


def _translate(key: str, setting: Any) -> dict[str, Any]:
    if key in NAMES:
        return {NAMES[key]: setting}
    if key in READERS:
        return READERS[key](key, setting)
    return {key: setting}


def annealed_from(setting: Any) -> float | None:
    """Return the number in lin_3e-4, by which the zoo means a value that falls from there to 0; else None."""
    if isinstance(setting, str) and re.fullmatch(r"lin_(\d+(\.\d*)?|\.\d+)(e-?\d+)?", setting):
        return float(setting.removeprefix("lin_"))
    return None


def _read_schedule(key: str, setting: Any) -> dict[str, Any]:
    first_value = annealed_from(setting)
    if first_value is None:
        return {key: setting}
    return {key: first_value, f"{key}_schedule": "linear"}


def _read_normalize(key: str, setting: Any) -> dict[str, Any]:
    if not isinstance(setting, bool):
        single = "normalize_observations and normalize_rewards set one alone"
        raise UserError(f"{key} = {setting!r} is not allowed: true or false; {single}")
    return {"normalize_observations": setting, "normalize_rewards": setting}


def _read_policy(key: str, policy: Any) -> dict[str, Any]:
    return {} if policy == "MlpPolicy" else {key: policy}


def _pass_on(key: str, argument: Any) -> dict[str, Any]:
    """Pass an argument that is not a field to the learner, unless it has the learner's default."""
    return {} if argument in (False, None, -1) else {ALGORITHM_KWARGS: {key: argument}}


def _read_policy_kwargs(key: str, setting: Any) -> dict[str, Any]:
    """Read a table, or the zoo's text "dict(net_arch=dict(pi=[64], vf=[64]), activation_fn=nn.ReLU)".

    Networks and three activations are fields. Other arguments are passed to the policy.
    """
    try:
        arguments = {**(read_arguments_text(setting) if isinstance(setting, str) else setting)}
        fields = _read_net_arch(arguments.pop("net_arch", None))
        if arguments.get("activation_fn") in _ACTIVATIONS:
            fields["activation"] = _ACTIVATIONS[arguments.pop("activation_fn")]
        if arguments:
            fields[ALGORITHM_KWARGS] = {key: arguments}
        return fields
    except WRONG_TEXT:
        raise UserError(f"{key} = {setting!r} is not allowed: a table or dict(…)") from None


def _read_net_arch(layers: Any) -> dict[str, Any]:
    """Read net_arch: one list for both networks, or a table of two, which older versions put into a list."""
    if layers is None:
        return {}
    if isinstance(layers, list | tuple) and len(layers) == 1 and isinstance(layers[0], Mapping):
        layers = layers[0]
    if isinstance(layers, Mapping):
        return {"actor": layers["pi"], "critic": layers["vf"]}
    return {"actor": layers, "critic": layers}


def takes_classes(argument_name: str) -> bool:
    """Return whether an argument of a learner or of its policy is a class, or several."""
    return argument_name in ("activation_fn", CALLBACK) or argument_name.endswith("_class")


def own_classes(arguments: str) -> list[str]:
    """Return the classes of a user's own, "module:Class", in the JSON of `algorithm_kwargs`."""
    class_names: list[str] = []

    def noted(class_name: str) -> str:
        class_names.append(class_name)
        return class_name

    replace_own_classes(arguments, noted)
    return class_names


def replace_own_classes(arguments: str, change: Callable[[str], str]) -> str:
    """Return the JSON of `algorithm_kwargs` with other names for classes of a user's own."""

    def changed(argument_name: str, argument: Any) -> Any:
        if isinstance(argument, dict):
            return {name: changed(name, part) for name, part in argument.items()}
        if isinstance(argument, list):
            return [changed(argument_name, part) for part in argument]
        if isinstance(argument, str) and ":" in argument and takes_classes(argument_name):
            return change(argument)
        return argument

    return json.dumps(changed("", json.loads(arguments)), sort_keys=True) if arguments else ""


def read_arguments_text(arguments_text: str) -> Any:
    """Return the arguments in a text such as "dict(net_arch=[64, 64])", by name; nothing is called.

    Raises:
        Exception: one of `WRONG_TEXT`, for any other text.
    """
    return _evaluate(ast.parse(arguments_text, mode="eval").body)


def _evaluate(node: ast.expr) -> Any:
    """Evaluate dict(…), {…}, […], numbers and names, also dotted, of an expression; nothing is called."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "dict":
        return {str(keyword.arg): _evaluate(keyword.value) for keyword in node.keywords}
    if isinstance(node, ast.List):
        return [_evaluate(element) for element in node.elts]
    if isinstance(node, ast.Attribute | ast.Name):
        return ast.unparse(node)
    return ast.literal_eval(node)


READERS: dict[str, Callable[[str, Any], dict[str, Any]]] = {
    "learning_rate": _read_schedule,
    "clip_range": _read_schedule,
    "normalize": _read_normalize,
    "policy": _read_policy,
    "policy_kwargs": _read_policy_kwargs,
    "use_sde": _pass_on,
    "sde_sample_freq": _pass_on,
    "clip_range_vf": _pass_on,
}
