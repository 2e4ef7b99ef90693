"""Execute a plan: train the runs that are not stored yet.

Plan → missing runs → executor → store
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from pneuma.config import GYMNASIUM_FIELDS, Run, env_config, is_resumable
from pneuma.errors import Hint, Message, counted
from pneuma.files import read_regular
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

    If an environment cannot be made, nothing is written. A user's study file is copied into the results.

    Args:
        plan: the runs.
        store: where they are stored.
        retry_failed: whether runs that failed before are trained again.
        until: the steps at which runs pause, by id; runs with a checkpoint there are left out. 0 is the end.

    Returns:
        The runs to train, by id, and notes for the user.
    """
    from pneuma.store.checkpoints import sound_checkpoint  # safetensors, pyarrow: not for `--help`

    statuses = {cell.run_id: store.status(cell.run_id) for cell in plan.cells}
    missing_runs = missing(plan, statuses, retry_failed)
    for run_id, step in until.items():
        if step and run_id in missing_runs:
            checkpoint = sound_checkpoint(store.run_folder(run_id))
            if checkpoint and checkpoint.step >= step:
                del missing_runs[run_id]
    check_environments(missing_runs.values())
    store.check_writable()
    for run_id, run in missing_runs.items():
        store.plan_run(run_id, run_identity(run))
    if plan.query.study:
        study = plan.study
        if study.path and study.own_path:
            store.write(store.studies / study.path.name, read_regular(study.path))
        note_query(store, plan)
    return missing_runs, _notes(plan, statuses, missing_runs)


def execute(
    plan: Plan, missing_runs: Mapping[str, Run], store: Store, config: ExecutorConfig, on_progress: OnProgress
) -> list[CellResult]:
    """Train the runs that `prepare` returned; return the plan's cells, without those only published.

    Raises:
        KeyboardInterrupt: after Ctrl-C, when every run has written a checkpoint.
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

    if missing_runs:
        load_executor(config).train_runs(Job(missing_runs, store, config), report)
    return cell_results(plan, store, missing_runs, end_events)


def cell_results(
    plan: Plan, store: Store, missing_runs: Collection[str], end_events: Mapping[str, Event] = {}
) -> list[CellResult]:
    """Return the state of a plan's cells, without those that are only published.

    Args:
        plan: the cells.
        store: where their runs are stored.
        missing_runs: the runs that had to be trained; one that finished without an end event was trained.
        end_events: the last event of each run that has ended, for ends that could not be stored.
    """
    results = []
    for cell in plan.cells:
        status = store.status(cell.run_id)
        trained, reason = status.finished and cell.run_id in missing_runs, ""
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
    missing_runs = {}
    for cell in plan.cells:
        status = statuses[cell.run_id]
        if status.finished or cell.run_id in plan.published:
            continue
        if retry_failed or not status.failed:
            missing_runs[cell.run_id] = cell.run
    return missing_runs


def _notes(plan: Plan, statuses: Mapping[str, Status], missing_runs: Mapping[str, Run]) -> list[str]:
    notes = []
    labels_by_run = {cell.run_id: f"{cell.condition} seed {cell.seed}" for cell in plan.cells}
    failures = []
    for run_id, status in statuses.items():
        if status.name == "damaged" and run_id in missing_runs:
            notes.append(f"{labels_by_run[run_id]}: {status.detail!r} is damaged; the run is trained again")
        if status.failed and run_id not in missing_runs and run_id not in plan.published:
            failures.append(status.name)
    published = [run_id for run_id in plan.published if not statuses[run_id].finished]
    if published:
        run_count = counted(len(published), "published run")
        notes.append(f"{run_count} not trained: figures and numbers take them from there")
    open_runs = [run for run in missing_runs.values() if not is_resumable(run)]
    if open_runs:
        run_count = counted(len(open_runs), "run")
        notes.append(f"{run_count} cannot be resumed: if stopped, they start over")
    if failures:
        statuses_text = ", ".join(sorted(set(failures)))
        text = f"{counted(len(failures), 'run')} failed before ({statuses_text}); "
        notes.append(Message(text, Hint("retry_failed", True), " tries again"))
    return notes


def check_environments(runs: Iterable[Run]) -> None:
    """Make each distinct environment of some runs once, to find mistakes."""
    from pneuma.engines.environment import check_environment  # gymnasium: not for `--help`

    environment_fields = ("env", *GYMNASIUM_FIELDS, "engine", "device", "algorithm")
    run_by_environment: dict[Any, Run] = {}
    for run in runs:
        if not is_resumable(run):
            environment: Any = replace(run, seed=0)  # its learner is made too
        else:
            environment = env_config(run), *(getattr(run, field_name) for field_name in environment_fields)
        run_by_environment[environment] = run
    for run in run_by_environment.values():
        check_environment(run)
