"""The identity of a run: a hash of everything that can change its result."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from pneuma.algorithms import is_own_algorithm
from pneuma.config import ENGINE_VERSIONS, RULES_VERSION, Run, as_fields
from pneuma.env.fields import are_own_characters, is_own_level, is_own_reward, read_field
from pneuma.files import read_regular
from pneuma.own_modules import in_package, module_files
from pneuma.sb3_names import ALGORITHM_KWARGS, own_classes, replace_own_classes

_IS_OWN: dict[str, Callable[[str], bool]] = {
    "level": is_own_level,
    "characters": are_own_characters,
    "algorithm": is_own_algorithm,
    "env_module": bool,
    "wrappers": bool,
    "reward": is_own_reward,
    ALGORITHM_KWARGS: bool,
}
"""Fields that may name a user's files, in the order in which these are hashed, and whether a name does."""
_CLASSES = ("reward", "wrappers", "algorithm", ALGORITHM_KWARGS)
"""Fields that name something in a module."""
_NOUNS = {"env_module": "module", "wrappers": "wrapper", ALGORITHM_KWARGS: "class"}
_UNSET: tuple[Any, ...] = (None, False, 0, "", [], {})
"""Values of fields that a version of Pneuma knew which this one does not, if they were not set."""
_FORMER_DEFAULTS = {"weapons": ["own"], "bodies": "block", "coast": "wall", "slow_factor": 0.5}
"""The same, of fields that had another default."""


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
    hashed_fields = {}
    for field_name, field_value in fields.items():
        if field_value != defaults[field_name] and field_name not in without:
            hashed_fields[field_name] = field_value
    for field_name in own_names(fields):
        if field_name not in _CLASSES:
            hashed_fields[field_name] = "of the user's own"
    if "algorithm" in hashed_fields:
        hashed_fields["algorithm"] = _by_file(run.algorithm)
    if "wrappers" in hashed_fields:
        hashed_fields["wrappers"] = list(map(_by_file, run.wrappers))
    if ALGORITHM_KWARGS in hashed_fields:
        hashed_fields[ALGORITHM_KWARGS] = replace_own_classes(run.algorithm_kwargs, _by_file)
    if "reward" in hashed_fields:
        hashed_fields["reward"] = list(map(_by_module, run.reward))
    identity = {
        "run": hashed_fields,
        "contents": user_files_digest(fields),
        "rules": RULES_VERSION,
        "engine": [run.engine, ENGINE_VERSIONS[run.engine]],
    }
    return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:16]


@cache
def _default_fields() -> dict[str, Any]:
    return as_fields(Run())


def comparable_fields(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields of this version or another one in a form that is equal for runs that do the same.

    Seed and steps are left out, and fields that this version does not know, if they were not set. Files and
    modules of the user's own count by their names, as published fields have no folders.
    """
    defaults = _default_fields()
    comparable = {}
    for field_name, value in {**defaults, **fields}.items():
        is_former = field_name not in defaults
        if is_former and (value in _UNSET or value == _FORMER_DEFAULTS.get(field_name)):
            continue
        if field_name not in ("seed", "steps"):
            comparable[field_name] = _with_bare_names(value)
    return comparable


def _with_bare_names(value: Any) -> Any:
    """Return a field's value with the user's own files by their names alone."""
    if isinstance(value, list | tuple):
        return tuple(map(_with_bare_names, value))
    if isinstance(value, str):
        file, colon, inside = value.partition(":")
        if file.startswith("/") or file.endswith(".py"):
            return Path(file).name.removesuffix(".py") + colon + inside
    return value


def _by_file(class_text: str) -> str:
    """Return a class with its arguments, by the name of its module's file where it is given by its path."""
    class_name, brace, arguments = class_text.partition("{")
    return Path(class_name).name + brace + arguments


def _by_module(reward_name: str) -> str:
    """Return the name of a reward, by the name of its module where it is given by its path."""
    module_path, _, function = reward_name.rpartition(":")
    if not module_path.endswith(".py"):
        return reward_name
    return f"{in_package(Path(module_path))[1]}:{function}"


def user_files_digest(fields: Mapping[str, Any]) -> str:
    """Return a digest of the user's own files in a run's fields: level, characters, and modules; "" of none.

    Shipped files are part of the rules' version. The fields may be untrusted: files are read, nothing is run.

    Raises:
        UserError, OSError: for a file that cannot be read.
    """
    file_paths = user_files(fields)
    if not file_paths:
        return ""
    digest = hashlib.sha256()
    for file_path in file_paths:
        contents = read_regular(file_path)
        digest.update(f"{file_path.name}\0{len(contents)}\0".encode() + contents)
    return digest.hexdigest()


def user_files(fields: Mapping[str, Any]) -> list[Path]:
    """Return the user's own files in a run's fields: level, characters, and modules."""
    file_paths: list[Path] = []
    for field_name, names in own_names(fields).items():
        for own_name in names:
            file_paths += _files_of(field_name, own_name)
    return file_paths


def _files_of(field_name: str, own_name: str) -> list[Path]:
    """Return the files to which a user's own name refers in a field."""
    if field_name == "level":
        from pneuma.env.load_level import level_files  # numpy: not for `import pneuma`

        return level_files(own_name)
    if field_name == "characters":
        from pneuma.env.characters import character_files

        return character_files(own_name)
    if field_name in _CLASSES:
        own_name = own_name.partition("{")[0].rpartition(":")[0]
    return module_files(own_name)


def own_names(fields: Mapping[str, Any]) -> dict[str, tuple[str, ...]]:
    """Return the names of a user's own level, characters or modules, by field."""
    names_by_field: dict[str, tuple[str, ...]] = {}
    for field_name, is_own in _IS_OWN.items():
        field_value = fields.get(field_name, ())
        names = (field_value,) if isinstance(field_value, str) else field_value
        if field_name == ALGORITHM_KWARGS:
            names = own_classes(field_value or "")
        user_names = tuple(filter(is_own, names))
        if user_names:
            names_by_field[field_name] = user_names
    return names_by_field


def with_file_paths(study_file: Path, fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields with the paths of a user's own files that are in the folder of a study's file.

    Files that are not there are searched for when they are used: in the current folder, and modules among
    those that are installed.
    """
    resolved = dict(fields)
    for field_name, names in own_names(fields).items():
        paths = {own_name: _file_path(study_file.parent, field_name, own_name) for own_name in names}
        field_value = fields[field_name]
        if field_name == ALGORITHM_KWARGS:
            resolved[field_name] = replace_own_classes(field_value, paths.__getitem__)
        elif isinstance(field_value, str):
            resolved[field_name] = paths[field_value]
        else:
            resolved[field_name] = tuple(paths.get(own_name, own_name) for own_name in field_value)
    return resolved


def _file_path(folder: Path, field_name: str, own_name: str) -> str:
    file, colon, class_name = own_name, "", ""
    if field_name in _CLASSES:
        file, colon, class_name = own_name.partition(":")
    module, exists = file.replace(".", "/"), os.path.isdir if field_name == "level" else os.path.isfile
    for candidate in (file, f"{module}.py", f"{module}/__init__.py"):
        file_path = folder / candidate
        if exists(file_path):  # of `os.path`: a name may be too long, or contain a NUL
            return f"{file_path.resolve()}{colon}{class_name}"
    return own_name


def describe_user_code(fields: Mapping[str, object]) -> dict[str, str]:
    """Return what using untrusted fields would do beyond what is installed, by field; for messages.

    They may name files, code, and arguments of an environment, which may start programs. Nothing is imported
    or opened.
    """
    read_values = {}
    for field_name in _IS_OWN:
        if fields.get(field_name) is not None:
            read_values[field_name] = read_field(Run, field_name, fields[field_name])
    described = {}
    for field_name, names in own_names(read_values).items():
        verb = "read" if field_name in ("level", "characters") else "run"
        described[field_name] = f"{verb} the {_NOUNS.get(field_name, field_name)} {', '.join(names)}"
    arguments = fields.get("env_kwargs")
    if arguments:
        described["env_kwargs"] = f"make {fields.get('env')} with {arguments}"
    return described
