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
    read_seeds_option,
    read_settings_options,
    read_workers,
    say,
)
from pneuma.cli.plain_text import command, plain
from pneuma.cli.progress import ProgressDisplay
from pneuma.errors import UserError, unknown_name
from pneuma.study import execute
from pneuma.study.executors.base import HERE, Detached, Place, Supervision
from pneuma.study.plan import Plan
from pneuma.study.store import Store

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
    workers: Workers = None,
    place: Place = HERE,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Try runs again that crashed before.")
    ] = False,
    results: Results = RESULTS,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Search for hyperparameters, going on where the search was stopped."""
    from pneuma.search.spec import load_search
    from pneuma.search.storage import replaced_note
    from pneuma.search.trials import Task

    search = load_search(name, world)
    over = {**read_settings_options(set_), **({"engine": engine} if engine else {})}
    if over:
        search = _with_options(search, over)
    task = Task(search, read_budget(search, preset, trials, seeds, steps))
    store = Store(results)
    if place.detach:
        raise UserError("--detach: a search asks for trials by how those before did; leave it by Ctrl-C")
    how = Supervision(workers=read_workers(workers, place), place=place)
    if note := replaced_note(store, task):
        say(f"Note: {note}.", aside=True, quiet=quiet)
    return _search(task, store, how, retry_failed, json, quiet)


def read_budget(
    search: Search, preset: str | None, trials: str | None, seeds: str | None, steps: str | None
) -> Budget:
    """Return a search's budget: its preset's, with what the options give in its place."""
    from pneuma.search import FIRST_SEED
    from pneuma.search.spec import Budget

    chosen = preset or "quick"
    if chosen not in search.presets:
        raise unknown_name(f"preset of search {search.name}", chosen, search.presets)
    own = search.presets[chosen]
    first = FIRST_SEED if seeds is not None and "," not in seeds else 0
    return Budget(
        own.trials if trials is None else read_count("--trials", trials),
        own.seeds if seeds is None else tuple(first + seed for seed in read_seeds_option(seeds)),
        own.steps if steps is None else read_count("--steps", steps),
    )


def _with_options(search: Search, over: Mapping[str, Any]) -> Search:
    """Return a search with fields of the run that are set over every trial."""
    from pneuma.config import Run, read_field
    from pneuma.search.spec import FIXABLE

    for key in over:
        if key not in FIXABLE.names:
            raise unknown_name("key of --set", key, FIXABLE.names)
    return search.with_settings({key: read_field(Run, key, value) for key, value in over.items()}, over)


def _search(
    task: Task,
    store: Store,
    how: Supervision,
    retry_failed: bool,
    json: bool,
    quiet: bool,
) -> int:
    from pneuma.search.storage import read_record, run_search, trial_document
    from pneuma.search.trials import Unfinished, best_number

    noted: set[str] = set()

    def train(planned: Plan) -> None:
        train_plan(planned, store, how, retry_failed, quiet, noted)

    told: list[Told] = []
    code = 0
    try:
        for trials in run_search(task, store, train):
            _tell_generation(task, trials[len(told) :], trials, quiet)
            told = [*trials]
    except Unfinished as error:
        say(f"Stopped: {error}", aside=True)
        code = 1
    except KeyboardInterrupt as left:
        stopped = str(left) if isinstance(left, Detached) else "Stopped."
        say(f"{stopped} The same command goes on where the search was stopped.", aside=True)
        code = 130
    if json:
        document = {
            "schema": 1,
            "search": task.search.name,
            "trials": [trial_document(trial, task.search) for trial in told],
            "best": best_number(told, task.search),
        }
        if told:
            record = read_record(store, task.search.name)
            document |= {"storage": record.storage, "optuna_study": record.optuna_study}
        print_json(document)
    elif not code:
        address = shlex.quote(read_record(store, task.search.name).storage)
        say(f"Look closer with: optuna-dashboard {plain(address)}", quiet=quiet)
        drawn = command("search", "plot", task.search.name, "--results", store.root)
        say(f"Draw it with: {drawn}", quiet=quiet)
    return code


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
    from pneuma.search.trials import best_number

    best = best_number(told, task.search)
    for trial in generation:
        note = f" ({trial.note})" if trial.note else ""
        say(f"trial {trial.number}: {trial.state}, {told_value(trial)}{note}", aside=True, quiet=quiet)
    if isinstance(best, int):
        found = f"best {told_value(told[best])}, trial {best}"
    else:
        found = f"Pareto front: {', '.join(map(str, best or ())) or 'none'}"
    say(f"{len(told)}/{task.budget.trials} trials; {found}", aside=True, quiet=quiet)


def told_value(trial: Told) -> str:
    """Return a trial's value or values for people."""
    return "no value" if trial.state == "failed" else ", ".join(f"{value:.4g}" for value in trial.values)
