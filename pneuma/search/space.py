"""The parameters of a search: fields of a run, each with a range or a list of values.

A *parameter* is what Optuna suggests for a field. It is the field's value, or text for values that Optuna
does not take, such as lists.
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

SEARCHABLE = tuple(item.name for item in fields(Run) if item.name not in PLANNED and item.name != "engine")


class Parameter(Table):
    """[space.NAME]: a range of a run's field, which includes both ends, or a list of its values.

    Attributes:
        step: a range has only whole steps from its low end.
        choices: values of the field, by the parameters that stand for them.
        when: earlier parameters or other fields, with the values for which this one is searched.
    """

    name: str
    low: int | float | None = None
    high: int | float | None = None
    step: int | float | None = None
    log: bool = False
    choices: dict[Any, Any] = {}
    when: dict[str, Any] = {}

    @model_validator(mode="before")
    @classmethod
    def _read_values(cls, table: dict[str, Any]) -> dict[str, Any]:
        """Read the range, or the list, and `when` in the types of the fields."""
        read = dict(table)
        for key in ("low", "high"):
            if key in read:
                read[key] = _read(read["name"], read[key], key)
        if "choices" in read:
            read["choices"] = _read_choices(read)
        if isinstance(read.get("when"), Mapping):
            when: dict[str, Any] = {}
            for name, values in read["when"].items():
                listed = values if isinstance(values, tuple) else (values,)
                when[name] = tuple(plain(_read(name, value, "when")) for value in listed)
            read["when"] = when
        return read

    @model_validator(mode="after")
    def _check_range(self) -> Parameter:
        """Refuse a range that Optuna refuses, or would change."""
        if self.choices:
            return self
        if self.low is None or self.high is None:
            raise wrong(f"{self.name} needs low and high, two numbers, or choices")
        if isinstance(self.low, int) and isinstance(self.step, float):
            raise wrong(f"step = {shown(self.step)} is not allowed: a whole number", "step")
        try:
            with warnings.catch_warnings(action="error"):
                _ = self.distribution
        except (ValueError, UserWarning) as error:
            raise wrong(str(error), "low" if self.step is None else "step") from None
        return self

    @property
    def extremes(self) -> list[Any]:
        """The parameters at the ends of a range, or all choices."""
        return list(self.choices) or [self.low, self.high]

    @property
    def distribution(self) -> BaseDistribution:
        """It as Optuna has it."""
        if self.low is None or self.high is None:
            return CategoricalDistribution(list(self.choices))
        if isinstance(self.low, int):
            step = 1 if self.step is None else int(self.step)
            return IntDistribution(low=self.low, high=int(self.high), log=self.log, step=step)
        return FloatDistribution(low=self.low, high=self.high, log=self.log, step=self.step)

    def contains(self, parameter: Any) -> bool:
        if self.choices:
            return parameter in self.choices
        return isinstance(parameter, int | float) and self.distribution._contains(parameter)

    def value(self, parameter: Any) -> Any:
        """Return the field's value for a parameter."""
        return self.choices.get(parameter, parameter)

    def applies(self, run_fields: Mapping[str, Any]) -> bool:
        """Return whether it is searched in a run with these fields."""
        return all(plain(run_fields.get(name)) in values for name, values in self.when.items())


def as_parameter(value: Any) -> Any:
    """Return the parameter that stands for a field's value."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return json.dumps(value)


def _read(name: str, value: Any, key: str) -> Any:
    try:
        if name not in SEARCHABLE:
            raise unknown_name("parameter", name, SEARCHABLE)
        return read_field(Run, name, value)
    except UserError as error:
        raise wrong(str(error), key) from None


def _read_choices(table: Mapping[str, Any]) -> dict[Any, Any]:
    values = table["choices"]
    if not isinstance(values, tuple) or len(values) < 2:
        raise wrong("choices: a list of two values or more", "choices")
    if table.keys() & {"low", "high", "log", "step"}:
        raise wrong("choices stand for themselves: leave out low, high, step and log", "choices")
    choices = {}
    for value in values:
        read = _read(table["name"], value, "choices")
        choices[as_parameter(read)] = read
    if len(choices) < len(values):
        raise wrong("choices: two values are equal", "choices")
    return choices


def with_names(tables: Any) -> Any:
    """Give each table its name as a field."""
    if not isinstance(tables, Mapping):
        return tables
    tables_with_names = {}
    for name, table in tables.items():
        tables_with_names[name] = {**table, "name": name} if isinstance(table, Mapping) else table
    return tables_with_names


def _check_order(space: dict[str, Parameter]) -> dict[str, Parameter]:
    """Refuse a parameter that depends on a later one."""
    names = list(space)
    for index, parameter in enumerate(space.values()):
        for name in parameter.when:
            if name in names[index:]:
                message = f"{name} is searched, too: [space.{name}] must stand before it"
                raise wrong(f"{parameter.name}.when: {message}", parameter.name)
    return space


Space = Annotated[dict[str, Parameter], MinLen(1), BeforeValidator(with_names), AfterValidator(_check_order)]
"""All of [space], in the order in which parameters are suggested."""
