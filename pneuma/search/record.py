"""A search's record in the results folder: results/searches/NAME.json, rewritten after every generation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pneuma.errors import UserError, unknown_name
from pneuma.search.space import Choices, Parameter, Range, Space
from pneuma.search.spec import Search, list_searches
from pneuma.search.trials import Task, Told
from pneuma.study.files import read_sealed, seal
from pneuma.study.store import Store


def save_record(store: Store, task: Task, told: Sequence[Told], storage: str, optuna_study: str) -> None:
    """Write a search's record.

    Raises:
        UserError: when the folder cannot be written.
    """
    search, budget = task.search, task.budget
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
        "trials": [trial_document(trial, task.search) for trial in told],
        "best": best_number(told, task.search),
    }
    store.write(_path(store, search.name), seal(document))


def read_record(store: Store, name: str) -> dict[str, Any]:
    """Return a search's record.

    Raises:
        UserError: where it was never run here, or its record is damaged.
    """
    path = _path(store, name)
    document = read_sealed(path)
    if document and isinstance(document.get("trials"), list) and document.get("search") == name:
        return document
    if path.exists():
        raise UserError(
            f"{path}: damaged; `pneuma search run {name}` writes it anew and trains nothing twice"
        )
    if name not in list_searches() and name not in known_searches(store):
        raise unknown_name("search", name, sorted({*list_searches(), *known_searches(store)}))
    raise UserError(
        f"search {name} was not run in {store.root}: run `pneuma search run {name}` first, "
        "or name the folder with --results"
    )


def known_searches(store: Store) -> list[str]:
    """Return the names of the searches that were run here."""
    return sorted(path.stem for path in (store.root / "searches").glob("*.json"))


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
        "rungs": {str(step): value for step, value in told.rungs.items()},
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


def _path(store: Store, name: str) -> Any:
    return store.root / "searches" / f"{name}.json"


def settings_of(trial: Mapping[str, Any], search: Search) -> dict[str, Any]:
    """Return what of the run a recorded trial's parameters set."""
    return search.space.settings(trial["params"])


def read_space(record: Mapping[str, Any]) -> Space:
    """Return the space of a recorded search, from what its identity holds of it.

    Raises:
        UserError: where the record, which may be a stranger's, holds none.
    """
    try:
        identity = record["identity"]
        parameters = tuple(_read_parameter(own) for own in identity["space"])
        return Space(parameters, identity["fixed"], identity["base"])
    except (KeyError, TypeError, AttributeError):
        raise UserError(
            f"the record of search {record.get('search')} is damaged: run the search again"
        ) from None


def _read_parameter(own: Mapping[str, Any]) -> Parameter:
    domain = Choices(**own["domain"]) if "settings_of" in own["domain"] else Range(**own["domain"])
    return Parameter(own["name"], domain, {name: tuple(values) for name, values in own["when"].items()})
