"""The tables [run] and [space.….] of a search's file: what all its trials share, and what varies.

A range, a choice between values or between bundles of fields, and what hangs on another parameter or field.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import fields
from typing import Any

from pneuma.config import FORK_SETTINGS, Run, read_setting
from pneuma.errors import UserError, unknown_name
from pneuma.search.space import Choices, Parameter, Params, Range, Space
from pneuma.study.conditions import does_nothing, unread_settings
from pneuma.study.toml_file import TomlFile, Where, shown
from pneuma.values import Choice, Flag, Number

SETTABLE = tuple(f.name for f in fields(Run) if f.name not in ("seed", "steps", "engine", *FORK_SETTINGS))
"""Fields of a run that a search may vary."""

FIXABLE = (*SETTABLE, "engine")
"""Those that it may fix for all its trials."""


def read_space(file: TomlFile, base: str) -> Space:
    """Check both tables and return the space, every corner of which makes a run.

    Raises:
        UserError: naming file, line, key, value and what is allowed.
    """
    fixed = _read_settings(file, ("run",))
    parameters: list[Parameter] = []
    for name in file.table(("space",)):
        parameters.append(_read_parameter(file, name, parameters))
    if not parameters:
        raise file.mistake((), "a search needs at least one parameter", "space")
    for parameter in parameters:
        for key in parameter.keys:
            if key in fixed:
                raise file.mistake(("run",), f"{key} is searched by [space.{parameter.name}]", key)
    space = Space(tuple(parameters), fixed, base)
    try:
        corners = list(space.corners())
    except UserError as error:
        name = str(error).split(" = ", 1)[0]
        raise file.mistake(("space", name) if name in file.table(("space",)) else (), str(error)) from None
    _refuse_twice(file, space, (own for own, _ in corners if len(own) > 1))
    for parameter in parameters:
        runs = [run for own, run in corners if parameter.name in own]
        for key in unread_settings(runs, parameter.keys) if runs else ():
            raise file.mistake(("space", parameter.name), does_nothing(key, runs))
    runs = [run for _, run in corners]
    for key in unread_settings(runs, fixed):
        raise file.mistake(("run",), does_nothing(key, runs), key)
    return space


def _refuse_twice(file: TomlFile, space: Space, pairs: Iterable[Params]) -> None:
    """Refuse two parameters that set one field beside each other."""
    for own in pairs:
        one, other = ({*space.parameter(name).domain.settings(name, value)} for name, value in own.items())
        for key in sorted(one & other):
            first, second = own
            raise file.mistake(("space", second), f"{key} is searched by [space.{first}], too")


def _read_parameter(file: TomlFile, name: str, before: Sequence[Parameter]) -> Parameter:
    where = ("space", name)
    table = file.table(where)
    file.refuse_unknown(where, table, ("low", "high", "log", "choices", "when"))
    when = _read_when(file, where, before)
    if "choices" in table:
        for key in ("low", "high", "log"):
            if key in table:
                raise file.mistake(where, f"{key} does not go with choices", key)
        return Parameter(name, _read_choices(file, where, name), when)
    return Parameter(name, _read_range(file, where, name), when)


def _read_range(file: TomlFile, where: Where, name: str) -> Range:
    table = file.table(where)
    _refuse_unknown_field(file, where, name)
    for key in ("low", "high"):
        if key not in table:
            raise file.mistake(where, f"the key {key!r} is missing (or give choices)")
    low, high = (read_value(file, where, key, name, table[key]) for key in ("low", "high"))
    log = read_by(file, where, "log", table.get("log", False), Flag())
    if isinstance(low, bool) or not isinstance(low, int | float) or not isinstance(high, int | float):
        raise file.mistake(where, f"{name} is no number: give choices")
    if not low < high:
        message = f"low = {shown(low)} is not below high = {shown(high)}: an empty range"
        raise file.mistake(where, message, "low")
    if log and low <= 0:
        raise file.mistake(where, f"low = {shown(low)} is not allowed with log: above 0", "low")
    return Range(low, high, log, whole=isinstance(low, int))


def _read_choices(file: TomlFile, where: Where, name: str) -> Choices:
    given = file.table(where)["choices"]
    if isinstance(given, dict):
        tables = {choice: _read_settings(file, (*where, "choices", choice)) for choice in given}
        if len(tables) < 2 or not all(tables.values()):
            raise file.mistake(where, "choices must be two tables or more, each with settings", "choices")
        return Choices(tables)
    _refuse_unknown_field(file, where, name)
    if not isinstance(given, list) or len(given) < 2:
        message = f"choices = {shown(given)} is not allowed: a list of two values or more, or tables"
        raise file.mistake(where, message, "choices")
    values = [read_value(file, where, "choices", name, value) for value in given]
    if len({shown(value) for value in values}) < len(values):
        raise file.mistake(where, "choices repeat a value", "choices")
    return Choices({_name(value): {name: value} for value in values})


def _name(value: Any) -> str:
    return "none" if value is None else value if isinstance(value, str) else json.dumps(value, default=str)


def _read_when(file: TomlFile, where: Where, before: Sequence[Parameter]) -> dict[str, tuple[Any, ...]]:
    place, domains = (*where, "when"), {parameter.name: parameter.domain for parameter in before}
    read = {}
    for name, given in file.table(place).items():
        if name not in domains and name in file.table(("space",)):
            raise file.mistake(place, f"{name} is searched, too: [space.{name}] must stand before it", name)
        if name not in domains and name not in SETTABLE:
            problem = unknown_name("parameter before it, or field of the run,", name, [*domains, *SETTABLE])
            raise file.mistake(place, str(problem), name)
        values = given if isinstance(given, list) else [given]
        read[name] = tuple(_read_condition(file, place, name, domains.get(name), value) for value in values)
        if not values:
            raise file.mistake(place, f"{name} = [] is not allowed: one value or more", name)
    return read


def _read_condition(
    file: TomlFile, where: Where, name: str, domain: Range | Choices | None, value: Any
) -> Any:
    """Read a value at which another parameter counts: the name of a choice, or what a field may be."""
    if not isinstance(domain, Choices):
        return read_value(file, where, name, name, value)
    choices = list(domain.settings_of)
    if _name(value) not in choices:
        message = f"{name} = {shown(value)} is no choice of [space.{name}]: {', '.join(choices)}"
        raise file.mistake(where, message, name)
    return _name(value)


def _refuse_unknown_field(file: TomlFile, where: Where, name: str) -> None:
    if name not in SETTABLE:
        told = f"{unknown_name('parameter', name, SETTABLE)}; or give it choices of settings"
        raise file.mistake(where, told)


def _read_settings(file: TomlFile, where: Where) -> dict[str, Any]:
    settings = file.table(where)
    file.refuse_unknown(where, settings, FIXABLE if where == ("run",) else SETTABLE)
    return {key: read_value(file, where, key, key, value) for key, value in settings.items()}


# --- Values ----------------------------------------------------------------------------------------


def read_by(file: TomlFile, where: Where, key: str, value: Any, reader: Number | Choice | Flag) -> Any:
    """Return what a reader makes of the value of a key, or refuse it with its line."""
    try:
        return reader.read(value)
    except (ValueError, TypeError):
        message = f"{key} = {shown(value)} is not allowed: {reader.allowed}"
        raise file.mistake(where, message, key) from None


def read_value(file: TomlFile, where: Where, key: str, name: str, value: Any) -> Any:
    """Return a value as the field `name` of a run has it, or refuse it with the line of `key`."""
    try:
        return read_setting(Run, name, value)
    except UserError as error:
        raise file.mistake(where, str(error), key) from None
