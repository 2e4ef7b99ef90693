"""`pneuma search …`: search for hyperparameters, and train the winners on fresh seeds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pneuma.cli import options as opt
from pneuma.cli.output import (
    Result,
    Table,
    check_file,
    command,
    draw_files,
    keep_files,
    listed_result,
    read_formats,
    say,
    write_file,
    wrote,
)
from pneuma.cli.study_run import train as train_study
from pneuma.errors import UserError, counted, unknown_name
from pneuma.search import FIRST_SEED
from pneuma.study import execute, plan, spec
from pneuma.study.executors.base import Detached, ExecutorConfig
from pneuma.study.progress import ProgressDisplay
from pneuma.study.store import Store

if TYPE_CHECKING:
    from optuna.trial import FrozenTrial

    from pneuma.search.journal import RecordedSearch
    from pneuma.search.promote import Gain, Winner
    from pneuma.search.spec import Search
    from pneuma.search.task import Task

app = opt.Commands(
    "Find hyperparameters over several seeds, and confirm them on fresh ones.",
    short_help="Find hyperparameters, and confirm them on fresh seeds.",
)

SEARCH = opt.argument("NAME", "A search's name, or the path of a search file (….toml).")


# --- What there is --------------------------------------------------------------------------------


@app.command("list")
def list_() -> Result:
    """List the shipped searches."""
    return listed_result("search", "searches", spec.studies_folder() / "search")


@app.command()
def show(name: str = SEARCH, world: opt.Text = opt.WORLD) -> Result:
    """Show what a search varies, what it seeks, and its presets."""
    from pneuma.search.spec import load_search

    search = load_search(name, world)
    document = {
        "search": search.name,
        "world": search.world,
        **search.spec.model_dump(),
        "title": search.title,
        "run": search.space.fixed,
        "space": {parameter.name: parameter.written for parameter in search.space.parameters},
        "objectives": {each.name: each.model_dump(exclude={"name"}) for each in search.objectives},
    }
    return Result(document, _show(search))


def _show(search: Search) -> Iterator[str | Table]:
    yield search.title + (f" (thesis section {search.spec.section})" if search.spec.section else "")
    yield from search.spec.about.splitlines()
    yield ""
    yield "Space:"
    yield Table(("", ""), [(f"  {parameter.name}", str(parameter)) for parameter in search.space.parameters])
    yield ""
    yield "Objectives:"
    for objective in search.objectives:
        yield f"  {objective.direction} the {objective.over_seeds} over seeds of {objective.outcome}"
    yield ""
    start = f"; the first trials are {', '.join(search.spec.start)}" if search.spec.start else ""
    yield f"Base: {search.space.base}{start}"
    yield f"All trials: {_pairs(search.space.fixed) or 'as the base'}"
    for head, chosen in (("Sampler", search.spec.sampler), ("Pruner", search.spec.pruner)):
        arguments = _pairs(chosen.arguments)
        yield f"{head}: {chosen.name or 'none'}" + (f" ({arguments})" if arguments else "")
    yield f"Suggested together: {counted(search.spec.generation, 'trial')}"
    yield ""
    yield "Presets:"
    for preset, budget in search.spec.presets.items():
        trials, seeds = counted(budget.trials, "trial"), counted(len(budget.seeds), "seed")
        yield f"  {preset:<9} {trials}, {seeds} each, {budget.steps:,} steps a run"


def _pairs(values: Mapping[str, Any]) -> str:
    from pneuma.schema import shown  # pydantic: not for `--help`

    words = {key: shown("none" if value is None else value) for key, value in values.items()}
    return ", ".join(f"{key} = {word}" for key, word in words.items())


@app.command()
def status(name: str = SEARCH, world: opt.Text = opt.WORLD, results: Path = opt.RESULTS) -> Result:
    """Show how far a search is, and its best trials."""
    from pneuma.search.journal import published_log, read_record

    searched = read_record(store := Store(results), name, world)
    label = searched.task.search.label
    budget = searched.task.budget
    amount = {"seeds": budget.seeds, "steps": budget.steps, "trials_asked": budget.trials}
    document = {**_document(searched.task, searched.trials), **amount}
    shown = [*_status(searched, _asked_words(name, world, results))]
    trials = f"search-{label}"
    if searched.published:
        shown.insert(0, f"Published in {searched.published}, without its runs.")
    elif other := published_log(store, label):
        shown.append(f"A published search is in {other}; --results with an empty folder shows it.")
    if searched.running and not searched.published and store.listing_path(trials).exists():
        runs = command("study", "status", trials, "--results", results)
        shown.append(f"Other trials have not ended. See their runs with: {runs}")
    return Result(document, shown)


def _asked_words(name: str, world: str | None, results: Path) -> list[object]:
    return [name, *(["--world", world] if world else []), "--results", results]


def _status(searched: RecordedSearch, asked: Sequence[object]) -> Iterator[str | Table]:
    from pneuma.search.journal import STATES

    budget, best = searched.task.budget, searched.best
    yield f"{len(searched.trials)} of {budget.trials} trials, {counted(len(budget.seeds), 'seed')} each"
    for objective in searched.task.search.objectives:
        yield f"Value: {objective.direction} the {objective.over_seeds} over seeds of {objective.outcome}"
    among, rows = best if isinstance(best, list) else [best], []
    for trial in searched.trials:
        params = ", ".join(
            f"{key}={value:.4g}" if isinstance(value, float) else f"{key}={value}"
            for key, value in searched.task.search.space.named(trial.params).items()
        )
        mark = "*" if trial.number in among else ""
        note = str(trial.user_attrs.get("note", ""))
        rows.append((f"{mark:>3}", trial.number, STATES[trial.state], _value(trial), params, note))
    yield Table(("", "trial", "", "value", "", ""), rows)
    if best is None:
        yield "No trial is complete yet."
    elif isinstance(best, int):
        yield f"Best (*): trial {best}. Confirm it with: {command('search', 'promote', *asked)}"
    else:
        yield f"Pareto front (*): trials {', '.join(map(str, best)) or 'none yet'}."
    yield f"Look closer with: {command('search', 'plot', *asked)}"


@app.command(short_help="Draw a search.")
def plot(
    name: str = SEARCH,
    out: Path | None = opt.PLOT_FOLDER,
    world: opt.Text = opt.WORLD,
    format: opt.SeveralRead = opt.FORMATS,
    results: Path = opt.RESULTS,
) -> Result:
    """Draw a search: history, importances, every parameter's values, and the best trials or Pareto front."""
    formats, store = read_formats(format, out), Store(results)
    from pneuma.figures.search import draw_search
    from pneuma.search.journal import read_record

    searched = read_record(store, name, world)
    formats_asked = (word for each in formats for word in ("--format", each))
    again = command("search", "plot", *_asked_words(name, world, results), *formats_asked)
    files = keep_files(store, out, lambda folder: draw_search(searched, folder, formats, again))
    if not files:
        say("Note: nothing is drawn before a trial is complete.", aside=True)
    return Result({"figures": files}, wrote(files))


# --- run ------------------------------------------------------------------------------------------


@app.command(short_help="Search for hyperparameters, or go on with a search.")
def run(
    place: opt.Place,
    name: str = SEARCH,
    preset: str = opt.option("--preset", "|".join(spec.PRESETS), "How much to search.", default="quick"),
    trials: Any = opt.count("--trials", "How many trials, those stored among them."),
    seeds: Any = opt.seeds(
        "--seeds", "Seeds of each trial: a count (seeds 1000, 1001, …) or a list.", FIRST_SEED
    ),
    steps: Any = opt.STEPS,
    set_: opt.SeveralRead = opt.SETTINGS,
    world: opt.Text = opt.WORLD,
    retry_failed: bool = opt.RETRY_FAILED,
    results: Path = opt.RESULTS,
    quiet: bool = opt.QUIET,
) -> Result:
    """Search for hyperparameters, going on where the search was stopped."""
    from pneuma.search.journal import STATES, best_number
    from pneuma.search.trials import Unfinished, run_search

    store = Store(results)
    task = _task(name, world, preset, dict(set_ or ()), trials=trials, seeds=seeds, steps=steps)
    how = place.config()
    ended_trials: list[FrozenTrial] = []
    report = partial(say, aside=True, quiet=quiet)
    train_trials = partial(train, store=store, how=how, retry_failed=retry_failed, quiet=quiet, noted=set())
    code = 0
    try:
        for ended in run_search(task, store, train_trials, report):
            for trial in ended[len(ended_trials) :]:
                note = f" ({note})" if (note := trial.user_attrs.get("note")) else ""
                state = STATES[trial.state]
                say(f"trial {trial.number}: {state}, {_value(trial)}{note}", aside=True, quiet=quiet)
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
    asked = _asked_words(name, world, results)
    shown = [
        f"See its trials with: {command('search', 'status', *asked)}",
        f"Draw it with: {command('search', 'plot', *asked)}",
    ]
    return Result(_document(task, ended_trials), [] if code or quiet else shown, code=code)


def _task(name: str, world: str | None, preset: str, over: Mapping[str, Any], **amount: Any) -> Task:
    """Return a search with overridden fields, and its preset's budget with the given amounts."""
    from pneuma.config import Run
    from pneuma.env.fields import read_field
    from pneuma.sb3_names import own_fields
    from pneuma.search.space import FIXABLE
    from pneuma.search.spec import load_search
    from pneuma.search.task import Task

    for key in (over := own_fields(over)):
        if key not in FIXABLE:
            raise unknown_name("key of --set", key, FIXABLE)
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

    Raises `Unfinished` when a run did not finish.
    """
    from pneuma.search.trials import Unfinished

    todo, notes = execute.prepare(planned, store, retry_failed, until)
    for note in (*planned.notes, *notes):
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


def _document(task: Task, trials: Sequence[FrozenTrial]) -> dict[str, Any]:
    from pneuma.search.journal import best_number, trial_document

    return {
        "search": task.search.name,
        "trials": [trial_document(trial, task.search) for trial in trials],
        "best": best_number(trials, task.search),
    }


def _value(trial: FrozenTrial) -> str:
    return ", ".join(f"{value:.4g}" for value in trial.values or ()) or "no value"


# --- promote --------------------------------------------------------------------------------------


@app.command(short_help="Train winners of searches on fresh seeds.")
def promote(
    names: list[str] = opt.argument("NAME", "Searches, or their files; several must be tuned alike."),
    seeds: Any = opt.seeds_of_runs("10"),
    steps: Any = opt.STEPS,
    trial: int | None = opt.number("--trial", "Which trial (default: the best)."),
    out: Path | None = opt.option("--out", "FILE", "Write the study to a .toml file; train nothing."),
    world: opt.Text = opt.WORLD,
    workers: Any = opt.WORKERS,
    results: Path = opt.RESULTS,
    quiet: bool = opt.QUIET,
) -> Result:
    """Train searches' winners and their bases on fresh seeds, and say how much of the gain was luck."""
    from pneuma.search import promote as promotion

    store = Store(results)
    promoted = promotion.promote(store, names, seeds, steps, trial, world)
    chosen: list[dict[str, Any]] = [
        {
            "search": winner.searched.task.search.name,
            "trial": winner.trial.number,
            "params": winner.trial.params,
            "is_base": winner.is_base,
        }
        for winner in promoted.winners
    ]
    if trial is None and out is None and all(each["is_base"] for each in chosen):
        said = "the search found nothing better than its base"
        return Result({"winners": chosen}, [f"{each['search']}: {said}" for each in chosen])
    if out is not None:
        check_file(out, (".toml",))
        if out.exists():
            raise UserError(f"--out {out}: is there already; name another, or remove it first")
        write_file(out, promoted.text.encode())
        train_with = f"Train it with: {command('study', 'run', out, '--results', results)}"
        return Result({"study": out, "winners": chosen}, notes=[f"wrote {out}", train_with])
    planned, path = promoted.plan(store), promoted.path(store)
    say(f"wrote {path}", aside=True, quiet=quiet)
    how = ExecutorConfig(workers=opt.most_workers(workers))
    trained = train_study(planned, store, how, retry_failed=True, quiet=quiet)
    ends = {arm: [c.run_id for c in planned.cells if c.condition == arm] for arm in planned.conditions}
    diverged = {arm: sum(store.status(i).name == "diverged" for i in ids) for arm, ids in ends.items()}
    document = {"study": path, "seeds": seeds, "run_ids": ends, "diverged": diverged, "winners": chosen}
    if trained.code:
        say(f"Not all runs ended: {command('study', 'status', path, '--results', store.root)}", aside=True)
        return Result(document, notes=trained.notes, code=trained.code)

    from pneuma.figures.search import winners_page

    data, shown = promoted.data(store), list[str | Table]()
    for winner, row in zip(promoted.winners, chosen, strict=True):
        row["objectives"] = promotion.gains(winner, data)
        shown += _show_gains(winner, row["objectives"], len(seeds))
    given = ["--seeds", ",".join(map(str, seeds)), "--steps", promoted.steps, "--results", results]
    given += ["--trial", trial] * (trial is not None) + ["--world", world] * (world is not None)
    page = winners_page(promoted.name, promoted.winners, data)
    again = command("search", "promote", *names, *given)
    document["figures"] = draw_files(store, None, read_formats(None, None), [(page, again)])
    shown += wrote(document["figures"])
    shown += [
        f"{count} of {arm}'s {len(seeds)} runs diverged, and count as in a search"
        for arm, count in diverged.items()
        if count
    ]
    return Result(document, shown, notes=trained.notes)


def _show_gains(winner: Winner, gains: Mapping[str, Gain], seeds: int) -> Iterator[str | Table]:
    search = winner.searched.task.search
    yield f"Trial {winner.trial.number} of search {search.name} on {seeds} fresh seeds:"
    heads = ("", "in the search", "on fresh seeds", "base", "difference of means", "95 % interval", "luck")
    rows = []
    for objective in search.objectives:
        gain = gains[objective.name]
        values = (f"{value:.4f}" for value in (gain.seen, gain.fresh, gain.fresh_baseline))
        interval = " to ".join(f"{end:+.4f}" for end in gain.interval)
        gained = f"{gain.difference:+.4f}", interval, f"{gain.luck:+.4f}"
        shown = ("–" if "nan" in text else text for text in (*values, *gained))
        rows.append((f"{objective.over_seeds} of {objective.outcome}", *shown))
    yield Table(heads, rows)
    yield "Luck: by how much the search's seeds had flattered it; unknown (–) with other steps."
