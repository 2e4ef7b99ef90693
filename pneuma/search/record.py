"""A search's record in the results folder: results/searches/NAME.json, rewritten after every generation."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pneuma.errors import UserError, unknown_name
from pneuma.search.record_shape import is_record
from pneuma.search.spec import Search, list_searches
from pneuma.search.trials import Task, Told
from pneuma.study.definition import split_setting
from pneuma.study.files import read_sealed, seal, to_json
from pneuma.study.store import Store


def save_record(store: Store, task: Task, told: Sequence[Told], storage: str, optuna_study: str) -> None:
    """Write a search's record, unless the one that is there goes on from these very trials.

    Args:
        store: the results folder.
        task: the search with its budget.
        told: its trials so far; while a stopped search is replayed, the record already holds more.
        storage: where optuna-dashboard finds it, without its password.
        optuna_study: what it is called there.

    Raises:
        UserError: when the folder cannot be written.
    """
    search, budget = task.search, task.budget
    trials = [trial_document(trial, search) for trial in told]
    held = _held(store, search.name)
    if held and held["digest"] == task.digest and _goes_on(held["trials"], trials):
        asked = max(budget.trials, len(held["trials"]))
        store.write(
            _path(store, search.name),
            seal({**held, "trials_asked": asked, "storage": storage, "optuna_study": optuna_study}),
        )
        return
    document = {
        "search": search.name,
        "title": search.title,
        "section": search.section,
        "path": str(search.path.resolve()),
        "digest": task.digest,
        "identity": task.identity,
        "trials_asked": budget.trials,
        "seeds": list(budget.seeds),
        "steps": budget.steps,
        "storage": storage,
        "optuna_study": optuna_study,
        "trials": trials,
        "best": best_number(told, task.search),
    }
    store.write(_path(store, search.name), seal(document))


def read_record(store: Store, name: str, called: str = "") -> dict[str, Any]:
    """Return a search's record.

    Args:
        store: the results folder.
        name: what the record is called.
        called: what a person called the search, where that is the path of its file.

    Raises:
        UserError: where it was never run here, or its record is damaged.
    """
    path = _path(store, name)
    document = _held(store, name)
    if document:
        return document
    if path.exists() or path.is_symlink():
        raise UserError(
            f"{path}: damaged; `pneuma search run {called or name}` writes it anew and trains nothing twice"
        )
    if not called and split_setting(name)[0] not in list_searches():
        raise unknown_name("search", name, sorted({*list_searches(), *known_searches(store)}))
    raise UserError(
        f"search {name} was not run in {store.root}: run `pneuma search run {called or name}` first, "
        "or name the folder with --results"
    )


def known_searches(store: Store) -> list[str]:
    """Return the names of the searches that were run here."""
    names = (path.stem for path in (store.root / "searches").glob("*.json"))
    return sorted(name for name in names if not name.startswith("sensitivity-"))


def check_folder(store: Store) -> None:
    """Make the folder of searches if need be.

    Raises:
        UserError: where it is none, or a link out of the results.
    """
    folder = store.root / "searches"
    if not folder.resolve().is_relative_to(store.root.resolve()):
        raise UserError(f"{folder}: is a link out of the results folder; link the whole folder instead")
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise UserError(f"{folder}: cannot be written ({error.strerror})") from None


def lock_folder(store: Store, name: str) -> Path:
    """Return the folder whose lock tells that a search is under way."""
    return store.root / "searches" / f".{name}"


def trial_values(trial: Mapping[str, Any]) -> list[Any]:
    """Return a recorded trial's values, a number for each objective; of a failed trial None, once."""
    return list(trial["values"] or [None]) if "values" in trial else [trial["value"]]


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


def best_number(told: Sequence[Told], search: Search) -> int | list[int] | None:
    """Return the number of the best trial, the first of equals; of several objectives, the Pareto front."""
    complete = [trial for trial in told if trial.state == "complete"]
    signs = [1 if objective.direction == "maximize" else -1 for objective in search.objectives]
    scores = {trial.number: [s * v for s, v in zip(signs, trial.values, strict=True)] for trial in complete}
    if len(signs) > 1:
        return [number for number, own in scores.items() if not any(_beats(o, own) for o in scores.values())]
    return max(scores, key=lambda number: (scores[number], -number), default=None)


def _beats(other: Sequence[float], own: Sequence[float]) -> bool:
    """Tell whether other values are nowhere worse and somewhere better (Pareto dominance)."""
    pairs = list(zip(other, own, strict=True))
    return all(o >= v for o, v in pairs) and any(o > v for o, v in pairs)


def _path(store: Store, name: str) -> Path:
    return store.root / "searches" / f"{name}.json"


def _held(store: Store, name: str) -> dict[str, Any] | None:
    """Return the record that is there; None where there is none, or not as `save_record` writes it."""
    path = _path(store, name)
    document = None if path.is_symlink() or path.parent.is_symlink() else read_sealed(path)
    return document if document and document.get("search") == name and is_record(document) else None


def _goes_on(held: Sequence[Mapping[str, Any]], trials: Sequence[Mapping[str, Any]]) -> bool:
    return len(held) >= len(trials) and to_json(held[: len(trials)]) == to_json(trials)
