"""The one place that turns pydantic's errors into one line that names what to change in a file.

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
from operator import itemgetter
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

from pneuma.errors import MOST_LISTED, UserError, nearest_name, unknown_name
from pneuma.files import read_text

Where = tuple[str, ...]
"""The path of a table in a file: () for the top, ("conditions", "tanh") for [conditions.tanh]."""
Mistake = tuple[Where, str, str]

CONFIG = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)
DEEPEST = 50
LONGEST_FILE = 1_000_000


class Table(BaseModel):
    """A table of a file, which has no other keys than its fields that are not excluded."""

    model_config = CONFIG

    @model_validator(mode="before")
    @classmethod
    def _only_known_keys(cls, data: Any) -> Any:
        if not isinstance(data, Mapping):
            return data
        names = [name for name, field in cls.model_fields.items() if not field.exclude]
        unknown = [key for key in data if key not in names]
        if unknown:
            raise all_wrong({key: str(unknown_name("key", key, names)) for key in unknown[:MOST_LISTED]})
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


KEPT_AS_WRITTEN = ("env_kwargs", "algorithm_kwargs")
"""Tables whose numbers keep their types, as they are handed to code that is not Pneuma's."""


def plain(value: Any, levels: int = DEEPEST, floats_to_integers: bool = True) -> Any:
    """Return a value in the types of models: lists as tuples, NumPy's as Python's, whole numbers as int.

    Args:
        value: of a file or an argument.
        levels: how deep tables and lists may lie in each other.
        floats_to_integers: whether 1e6 becomes an int; never in tables that are `KEPT_AS_WRITTEN`.

    Raises:
        ValueError: for tables or lists that lie too deep in each other.
    """
    if not levels:
        raise ValueError(f"tables or lists lie more than {DEEPEST} deep in each other")
    if isinstance(value, Mapping):
        table = {}
        for key, item in value.items():
            table[key] = plain(item, levels - 1, floats_to_integers and key not in KEPT_AS_WRITTEN)
        return table
    if type(value).__module__ == "numpy" and hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return tuple(plain(item, levels - 1, floats_to_integers) for item in value)
    if isinstance(value, PathLike):
        return fspath(value)
    if floats_to_integers and isinstance(value, float) and value.is_integer():
        return int(value)
    return value


# --- Fields of a dataclass -------------------------------------------------------------------------


def read_field(owner: type, key: str, value: Any) -> Any:
    """Check the value of a field of a dataclass and return it in its type."""
    if key not in _hints(owner):
        raise unknown_name("key", key, _hints(owner))
    data = plain({key: value})
    try:
        return _adapter(owner, key).validate_python(data[key])
    except ValidationError as error:
        (_, _, message), *_ = mistakes_in(data, error, at=(key,))
        raise UserError(message) from None


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

    def mistakes(self, mistakes: Iterable[Mistake]) -> UserError:
        """Return the error that lists mistakes in the order of their lines, all in one line."""
        texts_by_line = []
        for where, key, message in mistakes:
            text = f"[{'.'.join(where)}] {message}" if where else message
            line = _line_of(self.text, where + (key,) if key else where)
            if line:
                text = f"line {line}: {text}"
            texts_by_line.append((line or 0, text))
        texts_by_line.sort(key=itemgetter(0))
        text = "; ".join(text for _, text in texts_by_line)
        separator = ", " if text.startswith("line ") else ": "
        return UserError(f"{self.path}{separator}{text}")

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
        if len(text) > LONGEST_FILE:
            raise ValueError(f"more than {LONGEST_FILE:,} characters")
        return TomlFile(path, text, plain(tomllib.loads(text)))
    except (ValueError, RecursionError) as error:  # numbers of thousands of digits, endless brackets
        raise UserError(f"{path}: not TOML: {error}") from None


def read_model(
    model: type[Model],
    file: TomlFile,
    where: Where = (),
    defaults: Mapping[str, Any] = {},
    overrides: Mapping[str, Any] = {},
) -> Model:
    """Check a table of a file.

    Args:
        model: what the table must be.
        file: the file.
        where: the table's path in it; the whole file by default.
        defaults: values of missing keys.
        overrides: values that replace the table's.
    """
    data = {**defaults, **file.table(where), **overrides}
    try:
        return model.model_validate(data)
    except ValidationError as error:
        mistakes = []
        for path, key, message in mistakes_in(data, error):
            mistakes.append((where + path, key, message))
        raise file.mistakes(mistakes) from None
    except UserError as error:  # of a validator, which knows no file
        raise file.mistake(where, str(error)) from None


# --- From pydantic's errors to words ---------------------------------------------------------------


PLAINER = {
    "a valid integer": "a whole number", "valid ": "", "a tuple": "a list",
    "Tuple should have": "must have", " after validation": "",
    "greater than or equal to": "at least", "less than or equal to": "at most",
}  # fmt: skip


def mistakes_in(data: Mapping[str, Any], error: ValidationError, at: Where = ()) -> list[Mistake]:
    """Return the mistakes in some data, or at a path in it: of each of its keys one.

    Where a key has several, as where it could be a number or a table, the one that lies deepest says most.
    """
    deepest: dict[Any, Any] = {}
    for details in error.errors(include_url=False, include_input=False):
        details["loc"] = at + details["loc"]
        key = details["loc"][:1]
        if key not in deepest or len(details["loc"]) > len(deepest[key]["loc"]):
            deepest[key] = details
    mistakes = []
    for details in list(deepest.values())[:MOST_LISTED]:
        mistakes += _mistakes(details, data)
    return mistakes


def _mistakes(error: Mapping[str, Any], data: Mapping[str, Any]) -> list[Mistake]:
    """Return an error of pydantic as mistakes, of which `wrong` may have several."""
    error_type, context = error["type"], error.get("ctx", {})
    if error_type == "missing":
        (*where, key) = map(str, error["loc"])
        return [(tuple(where), "", f"the key {key!r} is missing")]
    path, value = _find(error["loc"], data)
    if error_type == "wrong" and isinstance(value, Mapping):
        return [(path, key, message) for key, message in context["messages"].items()]
    (*where, key) = path
    names = context.get("names") or re.findall(r"'([^']*)'", str(context.get("expected", "")))
    allowed = error["msg"].replace("Input should be ", "must be ")
    for words, plainer_words in PLAINER.items():
        allowed = allowed.replace(words, plainer_words)
    if error_type == "wrong":
        message = f"{key}: {next(iter(context['messages'].values()))}"
    elif error["loc"][-1] == "[key]" and names:
        message = str(unknown_name("key", key, names))
    elif error["loc"][-1] == "[key]":
        message = f"the name {key!r} is not allowed: {allowed}"
    elif error_type in ("dict_type", "model_type", "mappings_type"):
        message = f"{key} must be a table, not {shown(value)}"
    else:
        message = f"{key} = {shown(value)} is not allowed{_hint(value, names)}: {allowed}"
    return [(tuple(where), key, message)]


def _find(location: Iterable[Any], data: Mapping[str, Any]) -> tuple[Where, Any]:
    """Return the path and the value at a location of pydantic, which also names models and list items."""
    path: Where = ()
    value: Any = data
    for key in location:
        if isinstance(value, Mapping) and key in value:
            path, value = path + (str(key),), value[key]
    return path, value


def _hint(value: object, names: Iterable[str]) -> str:
    """Return a hint at the name that was meant by a word, or by the first one of a list that has a hint."""
    words = value if isinstance(value, list | tuple) else [value]
    for word in words:
        if isinstance(word, str) and word not in names:
            hint = nearest_name(word, names)
            if hint:
                return hint
    return ""


def shown(value: object) -> str:
    """Return a value much as it is written in the file."""
    return json.dumps(value, default=str, ensure_ascii=False)


# --- Lines -----------------------------------------------------------------------------------------

_KEY = r"""(?:[\w-]+|"[^"\n]*"|'[^'\n]*')"""
_PATH = rf"{_KEY}(?:[ \t]*\.[ \t]*{_KEY})*"
_SETS = re.compile(rf"^[ \t]*(?:\[+[ \t]*({_PATH})[ \t]*\]+[ \t]*(?:#.*)?$|({_PATH})[ \t]*=)", re.MULTILINE)
"""A table's header, or the beginning of a key's line."""
_LONG_TEXT = re.compile(r'""".*?"""' + r"|'''.*?'''", re.DOTALL)


def _line_of(text: str, target: Where) -> int | None:
    """Return the line, from 1, where a path is set or begins, or else the closest table around it."""
    text = _LONG_TEXT.sub(lambda match: "\n" * match[0].count("\n"), text)
    table: Where = ()
    closest_line, closest_depth = None, 0
    for match in _SETS.finditer(text):
        header, key_path = match[1], match[2]
        path = tuple(key.strip("\"'") for key in re.findall(_KEY, header or key_path))
        if header:
            table = path
        else:
            path = table + path
        depth = min(len(path), len(target))
        if depth > closest_depth and path[:depth] == target[:depth]:
            closest_line, closest_depth = text.count("\n", 0, match.start()) + 1, depth
    return closest_line
