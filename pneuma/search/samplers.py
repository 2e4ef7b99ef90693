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

    def create(self, seed: int | None = None) -> Any:
        """Return the sampler or pruner, with a seed if its class takes one."""
        created = _load_class(self.name)
        arguments = {**DEFAULTS.get(self.name, {}), **self.arguments}
        if seed is not None and "seed" in inspect.signature(created).parameters:
            arguments["seed"] = seed
        with warnings.catch_warnings(action="ignore"):  # of arguments that are experimental
            return created(**arguments)


def _load_class(name: str) -> Any:
    module, _, attribute = {**SAMPLERS, **PRUNERS}.get(name, name).rpartition(":")
    return getattr(load_module(module), attribute)


def _read_choice(names: Mapping[str, str], base: type, table: Any) -> Any:
    """Read [sampler] or [pruner], which is created once to find mistakes."""
    if not isinstance(table, Mapping):
        return table
    arguments = dict(table)
    name = arguments.pop("name", "")
    if not isinstance(name, str) or not (":" in name or name in names):
        raise wrong(f"{unknown_name('name', str(name), names)}; any other is named as module:Class", "name")
    choice = Choice(name=name, arguments=arguments)
    try:
        loaded = _load_class(name)
        is_of_base = isinstance(loaded, type) and issubclass(loaded, base)
        if is_of_base:
            choice.create()
    except Exception as error:  # a user's class may raise anything
        raise wrong(f"{name} cannot be created: {error}", "name") from None
    if not is_of_base:
        raise wrong(f"{name} is not a class of Optuna's {base.__name__}", "name")
    if issubclass(loaded, CmaEsSampler):
        raise wrong(f"{name} is not allowed: it keeps its state as a pickle, which is never loaded", "name")
    return choice


Sampler = Annotated[Choice, BeforeValidator(partial(_read_choice, SAMPLERS, BaseSampler))]
Pruner = Annotated[Choice, BeforeValidator(partial(_read_choice, PRUNERS, BasePruner))]
TPE = Choice(name="tpe", arguments={})
