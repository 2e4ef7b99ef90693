"""Samplers and pruners: Optuna's by a short name, or any by `module:Class`, with their arguments."""

from __future__ import annotations

import copy
import inspect
import warnings
from collections.abc import Callable, Mapping
from functools import partial
from importlib.util import find_spec
from typing import Annotated, Any

import numpy as np
import optuna
from optuna import pruners, samplers
from optuna._transform import _SearchSpaceTransform
from optuna.trial import FrozenTrial
from pydantic import BeforeValidator

from pneuma.errors import unknown_name
from pneuma.own_modules import load_module
from pneuma.schema import Table, shown, wrong

optuna.logging.set_verbosity(optuna.logging.ERROR)

Kinds = Mapping[str, tuple[Callable[..., Any], Mapping[str, Any]]]
"""What makes each, and the arguments that a file may set with their defaults, of which None is Optuna's."""


class Chosen(Table):
    """[sampler] or [pruner]: its name, and arguments by Optuna's names."""

    name: str
    arguments: dict[str, Any]


class CmaEs(samplers.CmaEsSampler):
    """Optuna's, whose state is worked out from the trials: the log's would have to be unpickled."""

    def sample_relative(self, study: optuna.Study, trial: FrozenTrial, search_space: Any) -> dict[str, Any]:
        self._searched = study.direction, search_space
        return super().sample_relative(study, trial, search_space)

    def _restore_optimizer(self, completed_trials: list[FrozenTrial]) -> Any:
        """Tell a new optimizer the trials of all generations so far; None in the first."""
        latest = max(
            (trial.system_attrs.get(self._attr_key_generation, 0) for trial in completed_trials), default=0
        )
        if latest == 0:
            return None
        direction, space = self._searched
        transform = _SearchSpaceTransform(space, transform_step=not self._with_margin, transform_0_1=True)
        sign = -1 if direction == optuna.study.StudyDirection.MAXIMIZE else 1
        drawn = self._cma_rng.rng.get_state()
        optimizer = self._init_optimizer(transform, direction)
        self._cma_rng.rng.set_state(drawn)
        for generation in range(latest):
            told = self._get_solution_trials(completed_trials, generation)[: optimizer.population_size]
            places = [
                trial.system_attrs.get("x_for_tell", transform.transform(trial.params)) for trial in told
            ]
            values = [sign * float(trial.value or 0.0) for trial in told]
            optimizer.tell([(np.array(place), value) for place, value in zip(places, values, strict=True)])
            optimizer = copy.deepcopy(optimizer)  # which rounds as storing it does
        return optimizer

    def _split_optimizer_str(self, optimizer_str: str) -> dict[str, str]:
        return {}  # nothing is stored


SAMPLERS: Kinds = {
    "tpe": (
        samplers.TPESampler,
        {
            "n_startup_trials": 10, "n_ei_candidates": 24, "multivariate": True, "group": True,
            "constant_liar": True,
        },
    ),
    "random": (samplers.RandomSampler, {}),
    "nsga-ii": (
        samplers.NSGAIISampler,
        {"population_size": 16, "mutation_prob": 0.1, "crossover_prob": 0.9, "swapping_prob": 0.5},
    ),
    "cmaes": (
        CmaEs,
        {
            "sigma0": None, "n_startup_trials": 1, "popsize": None, "consider_pruned_trials": False,
            "use_separable_cma": False, "with_margin": False, "lr_adapt": False,
        },
    ),
}  # fmt: skip
PRUNERS: Kinds = {
    "": (pruners.NopPruner, {}),
    "median": (
        pruners.MedianPruner,
        {"n_startup_trials": 5, "n_warmup_steps": 5, "interval_steps": 5, "n_min_trials": 1},
    ),
    "hyperband": (
        pruners.HyperbandPruner,
        {"min_resource": 2, "max_resource": 20, "reduction_factor": 3, "bootstrap_count": 0},
    ),
    "wilcoxon": (pruners.WilcoxonPruner, {"p_threshold": 0.1, "n_startup_steps": 2}),
}
"""By name. The steps of a pruner are twentieths of a run's training; Wilcoxon's are seeds."""
BY_SEED = "wilcoxon"
"""The pruner that compares trials seed by seed, each trained to its end."""

LEAST = {
    "min_resource": 1, "max_resource": 1, "reduction_factor": 2, "n_ei_candidates": 1, "popsize": 2,
    "sigma0": 1e-6, "population_size": 2,
}  # fmt: skip
"""Of arguments that Optuna checks only when it uses them."""


def read_choice(kinds: Kinds, base: type, value: Any) -> Any:
    """Read [sampler] or [pruner]: `name`, and arguments by Optuna's names, into name and all arguments.

    A name `module:Class` is imported, and must be of the class `base`.
    """
    if not isinstance(value, Mapping):
        return value
    name = value.get("name", "")
    given = {key: each for key, each in value.items() if key != "name"}
    if not isinstance(name, str) or not (":" in name or name in kinds):
        words = str(unknown_name("name", str(name), [*filter(None, kinds)]))
        raise wrong(f"{words}; any other is named as module:Class", "name")
    if name == "cmaes" and find_spec("cmaes") is None:
        raise wrong("cmaes needs a package that is missing: pip install cmaes", "name")
    make, usual = kinds.get(name) or _own_kind(name, base)
    for key, each in given.items():
        if key not in usual:
            raise wrong(str(unknown_name(f"argument of {name}", key, usual)), key)
        if name in kinds:
            _check_argument(key, each, usual[key])
    arguments = {**usual, **given} if name in kinds else given
    try:
        _make(make, arguments)
    except Exception as error:  # of anybody's class
        raise wrong(f"{name}: {error}", next(iter(given), "name")) from None
    return {"name": name, "arguments": arguments}


def _check_argument(key: str, value: Any, usual: Any) -> None:
    number = isinstance(value, int if isinstance(usual, int) or key == "popsize" else int | float)
    if isinstance(value, bool) != isinstance(usual, bool) or not number:
        allowed = "true or false" if isinstance(usual, bool) else "a number, whole if the default is"
        raise wrong(f"{key} = {shown(value)} is not allowed: {allowed}", key)
    if value < (least := LEAST.get(key, value)):
        raise wrong(f"{key} = {shown(value)} is not allowed: at least {least}", key)


def _own_kind(name: str, base: type) -> tuple[Callable[..., Any], dict[str, Any]]:
    """Import a class that the user's own file names; return it with its arguments."""
    module, _, attribute = name.rpartition(":")
    try:
        found = getattr(load_module(module), attribute)
        known = inspect.signature(found).parameters
    except Exception as error:  # a user's module may raise anything
        raise wrong(f"{name} cannot be imported: {error}", "name") from None
    if not (isinstance(found, type) and issubclass(found, base)):
        raise wrong(f"{name} is not a class of Optuna's {base.__name__}", "name")
    make = CmaEs if found is samplers.CmaEsSampler else found
    return make, {key: None for key in known if key != "seed"}


def _make(make: Callable[..., Any], arguments: Mapping[str, Any]) -> Any:
    given = {key: value for key, value in arguments.items() if value is not None}
    with warnings.catch_warnings(action="ignore"):  # of arguments that are experimental, or go with Optuna 6
        return make(**given)


Sampler = Annotated[Chosen, BeforeValidator(partial(read_choice, SAMPLERS, samplers.BaseSampler))]
Pruner = Annotated[Chosen, BeforeValidator(partial(read_choice, PRUNERS, pruners.BasePruner))]
TPE = Chosen(**read_choice(SAMPLERS, samplers.BaseSampler, {"name": "tpe"}))
NO_PRUNER = Chosen(name="", arguments={})


def make_sampler(chosen: Chosen, seed: int) -> samplers.BaseSampler:
    """Return a sampler that draws from a seed, if it draws at all."""
    make, _ = SAMPLERS.get(chosen.name) or _own_kind(chosen.name, samplers.BaseSampler)
    seeded = {"seed": seed} if "seed" in inspect.signature(make).parameters else {}
    made: samplers.BaseSampler = _make(make, {**chosen.arguments, **seeded})
    return made


def make_pruner(chosen: Chosen) -> pruners.BasePruner:
    make, _ = PRUNERS.get(chosen.name) or _own_kind(chosen.name, pruners.BasePruner)
    made: pruners.BasePruner = _make(make, chosen.arguments)
    return made
