"""Execute a plan: train what is not in the store yet, and record the selection.

Plan → groups of runs → executor → store
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from pneuma.config import OF_GYMNASIUM, Run, as_fields, env_config, is_gymnasium_id
from pneuma.errors import UserError, counted
from pneuma.study.executors.base import SLURM, Event, Supervision, load_executor
from pneuma.study.files import parse_json, to_json
from pneuma.study.plan import Cell, Plan, Selection
from pneuma.study.store import Status, Store
from pneuma.values import shown_settings


@dataclass(frozen=True)
class CellResult:
    """How one cell stands after `execute`.

    Attributes:
        cell: the cell.
        status: its run's.
        trained: whether this call trained it.
        reason: why it went wrong.
    """

    cell: Cell
    status: Status
    trained: bool
    reason: str = ""


OnProgress = Callable[[Cell, Event], None]
"""Told of every event of a cell's run; `executors.base.Executor` says what there are."""

SHAPED_BY = (
    "algorithm", "engine", "actor", "critic", "activation", "horizon", "minibatch", "epochs", "slots",
    "optimizer", "env", "players", "observation", "observe_facing", "perceive", "magic", "dash",
)  # fmt: skip
"""Fields by which a run's compiled programs differ."""
MOST_IN_GROUP = 8
"""Runs that one worker process trains; another `study run` finds them busy until it ends."""


def prepare(plan: Plan, store: Store, retry_failed: bool = False) -> tuple[dict[str, Run], list[str]]:
    """Check all that can be checked, record the selection; return what is to be trained, by id, and notes.

    Runs in an environment that cannot be made are stored as crashed, where other runs are left to train.

    Raises:
        UserError: before anything is written, where no environment can be made, or for a results folder
            that cannot be written or has runs of another file of that name.
    """
    recorded = store.selection(plan.study.name)
    if recorded is not None and plan.study.own_path is not None:
        store.check_same_file(recorded, Path(plan.study.own_path))
    if recorded is not None:
        _check_same_variant(recorded, plan)
    statuses = {cell.run_id: store.status(cell.run_id) for cell in plan.cells}
    todo = missing(plan, statuses, retry_failed)
    broken = broken_environments(todo)
    store.check_writable()
    store.save_selection(plan.study.name, _joined_record(plan, store.selections(plan.study.name)))
    for name, reason in broken.items():
        store.save_failure(name, todo.pop(name), "crashed", reason)
    return todo, [*dict.fromkeys(broken.values()), *_notes(plan, statuses, todo)]


def execute(
    plan: Plan, todo: Mapping[str, Run], store: Store, how: Supervision, on_progress: OnProgress
) -> list[CellResult]:
    """Train the runs that `prepare` found missing; return how the plan's cells stand.

    Of runs that are published and not stored there is nothing to tell.

    Raises:
        KeyboardInterrupt: after Ctrl-C, when every run has come to a checkpoint.
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

    if todo or how.executor == SLURM:  # whose jobs may have ended, and wait to be put away
        load_executor(how).run_groups(groups(todo, how.workers), store, how, report)
    return standing(plan, store, todo, ended)


def standing(
    plan: Plan, store: Store, todo: Mapping[str, Run], ended: Mapping[str, Event] | None = None
) -> list[CellResult]:
    """Return how a plan's cells stand, by the store and by what ended; without those published alone.

    An end that could not be stored counts as reported. Where none was, what is finished now was trained.
    """
    results = []
    for cell in plan.cells:
        status, end = store.status(cell.run_id), (ended or {}).get(cell.run_id, {})
        trained = bool(end["trained"]) if end else ended is None and status.finished and cell.run_id in todo
        if end and not status.finished:
            status = Status(end["status"], status.step)
        if status.finished or cell.run_id not in plan.published:
            reason = end.get("reason") or store.failure(cell.run_id)
            results.append(CellResult(cell, status, trained, reason))
    return results


def groups(todo: Mapping[str, Run], workers: int) -> list[dict[str, Run]]:
    """Share runs out to worker processes.

    Runs of equal shapes that the compiled engine trains go together, so that its programs are loaded or
    compiled once for them, and runs of tables, which take less time than a process does to start. But never
    so many that a worker stands idle.
    """
    alike: dict[Any, list[tuple[str, Run]]] = {}
    for name, run in todo.items():
        shapes = tuple(getattr(run, key) for key in SHAPED_BY)
        alike.setdefault(name if run.engine == "sb3" else shapes, []).append((name, run))
    size = min(MOST_IN_GROUP, math.ceil(len(todo) / workers))
    return [
        dict(runs[first : first + size]) for runs in alike.values() for first in range(0, len(runs), size)
    ]


def kept_step(run: Run, status: Status) -> int:
    """Return from which step a run would go on: its checkpoint's, or that at which it forks; else 0."""
    return 0 if status.finished else max(status.step, run.fork_step)


def missing(plan: Plan, statuses: Mapping[str, Status], retry_failed: bool = False) -> dict[str, Run]:
    """Return the plan's runs that are to be trained, by id, each once: no results, failures or published."""
    return {
        cell.run_id: cell.run
        for cell in plan.cells
        for status in [statuses[cell.run_id]]
        if not status.finished and (retry_failed or not status.failed) and cell.run_id not in plan.published
    }


def _notes(plan: Plan, statuses: Mapping[str, Status], todo: Mapping[str, Run]) -> list[str]:
    """Return what a person should know of stored runs: damage, and failures that are not tried again."""
    told = {cell.run_id: f"{cell.condition} seed {cell.seed}" for cell in plan.cells}
    notes = [
        f"{told[name]}: {status.detail!r} is damaged; the run is trained again"
        for name, status in statuses.items()
        if status.name == "damaged" and name in todo
    ]
    published = {name for name in plan.published if not statuses[name].finished}
    if published:
        runs = "1 run is" if len(published) == 1 else f"{len(published)} runs are"
        notes.append(f"{runs} published, and not trained: figures and numbers take them from there")
    failed = [name for name, status in statuses.items() if status.failed and name not in {*todo, *published}]
    if failed:
        kinds = ", ".join(sorted({statuses[name].name for name in failed}))
        notes.append(f"{counted(len(failed), 'run')} failed before ({kinds}); --retry-failed tries again")
    return notes


def broken_environments(runs: Mapping[str, Run]) -> dict[str, str]:
    """Make every environment of runs by id once; return why it cannot be made, by the ids of its runs.

    Raises:
        UserError: where none can be made, or one of Pneuma's own cannot, which is a mistake of the file's.
    """
    told = ("env", *OF_GYMNASIUM, "engine", "algorithm")
    alike: dict[Any, dict[str, Run]] = {}
    for name, run in runs.items():
        alike.setdefault((env_config(run), *(getattr(run, key) for key in told)), {})[name] = run
    broken: dict[str, str] = {}
    for own in alike.values():
        run = next(iter(own.values()))
        try:
            import_module("pneuma.engines.environment").check_environment(run)
        except UserError as error:
            broken |= dict.fromkeys(own, str(error))
            if len(broken) == len(runs) or not is_gymnasium_id(run.env):
                raise
    return broken


def selection_record(plan: Plan) -> dict[str, Any]:
    """Return what `results/studies/NAME.json` holds of a plan."""
    return {
        "study": plan.study.name,
        "path": plan.study.own_path,
        "world": plan.study.world,
        "title": plan.study.title,
        "figure": plan.study.figure,
        "baseline": plan.study.baseline,
        "same": [list(names) for names in plan.same],
        "selection": asdict(plan.selection),
        "saved": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
        "runs": [
            {"condition": own.condition, "seed": own.seed, "run_id": own.run_id, "run": as_fields(own.run)}
            for own in plan.cells
        ],
    }


def _joined_record(plan: Plan, earlier: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the record of a plan and of what was selected before.

    Runs of other seeds or conditions, else alike, join it; others stay beside it as they are.
    """
    record: dict[str, Any] = parse_json(to_json(selection_record(plan)))
    conditions, apart = list(plan.study.conditions), []
    runs = {(run["seed"], run["condition"]): run for run in record["runs"]}
    for own in earlier:
        if not alike(own, record):
            apart.append({key: own[key] for key in ("selection", "same", "runs", "saved") if key in own})
            continue
        more = [run for run in own["runs"] if run["condition"] in conditions]
        runs = {(run["seed"], run["condition"]): run for run in [*more, *runs.values()]}
        record["same"] += [names for names in own["same"] if names not in record["same"]]
    if len(runs) > len(record["runs"]):
        order = sorted(runs, key=lambda own: (own[0], conditions.index(own[1])))
        record["runs"] = [runs[key] for key in order]
        held = {condition for _, condition in runs}
        some = [] if held == {*conditions} else [name for name in conditions if name in held]
        record["selection"] |= {"seeds": sorted({seed for seed, _ in runs}), "conditions": some}
    return {**record, "earlier": apart}


def alike(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Tell whether two selections are one but for seeds and conditions."""
    first, second = (
        {run["condition"]: {**run["run"], "seed": 0} for run in own["runs"]} for own in (one, other)
    )
    keys = ("preset", "steps", "settings")
    asked = [[own["selection"].get(key) or None for key in keys] for own in (one, other)]
    shared = first.keys() & second.keys()
    return (bool(shared) or asked[0] == asked[1]) and all(first[name] == second[name] for name in shared)


def _check_same_variant(recorded: Mapping[str, Any], plan: Plan) -> None:
    """Refuse to call two variants by one name."""
    held, asked = (own.get("settings") or {} for own in (recorded["selection"], asdict(plan.selection)))
    if plan.selection.variant and held != parse_json(to_json(asked)):
        raise UserError(f"--as {plan.selection.variant}: names another variant, {shown_settings(held)}")


def recorded_selection(record: Mapping[str, Any]) -> Selection:
    """Return the selection that a study's record was made from."""
    kept = {key: own for key, own in record["selection"].items() if key in Selection.__dataclass_fields__}
    seeds = None if kept["seeds"] is None else tuple(kept["seeds"])
    return Selection(**{**kept, "seeds": seeds, "conditions": tuple(kept["conditions"])})
