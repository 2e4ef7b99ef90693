"""A search in a results folder: its runs, its record, and the lock that keeps a second process out.

The record results/searches/NAME.json is rewritten after every generation. A copy of it in
results/published/searches is for version control, and is read wherever the search was not run.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pneuma.analysis.outcomes import find_outcome, outcome
from pneuma.analysis.run_index import open_study
from pneuma.config import Run, read_settings
from pneuma.errors import UserError, counted, nearest_name
from pneuma.search.database import Database
from pneuma.search.space import Choices, Parameter, Range, Space
from pneuma.search.spec import Budget, Objective, Search, check_budget, list_searches
from pneuma.search.trials import Task, Told, Train, best_number, conduct, make_trial_plan
from pneuma.study.execute import check_environments, selection_record
from pneuma.study.files import read_sealed, seal, to_json
from pneuma.study.locks import RunLock
from pneuma.study.plan import Cell
from pneuma.study.store import Store
from pneuma.values import as_tuple
from pneuma.worlds import split_world

FOLDER, PUBLISHED = Path("searches"), Path("published", "searches")
"""Where records are, in a results folder."""
VERSIONS = ("optuna", "rules", "engines")
"""What of a search's identity nobody chooses."""


@dataclass(frozen=True)
class Searched:
    """A search as its record has it.

    Attributes:
        task: the search and its budget.
        trials: those that have ended.
        identity, digest: of the task, with the versions that it was searched with.
        storage, optuna_study: where optuna-dashboard finds it.
    """

    task: Task
    trials: tuple[Told, ...]
    identity: Mapping[str, Any]
    digest: str
    storage: str
    optuna_study: str

    @property
    def best(self) -> int | list[int] | None:
        """Return the number of the best trial; of several objectives, the Pareto front."""
        return best_number(self.trials, self.task.search)


def run_search(task: Task, store: Store, train: Train) -> Iterator[list[Told]]:
    """Search, training only runs that are not stored; yield all trials so far after every generation.

    Args:
        task: the search with its budget.
        store: the results folder, whose record is written as it goes.
        train: trains what a plan lacks.

    Raises:
        UserError: before anything is trained, for a search that cannot be done here.
        Unfinished: where a run crashed; what ended before is stored.
    """
    check_budget(task.search, task.budget)
    check_environments([run for _, run in task.search.space.corners()])
    store.check_writable()
    with _alone(task, store):
        database = Database(task, store.root / FOLDER)
        outcomes = Outcomes(task, store)
        told: list[Told] = []
        save_record(store, task, told, database.url, database.name)
        for generation in conduct(task, train, outcomes.read, outcomes.diverged):
            told += generation
            database.save(told)
            save_record(store, task, told, database.url, database.name)
            yield told


@contextmanager
def _alone(task: Task, store: Store) -> Iterator[None]:
    """Make the folder of searches, and keep a second process from searching there at the same time."""
    folder = store.root / FOLDER / f".{task.search.name}"
    if not folder.resolve().is_relative_to(store.root.resolve()):
        raise UserError(f"{folder}: leads out of the results folder; link the whole folder instead")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UserError(f"{folder}: cannot be written ({error.strerror})") from None
    with RunLock(folder) as mine:
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
        data = open_study(self._store, record, mixed=False)
        return outcome(data, data.runs[0], name)


# --- The record ------------------------------------------------------------------------------------


def save_record(store: Store, task: Task, told: Sequence[Told], storage: str, optuna_study: str) -> None:
    """Write a search's record; one that goes on from these very trials keeps what it has more.

    Args:
        store: the results folder.
        task: the search with its budget.
        told: its trials so far; while a stopped search is replayed, the record already holds more.
        storage: where optuna-dashboard finds it.
        optuna_study: what it is called there.

    Raises:
        UserError: when the folder cannot be written.
    """
    search, budget = task.search, task.budget
    path = store.root / FOLDER / f"{search.name}.json"
    trials, asked = [trial_document(trial, search) for trial in told], budget.trials
    held = read_sealed(path)
    if held and held.get("digest") == task.digest:
        before = held["trials"]
        if len(before) >= len(trials) and to_json(before[: len(trials)]) == to_json(trials):
            trials, asked = before, max(asked, len(before))
    document = {
        "search": search.name,
        "title": search.title,
        "section": search.section,
        "digest": task.digest,
        "identity": task.identity,
        "trials_asked": asked,
        "storage": storage,
        "optuna_study": optuna_study,
        "trials": trials,
    }
    store.write(path, seal(document))


def read_record(store: Store, name: str) -> Searched:
    """Return a search as it was recorded: by its run here, else by the published record.

    Args:
        store: the results folder.
        name: of the search.

    Raises:
        UserError: where it was never run here nor published, or its record is damaged.
    """
    paths = [store.root / folder / f"{name}.json" for folder in (FOLDER, PUBLISHED)]
    found = [_read(path, name) for path in paths if path.exists()]
    if found:
        return next((own for own in found if own.trials), found[0])
    own = split_world(name)[0]
    hint = "" if own in list_searches() else nearest_name(own, list_searches())
    raise UserError(
        f"search {name} was not run in {store.root}{hint}: `pneuma search run` it first, "
        "or name the folder with --results"
    )


def replaced_note(store: Store, task: Task) -> str:
    """Say what of a record a search is about to take the place of; empty where it goes on, or none is there.

    Raises:
        UserError: where it is other versions alone that ask for other trials now.
    """
    path = store.root / FOLDER / f"{task.search.name}.json"
    try:
        held = _read(path, task.search.name)
    except UserError:
        return ""
    if held.digest == task.digest or not held.trials:
        return ""
    own = json.loads(to_json(task.identity))
    changed = [key for key in own if held.identity.get(key) != own[key]]
    told = f"the {counted(len(held.trials), 'trial')} so far had other {', '.join(changed) or 'files'}"
    if changed and {*changed} <= {*VERSIONS}:
        raise UserError(f"{path}: {told}; remove it to begin anew: their runs stay")
    return f"{told}, and leave the record; their runs stay"


def trial_document(told: Told, search: Search) -> dict[str, Any]:
    """Return a trial as JSON has it: `value` with one objective, `values` with several."""
    values = list(told.values) if told.state != "failed" else None
    one = len(search.objectives) == 1
    return {
        "number": told.number,
        "params": dict(told.params),
        **({"value": values[0] if values else None} if one else {"values": values}),
        "state": told.state,
        "run_ids": list(told.run_ids),
        "rungs": {str(step): value if math.isfinite(value) else None for step, value in told.rungs.items()},
        "note": told.note,
    }


def _read(path: Path, name: str) -> Searched:
    """Return a search from its record, which may be untrusted.

    Raises:
        UserError: where it is not as it was written, or holds something else.
    """
    document = read_sealed(path)
    try:
        if document is None:
            raise ValueError
        identity, trials = document["identity"], document["trials"]
        space = Space(
            tuple(map(_read_parameter, identity["space"])),
            read_settings(Run, identity["fixed"]),
            str(identity["base"]),
        )
        search = Search(
            name=name,
            title=str(document["title"]),
            section=str(document["section"]),
            about="",
            space=space,
            objectives=tuple(Objective(**own) for own in identity["objectives"]),
            start=tuple(identity["start"]),
            start_names=(),
            generation=identity["generation"],
            sampler=identity["sampler"],
            pruner=identity["pruner"],
            presets={},
            world=split_world(name)[1],
        )
        budget = Budget(int(document["trials_asked"]), tuple(identity["seeds"]), int(identity["steps"]))
        texts = [str(document[key]) for key in ("digest", "storage", "optuna_study")]
        told = tuple(_read_trial(number, own, search) for number, own in enumerate(trials))
        return Searched(Task(search, budget), told, identity, *texts)
    except (KeyError, TypeError, ValueError, AttributeError):
        raise UserError(
            f"{path}: damaged; without it `pneuma search run` writes it anew, and trains nothing twice"
        ) from None


def _read_parameter(own: Mapping[str, Any]) -> Parameter:
    domain: Range | Choices
    if "settings_of" in own["domain"]:
        bundles = own["domain"]["settings_of"]
        domain = Choices({name: read_settings(Run, bundle) for name, bundle in bundles.items()})
    else:
        domain = Range(**own["domain"])
    when = {name: tuple(map(as_tuple, values)) for name, values in own["when"].items()}
    return Parameter(own["name"], domain, when)


def _read_trial(number: int, own: Mapping[str, Any], search: Search) -> Told:
    values = own["values"] or [] if "values" in own else [own["value"]]
    values = tuple(float(value) for value in values if value is not None)
    if own["state"] not in ("complete", "pruned", "failed") or not np.isfinite(values).all():
        raise ValueError
    if not own["params"].keys() <= {parameter.name for parameter in search.space.parameters}:
        raise ValueError
    if own["state"] != "failed" and len(values) != len(search.objectives):
        raise ValueError
    rungs = {int(step): math.nan if value is None else float(value) for step, value in own["rungs"].items()}
    return Told(
        number,
        own["params"],
        search.space.settings(own["params"]),
        own["state"],
        values,
        tuple(map(str, own["run_ids"])),
        rungs,
        str(own["note"]),
    )
