"""The search's Optuna storage: what optuna-dashboard opens.

It is written, never read back as truth: only trials that have ended are in it, in order, so none is ever
left running. What is missing is added; a lost file is written anew from the stored runs.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import optuna
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial, TrialState, create_trial

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
        url: of the storage; None for an SQLite file beside the search's record.
        store: the results folder.

    Raises:
        UserError: when it cannot be opened, or holds another search of this name.
    """

    def __init__(self, task: Task, url: str | None, store: Store) -> None:
        self._task = task
        self.url = url or f"sqlite:///{self._own_file(store)}"
        self.name = f"{task.search.name}-{task.digest}"
        self._study = self._open(None if url else self._path)

    def _own_file(self, store: Store) -> Path:
        folder = store.root / "searches"
        folder.mkdir(parents=True, exist_ok=True)
        self._path = folder / f"{self._task.search.name}.db"
        if self._path.is_symlink() or not folder.resolve().is_relative_to(store.root.resolve()):
            raise UserError(f"{self._path}: a link leads out of the results folder; remove it")
        return self._path.resolve()

    def _open(self, own: Path | None) -> optuna.Study:
        try:
            return self._load()
        except UserError:
            raise
        except Exception as error:  # whatever a database's driver raises
            if own is None:
                raise UserError(f"--storage {_without_password(self.url)}: {_first_line(error)}") from None
        own.unlink(missing_ok=True)  # damaged: nothing is in it that is not in the stored runs
        return self._load()

    def _load(self) -> optuna.Study:
        study = optuna.create_study(
            storage=self.url,
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
            UserError: where it holds other trials.
        """
        held = self._study.get_trials(deepcopy=False)
        for trial, own in zip(held, told, strict=False):
            if _essence(trial) != _essence(self._frozen(own)):
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
            f"{_without_password(self.url)}: its study {self.name} holds another search; "
            "name another storage with --storage, or another folder with --results"
        )


def _essence(trial: FrozenTrial) -> tuple[Any, ...]:
    return trial.state, trial.params, trial.values


def _without_password(url: str) -> str:
    scheme, at, rest = url.partition("://")
    return f"{scheme}{at}{rest.rsplit('@', 1)[-1]}"


def _first_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0]
