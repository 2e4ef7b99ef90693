"""A search's SQLite file for optuna-dashboard.

It is written, never read back as truth: it begins empty at every run of the search and gets the trials that
have ended, in order, so none is ever left running. What a search knows is in its stored runs.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import optuna
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState, create_trial
from sqlalchemy.pool import NullPool

from pneuma.errors import UserError
from pneuma.search.sampling import distribution
from pneuma.search.space import Space
from pneuma.search.spec import Objective
from pneuma.search.trials import Task, Told

STATES = {"complete": TrialState.COMPLETE, "pruned": TrialState.PRUNED, "failed": TrialState.FAIL}


class Database:
    """The file of one search.

    Args:
        task: the search.
        folder: where the file is.

    Raises:
        UserError: when what is in its place cannot be removed.
    """

    def __init__(self, task: Task, folder: Path) -> None:
        self._space = task.search.space
        self.url = f"sqlite:///{_new_file(folder / f'{task.search.name}.db')}"
        self.name = f"{task.search.name}-{task.digest}"
        self._study = create_study(task.search.objectives, open_storage(self.url), self.name)

    def save(self, told: Sequence[Told]) -> None:
        """Add the trials that are not in it yet; `told` are all of the search so far, in order."""
        held = len(self._study.get_trials(deepcopy=False))
        self._study.add_trials([frozen_trial(own, self._space, own.values) for own in told[held:]])


def create_study(
    objectives: Sequence[Objective], storage: optuna.storages.BaseStorage, name: str
) -> optuna.Study:
    """Return a new study of Optuna's for objectives."""
    study = optuna.create_study(
        storage=storage,
        study_name=name,
        directions=[StudyDirection[objective.direction.upper()] for objective in objectives],
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
        study.set_metric_names([objective.name for objective in objectives])
    return study


def open_storage(url: str) -> optuna.storages.RDBStorage:
    """Open a database for Optuna that keeps no connection while it is not asked: nobody would close it."""
    return optuna.storages.RDBStorage(url, engine_kwargs={"poolclass": NullPool})


def frozen_trial(told: Told, space: Space, values: Sequence[float]) -> FrozenTrial:
    """Return a trial that has ended as Optuna has it."""
    return create_trial(
        state=STATES[told.state],
        values=list(values) if told.state == "complete" else None,
        params=dict(told.params),
        distributions={name: distribution(space.parameter(name)) for name in told.params},
        user_attrs={"runs": list(told.run_ids), "note": told.note},
        intermediate_values=dict(told.rungs),
    )


def _new_file(path: Path) -> Path:
    """Return a path, and remove what is there and beside it.

    SQLite obeys a journal that lies beside a file, which could have it delete any other.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    for ending in ("", "-journal", "-wal", "-shm"):
        file = Path(f"{path}{ending}")
        try:
            file.unlink(missing_ok=True)
        except OSError as error:
            raise UserError(f"{file}: cannot be removed ({error.strerror})") from None
    return path.resolve()
