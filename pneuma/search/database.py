"""A search's Optuna storage: what optuna-dashboard opens.

It is written, never read back as truth: only trials that have ended are in it, in order, so none is ever
left running. What is missing is added; the search's own file is written anew from the stored runs.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import optuna
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState, create_trial
from sqlalchemy.pool import NullPool

from pneuma.errors import UserError
from pneuma.search.sampling import distribution
from pneuma.search.space import Space
from pneuma.search.trials import Task, Told

OWNER = "pneuma"
"""The user attribute of an Optuna study that tells whose it is."""
STATES = {"complete": TrialState.COMPLETE, "pruned": TrialState.PRUNED, "failed": TrialState.FAIL}


class Database:
    """The storage of one search.

    Args:
        task: the search.
        url: of the storage; None for an SQLite file, which begins empty.
        folder: where that file is.

    Raises:
        UserError: when it cannot be opened, or holds another search of this name.
    """

    def __init__(self, task: Task, url: str | None, folder: Path) -> None:
        self._task = task
        self.url = url or f"sqlite:///{_new_file(folder / f'{task.search.name}.db')}"
        self._where = f"--storage {self.shown_url}" if url else self.shown_url
        self.name = f"{task.search.name}-{task.digest}"
        with self._told():
            self._study = self._load()

    @property
    def shown_url(self) -> str:
        """Return the storage's URL without its password."""
        return without_password(self.url)

    def save(self, told: Sequence[Told]) -> None:
        """Add the trials that are not in it yet.

        Args:
            told: all trials of the search so far, in order.

        Raises:
            UserError: where it holds other trials, or does not answer.
        """
        space = self._task.search.space
        with self._told():
            held = self._study.get_trials(deepcopy=False)
            frozen = [frozen_trial(own, space, own.values) for own in told]
            if any(_essence(one) != _essence(other) for one, other in zip(held, frozen, strict=False)):
                raise self._foreign()
            self._study.add_trials(frozen[len(held) :])

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Tell in one line what a database's driver raises."""
        try:
            yield
        except UserError:
            raise
        except Exception as error:  # each driver has kinds of its own
            first = (str(error).strip() or type(error).__name__).splitlines()[0]
            raise UserError(f"{self._where}: {first.replace(self.url, self.shown_url)}") from None

    def _load(self) -> optuna.Study:
        objectives = self._task.search.objectives
        study = optuna.create_study(
            storage=open_storage(self.url),
            study_name=self.name,
            directions=[StudyDirection[objective.direction.upper()] for objective in objectives],
            load_if_exists=True,
        )
        if OWNER not in study.user_attrs and not study.get_trials(deepcopy=False):
            study.set_user_attr(OWNER, self._task.digest)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
                study.set_metric_names([objective.name for objective in objectives])
        if study.user_attrs.get(OWNER) != self._task.digest:
            raise self._foreign()
        return study

    def _foreign(self) -> UserError:
        return UserError(
            f"{self._where}: its study {self.name} holds another search; "
            "name another storage with --storage, or another folder with --results"
        )


def open_storage(url: str) -> optuna.storages.RDBStorage:
    """Open a database for Optuna that keeps no connection while it is not asked: nobody would close it."""
    return optuna.storages.RDBStorage(url, engine_kwargs={"poolclass": NullPool})


def without_password(url: str) -> str:
    """Return a URL without user, password and options, which may hold one too."""
    scheme, colon, rest = url.partition("://")
    if not rest.startswith("/"):  # else it is a file, whose path may hold an @
        rest = rest.rsplit("@", 1)[-1]
    return f"{scheme}{colon}{rest.partition('?')[0]}"


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


def _essence(trial: FrozenTrial) -> tuple[Any, ...]:
    return trial.state, trial.params, trial.values


def _new_file(path: Path) -> Path:
    """Return the path of the search's own SQLite file, and remove what is there: its trials are in the runs.

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
