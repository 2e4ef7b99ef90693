"""Optuna's part: samplers and pruners from a search's options, and asking for a trial.

The study that asks lives in memory. Before each ask the sampler is made anew with a seed of the trial's
own, so that what is suggested depends on the trials told before and on nothing else: not on the number
of workers, nor on how often the search was stopped (Akiba et al. 2019 describe ask and tell).
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import optuna
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.pruners import BasePruner, MedianPruner, NopPruner, WilcoxonPruner
from optuna.samplers import (
    BaseSampler,
    GPSampler,
    NSGAIISampler,
    RandomSampler,
    TPESampler,
)
from optuna.study import StudyDirection

from pneuma.config import stream_seed
from pneuma.search.space import Parameter, Params, Range, Space

optuna.logging.set_verbosity(optuna.logging.ERROR)


def begin_study(name: str, directions: Sequence[str], pruner: Mapping[str, Any]) -> optuna.Study:
    """Return an empty study in memory.

    Args:
        name: of the search.
        directions: of its objectives.
        pruner: its options.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        return optuna.create_study(
            storage=optuna.storages.InMemoryStorage(),
            sampler=RandomSampler(seed=0),
            pruner=_pruner(pruner),
            study_name=name,
            directions=[StudyDirection[direction.upper()] for direction in directions],
        )


def ask(
    study: optuna.Study, space: Space, sampler: Mapping[str, Any], stream: str, start: Sequence[Params]
) -> tuple[optuna.Trial, dict[str, Any]]:
    """Ask for the next trial; return it, and its parameters.

    Args:
        study: as `begin_study` makes it.
        space: what is searched.
        sampler: its options.
        stream: what keys the seeds of the samplers.
        start: parameters of the first trials.
    """
    number = len(study.get_trials(deepcopy=False))
    if number < len(start):
        study.enqueue_trial(dict(start[number]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        study.sampler = _sampler(sampler, stream_seed(stream, "sampler", number) % 2**32)
        trial = study.ask()
        return trial, space.ask(lambda parameter: _suggest(trial, parameter))


def _suggest(trial: optuna.Trial, parameter: Parameter) -> Any:
    domain = parameter.domain
    if not isinstance(domain, Range):
        return trial.suggest_categorical(parameter.name, list(domain.settings_of))
    if domain.whole:
        return trial.suggest_int(parameter.name, int(domain.low), int(domain.high), log=domain.log)
    return trial.suggest_float(parameter.name, domain.low, domain.high, log=domain.log)


def distribution(parameter: Parameter) -> BaseDistribution:
    """Return what a parameter's values are drawn from."""
    domain = parameter.domain
    if not isinstance(domain, Range):
        return CategoricalDistribution(tuple(domain.settings_of))
    if domain.whole:
        return IntDistribution(int(domain.low), int(domain.high), log=domain.log)
    return FloatDistribution(domain.low, domain.high, log=domain.log)


def _sampler(options: Mapping[str, Any], seed: int) -> BaseSampler:
    """Make a sampler with every argument that changes what it suggests stated."""
    name = options["name"]
    if name == "random":
        return RandomSampler(seed=seed)
    if name == "gp":
        return GPSampler(
            seed=seed,
            independent_sampler=RandomSampler(seed=seed),
            n_startup_trials=options["startup_trials"],
            deterministic_objective=False,
            warn_independent_sampling=False,
        )
    if name == "nsga-ii":
        return NSGAIISampler(
            population_size=options["population"],
            mutation_prob=options["mutation"],
            crossover_prob=options["crossover"],
            swapping_prob=0.5,
            seed=seed,
        )
    return TPESampler(
        n_startup_trials=options["startup_trials"],
        n_ei_candidates=options["candidates"],
        seed=seed,
        multivariate=options["multivariate"],
        group=options["multivariate"],
        constant_liar=True,
    )


def _pruner(options: Mapping[str, Any]) -> BasePruner:
    name = options["name"]
    if name == "median":
        return MedianPruner(
            n_startup_trials=options["startup_trials"], n_warmup_steps=0, interval_steps=1, n_min_trials=1
        )
    if name == "wilcoxon":
        return WilcoxonPruner(p_threshold=options["threshold"], n_startup_steps=options["startup_seeds"])
    return NopPruner()
