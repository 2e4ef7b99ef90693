"""Which studies stored runs belong to: the other way round than `asked.py`.

RunIndex → studies, worlds and conditions of each run; or the studies of which a folder has runs
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pneuma.analysis.run_index import Entry, RunIndex
from pneuma.errors import UserError
from pneuma.study.plan import Configurations, configure
from pneuma.study.spec import list_studies, load_study


def _known_studies(index: RunIndex, world: str | None = None) -> Iterator[Configurations]:
    """Yield the shipped studies, and those whose files are in this folder, in each of their worlds.

    Files that cannot be read are left out.
    """
    own = sorted(path.name for path in Path().glob("*.toml"))
    for name in [*list_studies(), *own]:
        try:
            study = load_study(name)
            for each in study.worlds:
                if world in (None, each):
                    yield configure(study.in_world(each), {}, engine=index.engine_of)
        except (UserError, OSError):
            continue


def holders(index: RunIndex) -> dict[str, list[dict[str, Any]]]:
    """Return the studies, worlds and conditions of each run in the results folder, by its id."""
    found: dict[str, list[dict[str, Any]]] = {}
    for known in _known_studies(index):
        study = known.study
        for condition, run in known.runs.items():
            for entry in index.of_run(run):
                held = {"study": study.name, "world": study.world, "condition": condition, "seed": entry.seed}
                found.setdefault(entry.run_id, []).append(held)
    for name in index.listings():
        for run in (index.listing(name) or {"runs": ()})["runs"]:
            held = {"study": name, "condition": run["condition"], "seed": run["seed"]}
            found.setdefault(run["run_id"], []).append(held)
    return found


@dataclass(frozen=True)
class Held:
    """What a results folder has of a study in a world.

    Attributes:
        name: the study's name, or its file.
        world: empty for a study without a file.
        whole: whether every condition has a finished run there.
    """

    name: str
    world: str
    entries: Sequence[Entry]
    whole: bool


def studies_here(index: RunIndex, world: str | None = None) -> list[Held]:
    """Return the studies of which the results folder itself has runs, in one world or in all."""
    found = []
    for known in _known_studies(index, world):
        of_each = {
            condition: [e for e in index.of_run(run) if e.table is None]
            for condition, run in known.runs.items()
        }
        entries = {entry.run_id: entry for each in of_each.values() for entry in each}
        if entries:
            whole = all(any(entry.finished for entry in each) for each in of_each.values())
            file = known.study.own_path or known.study.name
            found.append(Held(file, known.study.world, [*entries.values()], whole))
    for name in index.store.listings() if world is None else ():
        listed = (run["run_id"] for run in (index.listing(name) or {"runs": ()})["runs"])
        entries = {run_id: index.entries[run_id] for run_id in listed if run_id in index.entries}
        found.append(Held(name, "", [*entries.values()], any(e.finished for e in entries.values())))
    return found
