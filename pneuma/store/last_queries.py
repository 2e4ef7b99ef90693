"""The query of each study's last `study run` in a results folder, by world.

    results/last/STUDY.json: by world the preset, seeds, steps, conditions and changed fields

Commands that read runs use this query by default.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pydantic import TypeAdapter, ValidationError
from typing_extensions import TypedDict

from pneuma.config import Steps
from pneuma.errors import UserError
from pneuma.files import dump_checksummed, load_checksummed, names_in
from pneuma.store.store import Store
from pneuma.study.plan import Plan, Query
from pneuma.study.spec import LAST, Seeds
from pneuma.values import read_settings, setting_words


class _Note(TypedDict):
    preset: str
    seeds: Seeds | None
    steps: Steps | None
    conditions: tuple[str, ...]
    settings: list[str]


def note_query(store: Store, plan: Plan) -> None:
    """Note a plan's query as the last one of its study and world."""
    query, study = plan.query, plan.study
    query_note = {
        "preset": plan.preset,
        "seeds": query.seeds,
        "steps": query.steps,
        "conditions": query.conditions,
        "settings": setting_words(query.settings),
    }
    _write(store, study.name, {**_notes(store, study.name), study.world: query_note})


def forget_query(store: Store, study: str, world: str) -> None:
    """Forget the last query of a study in a world."""
    notes_by_world = _notes(store, study)
    notes_by_world.pop(world, None)
    _write(store, study, notes_by_world)


def last_query(store: Store, study: str, world: str) -> Query | None:
    """Return the last query of a study in a world; None without one that this version can read."""
    try:
        query_note = TypeAdapter(_Note).validate_python(_notes(store, study).get(world))
        settings = read_settings(query_note["settings"])
    except (ValidationError, UserError):
        return None
    query_fields: dict[str, Any] = {**query_note, "settings": settings}
    return Query(study=study, world=world, **query_fields)


def on_top_of_last(store: Store, study: str, world: str, query: Query) -> Query:
    """Return the last query of a study in a world, changed by the values of another query.

    Raises:
        UserError: if the study was not run there.
    """
    noted_query = last_query(store, study, world)
    if noted_query is None:
        raise UserError(f"{study}@{LAST}: was not run in {store.root} yet; run the study first")
    changes = {name: value for name, value in vars(query).items() if value and name != "preset"}
    return replace(noted_query, **changes)


def noted_studies(store: Store) -> list[tuple[str, str]]:
    """Return each study and world that was run here."""
    studies_and_worlds = []
    for file_name in names_in(store.root / "last"):
        study = file_name.removesuffix(".json")
        if study != file_name:
            studies_and_worlds += [(study, world) for world in _notes(store, study)]
    return studies_and_worlds


def _notes(store: Store, study: str) -> dict[str, Any]:
    return load_checksummed(store.last_path(study)) or {}


def _write(store: Store, study: str, notes_by_world: Mapping[str, Any]) -> None:
    note_path = store.last_path(study)
    if notes_by_world:
        store.write(note_path, dump_checksummed(notes_by_world))
    else:
        store.remove(note_path)
