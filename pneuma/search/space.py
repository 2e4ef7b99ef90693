"""The search space: what each parameter may be, and how it becomes settings of a run.

A parameter is a field of the run, or a named choice between bundles of fields, such as two sizes of
network. It may hang on another: a momentum counts only where the optimizer has one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from itertools import combinations, product
from typing import Any

from pneuma.config import ENVIRONMENTS, Run, as_fields, make_run, read_fields
from pneuma.env_fields import ENVIRONMENT_FIELDS
from pneuma.errors import UserError
from pneuma.study.conditions import does_nothing, unread_fields
from pneuma.study.spec import join_fields
from pneuma.values import as_tuple

Params = Mapping[str, Any]
"""What is suggested for a trial: numbers, and the names of choices."""


class Unsound(UserError):
    """What is wrong with a space, and at which table and key of the file."""

    def __init__(self, message: str, where: tuple[str, ...], key: str = "") -> None:
        super().__init__(message)
        self.where, self.key = where, key


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

    def settings(self, name: str, value: Any) -> dict[str, Any]:
        """Return what a value sets."""
        return {name: value}

    def value_in(self, name: str, settings: Mapping[str, Any]) -> Any:
        """Return the value that settings hold; None where that is outside."""
        value = settings.get(name)
        return value if value is not None and self.low <= value <= self.high else None


@dataclass(frozen=True)
class Choices:
    """Some settings to choose from, each with a name."""

    settings_of: Mapping[str, Mapping[str, Any]]

    @property
    def extremes(self) -> list[Any]:
        """Return every name."""
        return list(self.settings_of)

    def settings(self, name: str, value: Any) -> dict[str, Any]:
        """Return what a choice sets."""
        return dict(self.settings_of[value])

    def value_in(self, name: str, settings: Mapping[str, Any]) -> Any:
        """Return the choice whose settings are among those given; None where there is none."""
        return next((choice for choice, own in self.settings_of.items() if _agree(own, settings)), None)


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
        base: name of the settings to start from.
    """

    parameters: tuple[Parameter, ...]
    fixed: Mapping[str, Any]
    base: str

    def ask(self, suggest: Callable[[Parameter], Any]) -> dict[str, Any]:
        """Have a value suggested for every parameter that counts; return them by name."""
        params: dict[str, Any] = {}
        for parameter in self.parameters:
            if parameter.counts(self._known(params)):
                params[parameter.name] = suggest(parameter)
        return params

    def settings(self, params: Params) -> dict[str, Any]:
        """Return what a trial sets on top of the base, in fields of the run."""
        settings = dict(self.fixed)
        for parameter in self.parameters:
            if parameter.name in params:
                settings.update(parameter.domain.settings(parameter.name, params[parameter.name]))
        return settings

    def params_of(self, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Return the parameters that give settings, as far as the space holds them."""
        params: dict[str, Any] = {}
        for parameter in self.parameters:
            value = parameter.domain.value_in(parameter.name, settings)
            if value is not None and parameter.counts({**settings, **params}):
                params[parameter.name] = value
        return params

    def parameter(self, name: str) -> Parameter:
        """Return a parameter by its name."""
        return next(parameter for parameter in self.parameters if parameter.name == name)

    def check(self, unread: Iterable[str]) -> None:
        """Refuse a space that makes no run at some end of a range or at two, or has what does nothing.

        Args:
            unread: keys of `fixed` of which one that no run reads is refused.

        Raises:
            Unsound: naming the parameters, their values, and what a run allows.
        """
        for parameter in self.parameters:
            for key in parameter.keys:
                if key in self.fixed:
                    raise Unsound(f"{key} is searched by [space.{parameter.name}]", ("run",), key)
        corners = list(self.corners())
        for own, _ in corners:
            set_by: dict[str, str] = {}
            for name, value in own.items():
                for key in self.parameter(name).domain.settings(name, value):
                    if (first := set_by.setdefault(key, name)) != name:
                        raise Unsound(f"{key} is searched by [space.{first}], too", ("space", name))
        for parameter in self.parameters:
            runs = [run for own, run in corners if parameter.name in own]
            for key in unread_fields(runs, parameter.keys) if runs else ():
                raise Unsound(does_nothing(key, runs), ("space", parameter.name))
        runs = [run for _, run in corners]
        for key in unread_fields(runs, unread):
            raise Unsound(does_nothing(key, runs), ("run",), key)

    def corners(self) -> Iterator[tuple[dict[str, Any], Run]]:
        """Yield every end of every range, and every two together, as parameters, with the run they make.

        Raises:
            Unsound: where one makes no run.
        """
        for own in self._corners():
            params = {**self._usual(), **self._enabling(own), **own}
            if not all(self.parameter(name).counts(self._known(params)) for name in own):
                continue
            settings = self.settings({p.name: params[p.name] for p in self.parameters if p.name in params})
            try:
                run = make_run(join_fields(self.base, settings))
            except UserError as error:
                told = ", ".join(f"{name} = {value}" for name, value in own.items())
                raise Unsound(f"{told}: {error}", ("space", next(iter(own)))) from None
            yield own, run

    @property
    def _start(self) -> dict[str, Any]:
        return usual_fields(self.base, self.fixed)

    def _known(self, params: Params) -> dict[str, Any]:
        """Return what a `when` may name: fields as they are beside parameters, and these themselves."""
        return {**self._start, **self.settings(params), **params}

    def _corners(self) -> Iterator[dict[str, Any]]:
        singles = [(parameter,) for parameter in self.parameters]
        for group in [*singles, *combinations(self.parameters, 2)]:
            for values in product(*(parameter.domain.extremes for parameter in group)):
                yield {parameter.name: value for parameter, value in zip(group, values, strict=True)}

    def _usual(self) -> dict[str, Any]:
        """Return a value inside the space for each parameter that hangs on no other: the base's if it can."""
        base = self.params_of(self._start)
        return {
            parameter.name: base.get(parameter.name, parameter.domain.extremes[0])
            for parameter in self.parameters
            if not parameter.when
        }

    def _enabling(self, own: Params) -> dict[str, Any]:
        """Return values for the parameters on which those of `own` hang, so that they count."""
        wanted: dict[str, list[Any]] = {}
        for key, values in [item for name in own for item in self.parameter(name).when.items()]:
            wanted[key] = [value for value in wanted.get(key, values) if value in values]
        found: dict[str, Any] = {}
        for key, shared in wanted.items():
            for parameter in self.parameters if shared else ():  # without one in common they never meet
                if parameter.name == key:
                    found[key] = shared[0]
                elif isinstance(parameter.domain, Choices):  # of bundles, one may set the field
                    for choice, settings in parameter.domain.settings_of.items():
                        if key in settings and as_tuple(settings[key]) in shared:
                            found.setdefault(parameter.name, choice)
        return found


def usual_fields(base: str, fixed: Mapping[str, Any]) -> dict[str, Any]:
    """Return every field of the run as a base and what is fixed have it, not yet checked as one run."""
    own = join_fields(base, fixed)
    brought = ENVIRONMENT_FIELDS.get(own.get("env", ENVIRONMENTS[0]), {})
    return {**as_fields(Run()), **brought, **read_fields(Run, own)}


def _agree(own: Mapping[str, Any], settings: Mapping[str, Any]) -> bool:
    return all(as_tuple(settings.get(key)) == as_tuple(value) for key, value in own.items())
