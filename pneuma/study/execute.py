"""Execute a plan: train what is not in the store yet, and record the selection.

Plan → groups of runs → executor → store
"""

from __future__ import annotations

import json
import statistics
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from importlib import import_module
from typing import Any

from pneuma.config import Run, as_settings, env_config
from pneuma.study.executors import local
from pneuma.study.plan import Cell, Plan, Selection
from pneuma.study.store import Status, Store


@dataclass(frozen=True)
class Outcome:
    """How one cell stands after `execute`; `trained` says whether this call trained it."""

    cell: Cell
    status: Status
    trained: bool


@dataclass(frozen=True)
class Progress:
    """Sent while a plan is executed: a cell's steps, and its status once it has ended."""

    cell: Cell
    step: int
    status: str = ""


OnProgress = Callable[[Progress], None]


def prepare(plan: Plan, store: Store) -> dict[str, Run]:
    """Check all that can be checked, record the selection, and return the runs to train, by id.

    Raises:
        UserError: before anything is written, for an environment that cannot be made or a results
            folder that cannot be written.
    """
    todo = missing(plan, store)
    check_environments(list(todo.values()))
    store.check_writable()
    store.save_selection(plan.study.name, selection_record(plan))
    return todo


def execute(
    plan: Plan, todo: Mapping[str, Run], store: Store, workers: int, on_progress: OnProgress
) -> list[Outcome]:
    """Train the runs that `prepare` returned; return the outcomes of all the plan's cells."""
    cells: dict[str, list[Cell]] = {}
    for cell in plan.cells:
        cells.setdefault(cell.run_id, []).append(cell)

    def report(event: local.Event) -> None:
        for cell in cells[event["run_id"]]:
            on_progress(Progress(cell, event["step"], event.get("status", "")))

    local.run_groups([{name: run} for name, run in todo.items()], store, workers, report)
    return [Outcome(cell, store.status(cell.run_id), cell.run_id in todo) for cell in plan.cells]


def missing(plan: Plan, store: Store) -> dict[str, Run]:
    """Return the plan's runs that are not finished in the store, by id, each once."""
    return {cell.run_id: cell.run for cell in plan.cells if not store.status(cell.run_id).finished}


def check_environments(runs: list[Run]) -> None:
    """Make every environment of the runs once, so that its mistakes show before anything is written."""
    configs = {env_config(run) for run in runs}
    if configs:
        worlds = import_module("pneuma.env.worlds")
        for config in configs:
            worlds.Worlds(1, config)


def selection_record(plan: Plan) -> dict[str, Any]:
    """Return what `results/studies/NAME.json` holds of a plan."""
    return {
        "study": plan.study.name,
        "path": plan.study.own_path,
        "title": plan.study.title,
        "figure": plan.study.figure,
        "baseline": plan.study.baseline,
        "same": [list(names) for names in plan.same],
        "selection": asdict(plan.selection),
        "saved": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "runs": [
            {
                "condition": cell.condition,
                "seed": cell.seed,
                "run_id": cell.run_id,
                "run": as_settings(cell.run),
            }
            for cell in plan.cells
        ],
    }


def expected_seconds(plan: Plan, store: Store) -> dict[str, float | None]:
    """Return how long each run of a plan takes here, by id, judged by stored ones; None without any.

    A run is judged by the finished runs of its condition, or failing that by all of the plan's.
    """
    rates: dict[str, list[float]] = {}
    for cell in plan.cells:
        if store.status(cell.run_id).finished:
            seconds = json.loads(store.read_file(cell.run_id, "provenance.json"))["wall_seconds"]
            for group in (cell.condition, ""):
                rates.setdefault(group, []).append(seconds / cell.run.steps)
    known = {group: statistics.fmean(own) for group, own in rates.items()}
    rate = {cell.run_id: known.get(cell.condition, known.get("")) for cell in plan.cells}
    return {cell.run_id: r and r * cell.run.steps for cell in plan.cells for r in [rate[cell.run_id]]}


def recorded_selection(record: Mapping[str, Any]) -> Selection:
    """Return the selection that a study's record was made from."""
    kept = record["selection"]
    seeds = kept["seeds"]
    return Selection(
        **{
            **kept,
            "seeds": None if seeds is None else tuple(seeds),
            "conditions": tuple(kept["conditions"]),
        }
    )
