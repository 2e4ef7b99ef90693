"""A search's record in the results folder: results/searches/NAME.json, rewritten after every generation.

A published one, results/published/searches/NAME.json, is for version control: it says what was tried and
what it came to, without what is true of one machine alone. It is read wherever the search was not run.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pneuma.errors import UserError, counted, unknown_name
from pneuma.search.record_shape import is_record
from pneuma.search.spec import Search, list_searches
from pneuma.search.trials import Task, Told
from pneuma.study.files import read_sealed, seal, to_json
from pneuma.study.store import Store
from pneuma.worlds import split_world

PUBLISHED = Path("published", "searches")
"""Where published records are, in a results folder."""
VERSIONS = ("optuna", "rules", "engines")
"""What of a search's identity is nobody's choice."""


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
    held = _held(_path(store, search.name), search.name)
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


def record_replaced(store: Store, task: Task, begin_anew: bool) -> str:
    """Say what a search is about to take the record's place of; empty where it goes on, or nothing is there.

    Args:
        store: the results folder.
        task: the search with its budget.
        begin_anew: whether trials that other versions asked for may leave the record.

    Raises:
        UserError: where the same command would have gone on with these versions, and cannot.
    """
    held = _held(_path(store, task.search.name), task.search.name)
    if not held or held["digest"] == task.digest or not held["trials"]:
        return ""
    own = json.loads(to_json(task.identity))
    changed = [key for key in own if held["identity"].get(key) != own[key]]
    count = counted(len(held["trials"]), "trial")
    versions = [key for key in changed if key in VERSIONS]
    if versions and versions == changed and not begin_anew:
        told = ", ".join(f"{key} {held['identity'].get(key)}, now {own[key]}" for key in versions)
        raise UserError(
            f"search {task.search.name}: other versions asked for its {count} ({told}), and these would ask "
            "for others: --replace begins anew"
        )
    told = (
        f"the {count} so far had other {', '.join(changed) or 'files'}, and leave the record; their runs stay"
    )
    return told if versions else f"{told}, and the same command as then brings them back"


def read_record(store: Store, name: str, called: str = "") -> dict[str, Any]:
    """Return a search's record: of its run here, else the published one.

    Args:
        store: the results folder.
        name: what the record is called.
        called: what a person called the search, where that is the path of its file.

    Raises:
        UserError: where it was never run here nor published, or its record is damaged.
    """
    path, published = _path(store, name), published_path(store, name)
    own = _held(path, name)
    if own and own["trials"]:
        return own
    if (own or not path.exists()) and (document := _held(published, name) or own):
        return document  # a search that has only begun hides nothing
    if path.exists() or path.is_symlink():
        raise UserError(
            f"{path}: damaged; `pneuma search run {called or name}` writes it anew and trains nothing twice"
        )
    if published.exists():
        raise UserError(f"{published}: damaged; take it from version control again")
    if not called and split_world(name)[0] not in list_searches():
        raise unknown_name("search", name, sorted({*list_searches(), *known_searches(store)}))
    raise UserError(
        f"search {name} was not run in {store.root}: run `pneuma search run {called or name}` first, "
        "or name the folder with --results"
    )


def known_searches(store: Store) -> list[str]:
    """Return the names of the searches that were run here, or published."""
    folders = (store.root / "searches", store.root / PUBLISHED)
    names = {path.stem for folder in folders for path in folder.glob("*.json")}
    return sorted(name for name in names if not name.startswith("sensitivity-"))


def publish_record(store: Store, name: str, *, called: str = "", replace: bool = False) -> Path:
    """Write the record of a search that has ended here where version control keeps it; return the path.

    Args:
        store: the results folder.
        name: what the record is called.
        called: what a person called the search, where that is the path of its file.
        replace: whether other trials that were published before may be lost.

    Raises:
        UserError: where it was not run here, not to its end, or what was published would be lost.
    """
    record, path = read_record(store, name, called), published_path(store, name)
    if is_published(record):
        raise UserError(f"search {name}: is published, and was not run in {store.root}")
    refuse_unfinished(record)
    document = {**record, "path": Path(record["path"]).name, "storage": "", "optuna_study": ""}
    before = _held(path, name)
    goes_on = before and before["digest"] == record["digest"] and _goes_on(record["trials"], before["trials"])
    if path.exists() and not goes_on and not replace:
        raise UserError(f"{path}: holds other trials, or is damaged; --replace puts these in their place")
    store.write(path, seal(document))
    return path


def refuse_unfinished(record: Mapping[str, Any]) -> None:
    """Refuse a search that has not been run to its end.

    Raises:
        UserError: saying how far it is.
    """
    if len(record["trials"]) < record["trials_asked"]:
        told = f"{len(record['trials'])} of {record['trials_asked']} trials"
        raise UserError(f"search {record['search']}: has {told}; `pneuma search run` it to its end first")


def is_published(record: Mapping[str, Any]) -> bool:
    """Tell whether a record is a published one, of a search that may never have run here."""
    return not record["storage"]


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


def published_path(store: Store, name: str) -> Path:
    """Return where the published record of a search is, or would be."""
    return store.root / PUBLISHED / f"{name}.json"


def _path(store: Store, name: str) -> Path:
    return store.root / "searches" / f"{name}.json"


def _held(path: Path, name: str) -> dict[str, Any] | None:
    """Return the record of a search that a path has; None where there is none, or not as it was written."""
    document = None if path.is_symlink() or path.parent.is_symlink() else read_sealed(path)
    return document if document and document.get("search") == name and is_record(document) else None


def _goes_on(held: Sequence[Mapping[str, Any]], trials: Sequence[Mapping[str, Any]]) -> bool:
    return len(held) >= len(trials) and to_json(held[: len(trials)]) == to_json(trials)
