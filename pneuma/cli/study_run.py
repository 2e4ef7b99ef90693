"""`pneuma study plan` and `pneuma study run`: what would be trained, and training it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pneuma.cli.options import (
    Json,
    Quiet,
    Results,
    Selected,
    StudyName,
    Workers,
    WorldName,
    places,
    print_json,
    read_seconds,
    read_workers,
    say,
    selects,
)
from pneuma.cli.plain_text import command, plain
from pneuma.cli.progress import ProgressDisplay, duration
from pneuma.config import Run
from pneuma.errors import UserError
from pneuma.study import execute, plan, spec
from pneuma.study.executors.base import HERE, Detached, Place, Supervision
from pneuma.study.store import Status, Store
from pneuma.values import shown_value

if TYPE_CHECKING:
    from pneuma.study import foresight

RESULTS = Path("results")
UNWELL = ("crashed", "killed", "timeout", "damaged", "running", "partial")
"""Statuses that a cell should not have when a study has been run."""

Unpublished = Annotated[
    bool,
    typer.Option("--unpublished", help="Leave out runs that are finished in a published table of RESULTS."),
]

STOPPED = 130
"""The exit code after Ctrl-C; 1 is of runs that went wrong, 0 of a plan that is done."""

_STATES = {"done": "stored", "diverged": "stored", "partial": "partial", "killed": "partial"}


@selects
@places
def plan_(
    name: StudyName,
    selection: Selected = None,
    world: WorldName = None,
    workers: Workers = None,
    place: Place = HERE,
    calibrate: Annotated[
        bool,
        typer.Option(help="Train for a few seconds where no stored run tells how long such runs take."),
    ] = True,
    unpublished: Unpublished = False,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Say which runs are stored and which would be trained, and how long that takes; none is trained."""
    from pneuma.study import foresight

    selection = selection or plan.Selection()
    planned = plan.make_plan(spec.load_study(name, world), selection)
    at_once = read_workers(workers, place)
    store = Store(results)
    statuses = {cell.run_id: store.status(cell.run_id) for cell in planned.cells}
    if unpublished:
        planned = replace(planned, published=_published(store, planned))
    todo = execute.missing(planned, statuses)
    execute.check_environments(list(todo.values()))
    measured = foresight.measured_runs(planned, statuses, store)
    paces = foresight.known_paces(measured, store)
    if calibrate and any(foresight.kind(run) not in paces for run in todo.values()):
        paces = _calibrated(todo.values(), store, paces)
    seconds = _expected_seconds(planned, statuses, paces)
    if json:
        cells = [
            {
                **_cell(cell),
                "state": _state(statuses[cell.run_id], cell.run_id in planned.published),
                "expected_seconds": seconds[cell.run_id],
            }
            for cell in planned.cells
        ]
        return print_json({"schema": 1, "study": planned.study.name, "runs": cells})
    _print_plan(planned, statuses, seconds)
    for condition, speeds in foresight.processor_speeds(planned, measured).items():
        each = (f"{speed:,.0f} steps/s on {plain(on)} ({n} runs)" for on, (speed, n) in speeds.items())
        print(f"Measured of runs like {condition}: {', '.join(each)}.")
    if todo:
        _tell_cost(planned, todo, [own for name in todo if (own := seconds[name]) is not None], at_once)
    return None


def _expected_seconds(
    planned: plan.Plan, statuses: Mapping[str, Status], paces: Mapping[str, foresight.Pace]
) -> dict[str, float | None]:
    """Return how long each run would still train, by id; None where nothing tells, or it is published."""
    from pneuma.study import foresight

    seconds: dict[str, float | None] = {}
    for cell in planned.cells:
        pace = paces.get(foresight.kind(cell.run))
        if pace is None or cell.run_id in planned.published:
            seconds[cell.run_id] = None
        else:
            left = cell.run.steps - execute.kept_step(cell.run, statuses[cell.run_id])
            seconds[cell.run_id] = pace.seconds(left)
    return seconds


def _tell_cost(planned: plan.Plan, todo: Mapping[str, Run], known: Sequence[float], at_once: int) -> None:
    """Print how long the missing runs take, as far as that is known, and how much disk."""
    from pneuma.study import foresight

    room = sum(foresight.disk_bytes(run, planned.study.keep_checkpoints) for run in todo.values())
    disk = f"{max(room / 1e6, 1):,.0f} MB of disk"
    if not known:
        print(f"To train: {disk}; how long it takes is not known, as no run like these was timed.")
        return
    about = "about" if len(known) == len(todo) else "at least"
    told = duration(foresight.wall_seconds(known, at_once))
    print(f"To train: {about} {told} with {at_once} at once, {disk}.")


@selects
@places
def run(
    name: StudyName,
    selection: Selected = None,
    world: WorldName = None,
    workers: Workers = None,
    place: Place = HERE,
    checkpoint_seconds: Annotated[
        str,
        typer.Option("--checkpoint-seconds", metavar="S", help="Time between two checkpoints of a run."),
    ] = "15",
    timeout: Annotated[
        str | None,
        typer.Option("--timeout", metavar="S", help="The longest that one run may train, in seconds."),
    ] = None,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Try runs again that crashed or timed out before.")
    ] = False,
    until_decided: Annotated[
        bool,
        typer.Option(
            "--until-decided",
            help="Add seeds in stages until every condition is decided against the baseline.",
        ),
    ] = False,
    max_seeds: Annotated[
        str | None,
        typer.Option("--max-seeds", metavar="N", help="With --until-decided: the most seeds (default 40)."),
    ] = None,
    unpublished: Unpublished = False,
    results: Results = RESULTS,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Train a study's runs that are not stored yet, going on where they were stopped."""
    from pneuma.cli import study_stages

    selection = selection or plan.Selection()
    most_seeds = study_stages.read_most_seeds(until_decided, max_seeds, selection.seeds)
    if most_seeds and place.detach:
        raise UserError("--detach: --until-decided waits for what runs come to; leave it by Ctrl-C")
    if most_seeds and unpublished:
        raise UserError("--unpublished: --until-decided trains what it judges; leave one of them out")
    planned = plan.make_plan(spec.load_study(name, world), selection)
    supervision = Supervision(
        workers=read_workers(workers, place),
        checkpoint_seconds=read_seconds("--checkpoint-seconds", checkpoint_seconds),
        timeout_seconds=None if timeout is None else read_seconds("--timeout", timeout),
        keep_checkpoints=planned.study.keep_checkpoints,
        place=place,
    )
    store = Store(results)
    if most_seeds is None:
        if unpublished:
            planned = replace(planned, published=_published(store, planned))
        return train(planned, store, supervision, retry_failed, json, quiet)
    return study_stages.run_stages(planned, most_seeds, store, supervision, retry_failed, json, quiet)


def train(
    planned: plan.Plan, store: Store, how: Supervision, retry_failed: bool, json: bool, quiet: bool
) -> int:
    """Train what a plan lacks, showing how far it is; return the exit code."""
    try:
        outcomes, code = train_cells(planned, store, how, retry_failed, json, quiet)
    except Detached:  # as was asked
        outcomes, code = _as_stored(planned, store), 0
    if json:
        print_json({"schema": 1, "study": planned.study.name, "runs": outcome_rows(outcomes)})
    return code


def _calibrated(
    runs: Iterable[Run], store: Store, paces: Mapping[str, foresight.Pace]
) -> dict[str, foresight.Pace]:
    """Measure what paces are missing.

    Raises:
        UserError: where they could not be kept.
    """
    from pneuma.study import calibration

    try:
        return calibration.calibrate(runs, store, paces, lambda text: say(text, aside=True))
    except UserError as error:
        raise UserError(f"{error}; or plan without measuring: --no-calibrate") from None


def _as_stored(planned: plan.Plan, store: Store, todo: Container[str] = ()) -> list[execute.Outcome]:
    """Return how cells of a plan that was left stand; of what was `todo`, what is done was trained."""
    states = [(cell, store.status(cell.run_id)) for cell in planned.cells]
    return [
        execute.Outcome(cell, status, status.finished and cell.run_id in todo)
        for cell, status in states
        if status.finished or cell.run_id not in planned.published
    ]


def train_cells(
    planned: plan.Plan, store: Store, how: Supervision, retry_failed: bool, json: bool, quiet: bool
) -> tuple[list[execute.Outcome], int]:
    """Train what a plan lacks and tell how it went; return the cells' outcomes and the exit code.

    Raises:
        Detached: where the runs were left to go on, as --detach asks.
    """
    todo = execute.prepare(planned, store, retry_failed, how)
    for note in (*planned.notes, *todo.notes):
        say(f"Note: {note}.", aside=True, quiet=quiet)
    try:
        with ProgressDisplay(planned, todo.runs, how.workers, quiet, todo.kept) as display:
            outcomes = execute.execute(planned, todo.runs, store, how, display.update)
    except Detached as left:
        say(str(left), aside=True)
        if left.asked:
            raise
        return _as_stored(planned, store, todo.runs), STOPPED
    except KeyboardInterrupt:
        say("Stopped. The same command goes on where every run was stopped.", aside=True)
        return _as_stored(planned, store, todo.runs), STOPPED
    _tell_outcomes(planned, outcomes, store, json, quiet)
    return outcomes, int(any(outcome.status.name in UNWELL for outcome in outcomes))


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


def outcome_rows(outcomes: list[execute.Outcome]) -> list[dict[str, Any]]:
    """Return the runs of a JSON document."""
    return [{**_cell(o.cell), "status": o.status.name, "trained": o.trained} for o in outcomes]


def _cell(cell: plan.Cell) -> dict[str, Any]:
    return {"run_id": cell.run_id, "condition": cell.condition, "seed": cell.seed}


def _state(status: Status, published: bool = False) -> str:
    if published and not status.finished:
        return "published"
    if status.failed:
        return "failed"
    return _STATES.get(status.name, "partial" if status.step else "to-train")


def by_value(values: Mapping[str, Any]) -> str:
    """Return each value of a setting with the conditions that have it."""
    having: dict[str, list[str]] = {}
    for condition, value in values.items():
        having.setdefault(shown_value(value), []).append(condition)
    return "; ".join(f"{value} ({', '.join(conditions)})" for value, conditions in having.items())


def _print_plan(
    planned: plan.Plan, statuses: Mapping[str, Status], seconds: Mapping[str, float | None]
) -> None:
    for note in planned.notes:
        print(f"Note: {note}.")
    for key, values in plan.differing_settings(planned).items():
        print(f"Conditions differ in {key}: {by_value(values)}")
    width = max(18, *(len(cell.condition) for cell in planned.cells))
    states = {key: _state(status, key in planned.published) for key, status in statuses.items()}
    for cell in planned.cells:
        status, expected = statuses[cell.run_id], seconds[cell.run_id]
        state = states[cell.run_id]
        if state == "published":
            expected = None
        elif state == "failed":
            state = f"{status.name}: --retry-failed trains it again"
        elif state == "partial":
            state = f"partial, {status.step:,} steps"
        time = duration(expected) if expected is not None and not status.finished else ""
        budget = f"{cell.run.steps:>12,} steps"
        print(f"{cell.condition:<{width}} seed {cell.seed:<6} {budget}  {cell.run_id}  {time:>8}  {state}")
    kinds = {"stored": "stored", "published": "published", "partial": "partial", "failed": "failed"}
    kinds["to-train"] = "to train"
    counts = Counter(states.values())
    print(", ".join(f"{counts[state]} {words}" for state, words in kinds.items() if counts[state]) + ".")


def _tell_outcomes(
    planned: plan.Plan, outcomes: list[execute.Outcome], store: Store, as_json: bool, quiet: bool
) -> None:
    for outcome in outcomes:
        told, state = f"{outcome.cell.condition} seed {outcome.cell.seed}", outcome.status
        trace = store.run_folder(outcome.cell.run_id) / "error.txt"
        if state.name == "diverged":
            say(f"{told} diverged at step {state.step:,}; its records count", as_json)
        elif state.name in UNWELL and outcome.reason:  # what an error.txt has may be older
            say(f"{told} {state.name}: {plain(outcome.reason)}{_traced(trace)}", as_json)
        elif state.name in ("crashed", "killed") and trace.is_file():
            say(f"{told} {state.name}: {plain(_cause(trace))}{_traced(trace)}", as_json)
        elif state.name in UNWELL:
            say(f"{told} {state.name} at step {state.step:,}", as_json)
    trained = sum(outcome.trained for outcome in outcomes)
    counts = Counter(outcome.status.name for outcome in outcomes)
    states = ", ".join(f"{n} {state}" for state, n in counts.items()) or "nothing to train"
    kept = len(outcomes) - trained
    say(f"{planned.study.name}: {states}; {trained} trained now, {kept} were stored.", as_json, quiet)
    if outcomes and not any(counts[name] for name in UNWELL):
        drawn = command("study", "plot", planned.study.name, "--results", store.root)
        say(f"Draw it with: {drawn}", as_json, quiet)


def _cause(trace: Path) -> str:
    """Return the last line of a traceback."""
    lines = trace.read_text(errors="replace").strip().splitlines()
    return lines[-1] if lines else ""


def _traced(trace: Path) -> str:
    """Return where the whole of a traceback is, if it was kept."""
    return f" ({trace})" if trace.is_file() else ""
