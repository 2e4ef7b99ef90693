"""The one place between pydantic and people: a file's mistake in one line that says what to mend.

    TOML file → read_toml → read_model(SomeTable, file) → the model, checked
    pydantic's error → UserError "mine.toml, line 7: [run] gamma = 2 is not allowed: at most 1"

A model of a table derives from `Table`. What its types cannot say its validators raise as `wrong(…)`.
Lists are tuples in models; whole numbers may be written as 1e6.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from functools import cache
from os import PathLike, fspath
from pathlib import Path
from typing import Annotated, Any, TypeVar, get_type_hints

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    GetCoreSchemaHandler,
    TypeAdapter,
    ValidationError,
    model_validator,
    with_config,
)
from pydantic_core import CoreSchema, ErrorDetails, PydanticCustomError, core_schema
from typing_extensions import TypedDict

from pneuma.errors import UserError, nearest_name, unknown_name
from pneuma.reading import read_text

Where = tuple[str, ...]
"""The path of a table in a file: () for the top, ("conditions", "tanh") for [conditions.tanh]."""

CONFIG = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class Table(BaseModel):
    """A table of a file: no keys but its fields, and every value of its type."""

    model_config = CONFIG

    @model_validator(mode="before")
    @classmethod
    def _only_known_keys(cls, data: Any) -> Any:
        if cls.model_config.get("extra") == "forbid":
            refuse_unknown(data, cls.model_fields)
        return data


Model = TypeVar("Model", bound=BaseModel)


# --- For models ------------------------------------------------------------------------------------


def wrong(message: str, key: str = "") -> PydanticCustomError:
    """Return what a validator raises: a message in its own words, and the key of the table it is about."""
    return PydanticCustomError("wrong", "{message}", {"message": message, "key": key})


def refuse_unknown(data: Any, known: Iterable[str], what: str = "key") -> None:
    """Refuse the first key of a table that is none of those known."""
    for key in data if isinstance(data, Mapping) else ():
        if key not in (names := tuple(known)):
            raise wrong(str(unknown_name(what, key, names)), key)


def passes(check: Callable[[Any], object]) -> AfterValidator:
    """Return a validator that keeps a value which a function takes without a `UserError`."""

    def validate(value: Any) -> Any:
        try:
            check(value)
        except UserError as error:
            raise wrong(str(error)) from None
        return value

    return AfterValidator(validate)


def plain(value: Any) -> Any:
    """Return a value as models take it: lists as tuples, whole numbers as int, NumPy's as Python's."""
    if isinstance(value, Mapping):
        return {key: plain(own) for key, own in value.items()}
    if isinstance(value, list | tuple):
        return tuple(map(plain, value))
    if isinstance(value, PathLike):
        return fspath(value)
    if type(value).__module__ == "numpy" and getattr(value, "ndim", None) == 0:
        value = value.item()
    return int(value) if isinstance(value, float) and value.is_integer() else value


# --- Fields of a dataclass -------------------------------------------------------------------------


@dataclass(frozen=True)
class FieldsOf:
    """Says of a dictionary that it holds some fields of a dataclass, each of its type; for `Annotated`.

    Attributes:
        owner: the dataclass.
        elsewhere: fields that are not set here, and what sets them.
    """

    owner: type
    elsewhere: Mapping[str, str] = field(default_factory=dict)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the fields that may be set."""
        return tuple(own.name for own in fields(self.owner) if own.name not in self.elsewhere)

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        hints = get_type_hints(self.owner, include_extras=True)
        table = TypedDict(self.owner.__name__, {key: hints[key] for key in self.names}, total=False)  # type: ignore[misc]
        schema = handler.generate_schema(with_config(CONFIG)(table))
        return core_schema.no_info_before_validator_function(self._refuse_others, schema)

    def _refuse_others(self, data: Any) -> Any:
        for key in data if isinstance(data, Mapping) else ():
            if key in self.elsewhere:
                raise wrong(f"{key} is set by {self.elsewhere[key]}, not here", key)
        refuse_unknown(data, self.names)
        return data


def read_dataclass_fields(owner: type, values: Mapping[str, Any]) -> dict[str, Any]:
    """Check some fields of a dataclass and return each in its type.

    Raises:
        UserError: naming the field, its value and what is allowed.
    """
    try:
        return _fields_adapter(owner).validate_python(plain(values))
    except ValidationError as error:
        raise UserError(complaint(error, values)[2]) from None


@cache
def _fields_adapter(owner: type) -> TypeAdapter[dict[str, Any]]:
    return TypeAdapter(Annotated[dict[str, Any], FieldsOf(owner)])


# --- Files -----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class TomlFile:
    """A parsed file with its text, so that errors can name a line."""

    path: Path
    text: str
    data: dict[str, Any]

    def mistake(self, where: Where, message: str, key: str = "") -> UserError:
        """Build an error that names file, line, table and what is wrong with it or one of its keys."""
        line = _line_of(self.text, (*where, key) if key else where)
        place = f"{self.path}, line {line}" if line else str(self.path)
        table = f"[{'.'.join(where)}] " if where else ""
        return UserError(f"{place}: {table}{message}")

    def table(self, where: Where) -> dict[str, Any]:
        """Return a table, empty when there is none, and refuse another value in its place."""
        value: Any = self.data
        for key in where:
            value = value.get(key, {})
            if not isinstance(value, dict):
                raise self.mistake(where[:-1], f"{key} must be a table, not {shown(value)}", key)
        return dict(value)

    def refuse_unknown(self, where: Where, given: Mapping[str, Any], allowed: tuple[str, ...]) -> None:
        """Raise for the first key of a table that is none of `allowed`."""
        for key in given:
            if key not in allowed:
                raise self.mistake(where, str(unknown_name("key", key, allowed)), key)


DEEPEST = 50
"""How deep tables and lists of a file may lie in each other."""


def _depth(data: Mapping[str, Any]) -> int:
    """Return how deep tables and lists lie in each other; without recursion, which has an end."""
    level: list[Any] = [data]
    depth = 0
    while level:
        inner = [own.values() if isinstance(own, Mapping) else own for own in level]
        level = [each for own in inner for each in own if isinstance(each, Mapping | list)]
        depth += 1
    return depth


def read_toml(path: Path) -> TomlFile:
    """Read a TOML file.

    Raises:
        UserError: when it cannot be read or is not TOML, naming the line.
    """
    text = read_text(path)
    try:
        data = tomllib.loads(text)
        if _depth(data) > DEEPEST:
            raise ValueError(f"tables or lists lie more than {DEEPEST} deep in each other")
        return TomlFile(path, text, data)
    except (ValueError, RecursionError) as error:  # numbers of thousands of digits, brackets without end
        raise UserError(f"{path}: not TOML: {error}") from None


def read_model(
    model: type[Model],
    file: TomlFile,
    where: Where = (),
    usual: Mapping[str, Any] | None = None,
    fixed: Mapping[str, Any] | None = None,
) -> Model:
    """Check a table of a file, the whole file by default.

    Args:
        model: what it must be.
        file: the file.
        where: the table.
        usual: what the table has where it says nothing.
        fixed: what it has, whatever it says.

    Raises:
        UserError: naming file, line, key, value and what is allowed.
    """
    data = {**(usual or {}), **file.table(where), **(fixed or {})}
    try:
        return model.model_validate(plain(data))
    except ValidationError as error:
        inside, key, message = complaint(error, data)
        raise file.mistake((*where, *inside), message, key) from None


# --- From pydantic's errors to words ---------------------------------------------------------------

_ALLOWED = {
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "float_type": "a number",
    "finite_number": "a number",
    "bool_type": "true or false",
    "string_type": "a text",
    "string_too_short": "a text that is not empty",
    "tuple_type": "a list",
    "too_short": "{what} of at least {min_length}",
    "too_long": "{what} of at most {max_length}",
    "greater_than": "above {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "below {lt}",
    "less_than_equal": "at most {le}",
    "allowed": "{allowed}",
}
"""What is allowed, by the type of pydantic's error and what it has in its context."""


def complaint(error: ValidationError, data: Mapping[str, Any]) -> tuple[Where, str, str]:
    """Return the first mistake in some data: the table it is in, its key there, and what is wrong."""
    first = error.errors(include_url=False, include_input=False)[0]
    context = first.get("ctx", {})
    if first["type"] == "missing":
        (*where, key) = map(str, first["loc"])
        return tuple(where), "", f"the key {key!r} is missing"
    if first["loc"][-1:] == ("[key]",):  # a table's name, where only some are known
        (*where, key) = map(str, first["loc"][:-1])
        named = first["type"] != "literal_error" and f"the name {key!r} is not allowed{_allowed(first, key)}"
        return tuple(where), key, named or str(unknown_name("key", key, _names(first)))
    path, value = _followed(first, data)
    if isinstance(value, Mapping) and first["type"] == "wrong":
        return path, context["key"], context["message"]
    (*where, key) = path
    if first["type"] == "wrong":
        return tuple(where), key, f"{key}: {context['message']}"
    if first["type"] in ("dict_type", "model_type", "mappings_type"):
        return tuple(where), key, f"{key} must be a table, not {shown(value)}"
    return tuple(where), key, f"{key} = {shown(value)} is not allowed{_allowed(first, value)}"


def _followed(error: ErrorDetails, data: Any) -> tuple[Where, Any]:
    """Return the path of keys to what an error is about, and the value there; a list is not looked into."""
    path: Where = ()
    for key in error["loc"]:
        if not isinstance(data, Mapping) or key not in data:
            break
        path, data = (*path, str(key)), data[key]
    return path, data


def _allowed(error: ErrorDetails, value: Any) -> str:
    """Return ': ' and what is allowed in place of a value, after the nearest name if there is one."""
    names = _names(error)
    words = value if isinstance(value, list | tuple) else [value]
    hints = [nearest_name(word, names) for word in words if isinstance(word, str) and word not in names]
    if error["type"] == "literal_error":
        allowed = "one of " + ", ".join(name for name in names if name)
    else:
        context = {key: _bound(own) for key, own in error.get("ctx", {}).items()}
        what = "a table" if isinstance(value, Mapping) else "a list"
        allowed = _ALLOWED.get(error["type"], error["msg"]).format(**context, what=what)
    return f"{next(filter(None, hints), '')}: {allowed}"


def _names(error: ErrorDetails) -> list[str]:
    context = error.get("ctx", {})
    return [*context.get("names", re.findall(r"'([^']*)'", str(context.get("expected", ""))))]


def _bound(value: Any) -> Any:
    return f"{value:g}" if isinstance(value, float) else value


def shown(value: object) -> str:
    """Return a value about as it stands in the file."""
    return json.dumps(value, default=str, ensure_ascii=False)


# --- Lines -----------------------------------------------------------------------------------------


def _line_of(text: str, wanted: Where) -> int | None:
    """Return the line, from 1, where `wanted` is set or begins, or else the closest table around it."""
    best, best_depth = None, 0
    for number, path in _paths(text):
        shared = min(len(path), len(wanted))
        depth = shared if path[:shared] == wanted[:shared] else 0
        if depth > best_depth:
            best, best_depth = number, depth
    return best


def _paths(text: str) -> Iterator[tuple[int, Where]]:
    """Yield the line and full path of every header and key; texts over several lines are passed over."""
    table: Where = ()
    inside = ""  # the quotes of a text that goes on
    for number, line in enumerate(text.splitlines(), start=1):
        opened = inside
        for quotes in ('"""', "'''"):
            if line.count(quotes) % 2 and inside in ("", quotes):
                inside = "" if inside else quotes
        if opened:
            continue
        if line.lstrip().startswith("["):
            table = _nesting(line) or table
            yield number, table
        elif "=" in line and (own := _nesting(f"{line.partition('=')[0]} = 0")):
            yield number, table + own


def _nesting(line: str) -> Where:
    """Return the path of the one key or table that a line of TOML sets."""
    try:
        value: Any = tomllib.loads(line)
    except tomllib.TOMLDecodeError:
        return ()
    path: Where = ()
    while isinstance(value, dict) and value:
        key, value = next(iter(value.items()))
        path += (key,)
    return path
