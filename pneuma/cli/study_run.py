"""`pneuma study plan` and `pneuma study run`: what would be trained, and training it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterable, Mapping
from dataclasses import replace
from typing import Annotated, Any

import typer

from pneuma.cli import options as opt
from pneuma.cli.output import command, print_json, print_table, say
from pneuma.cli.progress import ProgressDisplay, duration
from pneuma.errors import UserError, plain
from pneuma.reading import read_whole
from pneuma.study import execute, plan, spec
from pneuma.study.executors.base import HERE, Detached, Supervision
from pneuma.study.store import Status, Store
from pneuma.values import shown_value

UNWELL = ("crashed", "killed", "timeout", "damaged", "running", "partial")
"""Statuses that a cell should not have when a study has been run."""

Unpublished = Annotated[
    bool, opt.flag("--unpublished", "Leave out runs that are finished in a published table of RESULTS.")
]

STOPPED = 130
"""The exit code after Ctrl-C; 1 is of runs that went wrong, 0 of a plan that is done."""


@opt.grouped
def plan_(
    name: opt.StudyName,
    selection: opt.Selected = None,
    world: opt.WorldName = None,
    unpublished: Unpublished = False,
    results: opt.Results = opt.RESULTS,
    json: opt.Json = False,
) -> None:
    """Say what is stored and what would be trained, and about how long that takes; none is trained."""
    from pneuma.study import estimate

    planned = _plan(name, world, selection or plan.Selection())
    at_once = opt.read_workers(None)
    store = Store(results)
    statuses = {cell.run_id: store.status(cell.run_id) for cell in planned.cells}
    if unpublished:
        planned = replace(planned, published=_published(store, planned))
    todo = execute.missing(planned, statuses)
    execute.check_environments(list(todo.values()))
    paces = estimate.stored_paces(store, statuses)
    seconds = {
        key: paces.seconds(run, run.steps - execute.kept_step(run, statuses[key]))
        for key, run in todo.items()
    }
    states = {key: _state(status, key in planned.published) for key, status in statuses.items()}
    if json:
        cells = [
            {**_cell(cell), "state": states[cell.run_id], "expected_seconds": seconds.get(cell.run_id)}
            for cell in planned.cells
        ]
        return print_json({"schema": 1, "study": planned.study.name, "runs": cells})
    _print_plan(planned, states, seconds)
    if todo:
        room = sum(estimate.disk_bytes(run, planned.study.keep_checkpoints) for run in todo.values())
        told = duration(estimate.total_seconds(seconds.values(), at_once))
        sure = all(paces.knows(run) for run in todo.values())
        rough = "" if sure else " (a rough estimate)"
        print(f"To train: about {told} with {at_once} at once{rough}, {max(room / 1e6, 1):,.0f} MB of disk.")
    return None


def _plan(name: str, world: str | None, selection: plan.Selection) -> plan.Plan:
    """Plan a study; name the rewards of a user's own before any code of theirs is loaded."""
    study = spec.load_study(name, world)
    told = [study.fields(own, selection.settings or {}).get("reward") or () for own in study.conditions]
    rewards = (reward for own in told for reward in ([own] if isinstance(own, str) else own))
    for reward in dict.fromkeys(reward for reward in rewards if ":" in reward):
        say(f"Note: the study's file names the reward {reward}, which is loaded and called.", aside=True)
    return plan.make_plan(study, selection)


def _print_plan(planned: plan.Plan, states: Mapping[str, str], seconds: Mapping[str, float]) -> None:
    """Print a line for each condition, and the sums of all."""
    for note in planned.notes:
        print(f"Note: {note}.")
    rows = []
    for condition in planned.conditions:
        own = [cell for cell in planned.cells if cell.condition == condition]
        expected = sum(seconds.get(cell.run_id, 0.0) for cell in own)
        time = f", {duration(expected)} of one core" if expected else ""
        counts = _counts(states[cell.run_id] for cell in own)
        rows.append((condition, f"{len(own):>3} x {own[0].run.steps:>11,} steps", f"{counts}{time}"))
    print_table(("", "", ""), rows)
    print(f"{_counts(states.values())}.")


def _counts(states: Iterable[str]) -> str:
    return ", ".join(f"{count} {state}" for state, count in Counter(states).items())


@opt.grouped
def run(
    name: opt.StudyName,
    selection: opt.Selected = None,
    world: opt.WorldName = None,
    workers: opt.Workers = None,
    place: Supervision = HERE,
    checkpoint_seconds: Annotated[
        float,
        typer.Option("--checkpoint-seconds", metavar="S", min=0.01, help="Between two checkpoints of a run."),
    ] = 15.0,
    retry_failed: opt.RetryFailed = False,
    unpublished: Unpublished = False,
    results: opt.Results = opt.RESULTS,
    json: opt.Json = False,
    quiet: opt.Quiet = False,
) -> int:
    """Train a study's runs that are not stored yet, going on where they were stopped."""
    planned = _plan(name, world, selection or plan.Selection())
    store = Store(results)
    if unpublished:
        planned = replace(planned, published=_published(store, planned))
    how = replace(
        place,
        workers=opt.read_workers(workers, place),
        checkpoint_seconds=checkpoint_seconds,
        keep_checkpoints=planned.study.keep_checkpoints,
    )
    return train(planned, store, how, retry_failed, json, quiet)


def train(
    planned: plan.Plan, store: Store, how: Supervision, retry_failed: bool, json: bool, quiet: bool
) -> int:
    """Train what a plan lacks, showing how far it is; return the exit code."""
    results, code = train_cells(planned, store, how, retry_failed, json, quiet)
    if json:
        rows = [{**_cell(own.cell), "status": own.status.name, "trained": own.trained} for own in results]
        print_json({"schema": 1, "study": planned.study.name, "runs": rows})
    return code


def train_cells(
    planned: plan.Plan, store: Store, how: Supervision, retry_failed: bool, json: bool, quiet: bool
) -> tuple[list[execute.CellResult], int]:
    """Train what a plan lacks and tell how it went; return the cells' results and the exit code."""
    todo = execute.prepare(planned, store, retry_failed)
    for note in (*planned.notes, *todo.notes):
        say(f"Note: {note}.", aside=True, quiet=quiet)
    try:
        with ProgressDisplay(planned, todo.runs, quiet, todo.kept) as display:
            results = execute.execute(planned, todo.runs, store, how, display.update)
    except Detached as left:  # as --detach asks, or by Ctrl-C
        say(str(left), aside=True)
        return _as_stored(planned, store, () if left.asked else todo.runs), 0 if left.asked else STOPPED
    except KeyboardInterrupt:
        say("Stopped. The same command goes on where every run was stopped.", aside=True)
        return _as_stored(planned, store, todo.runs), STOPPED
    _tell_results(planned, results, store, json, quiet)
    return results, int(any(result.status.name in UNWELL for result in results))


def _as_stored(planned: plan.Plan, store: Store, todo: Container[str]) -> list[execute.CellResult]:
    """Return how cells of a plan that was left stand; of what was `todo`, what is done was trained."""
    states = [(cell, store.status(cell.run_id)) for cell in planned.cells]
    return [
        execute.CellResult(cell, status, status.finished and cell.run_id in todo)
        for cell, status in states
        if status.finished or cell.run_id not in planned.published
    ]


def _published(store: Store, planned: plan.Plan) -> frozenset[str]:
    """Return which of a plan's runs a published table holds, of its study or another.

    Raises:
        UserError: when there is no table, or the study's own is damaged.
    """
    from pneuma.analysis.published import published_studies, read_published

    found: set[str] = set()
    studies = published_studies(store)
    if not studies:
        raise UserError(f"--unpublished: nothing is published in {store.root}; leave it out to train all")
    for study in studies:
        try:
            found |= read_published(store, study).finished
        except UserError as error:
            if study == planned.study.name:
                raise
            say(f"Note: {error}; its runs are trained.", aside=True)
    return frozenset(cell.run_id for cell in planned.cells if cell.run_id in found)


def _cell(cell: plan.Cell) -> dict[str, Any]:
    return {"run_id": cell.run_id, "condition": cell.condition, "seed": cell.seed}


def _state(status: Status, published: bool = False) -> str:
    if published and not status.finished:
        return "published"
    if status.finished:
        return "stored"
    if status.failed:
        return "failed"
    return "partial" if status.step else "to-train"


def by_value(values: Mapping[str, Any]) -> str:
    """Return each value of a setting with the conditions that have it."""
    having: dict[str, list[str]] = {}
    for condition, value in values.items():
        having.setdefault(shown_value(value), []).append(condition)
    return "; ".join(f"{value} ({', '.join(conditions)})" for value, conditions in having.items())


def _tell_results(
    planned: plan.Plan, results: list[execute.CellResult], store: Store, as_json: bool, quiet: bool
) -> None:
    for result in results:
        told, state = f"{result.cell.condition} seed {result.cell.seed}", result.status
        if state.name == "diverged":
            say(f"{told} diverged at step {state.step:,}; its records count", as_json)
        elif state.name in UNWELL:
            trace = store.run_folder(result.cell.run_id) / "error.txt"
            kept = trace.is_file()
            why = result.reason  # else what is kept, which may be of an earlier try
            if not why and kept and state.name in ("crashed", "killed"):
                why = read_whole(trace).decode(errors="replace").strip().rpartition("\n")[2]
            at = f" at step {state.step:,}" if not why else f": {plain(why)}{f' ({trace})' if kept else ''}"
            say(f"{told} {state.name}{at}", as_json)
    trained = sum(result.trained for result in results)
    counts = Counter(result.status.name for result in results)
    states = ", ".join(f"{n} {state}" for state, n in counts.items()) or "nothing to train"
    stored = f"{trained} trained now, {len(results) - trained} were stored"
    say(f"{planned.study.name}: {states}; {stored}.", as_json, quiet)
    if results and not any(counts[name] for name in UNWELL):
        drawn = command("study", "plot", planned.study.name, "--results", store.root)
        say(f"Draw it with: {drawn}", as_json, quiet)
