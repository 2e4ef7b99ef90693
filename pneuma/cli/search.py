"""`pneuma search …`: search for hyperparameters, and train the winners on fresh seeds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pneuma.cli import complete
from pneuma.cli import options as opt
from pneuma.cli.output import (
    check_file,
    command,
    draw_files,
    print_json,
    print_listed,
    print_table,
    read_formats,
    say,
    tell_written,
    write_file,
)
from pneuma.cli.study_run import train as train_study
from pneuma.errors import UserError, counted, unknown_name
from pneuma.search import FIRST_SEED
from pneuma.study import execute, plan, spec
from pneuma.study.executors.base import LOCAL_CONFIG, Detached, ExecutorConfig
from pneuma.study.progress import ProgressDisplay
from pneuma.study.store import Store

if TYPE_CHECKING:
    from pneuma.search.promote import Gain, Winner
    from pneuma.search.spec import Search
    from pneuma.search.trials import EndedTrial, Task

app = typer.Typer(
    help="Find hyperparameters over several seeds, and confirm them on fresh ones.",
    short_help="Find hyperparameters, and confirm them on fresh seeds.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

SearchName = Annotated[
    str, opt.argument("NAME", "A search's name, or the path of a search file (….toml).", complete.searches)
]


# --- What there is --------------------------------------------------------------------------------


@app.command("list")
def list_(json: opt.Json = False) -> None:
    """List the shipped searches."""
    return print_listed("search", "searches", spec.studies_folder() / "search", json)


@app.command()
def show(name: SearchName, world: opt.WorldName = None, json: opt.Json = False) -> None:
    """Show what a search varies, what it seeks, and its presets."""
    from pneuma.search.spec import load_search

    search = load_search(name, world)
    if json:
        return print_json(_written(search))
    say(search.title + (f" (thesis section {search.spec.section})" if search.spec.section else ""))
    for line in search.spec.about.splitlines():
        say(line)
    print("\nSpace:")
    print_table(("", ""), [(f"  {parameter.name}", str(parameter)) for parameter in search.space.parameters])
    print("\nObjectives:")
    for objective in search.objectives:
        say(f"  {objective.direction} the {objective.over_seeds} over seeds of {objective.outcome}")
    for preset, budget in search.spec.presets.items():
        trials, seeds = counted(budget.trials, "trial"), counted(len(budget.seeds), "seed")
        print(f"  {preset:<9} {trials}, {seeds} each, {budget.steps:,} steps a run")
    return None


def _written(search: Search) -> dict[str, Any]:
    """Return a search as JSON, with the keys of its file."""
    return {
        "search": search.name,
        "world": search.world,
        **search.spec.model_dump(),
        "title": search.title,
        "run": search.space.fixed,
        "space": {parameter.name: parameter.written for parameter in search.space.parameters},
        "objectives": {each.name: each.model_dump(exclude={"name"}) for each in search.objectives},
    }


@app.command()
def status(
    name: SearchName, world: opt.WorldName = None, results: opt.Results = opt.RESULTS, json: opt.Json = False
) -> None:
    """Show how far a search is, and its best trials."""
    from pneuma.search.storage import read_record

    store = Store(results)
    searched = read_record(store, name, world)
    search, budget, best = searched.task.search, searched.task.budget, searched.best
    if json:
        amount = {"seeds": budget.seeds, "steps": budget.steps, "trials_asked": budget.trials}
        return print_json({**_document(searched.task, searched.trials), **amount})
    print(f"{len(searched.trials)} of {budget.trials} trials, {counted(len(budget.seeds), 'seed')} each")
    for objective in search.objectives:
        say(f"Value: {objective.direction} the {objective.over_seeds} over seeds of {objective.outcome}")
    among, rows = best if isinstance(best, list) else [best], []
    for trial in searched.trials:
        params = ", ".join(
            f"{key}={value:.4g}" if isinstance(value, float) else f"{key}={value}"
            for key, value in trial.params.items()
        )
        mark = "*" if trial.number in among else ""
        rows.append((f"{mark:>3}", trial.number, trial.state, _value(trial), params, trial.note))
    print_table(("", "trial", "", "value", "", ""), rows)
    named = (name, *(["--world", world] if world else []), "--results", store.root)
    if best is None:
        print("No trial is complete yet.")
    elif isinstance(best, int):
        say(f"Best (*): trial {best}. Confirm it with: {command('search', 'promote', *named)}")
    else:
        print(f"Pareto front (*): trials {', '.join(map(str, best)) or 'none yet'}.")
    return say(f"Look closer with: {command('search', 'plot', *named)}")


@app.command(short_help="Draw a search.")
def plot(
    name: SearchName,
    out: opt.PlotFolder = None,
    world: opt.WorldName = None,
    format: opt.Formats = None,
    results: opt.Results = opt.RESULTS,
    json: opt.Json = False,
) -> None:
    """Draw a search: history, importances, every parameter's values, and the best trials or Pareto front."""
    formats, store = read_formats(format, out), Store(results)
    from pneuma.figures.search import draw_search
    from pneuma.search.storage import read_record

    searched = read_record(store, name, world)
    formats_asked = (word for each in formats for word in ("--format", each))
    again = command("search", "plot", name, *(["--world", world] if world else []), *formats_asked)
    paths = draw_files(store, out, lambda folder: draw_search(searched, folder, formats, again))
    if not paths:
        say("Note: nothing is drawn before a trial is complete.", aside=True)
    return tell_written(paths, json)


# --- run ------------------------------------------------------------------------------------------


@app.command(short_help="Search for hyperparameters, or go on with a search.")
@opt.grouped
def run(
    name: SearchName,
    preset: Annotated[str, opt.option("--preset", "|".join(spec.PRESETS), "How much to search.")] = "quick",
    trials: Annotated[Any, opt.count("--trials", "How many trials, those stored among them.")] = None,
    seeds: Annotated[
        Any, opt.seeds("--seeds", "Seeds of each trial: a count (seeds 1000, 1001, …) or a list.", FIRST_SEED)
    ] = None,
    steps: opt.Steps = None,
    set_: opt.Settings = None,
    world: opt.WorldName = None,
    workers: opt.Workers = None,
    place: ExecutorConfig = LOCAL_CONFIG,
    retry_failed: opt.RetryFailed = False,
    results: opt.Results = opt.RESULTS,
    json: opt.Json = False,
    quiet: opt.Quiet = False,
) -> int:
    """Search for hyperparameters, going on where the search was stopped."""
    from pneuma.search import storage
    from pneuma.search.trials import Unfinished, best_number

    if place.detach:
        raise UserError("--detach: a search asks for trials by how those before did; leave it by Ctrl-C")
    store = Store(results)
    task = _task(name, world, preset, dict(set_ or ()), trials=trials, seeds=seeds, steps=steps)
    how = replace(place, workers=opt.most_workers(workers, place))
    ended_trials: list[EndedTrial] = []
    tell = partial(say, aside=True, quiet=quiet)
    train_trials = partial(train, store=store, how=how, retry_failed=retry_failed, quiet=quiet, noted=set())
    code = 0
    try:
        for ended in storage.run_search(task, store, train_trials, tell):
            for trial in ended[len(ended_trials) :]:
                note = f" ({trial.note})" if trial.note else ""
                say(f"trial {trial.number}: {trial.state}, {_value(trial)}{note}", aside=True, quiet=quiet)
            ended_trials = [*ended]
            best = best_number(ended_trials, task.search)
            found = f"front: {best}" if best else "none complete yet"
            if isinstance(best, int):
                found = f"best {_value(ended_trials[best])}, trial {best}"
            say(f"{len(ended_trials)}/{task.budget.trials} trials; {found}", aside=True, quiet=quiet)
    except Unfinished as error:
        say(f"Stopped: {error}", aside=True)
        code = 1
    except KeyboardInterrupt as left:
        stopped = str(left) if isinstance(left, Detached) else "Stopped."
        say(f"{stopped} The same command goes on where the search was stopped.", aside=True)
        code = 130
    if json:
        print_json(_document(task, ended_trials))
    elif not code:
        at = (name, *(["--world", world] if world else []), "--results", store.root)
        say(f"See its trials with: {command('search', 'status', *at)}", quiet=quiet)
        say(f"Draw it with: {command('search', 'plot', *at)}", quiet=quiet)
    return code


def _task(
    name: str,
    world: str | None,
    preset: str,
    over: Mapping[str, Any],
    **amount: Any,
) -> Task:
    """Return a search with overridden fields, and its preset's budget with the given amounts."""
    from pneuma.config import Run
    from pneuma.env_fields import read_field
    from pneuma.sb3_names import own_fields
    from pneuma.search.space import FIXABLE
    from pneuma.search.spec import load_search
    from pneuma.search.trials import Task

    for key in (over := own_fields(over)):
        if key not in FIXABLE.names:
            raise unknown_name("key of --set", key, FIXABLE.names)
    over = {key: read_field(Run, key, value) for key, value in over.items()}
    search = load_search(name, world)
    presets = search.spec.presets
    if preset not in presets:
        raise unknown_name(f"preset of search {search.name}", preset, presets)
    given = {key: value for key, value in amount.items() if value is not None}
    return Task(search.with_settings(over, over), presets[preset].model_copy(update=given), over)


def train(
    planned: plan.Plan,
    until: Mapping[str, int],
    *,
    store: Store,
    how: ExecutorConfig,
    retry_failed: bool,
    quiet: bool,
    noted: set[str],
) -> None:
    """Train the missing runs of trials up to their steps, and print notes that are not in `noted` yet.

    Raises:
        Unfinished: when a run did not finish.
    """
    from pneuma.search.trials import Unfinished

    todo, notes = execute.prepare(planned, store, retry_failed, until)
    for note in notes:
        say(f"Note: {note}.", aside=True, quiet=quiet or note in noted)
        noted.add(note)
    with ProgressDisplay(todo, store, quiet, until) as display:
        results = execute.execute(planned, todo, store, replace(how, until=until), display.update)
    for each in results:
        cell, status = each.cell, each.status
        if cell.run_id in until and not (status.finished or 0 < until[cell.run_id] <= status.step):
            what = f"{cell.condition} seed {cell.seed} {status.name} (run {cell.run_id})"
            why = f": {each.reason}" if each.reason else ""
            again = "; --retry-failed tries again" if status.failed else ""
            raise Unfinished(f"{what}{why}{again}")


def _document(task: Task, trials: Sequence[EndedTrial]) -> dict[str, Any]:
    from pneuma.search.storage import trial_document
    from pneuma.search.trials import best_number

    return {
        "search": task.search.name,
        "trials": [trial_document(trial, task.search) for trial in trials],
        "best": best_number(trials, task.search),
    }


def _value(trial: EndedTrial) -> str:
    return "no value" if trial.state == "failed" else ", ".join(f"{value:.4g}" for value in trial.values)


# --- promote --------------------------------------------------------------------------------------


@app.command(short_help="Train winners of searches on fresh seeds.")
def promote(
    names: Annotated[
        list[str],
        opt.argument("NAME", "Searches, or their files; several must be tuned alike.", complete.searches),
    ],
    seeds: opt.Seeds = "10",
    steps: opt.Steps = None,
    trial: Annotated[
        int | None, typer.Option("--trial", metavar="N", help="Which trial (default: the best).")
    ] = None,
    out: Annotated[
        Path | None, opt.option("--out", "FILE", "Write the study to a .toml file; train nothing.")
    ] = None,
    world: opt.WorldName = None,
    workers: opt.Workers = None,
    results: opt.Results = opt.RESULTS,
    json: opt.Json = False,
    quiet: opt.Quiet = False,
) -> int:
    """Train searches' winners and their bases on fresh seeds, and say how much of the gain was luck."""
    from pneuma.search.promote import find_winners, gains, winners_study
    from pneuma.search.storage import read_record

    if trial is not None and len(names) > 1:
        raise UserError(f"--trial {trial}: is of one search; name one")
    store = Store(results)
    searches = [read_record(store, name, world) for name in names]
    winners = find_winners(searches, trial, seeds)
    steps = steps or searches[0].task.budget.steps
    text = winners_study(winners, seeds, steps).encode()
    searched_names = [searched.task.search.name for searched in searches]
    chosen: list[dict[str, Any]] = [
        {"search": name, "trial": winner.trial.number, "params": winner.trial.params}
        for name, winner in zip(searched_names, winners, strict=True)
    ]
    if out is not None:
        check_file(out, (".toml",))
        if out.exists():
            raise UserError(f"--out {out}: is there already; name another, or remove it first")
        write_file(out, text)
        say(f"wrote {out}", aside=json)
        say(f"Train it with: {command('study', 'run', out, '--results', results)}", aside=json)
        if json:
            print_json({"study": out, "winners": chosen})
        return 0
    study = "-".join(["promoted", *(searched.task.search.label for searched in searches)])
    path = store.root / "searches" / f"{study}.toml"
    store.check_writable()
    store.write(path, text)
    say(f"wrote {path}", aside=True, quiet=quiet)
    planned = plan.make_plan(spec.load_study(str(path)), plan.Selection(seeds=seeds, steps=steps))
    how = ExecutorConfig(workers=opt.most_workers(workers))
    code = train_study(planned, store, how, retry_failed=True, json=json, quiet=quiet, document=False)
    ends = {arm: [c.run_id for c in planned.cells if c.condition == arm] for arm in planned.conditions}
    diverged = {arm: sum(store.status(i).name == "diverged" for i in ids) for arm, ids in ends.items()}
    document = {"study": path, "seeds": seeds, "run_ids": ends, "diverged": diverged}
    if code:
        say(f"Not all runs ended: {command('study', 'status', path, '--results', store.root)}", aside=True)
    else:
        for winner, row in zip(winners, chosen, strict=True):
            row["objectives"] = gains(winner, planned, store)
    if json:
        print_json({**document, "winners": chosen})
    elif not code:
        for winner, row in zip(winners, chosen, strict=True):
            _print_gains(winner, row["objectives"], len(seeds))
        for arm, count in diverged.items():
            if count:
                print(f"{count} of {arm}'s {len(seeds)} runs diverged, and count as in a search")
    return code


def _print_gains(winner: Winner, gains: Mapping[str, Gain], seeds: int) -> None:
    search = winner.searched.task.search
    print(f"Trial {winner.trial.number} of search {search.name} on {seeds} fresh seeds:")
    heads = ("", "in the search", "on fresh seeds", "base", "difference of means", "95 % interval", "luck")
    rows = []
    for objective in search.objectives:
        gain = gains[objective.name]
        values = (f"{value:.4f}" for value in (gain.seen, gain.fresh, gain.fresh_baseline))
        interval = " to ".join(f"{end:+.4f}" for end in gain.interval)
        gained = f"{gain.difference:+.4f}", interval, f"{gain.luck:+.4f}"
        shown = ("–" if "nan" in text else text for text in (*values, *gained))
        rows.append((f"{objective.over_seeds} of {objective.outcome}", *shown))
    print_table(heads, rows)
    print("Luck: by how much the search's seeds had flattered it.")
