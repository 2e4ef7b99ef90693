"""Execute a plan: train what is not in the store yet, and record the selection.

Plan → groups of runs → executor → store
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from typing import Any

from pneuma.config import Run, as_settings, env_config
from pneuma.study.executors import local
from pneuma.study.plan import Cell, Plan
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


def execute(plan: Plan, store: Store, workers: int, on_progress: OnProgress) -> list[Outcome]:
    """Train the plan's cells that are not finished in the store; return all cells' outcomes.

    Raises:
        UserError: before anything is written, for an environment that cannot be made or a results
            folder that cannot be written.
    """
    todo = missing(plan, store)
    check_environments(list(todo.values()))
    store.check_writable()
    store.save_selection(plan.study.name, selection_record(plan))

    def report(event: local.Event) -> None:
        name = event["run_id"]
        for cell in plan.cells:
            if cell.run_id == name:
                on_progress(Progress(cell, event["step"], event.get("status", "")))

    local.run_groups([[run] for run in todo.values()], store, workers, report)
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
        "path": str(plan.study.path.resolve()),
        "title": plan.study.title,
        "figure": plan.study.figure,
        "baseline": plan.study.baseline,
        "same": [list(names) for names in plan.same],
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


def read_selection(record: Mapping[str, Any]) -> list[tuple[str, int, str]]:
    """Return (condition, seed, run id) of every run of a recorded selection."""
    return [(run["condition"], run["seed"], run["run_id"]) for run in record["runs"]]
