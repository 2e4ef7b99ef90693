"""The search space: the values of each parameter, and how they become fields of a run.

A parameter is a field of the run. It may depend on another: momentum is searched only for optimizers that
have it.
"""

from __future__ import annotations

import json
import random
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any

from annotated_types import MinLen
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from pydantic import AfterValidator, BeforeValidator, model_validator

from pneuma.config import Run, as_fields, make_run
from pneuma.env.fields import ENVIRONMENTS, read_field, read_fields, with_environment, with_layout
from pneuma.errors import UserError, unknown_name
from pneuma.schema import Table, shown, wrong
from pneuma.study.spec import PLANNED, does_nothing, join_fields, unread_fields
from pneuma.values import as_tuple

FIXABLE = tuple(item.name for item in fields(Run) if item.name not in PLANNED)
"""Fields that a search may fix for all its trials."""
SEARCHABLE = tuple(name for name in FIXABLE if name != "engine")
"""Fields that a search may vary."""
CORNERS = 256
"""Trials with which a space is checked before any training."""


class Parameter(Table):
    """[space.NAME]: a range of a run's field, which includes both ends, or a list of its values.

    A range may have only whole steps from its low end, and may be logarithmic.
    """

    name: str
    low: int | float | None = None
    high: int | float | None = None
    step: int | float | None = None
    log: bool = False
    choices: dict[Any, Any] = {}
    """By what they are in trials: themselves, or the text of what Optuna does not take."""
    when: dict[str, Any] = {}
    """Earlier parameters or fields, with the values for which this one is searched."""

    @model_validator(mode="before")
    @classmethod
    def _read_values(cls, data: dict[str, Any]) -> dict[str, Any]:
        """Read the range or the list in the field's type."""

        def read(key: str, value: Any) -> Any:
            try:
                return _read_field(data["name"], value)
            except UserError as error:
                raise wrong(str(error), key) from None

        ends: dict[str, Any] = {key: read(key, data[key]) for key in ("low", "high") if key in data}
        values = data.get("choices", ())
        if not isinstance(values, tuple) or len(values) == 1:
            raise wrong("choices: a list of two values or more", "choices")
        if values and (ends or {*data} & {"log", "step"}):
            raise wrong("choices stand for themselves: leave out low, high, step and log", "choices")
        choices = {_param(value): value for value in (read("choices", each) for each in values)}
        if len(choices) < len(values):
            raise wrong("choices: two values are equal", "choices")
        return {**data, **ends, "choices": choices}

    @model_validator(mode="after")
    def _check_range(self) -> Parameter:
        """Refuse a range that Optuna refuses, or would change."""
        if self.choices:
            return self
        if self.low is None or self.high is None:
            raise wrong(f"{self.name} needs low and high, two numbers, or choices")
        if self.low == self.high:
            raise wrong(f"low = {shown(self.low)} is high, too: an empty range", "low")
        if self.whole and isinstance(self.step, float):
            raise wrong(f"step = {shown(self.step)} is not allowed: a whole number", "step")
        try:
            with warnings.catch_warnings(action="error"):
                _ = self.distribution
        except (ValueError, UserWarning) as error:
            raise wrong(str(error), "low" if self.step is None else "step") from None
        return self

    @property
    def whole(self) -> bool:
        return isinstance(self.low, int)

    @property
    def extremes(self) -> list[Any]:
        return [*self.choices] or [self.low, self.high]

    @property
    def distribution(self) -> BaseDistribution:
        """Return it as Optuna has it."""
        if self.low is None or self.high is None:
            return CategoricalDistribution([*self.choices])
        if self.whole:
            step = 1 if self.step is None else int(self.step)
            return IntDistribution(int(self.low), int(self.high), self.log, step)
        return FloatDistribution(self.low, self.high, self.log, self.step)

    def holds(self, param: Any) -> bool:
        """Return whether a trial can have a value."""
        if self.choices:
            return param in self.choices
        return isinstance(param, int | float) and self.distribution._contains(param)

    @property
    def identity(self) -> dict[str, Any]:
        step = {"step": self.step} if self.step else {}
        numbers = {"low": self.low, "high": self.high, "log": self.log, "whole": self.whole, **step}
        choices = {_name(choice): {self.name: value} for choice, value in self.choices.items()}
        domain = {"settings_of": choices} if choices else numbers
        return {"name": self.name, "domain": domain, "when": self.when}

    def find(self, value: Any) -> list[Any]:
        """Return what a field's value is in trials; nothing if it is not in the space."""
        if self.choices:
            return [param for param, choice in self.choices.items() if choice == as_tuple(value)]
        return [value] if self.holds(value) else []

    def counts(self, known: Mapping[str, Any]) -> bool:
        return all(as_tuple(known.get(name)) in values for name, values in self.when.items())


def _param(value: Any) -> Any:
    """Return a value as Optuna takes it."""
    return value if value is None or isinstance(value, bool | int | float | str) else _name(value)


def _name(value: Any) -> str:
    return "none" if value is None else value if isinstance(value, str) else json.dumps(value, default=str)


def _read_field(name: str, value: Any) -> Any:
    if name not in SEARCHABLE:
        raise unknown_name("parameter", name, SEARCHABLE)
    return read_field(Run, name, value)


def named(tables: Any) -> Any:
    """Give each table its name as a field."""
    if not isinstance(tables, Mapping):
        return tables
    return {
        name: {**table, "name": name} if isinstance(table, Mapping) else table
        for name, table in tables.items()
    }


def _read_when(space: dict[str, Parameter]) -> dict[str, Parameter]:
    """Read for which values of earlier parameters or fields each parameter applies."""
    read: dict[str, Parameter] = {}
    for name, parameter in space.items():
        when = {}
        for key, given in parameter.when.items():
            if key in space and key not in read:
                message = f"{key} is searched, too: [space.{key}] must stand before it"
                raise wrong(f"{name}.when: {message}", name)
            try:
                values = [
                    _read_field(key, each) for each in (given if isinstance(given, tuple) else (given,))
                ]
            except UserError as error:
                raise wrong(f"{name}.when: {error}", name) from None
            found, earlier = values, read.get(key)
            if earlier is not None:  # a range of fractions never meets a value
                met = earlier.choices or earlier.whole
                found = [param for value in values for param in earlier.find(value) if met]
            if len(found) < len(values):
                raise wrong(f"{name}.when: [space.{key}] never meets {shown(given)}", name)
            when[key] = tuple(found)
        read[name] = parameter.model_copy(update={"when": when})
    return read


Parameters = Annotated[dict[str, Parameter], MinLen(1), BeforeValidator(named), AfterValidator(_read_when)]
"""All of [space], in the order in which parameters are suggested."""


@dataclass(frozen=True)
class Space:
    """The parameters of a search, each after those that it depends on, in the order of suggestion.

    Every trial sets the fixed fields too, on top of those that the base names.
    """

    parameters: tuple[Parameter, ...]
    fixed: Mapping[str, Any]
    base: str

    @property
    def keys(self) -> frozenset[str]:
        return frozenset(parameter.name for parameter in self.parameters)

    def ask(self, suggest: Callable[[Parameter], Any]) -> dict[str, Any]:
        """Suggest a value for each parameter that applies; return them by name."""
        usual = self._usual_fields(self.base)
        params: dict[str, Any] = {}
        for parameter in self.parameters:
            if parameter.counts({**usual, **self.fields(params), **params}):
                params[parameter.name] = suggest(parameter)
        return params

    def all_values(self) -> dict[str, list[Any]]:
        return {
            **{key: [value] for key, value in self.fixed.items()},
            **{parameter.name: list(parameter.choices.values()) for parameter in self.parameters},
        }

    def fields(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Return the fields of the run that a trial sets on top of the base."""
        given = dict(self.fixed)
        for parameter in self.parameters:
            if parameter.name in params:
                value = params[parameter.name]
                given[parameter.name] = parameter.choices[value] if parameter.choices else value
        return given

    def make_run(self, params: Mapping[str, Any], **over: Any) -> Run:
        return make_run({**join_fields(self.base, self.fields(params)), **over})

    def params_of(self, base: str) -> dict[str, Any]:
        """Return the parameters for the fields of another base, as far as the space contains them."""
        return self.find(self._usual_fields(base))

    def find(self, given: Mapping[str, Any]) -> dict[str, Any]:
        """Return the parameters for some fields of a run, as far as the space contains them."""
        params: dict[str, Any] = {}
        for parameter in self.parameters:
            for param in parameter.find(given.get(parameter.name)):
                if parameter.counts({**given, **params}):
                    params[parameter.name] = param
        return params

    def holds(self, params: Mapping[str, Any]) -> bool:
        """Return whether all parameters of a trial are in the space."""
        known = {parameter.name: parameter for parameter in self.parameters}
        return all(name in known and known[name].holds(param) for name, param in params.items())

    def named(self, params: Mapping[str, Any]) -> dict[str, Any]:
        """Return parameters with their choices in words."""
        known = {parameter.name: parameter for parameter in self.parameters}
        return {name: _name(value) if known[name].choices else value for name, value in params.items()}

    def check(self, unread: Iterable[str] = ()) -> None:
        """Refuse a space whose corners make no valid run, or that has parameters without effect.

        `unread` keys of `fixed` are refused if no run reads them.
        """
        for key in self.fixed.keys() & self.keys:
            raise UserError(f"{key} is searched by [space.{key}]")
        corners = list(self.corners())
        for key in self.keys:
            runs = [run for params, run in corners if key in params]
            if runs and unread_fields(runs, [key]):
                raise UserError(does_nothing(key, runs))
        runs = [run for _, run in corners]
        for key in unread_fields(runs, unread):
            raise UserError(does_nothing(key, runs))

    def check_when(self) -> None:
        """Refuse a parameter that never applies, because a field that is not searched has another value."""
        usual = self._usual_fields(self.base)
        for parameter in self.parameters:
            for key in parameter.when.keys() - self.keys:
                if as_tuple(usual.get(key)) not in parameter.when[key]:
                    raise UserError(f"{parameter.name} never applies: {key} is {shown(usual.get(key))}")

    def corners(self) -> Iterator[tuple[dict[str, Any], Run]]:
        """Yield trials at the ends of ranges, always the same ones, each with its run."""
        draw = random.Random(0)
        for _ in range(CORNERS):
            params = self.ask(lambda parameter: draw.choice(parameter.extremes))
            try:
                yield params, self.make_run(params)
            except UserError as error:
                trial = ", ".join(f"{name} = {value}" for name, value in self.named(params).items())
                raise UserError(f"{error}, with {trial}") from None

    def _usual_fields(self, base: str) -> dict[str, Any]:
        """Return the base's fields with the fixed ones and the environment's, not yet checked as a run."""
        fields = join_fields(base, self.fixed)
        env = fields.get("env", ENVIRONMENTS[0])
        return {**as_fields(Run()), **with_layout(read_fields(Run, with_environment(env, fields)))}
