"""The identity of a run: a hash of everything that can change its result."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from pneuma.algorithms import is_own_algorithm
from pneuma.config import ENGINE_VERSIONS, RULES_VERSION, Run, as_fields
from pneuma.env.fields import are_own_characters, is_own_level, own_rewards, read_field
from pneuma.own_modules import in_package

_MODULE_FILES = ("pneuma.own_modules", "module_files")
_USER_FILES = {
    "level": ("pneuma.env.load_level", "level_files"),
    "characters": ("pneuma.env.characters", "character_files"),
    **dict.fromkeys(("reward", "env_module", "wrappers", "algorithm"), _MODULE_FILES),
}
"""By field: the function that returns the user's files to hash. None imports them."""
CLASSES = ("reward", "wrappers", "algorithm")
"""Fields that name something in a module."""
_NOUNS = {"env_module": "module", "wrappers": "wrapper"}


def run_id(run: Run) -> str:
    """Return 16 hexadecimal digits, which two runs share only if they end with the same bits.

    The hash covers the resolved configuration with seed and budget, the contents of the user's own files (not
    their paths), and the versions of rules and engine, but not the study's name. Fields at their defaults are
    left out, so that a new field does not change old ids. Changing a default must therefore raise a version.
    """
    return _digest(run)


def config_id(run: Run) -> str:
    """Return 16 hexadecimal digits, shared by the runs that differ in seed and steps alone."""
    return _digest(run, ("seed", "steps"))


def _digest(run: Run, without: Sequence[str] = ()) -> str:
    defaults, fields = as_fields(Run()), as_fields(run)
    hashed = {}
    for name, value in fields.items():
        if value != defaults[name] and name not in without:
            hashed[name] = value
    for name in own_names(fields):
        if name not in CLASSES:
            hashed[name] = "of the user's own"
    if "wrappers" in hashed:
        hashed["wrappers"] = [_by_file(wrapper) for wrapper in fields["wrappers"]]
    if "algorithm" in hashed:
        hashed["algorithm"] = _by_file(fields["algorithm"])
    if "reward" in hashed:
        hashed["reward"] = [_by_module(reward) for reward in fields["reward"]]
    identity = {
        "run": hashed,
        "contents": user_files_digest(fields),
        "rules": RULES_VERSION,
        "engine": [run.engine, ENGINE_VERSIONS[run.engine]],
    }
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:16]


def _by_file(name: str) -> str:
    """Return a class with its arguments, by the name of its module's file where it is given by its path."""
    class_name, brace, arguments = name.partition("{")
    return Path(class_name).name + brace + arguments


def _by_module(reward: str) -> str:
    """Return the name of a reward, by the name of its module where it is given by its path."""
    path, _, function = reward.rpartition(":")
    if not path.endswith(".py"):
        return reward
    return f"{in_package(Path(path))[1]}:{function}"


def user_files_digest(fields: Mapping[str, Any]) -> str:
    """Return a digest of the user's own files in a run's fields: level, characters, and modules; "" of none.

    Shipped files are part of the rules' version. The fields may be untrusted: files are read, nothing is run.

    Raises:
        UserError, OSError: for a file that cannot be read.
    """
    paths = user_files(fields)
    if not paths:
        return ""
    digest = hashlib.sha256()
    for path in paths:
        data = path.read_bytes()
        digest.update(f"{path.name}\0{len(data)}\0".encode() + data)
    return digest.hexdigest()


def user_files(fields: Mapping[str, Any]) -> list[Path]:
    """Return the user's own files in a run's fields: level, characters, and modules."""
    paths: list[Path] = []
    for key, names in own_names(fields).items():
        module, function = _USER_FILES[key]
        for name in names:
            if key in CLASSES:
                name = name.partition("{")[0].rpartition(":")[0]
            paths += getattr(import_module(module), function)(name)
    return paths


def own_names(fields: Mapping[str, Any]) -> dict[str, tuple[str, ...]]:
    """Return the names of a user's own level, characters or modules, by field."""
    tests = {"level": is_own_level, "characters": are_own_characters, "algorithm": is_own_algorithm}
    values: dict[str, Any] = {}
    for key, is_own in tests.items():
        if key in fields and is_own(fields[key]):
            values[key] = fields[key]
    for key in ("env_module", "wrappers"):
        values[key] = fields.get(key)
    values["reward"] = own_rewards(fields.get("reward", ()))
    names: dict[str, tuple[str, ...]] = {}
    for key, value in values.items():
        if isinstance(value, str) and value:
            names[key] = (value,)
        elif value:
            names[key] = tuple(value)
    return names


def files_beside(path: Path, fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields with the paths of a user's modules, level and characters that are beside a study's file.

    What is not there is looked for when it is used: here, and modules among those that are installed.
    """
    resolved = dict(fields)
    for key, names in own_names(fields).items():
        paths = {name: _beside(path.parent, key, name) for name in names}
        value = fields[key]
        if isinstance(value, str):
            resolved[key] = paths[value]
        else:
            resolved[key] = tuple(paths.get(name, name) for name in value)
    return resolved


def _beside(folder: Path, key: str, name: str) -> str:
    file, colon, class_name = name, "", ""
    if key in CLASSES:
        file, colon, class_name = name.partition(":")
    module, exists = file.replace(".", "/"), os.path.isdir if key == "level" else os.path.isfile
    for candidate in (file, f"{module}.py", f"{module}/__init__.py"):
        path = folder / candidate
        if exists(path):  # of `os.path`: a name may be too long, or hold a NUL
            return f"{path.resolve()}{colon}{class_name}"
    return name


def describe_user_code(fields: Mapping[str, object]) -> dict[str, str]:
    """Return what using untrusted fields would do beyond what is installed, by field; for messages.

    They may name files, code, and arguments of an environment, which may start programs. Nothing is imported
    or opened.
    """
    read = {}
    for key in _USER_FILES:
        if fields.get(key) is not None:
            read[key] = read_field(Run, key, fields[key])
    described = {}
    for key, names in own_names(read).items():
        verb = "run" if _USER_FILES[key] is _MODULE_FILES else "read"
        described[key] = f"{verb} the {_NOUNS.get(key, key)} {', '.join(names)}"
    arguments = fields.get("env_kwargs")
    if arguments:
        described["env_kwargs"] = f"make {fields.get('env')} with {arguments}"
    return described
