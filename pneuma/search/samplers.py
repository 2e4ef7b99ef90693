"""Samplers and pruners: Optuna's by a short name, or any by `module:Class`, with their arguments."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Mapping
from functools import partial
from typing import Annotated, Any

import optuna
from optuna.pruners import BasePruner
from optuna.samplers import BaseSampler, CmaEsSampler
from pydantic import BeforeValidator

from pneuma.errors import unknown_name
from pneuma.own_modules import load_module
from pneuma.schema import Table, wrong

optuna.logging.set_verbosity(optuna.logging.ERROR)

SAMPLERS = {
    "tpe": "optuna.samplers:TPESampler",
    "random": "optuna.samplers:RandomSampler",
    "nsga-ii": "optuna.samplers:NSGAIISampler",
}
PRUNERS = {"median": "optuna.pruners:MedianPruner"}
DEFAULTS: Mapping[str, Mapping[str, Any]] = {
    "tpe": {"multivariate": True, "group": True},
    "median": {"n_warmup_steps": 5, "interval_steps": 5},
}
"""Arguments in which short names differ from Optuna's defaults; steps of pruners are twentieths of a run."""


class Choice(Table):
    """[sampler] or [pruner]: its name, and arguments by Optuna's names."""

    name: str
    arguments: dict[str, Any]

    def load(self) -> Any:
        """Return its class."""
        module, _, attribute = {**SAMPLERS, **PRUNERS}.get(self.name, self.name).rpartition(":")
        return getattr(load_module(module), attribute)

    def create(self, seed: int | None = None) -> Any:
        """Return the sampler or pruner, with a seed if its class takes one."""
        component_class = self.load()
        arguments = {**DEFAULTS.get(self.name, {}), **self.arguments}
        if seed is not None and "seed" in inspect.signature(component_class).parameters:
            arguments["seed"] = seed
        with warnings.catch_warnings(action="ignore"):  # experimental arguments
            return component_class(**arguments)


def _read_choice(short_names: Mapping[str, str], base_class: type, choice_table: Any) -> Any:
    """Read [sampler] or [pruner], which is created once to find mistakes."""
    if not isinstance(choice_table, Mapping):
        return choice_table
    arguments = dict(choice_table)
    choice_name = str(arguments.pop("name", ""))
    if ":" not in choice_name and choice_name not in short_names:
        raise wrong(
            f"{unknown_name('name', choice_name, short_names)}; any other is named as module:Class", "name"
        )
    choice = Choice(name=choice_name, arguments=arguments)
    try:
        component_class = choice.load()
        if not issubclass(component_class, base_class):
            raise TypeError(f"it is not a class of Optuna's {base_class.__name__}")
        if issubclass(component_class, CmaEsSampler):
            raise TypeError("it keeps its state as a pickle, which is never loaded")
        choice.create()
    except Exception as error:  # a user's class may raise anything
        raise wrong(f"{choice_name} cannot be used: {error}", "name") from None
    return choice


Sampler = Annotated[Choice, BeforeValidator(partial(_read_choice, SAMPLERS, BaseSampler))]
Pruner = Annotated[Choice, BeforeValidator(partial(_read_choice, PRUNERS, BasePruner))]
TPE = Choice(name="tpe", arguments={})
