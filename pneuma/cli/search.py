"""`pneuma search …`: search for hyperparameters, and train the winners on fresh seeds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.cli import options as opt
from pneuma.cli.output import (
    Result,
    Table,
    check_file,
    command,
    draw_files,
    frame_table,
    keep_files,
    listed_result,
    read_formats,
    rows_of,
    say,
    write_file,
    wrote,
)
from pneuma.cli.study_run import train as train_study
from pneuma.errors import UserError, counted, unknown_name
from pneuma.search import FIRST_SEED
from pneuma.store.store import Store
from pneuma.study import shipped, spec

if TYPE_CHECKING:
    import pandas as pd
    from optuna.trial import FrozenTrial

    from pneuma.search.record import Record
    from pneuma.study.plan import Plan

app = opt.Commands("search", "Find hyperparameters over several seeds, and confirm them on fresh ones.")


@dataclass(frozen=True)
class Asked:
    """Which search a command reads: the options that its name goes with."""

    set_: opt.Settings = None
    world: opt.World = None
    results: opt.Results = opt.HERE

    @property
    def store(self) -> Store:
        return Store(self.results)

    @property
    def settings(self) -> dict[str, Any]:
        return dict(self.set_ or ())

    def read(self, name: str) -> Record:
        from pneuma.search.record import read_record

        return read_record(self.store, name, self.world, self.settings)


SearchName = Annotated[str, opt.argument("NAME", "A search's name, or the path of a search file (….toml).")]


# --- What there is --------------------------------------------------------------------------------


@app.command("list")
def list_() -> Result:
    """List the shipped searches."""
    return listed_result("search", "searches", shipped.studies_folder() / "search")


@app.command(short_help="Show a search's file.")
def show(name: SearchName, world: opt.World = None) -> Result:
    """Show what a search varies and seeks, and its presets."""
    from pneuma.schema import read_toml
    from pneuma.search.spec import load_search

    search = load_search(name, world)  # which checks it
    file = read_toml(search.path)
    document = {"search": search.name, "world": search.world, **file.data, "run": search.run}
    return Result(document, [str(search.path), *file.text.splitlines()], search.full_title)


@app.command()
def status(name: SearchName, asked: Asked) -> Result:
    """Show how far a search is, and its best trials."""
    found = asked.read(name)
    return Result(found.document(), _status(found, asked.store, [name, *opt.words_of(asked)]))


def _status(found: Record, store: Store, asked: list[object]) -> Iterator[str | Table]:
    from pneuma.search.record import STATES, published_log

    search, budget, best = found.search, found.budget, found.best
    yield (
        f"Published in {found.journal.path}, without its runs."
        if found.published
        else f"Optuna's log: {found.journal.path}"
    )
    amount = f"{counted(len(budget.seeds), 'seed')} each, {budget.steps:,} steps a run"
    yield f"{len(found.trials)} of {budget.trials} trials, {amount}"
    for objective in search.sought:
        yield f"Value: {objective.direction} the {objective.over_seeds} over seeds of {objective.outcome}"
    among, rows = best if isinstance(best, list) else [best], []
    for trial in found.trials:
        params = ", ".join(
            f"{key}={value:.4g}" if isinstance(value, float) else f"{key}={value}"
            for key, value in search.in_words(trial.params).items()
        )
        mark, note = "*" if trial.number in among else "", str(trial.user_attrs.get("note", ""))
        rows.append((f"{mark:>3}", trial.number, STATES[trial.state], _value(trial), params, note))
    yield Table(("", "trial", "", "value", "", ""), rows)
    if isinstance(best, int):
        yield f"Best (*): trial {best}. Confirm it with: {command('search', 'promote', *asked)}"
    else:
        front = ", ".join(map(str, best or ()))
        yield f"Pareto front (*): trials {front}." if front else "No trial is complete yet."
    yield f"Look closer with: {command('search', 'plot', *asked)}"
    if found.published:
        return
    if other := published_log(store, search.label):
        yield f"A published search is in {other}; --results with an empty folder shows it."
    if found.under_way and store.listing_path(trials := f"search-{search.label}").exists():
        runs = command("study", "status", trials, "--results", store.root)
        yield f"Other trials have not ended. See their runs with: {runs}"


@app.command(short_help="Draw a search.")
def plot(name: SearchName, asked: Asked, out: opt.PlotFolder = None, formats: opt.Formats = None) -> Result:
    """Draw a search: history, importances, every parameter's values, and the best trials or Pareto front."""
    chosen = read_formats(formats, out)
    from pneuma.figures.search import draw_search

    found = asked.read(name)
    formats_asked = (word for each in chosen for word in ("--format", each))
    again = command("search", "plot", name, *opt.words_of(asked), *formats_asked)
    files = keep_files(asked.store, out, lambda folder: draw_search(found, folder, chosen, again))
    if not files:
        say("Note: nothing is drawn before a trial is complete.")
    return Result({"figures": files}, wrote(files))


# --- run ------------------------------------------------------------------------------------------


@app.command(short_help="Search for hyperparameters, or go on with a search.")
def run(
    name: SearchName,
    asked: Asked,
    place: opt.Place,
    preset: Annotated[str, opt.option("|".join(spec.PRESETS), "How much to search.")] = "quick",
    trials: Annotated[Any, opt.count("How many trials, those stored among them.")] = None,
    seeds: Annotated[Any, opt.seeds("Of each trial: a count (from 1000 on) or a list.", FIRST_SEED)] = None,
    steps: opt.Steps = None,
    retry_failed: opt.RetryFailed = False,
    quiet: opt.Quiet = False,
) -> Result:
    """Search for hyperparameters, going on where it was stopped; several processes share the work."""
    from pneuma import api
    from pneuma.search.record import STATES
    from pneuma.search.spec import load_search
    from pneuma.search.trials import Unfinished, refuse_unfinished, run_search

    store, tell = asked.store, partial(say, quiet=quiet)
    search = load_search(name, asked.world, asked.settings)
    if preset not in (presets := search.presets):
        raise unknown_name(f"preset of search {search.name}", preset, presets)
    amount = {"trials": trials, "seeds": seeds, "steps": steps}
    given = {key: value for key, value in amount.items() if value is not None}
    budget = presets[preset].model_copy(update=given)
    how, once = place.config(), cache(tell)  # which says the same of later generations no more

    def train(planned: Plan, until: Mapping[str, int]) -> None:
        results = api.train_plan(
            planned, store, replace(how, until=until), retry_failed=retry_failed, quiet=quiet, say=once
        )
        refuse_unfinished(results, until)

    document: dict[str, Any] = {"search": search.name, "trials": [], "best": None}
    told, code = set[int](), 0
    try:
        for found in run_search(search, budget, store, train, tell):
            for trial in found.trials:
                if trial.number not in told:
                    note = f" ({note})" if (note := trial.user_attrs.get("note")) else ""
                    tell(f"trial {trial.number}: {STATES[trial.state]}, {_value(trial)}{note}")
                    told.add(trial.number)
            document, best = found.document(), found.best
            so_far = f"front: {best}" if best else "none complete yet"
            if isinstance(best, int):
                so_far = f"best {_value(found.begun[best])}, trial {best}"
            tell(f"{len(told)}/{budget.trials} trials; {so_far}")
    except Unfinished as error:
        say(f"Stopped: {error}")
        code = 1
    except KeyboardInterrupt:
        say("Stopped. The same command goes on where the search was stopped.")
        code = 130
    words, then = [name, *opt.words_of(asked)], {"See its trials": "status", "Draw it": "plot"}
    shown = [f"{what} with: {command('search', verb, *words)}" for what, verb in then.items()]
    return Result(document, [] if code or quiet else shown, code=code)


def _value(trial: FrozenTrial) -> str:
    return ", ".join(f"{value:.4g}" for value in trial.values or ()) or "no value"


# --- promote --------------------------------------------------------------------------------------


@app.command(short_help="Train winners of searches on fresh seeds.")
def promote(
    names: Annotated[list[str], opt.argument("NAME", "Searches, or their files, all tuned alike.")],
    asked: Asked,
    seeds: opt.Seeds = "10",
    steps: opt.Steps = None,
    trial: Annotated[int | None, opt.option("N", "Which trial (default: the best).")] = None,
    out: Annotated[Path | None, opt.option("FILE", "Write the study to a .toml file; train nothing.")] = None,
    workers: opt.Workers = None,
    quiet: opt.Quiet = False,
) -> Result:
    """Train searches' winners and their bases on fresh seeds, and say how much of the gain was luck."""
    from pneuma.search import promote as promotion

    promoted = promotion.promote(
        store := asked.store, names, seeds, steps, trial, asked.world, asked.settings
    )
    document: dict[str, Any] = {"winners": [winner.document() for winner in promoted.winners]}
    if trial is None and out is None and all(each["is_base"] for each in document["winners"]):
        said = "the search found nothing better than its base"
        return Result(document, [f"{each['search']}: {said}" for each in document["winners"]])
    if out is not None:
        check_file(out, (".toml",))
        if out.exists():
            raise UserError(f"--out {out}: is there already; name another, or remove it first")
        write_file(out, promoted.text.encode())
        train_with = f"Train it with: {command('study', 'run', out, '--results', store.root)}"
        return Result({"study": out, **document}, notes=[f"wrote {out}", train_with])
    planned, path = promoted.plan(store), promoted.path(store)
    for line in (f"wrote {path}", promoted.budgets):
        say(line, quiet=quiet)
    trained = train_study(planned, store, opt.Place(workers).config(), retry_failed=True, quiet=quiet)
    ids = {
        name: [cell.run_id for cell in planned.cells if cell.condition == name] for name in planned.conditions
    }
    document |= {"study": path, "seeds": seeds, "steps": promoted.steps, "run_ids": ids}
    if trained.code:
        say(f"Not all runs ended: {command('study', 'status', path, '--results', store.root)}")
        return Result(document, notes=trained.notes, code=trained.code)
    from pneuma.figures.search import winners_page

    frame = promotion.gains(promoted.winners, data := promoted.data(store))
    given = ["--seeds", ",".join(map(str, seeds)), "--steps", promoted.steps]
    given += ["--trial", trial] * (trial is not None)
    again = command("search", "promote", *names, *given, *opt.words_of(asked))
    page = winners_page(promoted.name, promoted.winners, data)
    files = draw_files(store, None, read_formats(None, None), [(page, again)])
    document |= {"gains": rows_of(frame), "figures": files}
    return Result(document, [*_gained(frame), promoted.budgets, *wrote(files)], notes=trained.notes)


def _gained(frame: pd.DataFrame) -> Iterator[str | Table]:
    yield frame_table(frame.drop(columns=["diverged", "base_diverged"]))
    yield "low, high: the 95 % interval of the difference of means."
    yield "luck: by how much the search's seeds had flattered the winner; unknown (–) with other steps."
    for who in ("", "base_"):
        for name, count in zip(frame["search"], frame[f"{who}diverged"], strict=True):
            if count:
                runs = f"{counted(count, 'run')} of {name}'s {'base' if who else 'winner'}"
                yield f"{runs} diverged, and count as in a search"
