"""The parameters of a search: fields of a run, each with one of Optuna's distributions.

A *parameter* is what Optuna suggests for a field. It is the field's value, or text for values that Optuna
does not take, such as lists.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any

from annotated_types import MinLen
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from pydantic import BeforeValidator

from pneuma.config import Run
from pneuma.env.fields import read_field
from pneuma.errors import unknown_name
from pneuma.schema import normalize, wrong
from pneuma.search.optuna_private import contains
from pneuma.study.spec import MISPLACED
from pneuma.values import format_json

SEARCHABLE = tuple(item.name for item in fields(Run) if item.name not in MISPLACED and item.name != "engine")


@dataclass(frozen=True)
class Parameter:
    """[space.NAME]: a range of a run's field, which includes both ends, or a list of its values.

    Attributes:
        name: the field's name.
        distribution: Optuna's distribution of it.
        choices: values of the field, by the parameters that stand for them; empty for a range.
        when: earlier parameters or other fields, with the values for which this one is searched.
    """

    name: str
    distribution: BaseDistribution
    choices: Mapping[Any, Any]
    when: Mapping[str, tuple[Any, ...]]

    @property
    def extremes(self) -> list[Any]:
        """The parameters at the ends of a range, or all choices."""
        if isinstance(self.distribution, IntDistribution | FloatDistribution):
            return [self.distribution.low, self.distribution.high]
        return list(self.choices)

    @property
    def allowed(self) -> str:
        """Its range or its values, for messages."""
        if self.choices:
            return format_json(list(self.choices.values()))
        low, high = self.extremes
        return f"{low:g} to {high:g}"

    def contains(self, parameter: Any) -> bool:
        try:
            return contains(self.distribution, parameter)
        except ValueError:
            return False

    def value(self, parameter: Any) -> Any:
        """Return the field's value for a parameter."""
        return self.choices.get(parameter, parameter)

    def applies(self, run_fields: Mapping[str, Any]) -> bool:
        """Return whether it is searched in a run with these fields."""
        return all(
            normalize(run_fields.get(field_name)) in field_values
            for field_name, field_values in self.when.items()
        )


def as_parameter(value: Any) -> Any:
    """Return the parameter that stands for a field's value."""
    if value is None or isinstance(value, bool | int | float | str):
        return value
    return json.dumps(value)


def _read(field_name: str, value: Any) -> Any:
    if field_name not in SEARCHABLE:
        raise unknown_name("parameter", field_name, SEARCHABLE)
    return read_field(Run, field_name, value)


def _read_parameter(field_name: str, parameter_table: Mapping[str, Any]) -> Parameter:
    """Read a table by Optuna's own checks of its distributions.

    Raises:
        UserError: for a value that its field cannot have.
        ValueError: for a range that Optuna refuses; also TypeError, or UserWarning where it would change it.
    """
    arguments = dict(parameter_table)
    when: dict[str, tuple[Any, ...]] = {}
    for condition, condition_values in arguments.pop("when", {}).items():
        value_list = condition_values if isinstance(condition_values, tuple) else (condition_values,)
        when[condition] = tuple(normalize(_read(condition, value)) for value in value_list)
    choices: dict[Any, Any] = {}
    for value in arguments.get("choices", ()):
        choice = _read(field_name, value)
        choices[as_parameter(choice)] = choice
    for bound in arguments.keys() & {"low", "high"}:
        arguments[bound] = _read(field_name, arguments[bound])
    distribution: Any = IntDistribution if isinstance(arguments.get("low"), int) else FloatDistribution
    if "choices" in arguments:
        distribution, arguments["choices"] = CategoricalDistribution, list(choices)
        if len(choices) < 2:
            raise ValueError("choices must be a list of two different values or more")
    if distribution is IntDistribution and not isinstance(arguments.get("step", 1), int):
        raise ValueError(f"step = {arguments['step']} is not allowed: a whole number")
    with warnings.catch_warnings(action="error"):
        return Parameter(field_name, distribution(**arguments), choices, when)


def _read_space(tables: Any) -> Any:
    """Read all of [space], in the order in which parameters are suggested."""
    if not isinstance(tables, Mapping):
        return tables
    space: dict[str, Parameter] = {}
    for parameter_name, parameter_table in tables.items():
        try:
            space[parameter_name] = _read_parameter(parameter_name, parameter_table)
        except ArithmeticError:
            raise wrong(f"{parameter_name}: step is too small for this range", parameter_name) from None
        except Exception as error:  # from the fields or from Optuna's checks
            raise wrong(f"{parameter_name}: {error}", parameter_name) from None
        for condition in space[parameter_name].when:
            if condition in tables and condition not in space:
                message = f"{condition} is searched, too: [space.{condition}] must stand before it"
                raise wrong(f"{parameter_name}.when: {message}", parameter_name)
    return space


Space = Annotated[dict[str, Any], MinLen(1), BeforeValidator(_read_space)]
