"""Execute a plan: train the runs that are not stored yet.

Plan → missing runs → executor → store
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from pneuma.config import OF_GYMNASIUM, Run, env_config, is_open
from pneuma.errors import Hint, Message, counted
from pneuma.store.last_queries import note_query
from pneuma.store.store import Status, Store, run_identity
from pneuma.study.plan import Cell, Plan
from pneuma.training.executors.base import Event, ExecutorConfig, Job, load_executor


@dataclass(frozen=True)
class CellResult:
    """The state of a cell after `execute`; `trained` if this call trained it."""

    cell: Cell
    status: Status
    trained: bool
    reason: str = ""


OnProgress = Callable[[Cell, Event], None]
"""Called with each event of a cell's run; `executors.base` lists the events."""


def prepare(
    plan: Plan, store: Store, retry_failed: bool = False, until: Mapping[str, int] = {}
) -> tuple[dict[str, Run], list[str]]:
    """Check a plan, and note its runs as planned.

    If an environment cannot be made, nothing is written. A user's own study file is kept beside the results.

    Args:
        plan: which runs there are to be.
        store: where they are kept.
        retry_failed: whether runs that failed before are trained again.
        until: the steps at which runs pause: those that have come so far are not trained; 0 is the end.

    Returns:
        The runs to train, by id, and notes for the user.
    """
    from pneuma.store.checkpoints import sound_checkpoint  # safetensors, pyarrow: not for `--help`

    statuses = {cell.run_id: store.status(cell.run_id) for cell in plan.cells}
    todo = missing(plan, statuses, retry_failed)
    for name, step in until.items():
        if step and name in todo:
            checkpoint = sound_checkpoint(store.run_folder(name))
            if checkpoint and checkpoint.step >= step:
                del todo[name]
    check_environments(todo.values())
    store.check_writable()
    for name, run in todo.items():
        store.plan_run(name, run_identity(run))
    if plan.query.study:
        study = plan.study
        if study.path and study.own_path:
            store.write(store.studies / study.path.name, study.path.read_bytes())
        note_query(store, plan)
    return todo, _notes(plan, statuses, todo)


def execute(
    plan: Plan, todo: Mapping[str, Run], store: Store, config: ExecutorConfig, on_progress: OnProgress
) -> list[CellResult]:
    """Train the runs that `prepare` found missing; return the plan's cells, without those only published.

    Raises:
        KeyboardInterrupt: after Ctrl-C, once every run has reached a checkpoint.
    """
    cells_by_run: dict[str, list[Cell]] = {}
    for cell in plan.cells:
        cells_by_run.setdefault(cell.run_id, []).append(cell)
    end_events: dict[str, Event] = {}

    def report(event: Event) -> None:
        run_id = event["run_id"]
        if event["event"] == "end":
            end_events[run_id] = event
        for cell in cells_by_run[run_id]:
            on_progress(cell, event)

    if todo:
        load_executor(config).train_runs(Job(todo, store, config), report)
    return cell_results(plan, store, todo, end_events)


def cell_results(
    plan: Plan, store: Store, todo: Collection[str], end_events: Mapping[str, Event] = {}
) -> list[CellResult]:
    """Return the state of a plan's cells, without those that are only published.

    Args:
        plan: whose cells.
        store: where their runs are kept.
        todo: the runs that were to be trained. Finished ones without an end event were trained.
        end_events: the final event of each run that has ended. It counts where the end could not be stored.
    """
    results = []
    for cell in plan.cells:
        status = store.status(cell.run_id)
        trained, reason = status.finished and cell.run_id in todo, ""
        event = end_events.get(cell.run_id)
        if event:
            trained, reason = event["trained"], event.get("reason", "")
            if not status.finished:
                status = Status(event["status"], status.step)
        if status.finished or cell.run_id not in plan.published:
            reason = reason or store.failure(cell.run_id)
            results.append(CellResult(cell, status, trained, reason))
    return results


def kept_step(status: Status) -> int:
    """Return the step at which training would resume: that of its checkpoint, else 0."""
    return 0 if status.finished else status.step


def missing(plan: Plan, statuses: Mapping[str, Status], retry_failed: bool = False) -> dict[str, Run]:
    """Return the plan's runs to train, by id: not finished, published or (unless retried) failed."""
    todo = {}
    for cell in plan.cells:
        status = statuses[cell.run_id]
        if status.finished or cell.run_id in plan.published:
            continue
        if retry_failed or not status.failed:
            todo[cell.run_id] = cell.run
    return todo


def _notes(plan: Plan, statuses: Mapping[str, Status], todo: Mapping[str, Run]) -> list[str]:
    notes = []
    labels = {cell.run_id: f"{cell.condition} seed {cell.seed}" for cell in plan.cells}
    failures = []
    for name, status in statuses.items():
        if status.name == "damaged" and name in todo:
            notes.append(f"{labels[name]}: {status.detail!r} is damaged; the run is trained again")
        if status.failed and name not in todo and name not in plan.published:
            failures.append(status.name)
    published = [name for name in plan.published if not statuses[name].finished]
    if published:
        runs = counted(len(published), "published run")
        notes.append(f"{runs} not trained: figures and numbers take them from there")
    open_runs = [run for run in todo.values() if is_open(run)]
    if open_runs:
        runs = counted(len(open_runs), "run")
        notes.append(f"{runs} cannot be resumed: if stopped, they start over")
    if failures:
        statuses_text = ", ".join(sorted(set(failures)))
        text = f"{counted(len(failures), 'run')} failed before ({statuses_text}); "
        notes.append(Message(text, Hint("retry_failed", True), " tries again"))
    return notes


def check_environments(runs: Iterable[Run]) -> None:
    """Make each distinct environment of some runs once, with a learner of no fields, to find mistakes."""
    from pneuma.engines.environment import check_environment  # gymnasium: not for `--help`

    fields = ("env", *OF_GYMNASIUM, "engine", "algorithm")
    run_by_environment: dict[Any, Run] = {}
    for run in runs:
        if is_open(run):
            key: Any = replace(run, seed=0)  # its learner is made too
        else:
            key = env_config(run), *(getattr(run, field) for field in fields)
        run_by_environment[key] = run
    for run in run_by_environment.values():
        check_environment(run)
