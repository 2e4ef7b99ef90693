"""A search in a results folder: its record, and the lock that keeps other processes out.

The record results/searches/NAME.json is rewritten after every generation. It contains the trials. The search
itself stands in its file, which must not have changed.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pneuma.config import Run
from pneuma.env_fields import read_fields
from pneuma.errors import UserError, counted
from pneuma.files import read_sealed, seal, to_json
from pneuma.search.optuna_study import ended_study
from pneuma.search.spec import Budget, Search, check_budget, load_search
from pneuma.search.trials import EndedTrial, Outcomes, Task, Train, best_number, conduct
from pneuma.study.execute import check_environments
from pneuma.study.locks import run_lock
from pneuma.study.store import Store

VERSIONS = ("optuna", "rules", "engines")
"""Parts of a search's identity that the user does not choose."""


@dataclass(frozen=True)
class RecordedSearch:
    """A recorded search: its file, its budget, and the trials that have ended."""

    task: Task
    trials: tuple[EndedTrial, ...]

    @property
    def best(self) -> int | list[int] | None:
        """Return the number of the best trial; of several objectives, the Pareto front."""
        return best_number(self.trials, self.task.search)


def run_search(task: Task, store: Store, train: Train) -> Iterator[list[EndedTrial]]:
    """Search, training only runs that are not stored; yield all trials after each generation.

    Args:
        task: the search with its budget.
        store: the results folder, whose record is written as it goes.
        train: trains the missing runs of a plan.

    Raises:
        UserError: before anything is trained, for a search that cannot be run here.
        Unfinished: when a run crashed; trials that ended before are stored.
    """
    search = task.search
    check_budget(search, task.budget)
    check_environments(run for _, run in search.space.corners())
    store.check_writable()
    with run_lock(store.root / "searches" / f".{search.label}") as mine:
        if not mine:
            raise UserError(f"search {search.name}: another process searches in {store.root} now")
        trials: list[EndedTrial] = []
        save_record(store, task, trials)
        for generation in conduct(task, train, Outcomes(task, store)):
            trials += generation
            save_record(store, task, trials)
            yield trials


# --- The record ------------------------------------------------------------------------------------


def record_path(store: Store, name: str) -> Path:
    return store.root / "searches" / f"{name}.json"


def save_record(store: Store, task: Task, trials: Sequence[EndedTrial]) -> None:
    """Write a search's record. While a stopped search is replayed, later trials of the record are kept."""
    path = record_path(store, task.search.label)
    documents, asked = [trial_document(trial, task.search) for trial in trials], task.budget.trials
    recorded = read_sealed(path)
    if recorded and recorded.get("digest") == task.digest:
        before = recorded["trials"]
        if len(before) >= len(documents) and to_json(before[: len(documents)]) == to_json(documents):
            documents, asked = before, max(asked, len(before))
    document = {
        "search": task.search.name,
        "file": task.search.file,
        "set": task.over,
        "digest": task.digest,
        "identity": task.identity,
        "trials_asked": asked,
        "trials": documents,
    }
    store.write(path, seal(document))


def read_record(store: Store, name: str, world: str | None = None) -> RecordedSearch:
    """Return a recorded search.

    Args:
        store: the results folder.
        name: of the search, or the path of its file.
        world: of `pneuma.worlds.WORLDS`; default: the arena.

    Raises:
        UserError: when it was never run here, its record is damaged, or its file has changed.
    """
    search = load_search(name, world)
    path = record_path(store, search.label)
    if path.exists():
        return _read(path, search)
    raise UserError(
        f"search {search.label} was not run in {store.root}: `pneuma search run` it first, "
        "or name the folder with --results"
    )


def replaced_note(store: Store, task: Task) -> str:
    """Return a note on the record that a search is about to replace; empty if there is none."""
    recorded = read_sealed(record_path(store, task.search.label)) or {}
    if recorded.get("digest") == task.digest or not recorded.get("trials"):
        return ""
    changed = ", ".join(_changed(recorded.get("identity"), task)) or "files"
    trials = counted(len(recorded["trials"]), "trial")
    return f"the {trials} so far had other {changed}, and leave the record; their runs stay"


def trial_document(trial: EndedTrial, search: Search) -> dict[str, Any]:
    """Return a trial as JSON: `value` with one objective, `values` with several."""
    values = list(trial.values) if trial.state != "failed" else None
    one = {"value": values[0] if values else None}
    return {
        "number": trial.number,
        "params": dict(trial.params),
        **(one if len(search.objectives) == 1 else {"values": values}),
        "state": trial.state,
        "run_ids": list(trial.run_ids),
        "rungs": {str(step): value if math.isfinite(value) else None for step, value in trial.rungs.items()},
        "note": trial.note,
    }


def _changed(identity: object, task: Task) -> list[str]:
    recorded = identity if isinstance(identity, dict) else {}
    return [key for key, value in json.loads(to_json(task.identity)).items() if recorded.get(key) != value]


def _read(path: Path, search: Search) -> RecordedSearch:
    """Return a search from its record, which may be untrusted, and its file."""
    document = read_sealed(path) or {}
    try:
        over = read_fields(Run, document["set"])
        identity = document["identity"]
        budget = Budget(trials=document["trials_asked"], seeds=identity["seeds"], steps=identity["steps"])
        search = search.with_settings(over)
        task = Task(search, budget, over)
        if changed := [key for key in _changed(identity, task) if key not in VERSIONS]:
            raise UserError(
                f"{path}: the search had other {', '.join(changed)} than its file has now; search again"
            )
        searched = RecordedSearch(
            task, tuple(_read_trial(i, row) for i, row in enumerate(document["trials"]))
        )
        ended_study(searched.trials, search)  # refuses parameters and values that do not fit the search
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
        raise UserError(
            f"{path}: damaged; without it `pneuma search run` writes it anew, and trains nothing twice"
        ) from None
    return searched


def _read_trial(number: int, entry: Mapping[str, Any]) -> EndedTrial:
    values = entry["values"] if "values" in entry else [entry["value"]]
    return EndedTrial(
        number=number,
        params=entry["params"],
        state=str(entry["state"]),
        values=tuple(float(value) for value in values or () if value is not None),
        run_ids=tuple(map(str, entry["run_ids"])),
        rungs={int(k): math.nan if value is None else float(value) for k, value in entry["rungs"].items()},
        note=str(entry["note"]),
    )
