"""Execute a plan: train the runs that are not stored yet.

Plan → groups of runs → executor → store
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from pneuma.config import FIELDS, OF_GYMNASIUM, Run, env_config, is_open
from pneuma.errors import counted
from pneuma.store.last_queries import note_query
from pneuma.store.store import Status, Store, run_identity
from pneuma.study.plan import Cell, Plan
from pneuma.training.executors.base import Event, ExecutorConfig, load_executor


@dataclass(frozen=True)
class CellResult:
    """The state of a cell after `execute`; `trained` if this call trained it."""

    cell: Cell
    status: Status
    trained: bool
    reason: str = ""


OnProgress = Callable[[Cell, Event], None]
"""Called with each event of a cell's run; `executors.base` lists the events."""

SHAPED_BY = tuple(name for name, about in FIELDS.items() if about.shapes)
"""Fields by which runs are grouped: those in which they agree likely share their compiled programs."""
MOST_IN_GROUP = 8
"""Most runs per worker process. They are locked for other commands until the process ends."""


def prepare(
    plan: Plan, store: Store, retry_failed: bool = False, until: Mapping[str, int] | None = None
) -> tuple[dict[str, Run], list[str]]:
    """Check a plan, and note its runs as planned; return those to train, by id, and notes for the user.

    `until` has the only runs to train, with the step that each is to reach, or 0 for its end. If an
    environment cannot be made, nothing is written.
    """
    statuses = {cell.run_id: store.status(cell.run_id) for cell in plan.cells}
    todo = missing(plan, statuses, retry_failed)
    if until is not None:
        from pneuma.store.checkpoints import sound_checkpoint  # pydantic: not for `--help`

        latest = {name: sound_checkpoint(store.run_folder(name)) for name in todo.keys() & until.keys()}
        reached = {name: each.step if each else 0 for name, each in latest.items()}
        todo = {
            name: run for name, run in todo.items() if name in until and not 0 < until[name] <= reached[name]
        }
    check_environments(todo.values())
    store.check_writable()
    for name, run in todo.items():
        store.plan_run(name, run_identity(run))
    if plan.query.study:
        if plan.study.path and plan.study.own_path:
            store.write(store.studies / plan.study.path.name, plan.study.path.read_bytes())
        note_query(store, plan)
    return todo, _notes(plan, statuses, todo)


def execute(
    plan: Plan, todo: Mapping[str, Run], store: Store, how: ExecutorConfig, on_progress: OnProgress
) -> list[CellResult]:
    """Train the runs that `prepare` found missing; return the plan's cells, without those only published.

    Raises:
        KeyboardInterrupt: after Ctrl-C, once every run has reached a checkpoint.
    """
    cells: dict[str, list[Cell]] = {}
    for cell in plan.cells:
        cells.setdefault(cell.run_id, []).append(cell)
    ended: dict[str, Event] = {}

    def report(event: Event) -> None:
        if event["event"] == "end":
            ended[event["run_id"]] = event
        for cell in cells[event["run_id"]]:
            on_progress(cell, event)

    if todo:
        load_executor(how).run_groups(groups(todo, how.workers), store, how, report)
    return cell_results(plan, store, todo, ended)


def cell_results(
    plan: Plan, store: Store, todo: Collection[str], ended: Mapping[str, Event] = {}
) -> list[CellResult]:
    """Return the state of a plan's cells, without those that are only published.

    The final event of a run, in `ended`, counts where the end could not be stored. Of the runs in `todo` that
    have none, the finished ones were trained.
    """
    results = []
    for cell in plan.cells:
        status, end = store.status(cell.run_id), ended.get(cell.run_id, {})
        trained = bool(end["trained"]) if end else status.finished and cell.run_id in todo
        if end and not status.finished:
            status = Status(end["status"], status.step)
        if status.finished or cell.run_id not in plan.published:
            reason = end.get("reason") or store.failure(cell.run_id)
            results.append(CellResult(cell, status, trained, reason))
    return results


def groups(todo: Mapping[str, Run], workers: int) -> list[dict[str, Run]]:
    """Divide runs among worker processes.

    Compiled runs of equal shapes share a process, so that their programs are compiled or loaded once. Groups
    stay small enough to keep every worker busy.
    """
    by_shape: dict[Any, list[tuple[str, Run]]] = {}
    for name, run in todo.items():
        shape = tuple(getattr(run, key) for key in SHAPED_BY)
        by_shape.setdefault(name if run.engine == "sb3" else shape, []).append((name, run))
    size = min(MOST_IN_GROUP, math.ceil(len(todo) / workers))
    return [
        dict(runs[first : first + size]) for runs in by_shape.values() for first in range(0, len(runs), size)
    ]


def kept_step(status: Status) -> int:
    """Return the step at which training would resume: that of its checkpoint, else 0."""
    return 0 if status.finished else status.step


def missing(plan: Plan, statuses: Mapping[str, Status], retry_failed: bool = False) -> dict[str, Run]:
    """Return the plan's runs to train, by id: not finished, published or (unless retried) failed."""
    return {
        cell.run_id: cell.run
        for cell in plan.cells
        for status in [statuses[cell.run_id]]
        if not status.finished and (retry_failed or not status.failed) and cell.run_id not in plan.published
    }


def _notes(plan: Plan, statuses: Mapping[str, Status], todo: Mapping[str, Run]) -> list[str]:
    labels = {cell.run_id: f"{cell.condition} seed {cell.seed}" for cell in plan.cells}
    notes = [
        f"{labels[name]}: {status.detail!r} is damaged; the run is trained again"
        for name, status in statuses.items()
        if status.name == "damaged" and name in todo
    ]
    published = {name for name in plan.published if not statuses[name].finished}
    if published:
        runs = counted(len(published), "published run")
        notes.append(f"{runs} not trained: figures and numbers take them from there")
    if open_ones := sum(map(is_open, todo.values())):
        runs = counted(open_ones, "run")
        notes.append(f"{runs} by a learner whose state is not stored: stopped or killed, it begins anew")
    failed = [name for name, status in statuses.items() if status.failed and name not in {*todo, *published}]
    if failed:
        kinds = ", ".join(sorted({statuses[name].name for name in failed}))
        notes.append(f"{counted(len(failed), 'run')} failed before ({kinds}); --retry-failed tries again")
    return notes


def check_environments(runs: Iterable[Run]) -> None:
    """Make each distinct environment of some runs once, with a learner of no fields, to find mistakes."""
    from pneuma.engines.environment import check_environment  # gymnasium: not for `--help`

    names = ("env", *OF_GYMNASIUM, "engine", "algorithm")
    distinct: dict[Any, Run] = {}
    for run in runs:
        made = (env_config(run), *(getattr(run, name) for name in names))
        distinct[replace(run, seed=0) if is_open(run) else made] = run
    for run in distinct.values():
        check_environment(run)
