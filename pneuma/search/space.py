"""The parameters of a search: fields of a run, each with its values.

One may depend on another: momentum is searched only for optimizers that have it.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from dataclasses import fields
from typing import Annotated, Any

from annotated_types import MinLen
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from pydantic import AfterValidator, BeforeValidator, model_validator

from pneuma.config import Run
from pneuma.env.fields import read_field
from pneuma.errors import UserError, unknown_name
from pneuma.schema import Table, plain, shown, wrong
from pneuma.study.spec import PLANNED

FIXABLE = tuple(item.name for item in fields(Run) if item.name not in PLANNED)
"""Fields that a search may fix for all its trials."""
SEARCHABLE = tuple(name for name in FIXABLE if name != "engine")
"""Fields that a search may vary."""


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
            return [param for param, choice in self.choices.items() if choice == plain(value)]
        return [value] if self.holds(value) else []

    def in_words(self, param: Any) -> Any:
        return _name(param) if self.choices else param

    def counts(self, known: Mapping[str, Any]) -> bool:
        return all(plain(known.get(name)) in values for name, values in self.when.items())


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
