"""`pneuma search …`: search for hyperparameters, and train the best ones on fresh seeds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.cli import STOPPED
from pneuma.cli import options as opt
from pneuma.cli.hints import command
from pneuma.cli.output import (
    Result,
    answer_result,
    check_file,
    keep_files,
    listed_result,
    read_formats,
    say,
    write_file,
    wrote,
)
from pneuma.cli.study_run import train as train_study
from pneuma.errors import UserError, unknown_name
from pneuma.search import FIRST_SEED
from pneuma.store.store import Store
from pneuma.study import shipped, spec

if TYPE_CHECKING:
    from pneuma.answers.answer import Answer
    from pneuma.search.log import Record
    from pneuma.study.plan import Plan
    from pneuma.training.execute import CellResult

app = opt.Commands("search", "Search hyperparameters over several seeds and confirm them on fresh seeds.")


@dataclass(frozen=True)
class Location:
    """Which search a command reads: the options that its name goes with."""

    world: opt.World = None
    results: opt.Results = opt.HERE

    @property
    def store(self) -> Store:
        return Store(self.results)

    def command(self, verb: str, name: str) -> str:
        """Return a command about the same search."""
        world = [] if self.world is None else ["--world", self.world]
        return command("search", verb, name, *world, *spec.results_words(self.results))

    def read(self, name: str) -> Record:
        from pneuma.search.log import read_record

        return read_record(self.store, name, self.world)


SearchName = Annotated[str, opt.argument("NAME", "A search's name, or the path of a search file (….toml).")]


# --- What there is --------------------------------------------------------------------------------


@app.command("list")
def list_() -> Result:
    """List the shipped searches."""
    return listed_result("search", "searches", shipped.studies_folder() / "search")


@app.command(short_help="Show a search's file.")
def show(name: SearchName, world: opt.World = None) -> Result:
    """Show a search's space, objectives and presets."""
    from pneuma.schema import read_toml
    from pneuma.search.spec import load_search

    search = load_search(name, world)  # which checks it
    file = read_toml(search.path)
    document = {"search": search.name, "world": search.world, **file.data, "run": search.run}
    return Result(document, [str(search.path)] + file.text.splitlines(), search.full_title)


@app.command()
def status(name: SearchName, location: Location) -> Result:
    """Show the progress of a search, and its best trials."""
    record = location.read(name)
    from pneuma.answers.search import list_trials

    result = answer_result(list_trials(record))
    lines = [f"Look closer with: {location.command('plot', name)}"]
    if isinstance(record.best, int):
        lines.append(f"Confirm the best one with: {location.command('promote', name)}")
    return replace(result, shown=[*result.shown, *lines])


@app.command(short_help="Draw a search.")
def plot(
    name: SearchName, location: Location, out: opt.PlotFolder = None, formats: opt.Formats = None
) -> Result:
    """Draw a search: history, importances, all parameters, and the best trials or Pareto front."""
    file_formats = read_formats(formats, out)
    from pneuma.figures.search import draw_search

    record = location.read(name)
    files = keep_files(location.store, out, lambda folder: draw_search(record, folder, file_formats))
    if not files:
        say("Note: nothing is drawn before a trial is complete.")
    return Result({"figures": files}, wrote(files))


# --- run ------------------------------------------------------------------------------------------


@app.command(short_help="Run a hyperparameter search, or resume it.")
def run(
    name: SearchName,
    location: Location,
    place: opt.Place,
    preset: Annotated[str, opt.option("|".join(spec.PRESETS), "Size of the search.")] = "quick",
    trials: Annotated[Any, opt.count("Number of trials, including those already stored.")] = None,
    seeds: Annotated[Any, opt.seeds("Seeds per trial: a count (from 1000 on) or a list.", FIRST_SEED)] = None,
    steps: opt.Steps = None,
    retry_failed: opt.RetryFailed = False,
    quiet: opt.Quiet = False,
) -> Result:
    """Run a hyperparameter search, or resume it. Several processes can share the work."""
    from pneuma import api
    from pneuma.answers.search import list_trials
    from pneuma.search.spec import load_search
    from pneuma.search.trials import Unfinished, run_search

    search = load_search(name, location.world)
    if preset not in search.presets:
        raise unknown_name(f"preset of search {search.name}", preset, search.presets)
    amount = {"trials": trials, "seeds": seeds, "steps": steps}
    overrides = {key: value for key, value in amount.items() if value is not None}
    budget = search.presets[preset].model_copy(update=overrides)
    config = place.config()
    report = partial(say, quiet=quiet)
    say_once = cache(report)  # notes of a generation are those of the others

    def train(planned: Plan, until: Mapping[str, int]) -> Sequence[CellResult]:
        paused = replace(config, until=until)
        return api.train_plan(
            planned, location.store, paused, retry_failed=retry_failed, quiet=quiet, say=say_once
        )

    document: dict[str, Any] = {}
    code = reported = 0
    try:
        for record in run_search(search, budget, location.store, train, report):
            answer = list_trials(record)
            for line in _news(answer, reported):
                report(line)
            document, reported = answer.document, len(answer.table)
    except Unfinished as error:
        say(f"Stopped: {error}. To try crashed runs again, add --retry-failed.")
        code = 1
    except KeyboardInterrupt:
        say("Stopped. The same command goes on where the search was stopped.")
        code = STOPPED
    lines: list[str] = []
    if not code and not quiet:
        lines = [f"See its trials with: {location.command('status', name)}"]
        lines.append(f"Draw it with: {location.command('plot', name)}")
    return Result(document, lines, code=code)


def _news(answer: Answer, reported: int) -> Iterator[str]:
    """Yield a line for each trial that has ended since, then how far the search is."""
    trials = answer.cells[0]
    for trial in trials[reported:].to_dict("records"):
        text = f"trial {trial['trial']}: {trial['state']}, {trial['value']}; {trial['parameters']}"
        yield f"{text}; {trial['note']}" if trial["note"] else text
    if len(trials) > reported or not len(trials):
        yield f"{answer.notes[0]}. {answer.legend[0]}"


# --- promote --------------------------------------------------------------------------------------


@app.command(short_help="Train the best trial of a search on fresh seeds.")
def promote(
    name: SearchName,
    location: Location,
    seeds: opt.Seeds = "10",
    steps: opt.Steps = None,
    trial: Annotated[int | None, opt.option("N", "The trial to promote (default: the best).")] = None,
    out: Annotated[
        Path | None, opt.option("FILE", "Write the study to a .toml file instead of training it.")
    ] = None,
    workers: opt.Workers = None,
    quiet: opt.Quiet = False,
) -> Result:
    """Compare a search's best trial with its base on fresh seeds: write that study and run it."""
    from pneuma import api
    from pneuma.search.promote import BASE, TUNED, find_trial, promotion_study, write_study
    from pneuma.study.plan import Query

    store, record = location.store, location.read(name)
    promoted = find_trial(record, trial)
    text = promotion_study(record, promoted, seeds, steps)
    document = {"search": record.search.name, "trial": promoted.number, "params": promoted.params}
    results = spec.results_words(store.root)
    if out is not None:
        check_file(out, (".toml",))
        if out.exists():
            raise UserError(f"--out {out}: already exists; name another, or remove it first")
        write_file(out, text.encode())
        train_with = f"Train it with: {command('study', 'run', out, *results)}"
        return Result({"study": out, **document}, notes=[f"wrote {out}", train_with])
    path = write_study(store, record, text)
    say(f"wrote {path}", quiet=quiet)
    planned = api.plan_study(Query(str(path)), store, say)
    trained = train_study(planned, store, opt.Place(workers).config(), retry_failed=True, quiet=quiet)
    notes = list(trained.notes)
    if not trained.code:
        notes.append(f"Compare them with: {command('study', 'compare', path, TUNED, BASE, *results)}")
    return replace(trained, document={**trained.document, "study": path, **document}, notes=notes)
