"""The part of a search that Optuna does: suggesting trials, and finding the best.

The Optuna study is in memory. Before each ask, the sampler is made again with a seed of the trial, so that a
suggestion depends only on the trials before it, and not on the number of workers or on how often the search
was stopped (Akiba et al. 2019 describe ask and tell).
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import optuna
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.exceptions import ExperimentalWarning
from optuna.samplers import BaseSampler, NSGAIISampler, RandomSampler, TPESampler
from optuna.study import StudyDirection
from optuna.trial import TrialState, create_trial

from pneuma.config import stream_seed
from pneuma.search.space import Parameter
from pneuma.search.spec import Nsga, Sampler, Search, Tpe

if TYPE_CHECKING:
    from pneuma.search.trials import EndedTrial

optuna.logging.set_verbosity(optuna.logging.ERROR)

STATES = {"complete": TrialState.COMPLETE, "pruned": TrialState.PRUNED, "failed": TrialState.FAIL}


# --- Asking ---------------------------------------------------------------------------------------


def create_study(search: Search, objectives: int | None = None) -> optuna.Study:
    """Return an in-memory study without trials, with the first so many objectives."""
    sought = search.objectives[:objectives]
    study = optuna.create_study(
        sampler=RandomSampler(seed=0),
        study_name=search.name,
        directions=[StudyDirection[objective.direction.upper()] for objective in sought],
    )
    with warnings.catch_warnings(action="ignore", category=ExperimentalWarning):
        study.set_metric_names([f"{objective.outcome}, {objective.over_seeds}" for objective in sought])
    return study


def ask(
    study: optuna.Study, search: Search, first_trials: Sequence[Mapping[str, Any]]
) -> tuple[optuna.Trial, dict[str, Any]]:
    """Ask a study for the next trial; return it and its parameters."""
    number = len(study.get_trials(deepcopy=False))
    if number < len(first_trials):
        study.enqueue_trial(dict(first_trials[number]))
    with warnings.catch_warnings(action="ignore", category=ExperimentalWarning):
        study.sampler = _sampler(search.spec.sampler, stream_seed(search.name, "sampler", number) % 2**32)
        trial = study.ask()
        return trial, search.space.ask(lambda parameter: _suggest(trial, parameter))


def _suggest(trial: optuna.Trial, parameter: Parameter) -> Any:
    if parameter.choices:
        return trial.suggest_categorical(parameter.name, [*parameter.choices])
    low, high = parameter.extremes
    suggest = trial.suggest_int if parameter.whole else trial.suggest_float
    return suggest(parameter.name, low, high, log=parameter.log)


def _sampler(options: Sampler, seed: int) -> BaseSampler:
    """Return a sampler, with every argument that affects its suggestions set explicitly."""
    if isinstance(options, Tpe):
        return TPESampler(
            n_startup_trials=options.startup_trials,
            n_ei_candidates=options.candidates,
            seed=seed,
            multivariate=options.multivariate,
            group=options.multivariate,
            constant_liar=True,
        )
    if isinstance(options, Nsga):
        return NSGAIISampler(
            population_size=options.population,
            mutation_prob=options.mutation,
            crossover_prob=options.crossover,
            swapping_prob=0.5,
            seed=seed,
        )
    return RandomSampler(seed=seed)


# --- What has ended -------------------------------------------------------------------------------


def ended_study(trials: Iterable[EndedTrial], search: Search, objectives: int | None = None) -> optuna.Study:
    """Return a study in memory of trials that have ended, with the values of the first so many objectives.

    Raises:
        ValueError: for a parameter or value that is not in the search space.
    """
    study = create_study(search, objectives)
    parameters = {parameter.name: _distribution(parameter) for parameter in search.space.parameters}
    study.add_trials(
        create_trial(
            state=STATES[trial.state],
            values=list(trial.values[:objectives]) if trial.state == "complete" else None,
            params=dict(trial.params),
            distributions={name: parameters[name] for name in trial.params},
            intermediate_values=dict(trial.rungs),
        )
        for trial in trials
    )
    return study


def _distribution(parameter: Parameter) -> BaseDistribution:
    if parameter.choices:
        return CategoricalDistribution([*parameter.choices])
    low, high = parameter.extremes
    kind = IntDistribution if parameter.whole else FloatDistribution
    return kind(low, high, log=parameter.log)
