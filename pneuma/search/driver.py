"""A search in a results folder: what joins its trials, the stored runs, its record and its database."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec

import numpy as np

from pneuma.analysis.outcomes import find_outcome, outcome
from pneuma.analysis.run_records import RunRecords
from pneuma.analysis.tables import StudyData
from pneuma.errors import UserError, counted, install_extra
from pneuma.search.database import Database
from pneuma.search.record import check_folder, lock_folder, save_record
from pneuma.search.trials import Task, Told, Train, conduct, make_trial_plan
from pneuma.study.execute import check_environments, selection_record
from pneuma.study.locks import RunLock
from pneuma.study.plan import Cell
from pneuma.study.store import Store

OnGeneration = Callable[[list[Told], list[Told]], None]
"""Is handed the trials of a generation that has ended, and all trials so far."""


def run_search(
    task: Task, store: Store, storage: str | None, train: Train, on_generation: OnGeneration
) -> None:
    """Search, training only runs that are not stored; record and storage are written as it goes.

    Args:
        task: the search with its budget.
        store: the results folder.
        storage: URL of an Optuna storage; None for an SQLite file in the results folder.
        train: trains what a plan lacks.
        on_generation: is told of every generation.

    Raises:
        UserError: before anything is trained, for a search that cannot be done here.
        Unfinished: where a run crashed; what ended before is stored.
    """
    check_outcomes(task)
    check_environments([run for _, run in task.search.space.corners()])
    store.check_writable()
    check_folder(store)
    with _alone(task, store):
        database = Database(task, storage, store)
        outcomes = Outcomes(task, store)
        told: list[Told] = []
        save_record(store, task, told, database.shown_url, database.name)
        for generation in conduct(task, train, outcomes.read, outcomes.diverged):
            told += generation
            database.save(told)
            save_record(store, task, told, database.shown_url, database.name)
            on_generation(generation, told)


def check_outcomes(task: Task) -> None:
    """Refuse objectives that there are not, and a budget, pruner or sampler that they cannot do with.

    Raises:
        UserError: naming the objective, pruner or sampler.
    """
    search = task.search
    for objective in search.objectives:
        try:
            find_outcome(objective.outcome)
        except UserError as error:
            raise UserError(f"{task.search.path}: [objectives.{objective.name}] outcome: {error}") from None
        if objective.over_seeds == "deviation" and len(task.budget.seeds) < 2:
            raise UserError(f"objective {objective.name}: a deviation needs --seeds 2 at least")
    if search.pruner["name"] and len(search.objectives) > 1:
        raise UserError(f"pruner {search.pruner['name']}: goes with one objective alone")
    if search.sampler["name"] == "cma-es":
        if len(search.objectives) > 1:
            raise UserError("sampler cma-es: goes with one objective alone; tpe and nsga-ii take several")
        if find_spec("cmaes") is None:
            raise UserError(f"sampler cma-es: needs an extra package: {install_extra('cmaes')}")
    if search.pruner["name"] == "wilcoxon":
        if search.objectives[0].over_seeds == "deviation":
            raise UserError("pruner wilcoxon: compares seed by seed, which a deviation does not have")
        _refuse_too_few_pairs(len(task.budget.seeds), search.pruner["threshold"])


def _refuse_too_few_pairs(seeds: int, threshold: float) -> None:
    """Refuse a signed-rank test that can never give a trial up.

    It is made before the last seed, and the least p-value of n pairs is 2**-n.
    """
    least = math.floor(-math.log2(threshold)) + 2
    if seeds < least:
        raise UserError(
            f"pruner wilcoxon: {counted(seeds, 'seed')} cannot give a trial up at threshold {threshold:g}; "
            f"it needs {least} at least"
        )


@contextmanager
def _alone(task: Task, store: Store) -> Iterator[None]:
    """Keep a second process from searching here at the same time."""
    folder = lock_folder(store, task.search.name)
    if folder.is_symlink():
        raise UserError(f"{folder}: is a link; remove it, the search makes a folder in its place")
    with ExitStack() as held:
        try:
            mine = held.enter_context(RunLock(folder))
        except OSError as error:
            raise UserError(f"{folder}: cannot be written ({error.strerror})") from None
        if not mine:
            raise UserError(f"search {task.search.name}: another process searches in {store.root} now")
        yield


class Outcomes:
    """Outcomes of stored runs as a search counts them, each read once.

    A diverged run cannot play: it counts with the worst that its outcome can be for what is sought, where
    there is such a bound, and with its last recorded value where there is none.
    """

    def __init__(self, task: Task, store: Store) -> None:
        self._task = task
        self._store = store
        self._sought = {
            own.outcome: own.direction for own in task.search.objectives if own.over_seeds != "deviation"
        }
        self._values: dict[tuple[str, str], float] = {}

    def read(self, cell: Cell, name: str) -> float:
        """Return an outcome of a finished run."""
        key = (cell.run_id, name)
        if key not in self._values:
            self._values[key] = self._measure(cell, name)
        return self._values[key]

    def diverged(self, cell: Cell) -> bool:
        """Tell whether a finished run diverged."""
        return self._store.status(cell.run_id).name == "diverged"

    def _measure(self, cell: Cell, name: str) -> float:
        found = find_outcome(name)
        worst = found.bounds[1 if self._sought.get(name) == "minimize" else 0]
        if self.diverged(cell) and np.isfinite(worst):
            return float(worst)
        record = selection_record(make_trial_plan(self._task, [cell]))
        data = StudyData(RunRecords(self._store), record, str(self._store.root))
        return outcome(data, data.runs[0], name)
