"""An entry of rl-baselines3-zoo as a study: its YAML, which may be anybody's, → the text of a study's file.

Nothing in it is evaluated or made, but for numbers, texts, lists and tables. Each key goes where it belongs,
or is named with the reason why it cannot be kept.
"""

from __future__ import annotations

import json
import math
import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from pneuma.algorithms import has_rollouts
from pneuma.config import FIELDS, Run, make_run
from pneuma.env.fields import read_field
from pneuma.errors import UserError, printable, unknown_name
from pneuma.files import read_text
from pneuma.sb3_names import NAMES, READERS, WRONG_TEXT, ZOO_NOISE, own_fields, read_arguments_text
from pneuma.study.spec import unread_fields
from pneuma.values import format_json

ALGORITHMS = {
    "ppo": "ppo", "a2c": "a2c", "trpo": "trpo", "dqn": "dqn", "qrdqn": "qr-dqn", "sac": "sac", "td3": "td3",
    "ddpg": "ddpg", "tqc": "tqc", "crossq": "crossq", "ppo_lstm": "recurrent-ppo",
}  # fmt: skip
"""Algorithms, by the names of the zoo's files."""
LARGEST_FILE = 2**17
"""Most bytes of a file; the zoo's largest has a seventh of it."""
MOST_ALIASES, MOST_KEYS, MOST_VALUES = 200, 1000, 1000
"""Most references of a file, keys of a table and values of an entry: references multiply what they name."""
NUMBER = r"[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?"
"""Texts that are numbers, although YAML reads 1e-3 as a text."""
NORMALIZED = {"norm_obs": "normalize_observations", "norm_reward": "normalize_rewards"}
WITHOUT_FIELD = {
    "frame_stack": "give wrappers that stack observations instead",
    "callback": "in algorithm_kwargs, callback takes classes without arguments",
    "vec_env_wrapper": "wrappers are of single environments",
    "monitor_kwargs": "episodes are recorded by Pneuma's own monitor",
}
"""Keys that cannot be kept, and why."""
DEFAULT_HORIZON = Run().horizon


def zoo_study(path: Path, env_id: str) -> tuple[str, list[str]]:
    """Return the text of a study with an environment's entry, and messages on keys that it lacks.

    Raises:
        UserError: for a file that is not the zoo's, or has no such entry.
    """
    if path.stem not in ALGORITHMS:
        raise UserError(
            f"{path}: {unknown_name('algorithm', path.stem, ALGORITHMS)}; the file's name tells it"
        )
    entries = _read_yaml(path)
    name, notes = env_id, []
    if name not in entries:
        name = "atari" if env_id.startswith("ALE/") or "NoFrameskip" in env_id else "default"
        notes = [f"{path} has no entry of {env_id}; its entry {name} is taken"]
    if not isinstance(entries.get(name), dict):
        raise unknown_name(f"entry of {path}", env_id, map(str, entries))
    try:
        entry = dict(_plain_items(entries[name]))
    except ValueError as error:
        raise UserError(f"{path}: {name}: {error}") from None
    tables, steps, left_out = _convert(entry, env_id, ALGORITHMS[path.stem])
    title = f"{path.stem} in {env_id}, as rl-baselines3-zoo tuned it"
    lines = []
    for key, reason in left_out.items():  # printable: a line's end would end the comment
        lines.append(printable(f"# not kept: {key} = {format_json(entry[key])}: {reason}"))
    lines += [f"title = {format_json(title)}"]
    for heading, table in tables.items():
        lines += ["", f"[{heading}]", *(f"{_key(key)} = {_toml(value)}" for key, value in table.items())]
    lines += ["", "[presets.quick]", "seeds = 5", f"steps = {steps}", ""]
    text = "\n".join(lines)
    try:
        tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise UserError(f"{path}: {name}: has a value that TOML cannot hold ({error})") from None
    return text, notes + [f"{key} is not kept: {reason}" for key, reason in left_out.items()]


class _Loader(yaml.SafeLoader):
    """Loads plain values alone, and few references."""

    aliases = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            self.aliases += 1
            if self.aliases > MOST_ALIASES:
                raise ValueError("has too many references")
        return super().compose_node(parent, index)

    def flatten_mapping(self, node: Any) -> None:
        super().flatten_mapping(node)
        if len(node.value) > MOST_KEYS:
            raise ValueError("has too many keys")


def _read_yaml(path: Path) -> dict[Any, Any]:
    text = read_text(path, LARGEST_FILE)
    try:
        entries = yaml.load(text, _Loader)  # noqa: S506, which knows only the library's own safe loaders
    except RecursionError:
        raise UserError(f"{path}: is nested too deeply") from None
    except Exception as error:  # besides YAMLError, ValueError and TypeError of single values
        reason = " ".join(str(getattr(error, "problem", None) or error).split())[:100]
        raise UserError(f"{path}: is not YAML of plain values ({reason})") from None
    if not isinstance(entries, dict):
        raise UserError(f"{path}: has no entries")
    return entries


def _plain_items(entry: Mapping[Any, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the keys and values of an entry, which are such as TOML has."""
    value_count = 0

    def plain(value: Any, depth: int) -> Any:
        nonlocal value_count
        value_count += 1
        if value_count > MOST_VALUES or depth > 10:
            raise ValueError("has too many values")
        if isinstance(value, dict):
            return {str(key): plain(inner, depth + 1) for key, inner in value.items()}
        if isinstance(value, list):
            return [plain(inner, depth + 1) for inner in value]
        if isinstance(value, str) and re.fullmatch(NUMBER, value):
            value = float(value)
        if (
            not isinstance(value, str | int | float | None)
            or value in (math.inf, -math.inf)
            or value != value
        ):
            raise ValueError(f"{str(value)[:40]} is neither a finite number nor a text, list or table")
        return value

    for key, value in entry.items():
        yield str(key), plain(value, 0)


def _convert(
    entry: Mapping[str, Any], env_id: str, algorithm: str
) -> tuple[dict[str, dict[str, Any]], int, dict[str, str]]:
    """Return the tables of a study's file, the steps, and the keys that cannot be kept with the reasons."""
    run: dict[str, Any] = {"env": env_id, "algorithm": algorithm}
    arguments: dict[str, Any] = {}
    left_out: dict[str, str] = {}
    steps = make_run(run).steps
    for key, value in entry.items():
        try:
            if value is None:
                raise UserError("it is empty")
            if key in WITHOUT_FIELD:
                raise UserError(WITHOUT_FIELD[key])
            if key == "n_timesteps":
                steps = read_field(Run, "steps", value)
            elif key == "normalize":
                run |= _normalization(value, left_out)
            elif key == "env_wrapper":
                run["wrappers"] = [
                    _wrapper(wrapper) for wrapper in (value if isinstance(value, list) else [value])
                ]
            elif key in ("noise_type", "noise_std") and not _is_noise(entry):
                raise UserError(f"noise_type must be {' or '.join(ZOO_NOISE)}, and noise_std a number")
            elif key == "train_freq" and not _is_frequency(value):
                raise UserError('it must be a number from 1 on, or such a number and "step" or "episode"')
            elif _is_field(key, algorithm):
                for field_name, field_value in own_fields({key: value}).items():
                    if field_name in FIELDS:
                        read_field(Run, field_name, field_value)
                run[key] = value
            else:
                if isinstance(value, str) and "(" in value:
                    read_arguments_text(value)  # refuses what would have to be evaluated
                arguments[key] = value
        except UserError as error:
            left_out[key] = str(error)
        except WRONG_TEXT:
            left_out[key] = "it is not a table or dict(…) of plain values"
    train_freq = arguments.get("train_freq", 1)
    if isinstance(train_freq, int) and train_freq > 0 and DEFAULT_HORIZON % train_freq:
        run["horizon"] = train_freq * max(1, DEFAULT_HORIZON // train_freq)
    whole_run = {**run, **({"algorithm_kwargs": arguments} if arguments else {})}
    fields = own_fields(whole_run)
    for field_name in unread_fields([make_run(fields)], fields):
        if field_name in run and field_name not in ("env", "algorithm"):
            del run[field_name]
            left_out[field_name] = f"{algorithm} does not read it"
    tables = {"run": run}
    if arguments:
        tables["run.algorithm_kwargs"] = arguments
    return {**tables, f"conditions.{algorithm}": {}}, steps, left_out


def _is_noise(entry: Mapping[str, Any]) -> bool:
    """Return whether an entry has action noise that a learner can take."""
    return str(entry.get("noise_type")) in ZOO_NOISE and type(entry.get("noise_std")) in (int, float)


def _is_frequency(value: Any) -> bool:
    """Return whether a learner can train so often: a number of steps, or [number, "step" or "episode"]."""
    number = value[0] if isinstance(value, list) and value else value
    return type(number) is int and number >= 1


def _is_field(key: str, algorithm: str) -> bool:
    """Return whether a key is a field of a run, by its name here or there, and no argument of the learner."""
    if key == "n_steps":
        return has_rollouts(algorithm)
    if algorithm == "ppo":
        return key in NAMES or key in READERS or (key in FIELDS and "ppo" in FIELDS[key].read_by)
    return key in ("n_envs", "policy", "env_kwargs")


def _normalization(value: Any, left_out: dict[str, str]) -> dict[str, Any]:
    """Return the fields for `normalize`: true, false, or the arguments of VecNormalize."""
    if isinstance(value, bool):
        return {"normalize": value}
    arguments = read_arguments_text(value) if isinstance(value, str) else dict(value)
    others = ", ".join(arguments.keys() - NORMALIZED.keys() - {"gamma"})  # gamma is the learner's
    if others:
        left_out["normalize"] = f"its {others} cannot be set; the rest is kept"
    return {field_name: bool(arguments.get(name, True)) for name, field_name in NORMALIZED.items()}


def _wrapper(wrapper: Any) -> dict[str, Any]:
    """Return module.Class, or {module.Class: arguments}, as a wrapper of a study."""
    class_path, arguments = wrapper, None
    if isinstance(wrapper, dict):
        if len(wrapper) != 1:
            raise UserError("is not one wrapper")
        ((class_path, arguments),) = wrapper.items()
    module, _, class_name = str(class_path).rpartition(".")
    table = {**(arguments or {}), "name": f"{module}:{class_name}"}
    read_field(Run, "wrappers", [table])
    return table


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{_key(key)} = {_toml(inner)}" for key, inner in value.items()) + " }"
    if isinstance(value, list):
        return f"[{', '.join(map(_toml, value))}]"
    return json.dumps(value)


def _key(key: str) -> str:
    return key if re.fullmatch(r"[\w-]+", key, re.ASCII) else json.dumps(key)
