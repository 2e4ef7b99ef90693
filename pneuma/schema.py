"""The one place that turns pydantic's errors into one line that says what to change in a file.

    TOML file → read_toml → read_model(SomeTable, file) → the model, checked
    pydantic's error → UserError "mine.toml, line 7: [run] gamma = 2 is not allowed: less than or equal to 1"

A model of a table derives from `Table`. Its validators raise `wrong(…)` for what types cannot express. Lists
become tuples, and whole numbers may be written as 1e6.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from os import PathLike, fspath
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    TypeAdapter,
    ValidationError,
    model_validator,
)
from pydantic_core import PydanticCustomError

from pneuma.errors import UserError, nearest_name, unknown_name
from pneuma.files import read_text

Where = tuple[str, ...]
"""The path of a table in a file: () for the top, ("conditions", "tanh") for [conditions.tanh]."""
Mistake = tuple[Where, str, str]

CONFIG = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)
DEEPEST = 50


class Table(BaseModel):
    """A table of a file, which has no other keys than its fields that are not excluded."""

    model_config = CONFIG

    @model_validator(mode="before")
    @classmethod
    def _only_known_keys(cls, data: Any) -> Any:
        names = [name for name, field in cls.model_fields.items() if not field.exclude]
        unknown = [key for key in data if key not in names] if isinstance(data, Mapping) else []
        if unknown:
            raise all_wrong({key: str(unknown_name("key", key, names)) for key in unknown})
        return data


Model = TypeVar("Model", bound=BaseModel)


# --- For models ------------------------------------------------------------------------------------


def wrong(message: str, key: str = "") -> PydanticCustomError:
    """Return an error for a validator to raise: a message, and the key of the table that it is about."""
    return all_wrong({key: message})


def all_wrong(messages: Mapping[str, str]) -> PydanticCustomError:
    """Return an error for a validator to raise: a message for each key of the table."""
    return PydanticCustomError("wrong", "{messages}", {"messages": dict(messages)})


def passes(check: Callable[[Any], object]) -> AfterValidator:
    """Return a validator that accepts values for which a function raises no `UserError`."""

    def validate(value: Any) -> Any:
        try:
            check(value)
        except UserError as error:
            raise wrong(str(error)) from None
        return value

    return AfterValidator(validate)


FREE = ("env_kwargs", "algorithm_kwargs")
"""Tables whose numbers keep their types, as they are handed to code that is not Pneuma's."""


def plain(value: Any, deepest: int = DEEPEST, whole: bool = True) -> Any:
    """Return a value in the types of models: lists as tuples, NumPy's as Python's, whole numbers as int.

    The last not if `whole` is false, and never in the tables `FREE`. ValueError for those nested too deeply.
    """
    if not deepest:
        raise ValueError(f"tables or lists lie more than {DEEPEST} deep in each other")
    if isinstance(value, Mapping):
        return {key: plain(item, deepest - 1, whole and key not in FREE) for key, item in value.items()}
    if type(value).__module__ == "numpy" and hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return tuple(plain(item, deepest - 1, whole) for item in value)
    if isinstance(value, PathLike):
        return fspath(value)
    return int(value) if whole and isinstance(value, float) and value.is_integer() else value


# --- Fields of a dataclass -------------------------------------------------------------------------


def read_field(owner: type, key: str, value: Any) -> Any:
    """Check the value of a field of a dataclass and return it in its type."""
    if key not in _hints(owner):
        raise unknown_name("key", key, _hints(owner))
    given = plain({key: value})
    try:
        return _adapter(owner, key).validate_python(given[key])
    except ValidationError as error:
        raise UserError(complaints(error, given, (key,))[0][2]) from None


@cache
def _hints(owner: type) -> dict[str, Any]:
    return get_type_hints(owner, include_extras=True)


@cache
def _adapter(owner: type, key: str) -> TypeAdapter[Any]:
    return TypeAdapter(_hints(owner)[key], config=CONFIG)


# --- Files -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TomlFile:
    """A parsed file with its text, so that errors can name a line."""

    path: Path
    text: str
    data: dict[str, Any]

    def mistake(self, where: Where, message: str, key: str = "") -> UserError:
        return self.mistakes([(where, key, message)])

    def mistakes(self, all_of_them: Iterable[Mistake]) -> UserError:
        """Return the error that tells mistakes at their lines, all in one line."""
        told = []
        for where, key, message in all_of_them:
            line = _line_of(self.text, (*where, key) if key else where)
            table = f"[{'.'.join(where)}] " if where else ""
            told.append((line or 0, f"{f'line {line}: ' if line else ''}{table}{message}"))
        first, *others = [text for _, text in sorted(told, key=lambda one: one[0])]
        between = ", " if first.startswith("line ") else ": "
        return UserError("; ".join([f"{self.path}{between}{first}", *others]))

    def table(self, where: Where) -> dict[str, Any]:
        """Return a table, empty when there is none, and refuse another value in its place."""
        value: Any = self.data
        for key in where:
            value = value.get(key, {})
            if not isinstance(value, dict):
                raise self.mistake(where[:-1], f"{key} must be a table, not {shown(value)}", key)
        return dict(value)


def read_toml(path: Path) -> TomlFile:
    text = read_text(path)
    try:
        return TomlFile(path, text, plain(tomllib.loads(text)))
    except (ValueError, RecursionError) as error:  # numbers of thousands of digits, endless brackets
        raise UserError(f"{path}: not TOML: {error}") from None


def read_model(
    model: type[Model],
    file: TomlFile,
    where: Where = (),
    usual: Mapping[str, Any] | None = None,
    fixed: Mapping[str, Any] | None = None,
) -> Model:
    """Check a table of a file, the whole file by default.

    `usual` has values of missing keys, `fixed` those that replace what the table says.
    """
    data = {**(usual or {}), **file.table(where), **(fixed or {})}
    try:
        return model.model_validate(data)
    except ValidationError as error:
        found = complaints(error, data)
        raise file.mistakes([((*where, *inside), key, message) for inside, key, message in found]) from None


# --- From pydantic's errors to words ---------------------------------------------------------------


PLAINER = {
    "a valid integer": "a whole number", "valid ": "", "a tuple": "a list",
    "Tuple should have": "must have", " after validation": "",
    "greater than or equal to": "at least", "less than or equal to": "at most",
}  # fmt: skip


def complaints(error: ValidationError, data: Mapping[str, Any], at: Where = ()) -> list[Mistake]:
    """Return the mistakes in some data, or `at` a place of it: of each of its keys the first."""
    deepest: dict[Any, Any] = {}  # a table tells more than that it is no number
    for one in error.errors(include_url=False, include_input=False):
        one["loc"] = (*at, *one["loc"])
        if len(one["loc"]) > len(deepest.setdefault(one["loc"][:1], one)["loc"]):
            deepest[one["loc"][:1]] = one
    return [mistake for one in deepest.values() for mistake in _mistakes(one, data)]


def _mistakes(error: Mapping[str, Any], data: Mapping[str, Any]) -> list[Mistake]:
    kind, loc, context = error["type"], error["loc"], error.get("ctx", {})
    if kind == "missing":
        (*where, key) = map(str, loc)
        return [(tuple(where), "", f"the key {key!r} is missing")]
    path: Where = ()
    value: Any = data
    for step in loc:  # a list is not looked into; which of several models it was is no key
        if isinstance(value, Mapping) and step in value:
            path, value = (*path, str(step)), value[step]
    if kind == "wrong" and isinstance(value, Mapping):
        return [(path, *pair) for pair in context["messages"].items()]
    (*where, key) = path
    names = context.get("names") or re.findall(r"'([^']*)'", str(context.get("expected", "")))
    allowed = error["msg"].replace("Input should be ", "must be ")
    for pydantics, ours in PLAINER.items():
        allowed = allowed.replace(pydantics, ours)
    if kind == "wrong":
        message = f"{key}: {next(iter(context['messages'].values()))}"
    elif loc[-1] == "[key]":  # a table's name, where only some are known
        message = (
            str(unknown_name("key", key, names)) if names else f"the name {key!r} is not allowed: {allowed}"
        )
    elif kind in ("dict_type", "model_type", "mappings_type"):
        message = f"{key} must be a table, not {shown(value)}"
    else:
        words = value if isinstance(value, list | tuple) else [value]
        hints = [nearest_name(word, names) for word in words if isinstance(word, str) and word not in names]
        message = f"{key} = {shown(value)} is not allowed{next(filter(None, hints), '')}: {allowed}"
    return [(tuple(where), key, message)]


def shown(value: object) -> str:
    """Return a value much as it is written in the file."""
    return json.dumps(value, default=str, ensure_ascii=False)


# --- Lines -----------------------------------------------------------------------------------------

_KEY = r"""(?:[\w-]+|"[^"\n]*"|'[^'\n]*')"""
_PATH = rf"{_KEY}(?:[ \t]*\.[ \t]*{_KEY})*"
_SETS = re.compile(rf"^[ \t]*(?:\[+[ \t]*({_PATH})[ \t]*\]+[ \t]*(?:#.*)?$|({_PATH})[ \t]*=)", re.MULTILINE)
"""A table's header, or the beginning of a key's line."""
_LONG_TEXT = re.compile(r'""".*?"""' + r"|'''.*?'''", re.DOTALL)


def _line_of(text: str, wanted: Where) -> int | None:
    """Return the line, from 1, where `wanted` is set or begins, or else the closest table around it."""
    text = _LONG_TEXT.sub(lambda found: "\n" * found[0].count("\n"), text)
    table: Where = ()
    best, best_depth = None, 0
    for found in _SETS.finditer(text):
        path = tuple(key.strip("\"'") for key in re.findall(_KEY, found[1] or found[2]))
        if found[1]:
            table = path
        else:
            path = table + path
        depth = min(len(path), len(wanted))
        if depth > best_depth and path[:depth] == wanted[:depth]:
            best, best_depth = text.count("\n", 0, found.start()) + 1, depth
    return best
