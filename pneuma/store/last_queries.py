"""What each study's last `study run` in a results folder trained, in each world.

    results/last/STUDY.json: by world the preset, seeds, steps, conditions and changed fields

Commands that read runs take this query where none is named.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from pneuma.errors import UserError
from pneuma.files import dump_checksummed, load_checksummed, names_in
from pneuma.presets import checked_world
from pneuma.store.store import Store
from pneuma.study.plan import Plan, Query
from pneuma.study.spec import LAST
from pneuma.values import read_seeds, read_settings, seeds_option, setting_words


def note_query(store: Store, plan: Plan) -> None:
    """Note a plan's query as the last one of its study and world."""
    query = plan.query
    noted = {
        "preset": plan.preset,
        "seeds": None if query.seeds is None else seeds_option(query.seeds),
        "steps": query.steps,
        "conditions": [*query.conditions],
        "settings": setting_words(query.settings),
    }
    _write(store, plan.study.name, {**_noted(store, plan.study.name), plan.study.world: noted})


def forget_query(store: Store, study: str, world: str) -> None:
    """Forget the last query of a study in a world."""
    noted = _noted(store, study)
    noted.pop(world, None)
    _write(store, study, noted)


def last_query(store: Store, study: str, world: str) -> Query | None:
    """Return the last query of a study in a world; None if there is none, or its record is damaged."""
    noted = _noted(store, study).get(world)
    if not isinstance(noted, Mapping):
        return None
    try:
        return _read_query(study, world, noted)
    except (KeyError, ValueError, TypeError, AttributeError, UserError):
        return None


def on_top_of_last(store: Store, study: str, world: str, query: Query) -> Query:
    """Return the last query of a study in a world, with what another query asks for in its place.

    Raises:
        UserError: if the study was not run there.
    """
    last = last_query(store, study, world)
    if last is None:
        raise UserError(f"{study}@{LAST}: it was not run in {store.root} yet")
    given = {name: value for name, value in vars(query).items() if value and name != "preset"}
    return replace(last, **given)


def noted_studies(store: Store) -> list[tuple[str, str]]:
    """Return each study and world that was run here."""
    return [(study, world) for study in _noted_names(store) for world in _noted(store, study)]


def _read_query(study: str, world: str, noted: Mapping[str, Any]) -> Query:
    """Read a record, which may be untrusted."""
    seeds, steps, preset = noted["seeds"], noted["steps"], noted["preset"]
    if not (isinstance(preset, str) and (steps is None or (type(steps) is int and steps > 0))):
        raise ValueError
    return Query(
        study=study,
        world=checked_world(world),
        preset=preset,
        seeds=None if seeds is None else read_seeds(seeds),
        steps=steps,
        conditions=tuple(str(name) for name in noted["conditions"]),
        settings=read_settings(noted["settings"]),
    )


def _noted_names(store: Store) -> list[str]:
    names = names_in(store.root / "last")
    return [name.removesuffix(".json") for name in names if name.endswith(".json")]


def _noted(store: Store, study: str) -> dict[str, Any]:
    noted = load_checksummed(store.last_path(study)) or {}
    noted.pop("schema", None)
    return noted


def _write(store: Store, study: str, noted: Mapping[str, Any]) -> None:
    path = store.last_path(study)
    if noted:
        store.write(path, dump_checksummed(noted))
    else:
        store.remove(path)
