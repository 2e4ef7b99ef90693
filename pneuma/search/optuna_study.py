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
from optuna.pruners import MedianPruner, NopPruner
from optuna.samplers import BaseSampler, NSGAIISampler, RandomSampler, TPESampler
from optuna.storages.journal import JournalFileBackend
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState, create_trial

from pneuma.config import stream_seed
from pneuma.search.space import Parameter, Params, Range, Space
from pneuma.search.spec import Objective

if TYPE_CHECKING:
    from pneuma.search.trials import Task, Told

optuna.logging.set_verbosity(optuna.logging.ERROR)

STATES = {"complete": TrialState.COMPLETE, "pruned": TrialState.PRUNED, "failed": TrialState.FAIL}


# --- Asking ---------------------------------------------------------------------------------------


def create_study(
    objectives: Sequence[Objective],
    name: str,
    storage: optuna.storages.BaseStorage | None = None,
    pruner: Mapping[str, Any] | None = None,
) -> optuna.Study:
    """Return a study without trials: in memory, or in a storage; its pruner as its options say."""
    chosen = (
        MedianPruner(pruner["startup_trials"], n_warmup_steps=0, interval_steps=1, n_min_trials=1)
        if pruner and pruner["name"]
        else NopPruner()
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        study = optuna.create_study(
            storage=storage or optuna.storages.InMemoryStorage(),
            sampler=RandomSampler(seed=0),
            pruner=chosen,
            study_name=name,
            directions=[StudyDirection[own.direction.upper()] for own in objectives],
        )
        study.set_metric_names([own.name for own in objectives])
    return study


def ask(
    study: optuna.Study, space: Space, sampler: Mapping[str, Any], stream: str, start: Sequence[Params]
) -> tuple[optuna.Trial, dict[str, Any]]:
    """Ask for the next trial; return it, and its parameters.

    Args:
        study: as `create_study` makes it, in memory.
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


# --- Showing --------------------------------------------------------------------------------------


def new_journal(path: Path, task: Task) -> optuna.Study:
    """Return a study without trials that writes a journal file, in place of what is there."""
    for old in (path, Path(f"{path}.lock")):
        old.unlink(missing_ok=True)
    storage = optuna.storages.JournalStorage(JournalFileBackend(str(path)))
    return create_study(task.search.objectives, f"{task.search.name}-{task.digest}", storage)


def frozen_trials(told: Iterable[Told], space: Space, objectives: int) -> list[FrozenTrial]:
    """Return trials that have ended as Optuna has them, with the values of so many objectives."""
    return [
        create_trial(
            state=STATES[trial.state],
            values=list(trial.values[:objectives]) if trial.state == "complete" else None,
            params=dict(trial.params),
            distributions={name: distribution(space.parameter(name)) for name in trial.params},
            user_attrs={"runs": list(trial.run_ids), "note": trial.note},
            intermediate_values=dict(trial.rungs),
        )
        for trial in told
    ]
