"""Names that Optuna keeps private, all of them here: the risk of each new version.

By `ask` and `tell` alone one process begins and ends a trial. Here several processes write one trial, and
sampler and pruner decide from a copy of the study, so that they repeat their decisions.
"""

from __future__ import annotations

from typing import Any

import optuna
from optuna.distributions import BaseDistribution
from optuna.pruners import MedianPruner
from optuna.storages import BaseStorage
from optuna.storages.journal._file import BaseJournalFileLock as BaseJournalFileLock


def storage_of(study: optuna.Study) -> BaseStorage:
    return study._storage


def study_id(study: optuna.Study) -> int:
    return study._study_id


def trial_id(trial: optuna.Trial | optuna.trial.FrozenTrial) -> int:
    return trial._trial_id


def draw_value(trial: optuna.Trial, parameter_name: str, distribution: BaseDistribution) -> Any:
    return trial._suggest(parameter_name, distribution)


def contains(distribution: BaseDistribution, value: Any) -> bool:
    """Return whether a distribution has a value; ValueError for one of another type."""
    return distribution._contains(distribution.to_internal_repr(value))


def steps_of_median(pruner: MedianPruner) -> tuple[int, int]:
    """Return before which step a pruner stops no trial, and how many steps there are between its looks."""
    return pruner._n_warmup_steps, pruner._interval_steps
