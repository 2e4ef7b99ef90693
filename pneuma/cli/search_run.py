"""`pneuma search run` and `promote`: what trains the runs of trials, and of winners."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pneuma.cli.options import (
    EngineName,
    Json,
    OwnSeeds,
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
    read_path,
    read_seeds_option,
    read_settings_options,
    read_workers,
    say,
)
from pneuma.cli.out_files import check_file, write_file
from pneuma.cli.plain_text import command, plain
from pneuma.cli.progress import ProgressDisplay
from pneuma.cli.study_run import train_cells
from pneuma.errors import UserError, unknown_name
from pneuma.study import execute, plan, spec
from pneuma.study.executors.base import HERE, Detached, Place, Supervision
from pneuma.study.store import Store
from pneuma.worlds import TEXT, split_world

if TYPE_CHECKING:
    from pneuma.search.promote import Gain, Winner
    from pneuma.search.spec import Budget, Search
    from pneuma.search.storage import Searched
    from pneuma.search.trials import Task, Told

RESULTS = Path("results")

SearchName = Annotated[
    str, typer.Argument(metavar="NAME", help="A search's name, or the path of a search file (….toml).")
]


@places
def run(
    name: SearchName,
    preset: Preset = None,
    trials: Annotated[
        str | None, typer.Option("--trials", metavar="N", help="How many trials, those stored among them.")
    ] = None,
    seeds: Annotated[
        str | None,
        typer.Option(
            "--seeds",
            metavar="N|LIST",
            help="Seeds of each trial: a count N (seeds 1000, 1001, …) or a list.",
        ),
    ] = None,
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
    from pneuma.search.storage import replaced_note

    over = {**read_settings_options(set_), **({"engine": engine} if engine else {})}
    task = _task(name, world, over, preset, trials, seeds, steps)
    if place.detach:
        raise UserError("--detach: a search asks for trials by how those before did; leave it by Ctrl-C")
    store, how = Store(results), Supervision(workers=read_workers(workers, place), place=place)
    if note := replaced_note(store, task):
        say(f"Note: {note}.", aside=True, quiet=quiet)
    noted: set[str] = set()
    return _search(task, store, lambda planned: train(planned, store, how, retry_failed, quiet, noted),
                   json, quiet)  # fmt: skip


def promote(
    names: Annotated[
        list[str],
        typer.Argument(metavar="NAME…", help="Searches, or their files; several must be tuned alike."),
    ],
    seeds: OwnSeeds = "10",
    steps: Steps = None,
    trial: Annotated[
        int | None, typer.Option("--trial", metavar="N", help="Which trial (default: the best).")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="FILE",
            parser=read_path,
            help="Write the study to a .toml file; train nothing.",
        ),
    ] = None,
    world: WorldName = None,
    workers: Workers = None,
    results: Results = RESULTS,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Train searches' winners and their bases on fresh seeds, and say how much of the gain was luck."""
    from pneuma.search.promote import find_winners, gains, winners_study
    from pneuma.search.storage import read_record

    if trial is not None and len(names) > 1:
        raise UserError(f"--trial {trial}: is of one search; name one")
    store, fresh = Store(results), read_seeds_option(seeds)
    searches = [read_record(store, name, world) for name in names]
    winners = find_winners(searches, trial, fresh)
    for name, winner in zip(names, winners, strict=True):
        _refuse_untrusted(winner, name)
    budget = searches[0].task.budget.steps if steps is None else read_count("--steps", steps)
    text = winners_study(winners, fresh, budget).encode()
    chosen = [
        {"search": own.searched.task.search.name, "trial": own.trial.number, "params": own.trial.params}
        for own in winners
    ]
    if out is not None:
        check_file(out, (".toml",))
        if out.exists():
            raise UserError(f"--out {out}: is there already; name another, or remove it first")
        write_file(out, text)
        say(f"wrote {plain(str(out))}", aside=json)
        say(f"Train it with: {command('study', 'run', out, '--results', results)}", aside=json)
        if json:
            print_json({"schema": 1, "study": str(out), "winners": chosen})
        return 0
    path = store.root / "searches" / f"{_study_name(searches)}.toml"
    store.check_writable()
    store.write(path, text)
    say(f"wrote {plain(str(path))}", aside=True, quiet=quiet)
    planned = plan.make_plan(spec.load_study(str(path)), plan.Selection(seeds=fresh, steps=budget))
    how = Supervision(workers=read_workers(workers))
    _, code = train_cells(planned, store, how, retry_failed=True, json=json, quiet=quiet)
    if code:
        say(f"Not all runs ended: {command('study', 'status', path, '--results', store.root)}", aside=True)
        return code
    found = [gains(winner, planned, store) for winner in winners]
    ends = {arm: [c.run_id for c in planned.cells if c.condition == arm] for arm in planned.conditions}
    diverged = {arm: sum(store.status(i).name == "diverged" for i in ids) for arm, ids in ends.items()}
    if json:
        rows = [
            {**own, "objectives": {name: asdict(gain) for name, gain in gained.items()}}
            for own, gained in zip(chosen, found, strict=True)
        ]
        document = {"study": str(path), "seeds": list(fresh), "run_ids": ends, "diverged": diverged}
        print_json({"schema": 1, **document, "winners": rows})
        return 0
    for winner, gained in zip(winners, found, strict=True):
        _print_gains(winner, gained, len(fresh))
    for arm, count in diverged.items():
        if count:
            print(f"{count} of {arm}'s {len(fresh)} runs diverged, and count as in a search")
    return 0


# --- Running ---------------------------------------------------------------------------------------


def _task(
    name: str,
    world: str | None,
    over: Mapping[str, Any],
    preset: str | None,
    trials: str | None,
    seeds: str | None,
    steps: str | None,
) -> Task:
    """Return the search and budget that options ask for."""
    from pneuma.config import Run, read_field
    from pneuma.search.space import FIXABLE
    from pneuma.search.spec import load_search
    from pneuma.search.trials import Task

    search = load_search(name, world)
    for key in over:
        if key not in FIXABLE.names:
            raise unknown_name("key of --set", key, FIXABLE.names)
    over = {key: read_field(Run, key, value) for key, value in over.items()}
    budget = _budget(search, preset or "quick", trials, seeds, steps)
    file = str(Path(name).resolve()) if name.endswith(".toml") else ""
    return Task(search.with_settings(over, over) if over else search, budget, file, over)


def _budget(search: Search, preset: str, trials: str | None, seeds: str | None, steps: str | None) -> Budget:
    """Return a search's budget: its preset's, with what the options give in its place."""
    from pneuma.search import FIRST_SEED
    from pneuma.search.spec import Budget

    if preset not in search.presets:
        raise unknown_name(f"preset of search {search.name}", preset, search.presets)
    own = search.presets[preset]
    first = FIRST_SEED if seeds is not None and not {",", "."} & {*seeds} else 0
    return Budget(
        own.trials if trials is None else read_count("--trials", trials),
        own.seeds if seeds is None else tuple(first + seed for seed in read_seeds_option(seeds)),
        own.steps if steps is None else read_count("--steps", steps),
    )


def _search(task: Task, store: Store, train: Any, json: bool, quiet: bool) -> int:
    from pneuma.search import storage
    from pneuma.search.trials import Unfinished, best_number

    told: list[Told] = []
    code = 0
    try:
        for trials in storage.run_search(task, store, train):
            for trial in trials[len(told) :]:
                note = f" ({trial.note})" if trial.note else ""
                say(
                    f"trial {trial.number}: {trial.state}, {told_value(trial)}{note}", aside=True, quiet=quiet
                )
            told = [*trials]
            best = best_number(told, task.search)
            found = (
                f"best {told_value(told[best])}, trial {best}" if isinstance(best, int) else f"front: {best}"
            )
            say(f"{len(told)}/{task.budget.trials} trials; {found}", aside=True, quiet=quiet)
    except Unfinished as error:
        say(f"Stopped: {error}", aside=True)
        code = 1
    except KeyboardInterrupt as left:
        stopped = str(left) if isinstance(left, Detached) else "Stopped."
        say(f"{stopped} The same command goes on where the search was stopped.", aside=True)
        code = 130
    if json:
        print_json(search_document(task, told, store))
    elif not code:
        at = ("--results", store.root)
        say(f"See its trials with: {command('search', 'status', task.search.name, *at)}", quiet=quiet)
        say(f"Draw it with: {command('search', 'plot', task.search.name, *at)}", quiet=quiet)
    return code


def train(
    planned: plan.Plan, store: Store, how: Supervision, retry_failed: bool, quiet: bool, noted: set[str]
) -> None:
    """Train what a plan of trials lacks, and note what is to be known that was not `noted` before.

    Raises:
        Unfinished: where a run did not come to its end.
    """
    from pneuma.search.trials import Unfinished

    todo = execute.prepare(planned, store, retry_failed, how)
    for note in dict.fromkeys(todo.notes):
        say(f"Note: {note}.", aside=True, quiet=quiet or note in noted)
        noted.add(note)
    if todo.runs:
        with ProgressDisplay(planned, todo.runs, quiet, todo.kept) as display:
            execute.execute(planned, todo.runs, store, how, display.update)
    for cell in planned.cells:
        status = store.status(cell.run_id)
        if not status.finished:
            again = "; --retry-failed tries again" if status.failed else ""
            raise Unfinished(f"{cell.condition} seed {cell.seed} {status.name} (run {cell.run_id}){again}")


def _refuse_untrusted(winner: Winner, name: str) -> None:
    """Refuse what a record, or a file that it alone names, would have run or read: both may be untrusted."""
    from pneuma.study.identity import own_things

    task = winner.searched.task
    for settings in (task.search.space.fixed, winner.trial.settings):
        for key, deed in own_things(settings).items():
            if key in task.over or not name.endswith(".toml"):
                raise UserError(f"search {task.search.name} would {deed}: say so in its file, and name that")


def _study_name(searches: Sequence[Searched]) -> str:
    """Return what the study of winners is called; the end of a name tells a study's world."""
    split = [split_world(searched.task.search.name) for searched in searches]
    there = [] if split[0][1] == TEXT else [split[0][1]]
    return "-".join(["promoted", *there, *(name for name, _ in split)])


def _print_gains(winner: Winner, gains: Mapping[str, Gain], seeds: int) -> None:
    search = winner.searched.task.search
    print(f"Trial {winner.trial.number} of search {search.name} on {seeds} fresh seeds:")
    for objective in search.objectives:
        own = gains[objective.name]
        low, high = (_signed(end) for end in own.interval)
        luck = _signed(own.luck)
        print(f"  {objective.over_seeds} over seeds of {plain(objective.outcome)}:")
        print(f"    in the search       {own.seen:.4f}")
        print(f"    on fresh seeds      {own.fresh:.4f}   (base: {own.fresh_baseline:.4f})")
        between = "not told" if low == "not told" else f"{low} to {high}"
        print(f"    difference of means {_signed(own.difference)} (95 % interval {between})")
        flattery = "" if luck == "not told" else ": by how much the search's seeds had flattered it"
        print(f"    luck                {luck}{flattery}")


def _signed(value: float) -> str:
    """Return a difference with its sign; "not told" where it is not known."""
    return "not told" if math.isnan(value) else f"{value:+.4f}"


def search_document(task: Task, trials: Sequence[Told], store: Store) -> dict[str, Any]:
    """Return what a search came to, as JSON has it."""
    from pneuma.search.storage import journal_path, trial_document
    from pneuma.search.trials import best_number

    return {
        "schema": 1,
        "search": task.search.name,
        "trials": [trial_document(trial, task.search) for trial in trials],
        "best": best_number(trials, task.search),
        "journal": str(journal_path(store, task.search.name)),
    }


def told_value(trial: Told) -> str:
    """Return a trial's value or values for people."""
    return "no value" if trial.state == "failed" else ", ".join(f"{value:.4g}" for value in trial.values)
