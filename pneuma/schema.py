"""The one place that turns pydantic's errors into one line that names what to change in a file.

    TOML file → read_toml → read_model(SomeTable, file) → the model, checked
    pydantic's error → UserError "mine.toml, line 7: [run] gamma = 2 is not allowed: less than or equal to 1"

A model of a table derives from `Table`. Its validators raise `wrong(…)` for what types cannot express. Lists
become tuples, and whole numbers may be written as 1e6.
"""

from __future__ import annotations

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
from pneuma.values import format_json

Where = tuple[str, ...]
"""The path of a table in a file: () for the top, ("conditions", "tanh") for [conditions.tanh]."""
Mistake = tuple[Where, str, str]

CONFIG = ConfigDict(strict=True, frozen=True, allow_inf_nan=False)
DEEPEST = 50
LONGEST_FILE = 1_000_000
LARGEST_BITS = 1024
"""Of a whole number, as of the largest float."""
MOST_JOINED_KEYS = 100
_JOINED_KEYS = re.compile(rf"""(?<![\w"'.-])(?:[\w"'-]++[ \t]*+\.[ \t]*+){{{MOST_JOINED_KEYS}}}""")
"""A dotted key for which `tomllib` takes a time that grows with the square of its length."""
_CLOSED = re.compile(
    r"""[^"'#]+|\#[^\n]*|\"{3}(?:\\.|[^\\])*?"{3,5}|'{3}.*?'{3,5}"""
    r"""|"(?!"")(?:\\.|[^"\\\n])*"|'(?!'')[^'\n]*'""",
    re.DOTALL,
)
"""A comment of TOML, a text with its closing quotes, or what is between them."""


class Table(BaseModel):
    """A table of a file, which has no other keys than its fields that are not excluded."""

    model_config = CONFIG

    @model_validator(mode="before")
    @classmethod
    def _only_known_keys(cls, table: Any) -> Any:
        if not isinstance(table, Mapping):
            return table
        field_names = [name for name, field in cls.model_fields.items() if not field.exclude]
        unknown = [key for key in table if key not in field_names]
        if unknown:
            raise all_wrong(
                {key: str(unknown_name("key", key, field_names)) for key in unknown[:MOST_LISTED]}
            )
        return table


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

    def validate(field_value: Any) -> Any:
        try:
            check(field_value)
        except UserError as error:
            raise wrong(str(error)) from None
        return field_value

    return AfterValidator(validate)


KEPT_AS_WRITTEN = ("env_kwargs", "algorithm_kwargs")
"""Tables whose numbers keep their types, because they are arguments of code that is not Pneuma's."""


def normalize(value: Any, levels: int = DEEPEST, floats_to_integers: bool = True) -> Any:
    """Return a value in the types of models: lists as tuples, NumPy's as Python's, whole numbers as int.

    Args:
        value: of a file or an argument.
        levels: how deep tables and lists may be nested.
        floats_to_integers: whether 1e6 becomes an int; never in tables that are `KEPT_AS_WRITTEN`.
    """
    if not levels:
        raise UserError(f"tables or lists are nested more than {DEEPEST} deep")
    if isinstance(value, Mapping):
        table = {}
        for key, item in value.items():
            table[key] = normalize(item, levels - 1, floats_to_integers and key not in KEPT_AS_WRITTEN)
        return table
    if type(value).__module__ == "numpy" and hasattr(value, "tolist"):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return tuple(normalize(item, levels - 1, floats_to_integers) for item in value)
    if isinstance(value, PathLike):
        return fspath(value)
    if floats_to_integers and isinstance(value, float) and value.is_integer():
        return int(value)
    if isinstance(value, int) and value.bit_length() > LARGEST_BITS:  # messages could not print it
        raise UserError("a whole number is beyond 1e308")
    return value


# --- Fields of a dataclass -------------------------------------------------------------------------


def read_field(dataclass_type: type, field_name: str, field_value: Any) -> Any:
    """Check the value of a field of a dataclass and return it in its type."""
    if field_name not in _hints(dataclass_type):
        raise unknown_name("key", field_name, _hints(dataclass_type))
    table = normalize({field_name: field_value})
    try:
        return _adapter(dataclass_type, field_name).validate_python(table[field_name])
    except ValidationError as error:
        (_, _, message), *_ = mistakes_in(table, error, table_path=(field_name,))
        raise UserError(message) from None


@cache
def _hints(dataclass_type: type) -> dict[str, Any]:
    return get_type_hints(dataclass_type, include_extras=True)


@cache
def _adapter(dataclass_type: type, field_name: str) -> TypeAdapter[Any]:
    return TypeAdapter(_hints(dataclass_type)[field_name], config=CONFIG)


# --- Files -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TomlFile:
    """A parsed file with its text, so that errors can name a line."""

    path: Path
    text: str
    data: dict[str, Any]

    def mistake(self, table_path: Where, message: str, key: str = "") -> UserError:
        return self.mistakes([(table_path, key, message)])

    def mistakes(self, mistakes: Iterable[Mistake]) -> UserError:
        """Return the error that lists mistakes in the order of their lines, all in one line."""
        texts_by_line = []
        for table_path, key, message in mistakes:
            mistake_text = f"[{'.'.join(table_path)}] {message}" if table_path else message
            line_number = _line_of(self.text, table_path + (key,) if key else table_path)
            if line_number:
                mistake_text = f"line {line_number}: {mistake_text}"
            texts_by_line.append((line_number or 0, mistake_text))
        texts_by_line.sort(key=itemgetter(0))
        all_texts = "; ".join(mistake_text for _, mistake_text in texts_by_line)
        separator = ", " if all_texts.startswith("line ") else ": "
        return UserError(f"{self.path}{separator}{all_texts}")


def read_toml(path: Path) -> TomlFile:
    toml_text = read_text(path, most_bytes=4 * LONGEST_FILE)  # in UTF-8 a character has at most four
    try:
        if len(toml_text) > LONGEST_FILE:
            raise UserError(f"more than {LONGEST_FILE:,} characters")
        if _JOINED_KEYS.search(toml_text):
            raise UserError(f"{MOST_JOINED_KEYS} names or more are joined by dots")
        return TomlFile(path, toml_text, normalize(tomllib.loads(toml_text)))
    except (UserError, ValueError, RecursionError) as error:  # such as endless brackets
        raise UserError(f"{path}: not TOML: {error}{_open_quote(toml_text, str(error))}") from None


def _open_quote(toml_text: str, problem: str) -> str:
    """Return which line opens a text that is never closed; empty for another mistake of TOML."""
    if not re.search(r"Unterminated string|Expected \"'|character '\\n'|in a string \(at end", problem):
        return ""
    position = 0
    while match := _CLOSED.match(toml_text, position):
        position = match.end()
    line_number = toml_text.count("\n", 0, position) + 1
    return f"; the text that line {line_number} opens is not closed"


def read_model(
    model: type[Model],
    toml_file: TomlFile,
    table_path: Where = (),
    table: Mapping[str, Any] | None = None,
) -> Model:
    """Check a file, or a table of it.

    Args:
        model: what the table must be.
        toml_file: the file.
        table_path: the table's path in it.
        table: the table with what its file leaves out; the whole file by default.
    """
    if table is None:
        table = toml_file.data
    try:
        return model.model_validate(table)
    except ValidationError as error:
        mistakes = []
        for mistake_path, key, message in mistakes_in(table, error):
            mistakes.append((table_path + mistake_path, key, message))
        raise toml_file.mistakes(mistakes) from None
    except UserError as error:  # of a validator, which knows no file
        raise toml_file.mistake(table_path, str(error)) from None


# --- From pydantic's errors to words ---------------------------------------------------------------


PLAINER = {
    "'', ": "",  # the default, which nobody writes
    "a valid integer": "a whole number", "valid ": "", "a tuple": "a list",
    "Tuple should have": "must have", " after validation": "",
    "greater than or equal to": "at least", "less than or equal to": "at most",
}  # fmt: skip


def mistakes_in(table: Mapping[str, Any], error: ValidationError, table_path: Where = ()) -> list[Mistake]:
    """Return the mistakes in a table, or at a path in it: one for each key.

    Where a key has several errors, because it may be a number or a table, the deepest one is the most exact.
    """
    deepest: dict[Any, Any] = {}
    for details in error.errors(include_url=False, include_input=False):
        details["loc"] = table_path + details["loc"]
        key = details["loc"][:1]
        if key not in deepest or len(details["loc"]) > len(deepest[key]["loc"]):
            deepest[key] = details
    mistakes = []
    for details in list(deepest.values())[:MOST_LISTED]:
        mistakes += _mistakes(details, table)
    return mistakes


def _mistakes(details: Mapping[str, Any], table: Mapping[str, Any]) -> list[Mistake]:
    """Return an error of pydantic as mistakes. An error made by `all_wrong` has several."""
    error_type, context = details["type"], details.get("ctx", {})
    if error_type == "missing":
        (*table_path, key) = map(str, details["loc"])
        return [(tuple(table_path), "", f"the key {key!r} is missing")]
    key_path, wrong_value = _find(details["loc"], table)
    if error_type == "wrong" and isinstance(wrong_value, Mapping):
        return [(key_path, key, message) for key, message in context["messages"].items()]
    (*table_path, key) = key_path
    allowed_names = context.get("names") or re.findall(r"'([^']*)'", str(context.get("expected", "")))
    allowed = details["msg"].replace("Input should be ", "must be ")
    for pydantic_words, plainer_words in PLAINER.items():
        allowed = allowed.replace(pydantic_words, plainer_words)
    if error_type == "wrong":
        message = f"{key}: {next(iter(context['messages'].values()))}"
    elif details["loc"][-1] == "[key]" and allowed_names:
        message = str(unknown_name("key", key, allowed_names))
    elif details["loc"][-1] == "[key]":
        message = f"the name {key!r} is not allowed: {allowed}"
    elif error_type in ("dict_type", "model_type", "mappings_type"):
        message = f"{key} must be a table, not {format_json(wrong_value)}"
    else:
        message = (
            f"{key} = {format_json(wrong_value)} is not allowed{_hint(wrong_value, allowed_names)}: {allowed}"
        )
    return [(tuple(table_path), key, message)]


def _find(location: Iterable[Any], table: Mapping[str, Any]) -> tuple[Where, Any]:
    """Return the path and the value at a location of pydantic, which also names models and list items."""
    key_path: Where = ()
    value: Any = table
    for key in location:
        if isinstance(value, Mapping) and key in value:
            key_path, value = key_path + (str(key),), value[key]
    return key_path, value


def _hint(wrong_value: object, allowed_names: Iterable[str]) -> str:
    """Return a hint at the name that a word, or a word of a list, resembles."""
    words = wrong_value if isinstance(wrong_value, list | tuple) else [wrong_value]
    for word in words:
        if isinstance(word, str) and word not in allowed_names:
            hint = nearest_name(word, allowed_names)
            if hint:
                return hint
    return ""


# --- Lines -----------------------------------------------------------------------------------------

_KEY = r"""(?:[\w-]+|"[^"\n]*"|'[^'\n]*')"""
_PATH = rf"{_KEY}(?:[ \t]*\.[ \t]*{_KEY})*"
_SETS = re.compile(rf"^[ \t]*(?:\[+[ \t]*({_PATH})[ \t]*\]+[ \t]*(?:#.*)?$|({_PATH})[ \t]*=)", re.MULTILINE)
"""A table's header, or the beginning of a key's line."""
_LONG_TEXT = re.compile(r'""".*?"""' + r"|'''.*?'''", re.DOTALL)


def _line_of(toml_text: str, target_path: Where) -> int | None:
    """Return the line, from 1, where a path is set or begins, or else the closest table around it."""
    toml_text = _LONG_TEXT.sub(lambda match: "\n" * match[0].count("\n"), toml_text)
    table_path: Where = ()
    closest_line, closest_depth = None, 0
    for match in _SETS.finditer(toml_text):
        header, key_path = match[1], match[2]
        full_path = tuple(key.strip("\"'") for key in re.findall(_KEY, header or key_path))
        if header:
            table_path = full_path
        else:
            full_path = table_path + full_path
        depth = min(len(full_path), len(target_path))
        if depth > closest_depth and full_path[:depth] == target_path[:depth]:
            closest_line, closest_depth = toml_text.count("\n", 0, match.start()) + 1, depth
    return closest_line
