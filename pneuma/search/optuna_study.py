"""What Optuna does of a search: asking for trials, and showing those that have ended.

The study that asks lives in memory. Before each ask the sampler is made anew with a seed of the trial's
own, so that what is suggested depends on the trials told before and on nothing else: not on the number
of workers, nor on how often the search was stopped (Akiba et al. 2019 describe ask and tell).

The journal file, for optuna-dashboard, is written and never read back: what a search knows is in its runs.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import optuna
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.exceptions import ExperimentalWarning
from optuna.pruners import MedianPruner, NopPruner
from optuna.samplers import BaseSampler, NSGAIISampler, RandomSampler, TPESampler
from optuna.storages.journal import JournalFileBackend
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState, create_trial

from pneuma.config import stream_seed
from pneuma.search.space import Parameter, Range
from pneuma.search.spec import Search

if TYPE_CHECKING:
    from pneuma.search.trials import Told

optuna.logging.set_verbosity(optuna.logging.ERROR)

STATES = {"complete": TrialState.COMPLETE, "pruned": TrialState.PRUNED, "failed": TrialState.FAIL}


# --- Asking ---------------------------------------------------------------------------------------


def create_study(
    search: Search, objectives: int | None = None, storage: optuna.storages.BaseStorage | None = None
) -> optuna.Study:
    """Return a study without trials, of the first so many objectives: in memory, or in a storage."""
    sought, pruner = search.objectives[:objectives], search.pruner
    study = optuna.create_study(
        storage=storage or optuna.storages.InMemoryStorage(),
        sampler=RandomSampler(seed=0),
        pruner=MedianPruner(pruner["startup_trials"], n_min_trials=1) if pruner["name"] else NopPruner(),
        study_name=search.name,
        directions=[StudyDirection[own.direction.upper()] for own in sought],
    )
    with warnings.catch_warnings(action="ignore", category=ExperimentalWarning):
        study.set_metric_names([f"{own.outcome}, {own.over_seeds}" for own in sought])
    return study


def ask(
    study: optuna.Study, search: Search, first_trials: Sequence[Mapping[str, Any]]
) -> tuple[optuna.Trial, dict[str, Any]]:
    """Ask a study in memory for the next trial; return it, and its parameters."""
    number = len(study.get_trials(deepcopy=False))
    if number < len(first_trials):
        study.enqueue_trial(dict(first_trials[number]))
    with warnings.catch_warnings(action="ignore", category=ExperimentalWarning):
        study.sampler = _sampler(search.sampler, stream_seed(search.name, "sampler", number) % 2**32)
        trial = study.ask()
        return trial, search.space.ask(lambda parameter: _suggest(trial, parameter))


def _suggest(trial: optuna.Trial, parameter: Parameter) -> Any:
    domain = parameter.domain
    if not isinstance(domain, Range):
        return trial.suggest_categorical(parameter.name, list(domain.settings_of))
    if domain.whole:
        return trial.suggest_int(parameter.name, int(domain.low), int(domain.high), log=domain.log)
    return trial.suggest_float(parameter.name, domain.low, domain.high, log=domain.log)


def _sampler(options: Mapping[str, Any], seed: int) -> BaseSampler:
    """Make a sampler with every argument that changes what it suggests stated."""
    if options["name"] == "random":
        return RandomSampler(seed=seed)
    if options["name"] == "nsga-ii":
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


# --- Showing --------------------------------------------------------------------------------------


def ended_study(told: Iterable[Told], search: Search, objectives: int | None = None) -> optuna.Study:
    """Return a study in memory of trials that have ended, with the values of the first so many objectives.

    Raises:
        ValueError: for a parameter or a value that the search cannot have had.
    """
    study = create_study(search, objectives)
    study.add_trials(frozen_trials(told, search, objectives))
    return study


def new_journal(path: Path, search: Search) -> optuna.Study:
    """Return a study without trials that writes a journal file, in place of what is there."""
    for old in (path, Path(f"{path}.lock")):
        old.unlink(missing_ok=True)
    return create_study(search, storage=optuna.storages.JournalStorage(JournalFileBackend(str(path))))


def frozen_trials(told: Iterable[Told], search: Search, objectives: int | None = None) -> list[FrozenTrial]:
    """Return trials that have ended as Optuna has them."""
    parameters = {parameter.name: _distribution(parameter) for parameter in search.space.parameters}
    return [
        create_trial(
            state=STATES[trial.state],
            values=list(trial.values[:objectives]) if trial.state == "complete" else None,
            params=dict(trial.params),
            distributions={name: parameters[name] for name in trial.params},
            user_attrs={"runs": list(trial.run_ids), "note": trial.note},
            intermediate_values=dict(trial.rungs),
        )
        for trial in told
    ]


def _distribution(parameter: Parameter) -> BaseDistribution:
    domain = parameter.domain
    if not isinstance(domain, Range):
        return CategoricalDistribution(tuple(domain.settings_of))
    if domain.whole:
        return IntDistribution(int(domain.low), int(domain.high), log=domain.log)
    return FloatDistribution(domain.low, domain.high, log=domain.log)
