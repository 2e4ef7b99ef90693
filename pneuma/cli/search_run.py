"""`pneuma search run`: ask for trials, train them as runs, tell how they did."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pneuma.cli.options import (
    EngineName,
    Json,
    Preset,
    Quiet,
    Results,
    Settings,
    Steps,
    Workers,
    WorldName,
    places,
    print_json,
    read_count,
    read_settings_options,
    read_workers,
    say,
)
from pneuma.cli.plain_text import command
from pneuma.cli.progress import ProgressDisplay
from pneuma.errors import UserError, unknown_name
from pneuma.study import execute
from pneuma.study.conditions import does_nothing, unread_settings
from pneuma.study.executors.base import HERE, Detached, Place, Supervision
from pneuma.study.plan import Plan
from pneuma.study.store import Store
from pneuma.worlds import TEXT, check_world, in_world

if TYPE_CHECKING:
    from pneuma.search.spec import Budget, Search
    from pneuma.search.trials import Task, Told

RESULTS = Path("results")

SearchName = Annotated[
    str, typer.Argument(metavar="NAME", help="A search's name, or the path of a search file (….toml).")
]
Trials = Annotated[
    str | None, typer.Option("--trials", metavar="N", help="How many trials, those stored among them.")
]
SearchSeeds = Annotated[
    str | None,
    typer.Option(
        "--seeds", metavar="N|LIST", help="Seeds of each trial: a count N (seeds 1000, 1001, …) or a list."
    ),
]


@places
def run(
    name: SearchName,
    preset: Preset = None,
    trials: Trials = None,
    seeds: SearchSeeds = None,
    steps: Steps = None,
    engine: EngineName = None,
    set_: Settings = None,
    world: WorldName = None,
    sensitivity: Annotated[
        bool,
        typer.Option(
            "--sensitivity",
            help="Search nothing: train each hyperparameter alone at several values around the base.",
        ),
    ] = False,
    storage: Annotated[
        str | None,
        typer.Option(
            "--storage", metavar="URL", help="An Optuna storage, as postgresql://… (default: an SQLite file)."
        ),
    ] = None,
    workers: Workers = None,
    place: Place = HERE,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Try runs again that crashed before.")
    ] = False,
    replace: Annotated[
        bool,
        typer.Option(
            "--replace", help="Begin anew where the versions of Optuna, rules or engines have changed."
        ),
    ] = False,
    results: Results = RESULTS,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Search for hyperparameters, going on where the search was stopped."""
    from pneuma.search.record import record_replaced
    from pneuma.search.spec import load_search
    from pneuma.search.trials import Task

    search = load_search(name, world)
    over = {**read_settings_options(set_), **({"engine": engine} if engine else {})}
    if over:
        search = search.with_settings(_checked(over))
        _refuse_unread(search, over)
    task = Task(search, read_budget(search, preset, trials, seeds, steps))
    store = Store(results)
    if place.detach:
        raise UserError("--detach: a search asks for trials by how those before did; leave it by Ctrl-C")
    how = Supervision(workers=read_workers(workers, place), place=place)
    if sensitivity:
        for option, given in (("--trials", trials), ("--storage", storage)):
            if given is not None:
                raise UserError(f"{option} {given}: does not go with --sensitivity, which searches nothing")
        from pneuma.cli.search_promote import run_sensitivity

        return run_sensitivity(task, store, how, retry_failed, json, quiet)
    if note := record_replaced(store, task, replace):
        say(f"Note: {note}.", aside=True, quiet=quiet)
    return _search(task, store, storage, how, retry_failed, json, quiet)


def read_budget(
    search: Search, preset: str | None, trials: str | None, seeds: str | None, steps: str | None
) -> Budget:
    """Return a search's budget: its preset's, with what the options give in its place."""
    from pneuma.search.spec import Budget

    chosen = preset or "quick"
    if chosen not in search.presets:
        raise unknown_name(f"preset of search {search.name}", chosen, search.presets)
    own = search.presets[chosen]
    return Budget(
        own.trials if trials is None else read_count("--trials", trials),
        own.seeds if seeds is None else read_search_seeds_option(seeds),
        own.steps if steps is None else read_count("--steps", steps),
    )


def record_name(name: str, world: str | None) -> str:
    """Return what the record of a search is called."""
    check_world(world)
    return in_world(Path(name).stem if name.endswith(".toml") else name, world or TEXT)


def recorded(store: Store, name: str, world: str | None) -> dict[str, Any]:
    """Return the record of the search that a person names."""
    from pneuma.search.record import read_record

    return read_record(store, record_name(name, world), called_by_file(name, world))


def called_by_file(name: str, world: str | None) -> str:
    """Return how a command names a search that is a person's own file; empty for a shipped one."""
    own_file = f"{name} --world {world}" if world else name
    return own_file if name.endswith(".toml") else ""


def read_search_seeds_option(text: str) -> tuple[int, ...]:
    """Read `--seeds` of a search: a count from 1000 on, or a list."""
    from pneuma.cli.options import read_seeds_option
    from pneuma.search import FIRST_SEED

    seeds = read_seeds_option(text)
    return seeds if "," in text else tuple(FIRST_SEED + seed for seed in seeds)


def _checked(over: Mapping[str, Any]) -> dict[str, Any]:
    """Check what is set over every trial: fields of the run."""
    from pneuma.config import Run, read_setting
    from pneuma.search.space_file import FIXABLE

    for key in over:
        if key not in FIXABLE:
            raise unknown_name("key of --set", key, FIXABLE)
    return {key: read_setting(Run, key, value) for key, value in over.items()}


def _refuse_unread(search: Search, over: Mapping[str, Any]) -> None:
    """Refuse what is set over every trial and read by none."""
    runs = [run for _, run in search.space.corners()]
    for key in unread_settings(runs, over):
        raise UserError(f"--set {key}: {does_nothing(key, runs)}")


def _search(
    task: Task,
    store: Store,
    storage: str | None,
    how: Supervision,
    retry_failed: bool,
    json: bool,
    quiet: bool,
) -> int:
    from pneuma.search.driver import run_search
    from pneuma.search.trials import Unfinished

    noted: set[str] = set()

    def train(planned: Plan) -> None:
        train_plan(planned, store, how, retry_failed, quiet, noted)

    ended: list[Told] = []

    def tell(generation: list[Told], told: list[Told]) -> None:
        ended[:] = told
        _tell_generation(task, generation, told, quiet)

    code = 0
    try:
        run_search(task, store, storage, train, tell)
    except Unfinished as error:
        say(f"Stopped: {error}", aside=True)
        code = 1
    except KeyboardInterrupt as left:
        told = str(left) if isinstance(left, Detached) else "Stopped."
        say(f"{told} The same command goes on where the search was stopped.", aside=True)
        code = 130
    if json:
        print_json(_stopped_document(task, store) if code else _document(task, store, ended))
    elif not code:
        _tell_next(task.search, store, quiet)
    return code


def _document(task: Task, store: Store, told: Sequence[Told]) -> dict[str, Any]:
    """Return all trials of a search that has ended."""
    from pneuma.search.record import best_number, read_record, trial_document

    record = read_record(store, task.search.name)
    return {
        "schema": 1,
        "search": task.search.name,
        "trials": [trial_document(trial, task.search) for trial in told],
        "best": best_number(told, task.search),
        "storage": record["storage"],
        "optuna_study": record["optuna_study"],
    }


def _stopped_document(task: Task, store: Store) -> dict[str, Any]:
    """Return the trials of the generations that had ended before a search was stopped, if any."""
    from pneuma.search.record import is_published, read_record

    document = {"schema": 1, "search": task.search.name, "trials": [], "best": None}
    try:
        record = read_record(store, task.search.name)
    except UserError:  # it was stopped before it wrote anything
        return document
    if is_published(record):
        return document
    return {**document, **{key: record[key] for key in ("trials", "best", "storage", "optuna_study")}}


def _tell_next(search: Search, store: Store, quiet: bool) -> None:
    """Say what can be done with a search that has ended."""
    from pneuma.search.record import read_record

    storage = read_record(store, search.name)["storage"]
    say(f"Look closer with: optuna-dashboard {shlex.quote(storage)}", quiet=quiet)
    say(f"Draw it with: {command('search', 'plot', search.name, '--results', store.root)}", quiet=quiet)


def train_plan(
    planned: Plan, store: Store, how: Supervision, retry_failed: bool, quiet: bool, noted: set[str]
) -> None:
    """Train what a plan of trials lacks, and note what is to be known that was not `noted` before.

    Raises:
        Unfinished: where a run did not come to its end.
    """
    from pneuma.search.trials import Unfinished

    todo = execute.prepare(planned, store, retry_failed, how)
    for note in dict.fromkeys(todo.notes):
        if note not in noted:
            say(f"Note: {note}.", aside=True, quiet=quiet)
            noted.add(note)
    if todo.runs:
        with ProgressDisplay(planned, todo.runs, how.workers, quiet, todo.kept) as display:
            execute.execute(planned, todo.runs, store, how, display.update)
    for cell in planned.cells:
        status = store.status(cell.run_id)
        if not status.finished:
            again = "; --retry-failed tries again" if status.failed else ""
            raise Unfinished(f"{cell.condition} seed {cell.seed} {status.name} (run {cell.run_id}){again}")


def _tell_generation(task: Task, generation: Sequence[Told], told: Sequence[Told], quiet: bool) -> None:
    from pneuma.search.record import best_number, trial_document

    best = best_number(told, task.search)
    for trial in generation:
        own = trial_document(trial, task.search)
        note = f" ({trial.note})" if trial.note else ""
        say(f"trial {trial.number}: {trial.state}, {told_value(own)}{note}", aside=True, quiet=quiet)
    if isinstance(best, int):
        value = told_value(trial_document(told[best], task.search))
        say(f"{len(told)}/{task.budget.trials} trials; best {value}, trial {best}", aside=True, quiet=quiet)
    else:
        front = ", ".join(map(str, best or ())) or "none"
        say(f"{len(told)}/{task.budget.trials} trials; Pareto front: {front}", aside=True, quiet=quiet)


def told_value(trial: Mapping[str, Any]) -> str:
    """Return a recorded trial's value or values for people."""
    from pneuma.search.record import trial_values

    values = trial_values(trial)
    return "no value" if None in values else ", ".join(f"{value:.4g}" for value in values)
