"""A search's trials as Optuna has them: in memory for its plots, in a journal file for optuna-dashboard.

The file is written, never read back: it begins empty at every run of the search and gets the trials that
have ended, in order. What a search knows is in its stored runs.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Sequence
from pathlib import Path

import optuna
from optuna.storages.journal import JournalFileBackend
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState, create_trial

from pneuma.search.sampling import distribution
from pneuma.search.space import Space
from pneuma.search.spec import Objective
from pneuma.search.trials import Task, Told

STATES = {"complete": TrialState.COMPLETE, "pruned": TrialState.PRUNED, "failed": TrialState.FAIL}


def new_journal(path: Path, task: Task) -> optuna.Study:
    """Return a study without trials that writes a journal file, in place of what is there."""
    for old in (path, Path(f"{path}.lock")):
        old.unlink(missing_ok=True)
    storage = optuna.storages.JournalStorage(JournalFileBackend(str(path)))
    return create_study(task.search.objectives, storage, f"{task.search.name}-{task.digest}")


def create_study(
    objectives: Sequence[Objective], storage: optuna.storages.BaseStorage, name: str
) -> optuna.Study:
    """Return a study without trials."""
    study = optuna.create_study(
        storage=storage,
        study_name=name,
        directions=[StudyDirection[objective.direction.upper()] for objective in objectives],
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        study.set_metric_names([objective.name for objective in objectives])
    return study


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
