"""The search's Optuna storage: what optuna-dashboard opens.

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
from pneuma.search.sampling import distributions
from pneuma.search.trials import Task, Told
from pneuma.study.store import Store

OWNER = "pneuma"
"""The user attribute of an Optuna study that tells whose it is."""


class Database:
    """The storage of one search.

    Args:
        task: the search.
        url: of the storage; None for an SQLite file beside the search's record, which begins empty.
        store: the results folder.

    Raises:
        UserError: when it cannot be opened, or holds another search of this name.
    """

    def __init__(self, task: Task, url: str | None, store: Store) -> None:
        self._task = task
        self.url = url or f"sqlite:///{_new_file(store, task.search.name)}"
        self._where = f"--storage {self.shown_url}" if url else self.shown_url
        self.name = f"{task.search.name}-{task.digest}"
        with self._told():
            self._storage = open_storage(self.url)
            self._study = self._load()

    @property
    def shown_url(self) -> str:
        """Return the storage's URL without user and password."""
        return _without_password(self.url)

    @contextmanager
    def _told(self) -> Iterator[None]:
        """Tell in one line what a database's driver raises."""
        try:
            yield
        except UserError:
            raise
        except Exception as error:  # each driver has kinds of its own
            told = _first_line(error).replace(self.url, self.shown_url)
            raise UserError(f"{self._where}: {told}") from None

    def _load(self) -> optuna.Study:
        study = optuna.create_study(
            storage=self._storage,
            study_name=self.name,
            directions=[
                StudyDirection[objective.direction.upper()] for objective in self._task.search.objectives
            ],
            load_if_exists=True,
        )
        if study.user_attrs.get(OWNER, self._task.digest) != self._task.digest:
            raise self._foreign()
        if OWNER not in study.user_attrs:
            if study.get_trials(deepcopy=False):
                raise self._foreign()
            study.set_user_attr(OWNER, self._task.digest)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", optuna.exceptions.ExperimentalWarning)
                study.set_metric_names([objective.name for objective in self._task.search.objectives])
        return study

    def save(self, told: Sequence[Told]) -> None:
        """Add the trials that are not in it yet.

        Args:
            told: all trials of the search so far, in order.

        Raises:
            UserError: where it holds other trials, or does not answer.
        """
        with self._told():
            held = self._study.get_trials(deepcopy=False)
            pairs = zip(held, told, strict=False)
            if any(_essence(trial) != _essence(self._frozen(own)) for trial, own in pairs):
                raise self._foreign()
            self._study.add_trials([self._frozen(own) for own in told[len(held) :]])

    def _frozen(self, told: Told) -> FrozenTrial:
        state = {"complete": TrialState.COMPLETE, "pruned": TrialState.PRUNED, "failed": TrialState.FAIL}
        done = told.state == "complete"
        return create_trial(
            state=state[told.state],
            values=list(told.values) if done else None,
            params=dict(told.params),
            distributions=distributions(self._task.search.space, told.params),
            user_attrs={"runs": list(told.run_ids), "note": told.note},
            intermediate_values=dict(told.rungs),
        )

    def _foreign(self) -> UserError:
        return UserError(
            f"{self._where}: its study {self.name} holds another search; "
            "name another storage with --storage, or another folder with --results"
        )


def open_storage(url: str) -> optuna.storages.RDBStorage:
    """Open a database for Optuna that keeps no connection while it is not asked: nobody would close it."""
    return optuna.storages.RDBStorage(url, engine_kwargs={"poolclass": NullPool})


def _essence(trial: FrozenTrial) -> tuple[Any, ...]:
    return trial.state, trial.params, trial.values


def _new_file(store: Store, search: str) -> Path:
    """Return the path of the search's own SQLite file, and remove what is there: its trials are in the runs.

    SQLite obeys what lies beside a file: a stranger's journal there could have it delete any other.

    Raises:
        UserError: where something is no file, and nothing is removed then; or cannot be removed.
    """
    path = store.root / "searches" / f"{search}.db"
    path.parent.mkdir(parents=True, exist_ok=True)
    there = [Path(f"{path}{ending}") for ending in ("", "-journal", "-wal", "-shm")]
    for file in there:
        if file.is_symlink() or (file.exists() and not file.is_file()):
            raise UserError(f"{file}: is no file; remove it, the search makes its own")
    for file in there:
        try:
            file.unlink(missing_ok=True)
        except OSError as error:
            raise UserError(f"{file}: cannot be removed ({error.strerror})") from None
    return path.resolve()


def _without_password(url: str) -> str:
    """Return a URL without user, password and options, which may hold one too."""
    scheme, colon, rest = url.partition("://")
    if not rest.startswith("/"):  # else it is a file, whose path may hold an @
        rest = rest.rsplit("@", 1)[-1]
    return f"{scheme}{colon}{rest.partition('?')[0]}"


def _first_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
