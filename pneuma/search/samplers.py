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
        loaded = self.load()
        arguments = {**DEFAULTS.get(self.name, {}), **self.arguments}
        if seed is not None and "seed" in inspect.signature(loaded).parameters:
            arguments["seed"] = seed
        with warnings.catch_warnings(action="ignore"):  # of arguments that are experimental
            return loaded(**arguments)


def _read_choice(names: Mapping[str, str], base: type, table: Any) -> Any:
    """Read [sampler] or [pruner], which is created once to find mistakes."""
    if not isinstance(table, Mapping):
        return table
    arguments = dict(table)
    name = str(arguments.pop("name", ""))
    if ":" not in name and name not in names:
        raise wrong(f"{unknown_name('name', name, names)}; any other is named as module:Class", "name")
    choice = Choice(name=name, arguments=arguments)
    try:
        loaded = choice.load()
        if not issubclass(loaded, base):
            raise TypeError(f"it is not a class of Optuna's {base.__name__}")
        if issubclass(loaded, CmaEsSampler):
            raise TypeError("it keeps its state as a pickle, which is never loaded")
        choice.create()
    except Exception as error:  # a user's class may raise anything
        raise wrong(f"{name} cannot be used: {error}", "name") from None
    return choice


Sampler = Annotated[Choice, BeforeValidator(partial(_read_choice, SAMPLERS, BaseSampler))]
Pruner = Annotated[Choice, BeforeValidator(partial(_read_choice, PRUNERS, BasePruner))]
TPE = Choice(name="tpe", arguments={})
