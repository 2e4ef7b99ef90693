"""The search space: what each parameter may be, and how it becomes fields of a run.

A parameter is a field of the run, or a named choice between bundles of fields, such as two sizes of
network. It may hang on another: a momentum counts only where the optimizer has one.
"""

from __future__ import annotations

import json
import random
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from pneuma.config import ENVIRONMENTS, FORK_FIELDS, Run, as_fields, make_run, read_field, read_fields
from pneuma.env_fields import ENVIRONMENT_FIELDS
from pneuma.errors import UserError, unknown_name
from pneuma.schema import FieldsOf, Table, TomlFile, Where, shown
from pneuma.study.spec import does_nothing, join_fields, unread_fields
from pneuma.values import as_tuple

FIXABLE = FieldsOf(Run, {"seed": "a preset", "steps": "a preset"} | dict.fromkeys(FORK_FIELDS, "`run fork`"))
"""Fields of a run that a search may fix for all its trials."""
SEARCHABLE = tuple(name for name in FIXABLE.names if name != "engine")
"""Those that it may vary."""
CORNERS = 256
"""Trials that a space is tried with before any is trained."""


@dataclass(frozen=True)
class Range:
    """Numbers from `low` to `high`, both among them; `log` where ratios count."""

    low: float
    high: float
    log: bool = False
    whole: bool = False

    @property
    def extremes(self) -> list[Any]:
        """Return both ends."""
        return [self.low, self.high]

    def fields(self, name: str, value: Any) -> dict[str, Any]:
        """Return what a value sets."""
        return {name: value}

    def value_in(self, name: str, given: Mapping[str, Any]) -> Any:
        """Return the value that the fields hold; None where that is outside."""
        value = given.get(name)
        return value if value is not None and self.low <= value <= self.high else None


@dataclass(frozen=True)
class Choices:
    """Some values, or bundles of fields, to choose from, each with a name."""

    settings_of: Mapping[str, Mapping[str, Any]]

    @property
    def extremes(self) -> list[Any]:
        """Return every name."""
        return list(self.settings_of)

    def fields(self, name: str, value: Any) -> dict[str, Any]:
        """Return what a choice sets."""
        return dict(self.settings_of[value])

    def value_in(self, name: str, given: Mapping[str, Any]) -> Any:
        """Return the choice whose fields are among those given; None where there is none."""
        return next((choice for choice, own in self.settings_of.items() if _agree(own, given)), None)


@dataclass(frozen=True)
class Parameter:
    """One dimension of a search space.

    Attributes:
        name: a field of the run, or what a choice between bundles of fields is called.
        domain: what it may be.
        when: names of parameters before it, or of fields, with the values at which it counts.
    """

    name: str
    domain: Range | Choices
    when: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)

    def __str__(self) -> str:
        """Say what it may be, and where it counts."""
        if isinstance(self.domain, Range):
            ends = f"{self.domain.low:g} to {self.domain.high:g}"
            told = f"{ends}, logarithmic" if self.domain.log else ends
        else:
            told = "one of " + ", ".join(self.domain.settings_of)
        when = " and ".join(f"{name} is {' or '.join(map(str, own))}" for name, own in self.when.items())
        return f"{told}, where {when}" if when else told

    @property
    def keys(self) -> tuple[str, ...]:
        """Return the fields of the run that it sets."""
        if isinstance(self.domain, Range):
            return (self.name,)
        return tuple(dict.fromkeys(key for own in self.domain.settings_of.values() for key in own))

    def counts(self, known: Mapping[str, Any]) -> bool:
        """Tell whether it counts beside what is known of the others."""
        return all(as_tuple(known.get(name)) in values for name, values in self.when.items())


@dataclass(frozen=True)
class Space:
    """The parameters of a search, in the order in which they are asked for.

    Attributes:
        parameters: each after those that it hangs on.
        fixed: what every trial sets besides, over the base.
        base: name of the fields to start from.
    """

    parameters: tuple[Parameter, ...]
    fixed: Mapping[str, Any]
    base: str

    @property
    def keys(self) -> frozenset[str]:
        """Return the fields of the run that parameters set."""
        return frozenset(key for parameter in self.parameters for key in parameter.keys)

    def ask(self, suggest: Callable[[Parameter], Any]) -> dict[str, Any]:
        """Have a value suggested for every parameter that counts; return them by name."""
        usual = self._usual_fields(self.base)
        params: dict[str, Any] = {}
        for parameter in self.parameters:
            if parameter.counts({**usual, **self.fields(params), **params}):
                params[parameter.name] = suggest(parameter)
        return params

    def fields(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Return what a trial sets on top of the base, in fields of the run."""
        given = dict(self.fixed)
        for parameter in self.parameters:
            if parameter.name in params:
                given.update(parameter.domain.fields(parameter.name, params[parameter.name]))
        return given

    def make_run(self, params: Mapping[str, Any], **over: Any) -> Run:
        """Return the run of a trial, with some fields set over it."""
        return make_run({**join_fields(self.base, self.fields(params)), **over})

    def params_of(self, base: str) -> dict[str, Any]:
        """Return the parameters that give the fields of another base, as far as the space holds them."""
        given = self._usual_fields(base)
        params: dict[str, Any] = {}
        for parameter in self.parameters:
            value = parameter.domain.value_in(parameter.name, given)
            if value is not None and parameter.counts({**given, **params}):
                params[parameter.name] = value
        return params

    def check(self, unread: Iterable[str] = ()) -> None:
        """Refuse a space that makes no run at ends of its ranges, or has what does nothing.

        Args:
            unread: keys of `fixed` of which one that no run reads is refused.

        Raises:
            UserError: naming the parameters, their values, and what a run allows.
        """
        for parameter in self.parameters:
            for key in self.fixed.keys() & {*parameter.keys}:
                raise UserError(f"{key} is searched by [space.{parameter.name}]")
        corners = list(self.corners())
        for params, _ in corners:
            asked = [parameter for parameter in self.parameters if parameter.name in params]
            set_by: dict[str, str] = {}
            for parameter in asked:
                for key in parameter.domain.fields(parameter.name, params[parameter.name]):
                    if (first := set_by.setdefault(key, parameter.name)) != parameter.name:
                        raise UserError(
                            f"[space.{parameter.name}]: {key} is searched by [space.{first}], too"
                        )
        for parameter in self.parameters:
            runs = [run for params, run in corners if parameter.name in params]
            for key in unread_fields(runs, parameter.keys) if runs else ():
                raise UserError(does_nothing(key, runs))
        runs = [run for _, run in corners]
        for key in unread_fields(runs, unread):
            raise UserError(does_nothing(key, runs))

    def corners(self) -> Iterator[tuple[dict[str, Any], Run]]:
        """Yield trials at ends of the ranges, drawn alike each time, each with the run it makes.

        Raises:
            UserError: where one makes no run.
        """
        draw = random.Random(0)
        for _ in range(CORNERS):
            params = self.ask(lambda parameter: draw.choice(parameter.domain.extremes))
            try:
                yield params, self.make_run(params)
            except UserError as error:
                told = ", ".join(f"{name} = {value}" for name, value in params.items())
                raise UserError(f"{error}, with {told}") from None

    def _usual_fields(self, base: str) -> dict[str, Any]:
        """Return every field of the run as a base and what is fixed have it, not yet checked as one run."""
        own = join_fields(base, self.fixed)
        brought = ENVIRONMENT_FIELDS.get(own.get("env", ENVIRONMENTS[0]), {})
        return {**as_fields(Run()), **brought, **read_fields(Run, own)}


# --- From a file -----------------------------------------------------------------------------------


class ParameterTable(Table):
    """[space.NAME]: a range of the field NAME, a list of its values, or named tables of fields."""

    low: Any = None
    high: Any = None
    log: bool = False
    choices: dict[str, dict[str, Any]] | tuple[Any, ...] | None = None
    when: dict[str, Any] = {}


def read_parameter(file: TomlFile, name: str, said: ParameterTable, before: Sequence[Parameter]) -> Parameter:
    """Read [space.NAME], which may hang on the parameters before it.

    Raises:
        UserError: naming file, line, key, value and what is allowed.
    """
    where = ("space", name)
    when = _read_when(file, (*where, "when"), said.when, before)
    if isinstance(said.choices, dict):
        bundles = {
            choice: {
                key: _field(file, (*where, "choices", choice), key, key, value) for key, value in own.items()
            }
            for choice, own in said.choices.items()
        }
        return Parameter(name, _choices(file, where, bundles), when)
    if said.choices is not None:
        values = [_field(file, where, "choices", name, value) for value in said.choices]
        return Parameter(name, _choices(file, where, {_name(own): {name: own} for own in values}), when)
    low, high = (_field(file, where, key, name, getattr(said, key)) for key in ("low", "high"))
    if any(isinstance(value, bool) or not isinstance(value, int | float) for value in (low, high)):
        raise file.mistake(where, f"{name} needs low and high, two numbers, or choices")
    if not low < high:
        told = f"low = {shown(low)} is not below high = {shown(high)}: an empty range"
        raise file.mistake(where, told, "low")
    if said.log and low <= 0:
        raise file.mistake(where, f"low = {shown(low)} is not allowed with log: above 0", "low")
    return Parameter(name, Range(low, high, said.log, whole=isinstance(low, int)), when)


def _choices(file: TomlFile, where: Where, choices: Mapping[str, Mapping[str, Any]]) -> Choices:
    if len(choices) < 2:
        raise file.mistake(where, "choices: two or more", "choices")
    return Choices(choices)


def _field(file: TomlFile, where: Where, key: str, name: str, value: Any) -> Any:
    """Return a key's value as a field of the run has it."""
    if name not in SEARCHABLE:
        raise file.mistake(where, str(unknown_name("parameter", name, SEARCHABLE)), key)
    try:
        return read_field(Run, name, value)
    except UserError as error:
        raise file.mistake(where, str(error), key) from None


def _read_when(
    file: TomlFile, where: Where, when: Mapping[str, Any], before: Sequence[Parameter]
) -> dict[str, tuple[Any, ...]]:
    """Return at which values of earlier parameters, or of fields, a parameter counts."""
    domains, read = {parameter.name: parameter.domain for parameter in before}, {}
    for name, given in when.items():
        if name not in domains and name in file.table(("space",)):
            raise file.mistake(where, f"{name} is searched, too: [space.{name}] must stand before it", name)
        values, domain = given if isinstance(given, tuple) else (given,), domains.get(name)
        if isinstance(domain, Choices):
            read[name] = tuple(map(_name, values))
            for value in {*read[name]} - {*domain.settings_of}:
                raise file.mistake(
                    where, str(unknown_name(f"choice of {name}", value, domain.settings_of)), name
                )
        else:
            read[name] = tuple(_field(file, where, name, name, value) for value in values)
    return read


def _name(value: Any) -> str:
    return "none" if value is None else value if isinstance(value, str) else json.dumps(value, default=str)


def _agree(own: Mapping[str, Any], given: Mapping[str, Any]) -> bool:
    return all(as_tuple(given.get(key)) == as_tuple(value) for key, value in own.items())
