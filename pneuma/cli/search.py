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
from pneuma.study.command_words import results_words

if TYPE_CHECKING:
    from pneuma.analysis.answer import Answer
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

    def command(self, verb: str, search_name: str) -> str:
        """Return a command about the same search."""
        world_words = [] if self.world is None else ["--world", self.world]
        return command("search", verb, search_name, *world_words, *results_words(self.results))

    def read(self, search_name: str) -> Record:
        from pneuma.search.log import read_record

        return read_record(self.store, search_name, self.world)


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
    search_file = read_toml(search.path)
    document = {"search": search.name, "world": search.world, **search_file.data, "run": search.run}
    return Result(document, [str(search.path)] + search_file.text.splitlines(), search.full_title)


@app.command()
def status(name: SearchName, location: Location) -> Result:
    """Show the progress of a search, and its best trials."""
    search_record = location.read(name)
    from pneuma.search.trial_list import list_trials

    result = answer_result(list_trials(search_record))
    next_commands = [f"Look closer with: {location.command('plot', name)}"]
    if isinstance(search_record.best, int):
        next_commands.append(f"Confirm the best one with: {location.command('promote', name)}")
    return replace(result, lines=[*result.lines, *next_commands])


@app.command(short_help="Draw a search.")
def plot(
    name: SearchName, location: Location, out: opt.PlotFolder = None, formats: opt.Formats = None
) -> Result:
    """Draw a search: history, all parameters, importances, and the Pareto front of two objectives.

    Importances need two parameters and ten complete trials.
    """
    file_formats = read_formats(formats, out)
    from pneuma.figures.search import draw_search

    record = location.read(name)
    written_files = keep_files(location.store, out, lambda folder: draw_search(record, folder, file_formats))
    if not written_files:
        say("Note: nothing is drawn before a trial is complete.")
    return Result({"figures": written_files}, wrote(written_files))


# --- run ------------------------------------------------------------------------------------------


@app.command(short_help="Run a hyperparameter search, or resume it.")
def run(
    name: SearchName,
    location: Location,
    resources: opt.Resources,
    preset: Annotated[str, opt.option("|".join(spec.PRESETS), "Size of the search.")] = "quick",
    trials: Annotated[Any, opt.count("Number of trials, including those already stored.")] = None,
    seeds: Annotated[
        Any, opt.seeds("Seeds per trial: a count (starting at 1000) or a list.", FIRST_SEED)
    ] = None,
    steps: opt.Steps = None,
    retry_failed: opt.RetryFailed = False,
    quiet: opt.Quiet = False,
) -> Result:
    """Run a hyperparameter search, or resume it. Several processes can share the work."""
    from pneuma import api
    from pneuma.search.spec import load_search
    from pneuma.search.trial_list import list_trials
    from pneuma.search.trials import Unfinished, run_search

    search = load_search(name, location.world)
    if preset not in search.presets:
        raise unknown_name(f"preset of search {search.name}", preset, search.presets)
    set_options = {"trials": trials, "seeds": seeds, "steps": steps}
    overrides = {option_name: value for option_name, value in set_options.items() if value is not None}
    search_budget = search.presets[preset].model_copy(update=overrides)
    executor_config = resources.config()
    say_unless_quiet = partial(say, quiet=quiet)
    say_once = cache(say_unless_quiet)  # notes of a generation are those of the others

    def train(planned: Plan, until: Mapping[str, int]) -> Sequence[CellResult]:
        paused_config = replace(executor_config, until=until)
        return api.train_plan(
            planned, location.store, paused_config, retry_failed=retry_failed, quiet=quiet, say=say_once
        )

    document: dict[str, Any] = {}
    exit_code = reported_count = 0
    try:
        for search_record in run_search(search, search_budget, location.store, train, say_unless_quiet):
            trials_answer = list_trials(search_record)
            for news_line in _news(trials_answer, reported_count):
                say_unless_quiet(news_line)
            document, reported_count = trials_answer.document, len(trials_answer.table)
    except Unfinished as error:
        say(f"Stopped: {error}. To try crashed runs again, add --retry-failed.")
        exit_code = 1
    except KeyboardInterrupt:
        say("Stopped. The same command goes on where the search was stopped.")
        exit_code = STOPPED
    next_commands: list[str] = []
    if not exit_code and not quiet:
        next_commands = [f"See its trials with: {location.command('status', name)}"]
        next_commands.append(f"Draw it with: {location.command('plot', name)}")
    return Result(document, next_commands, code=exit_code)


def _news(trials_answer: Answer, reported_count: int) -> Iterator[str]:
    """Yield a line for each trial that has ended since, then how far the search is."""
    trial_frame = trials_answer.cells[0]
    for trial in trial_frame[reported_count:].to_dict("records"):
        trial_text = f"trial {trial['trial']}: {trial['state']}, {trial['value']}; {trial['parameters']}"
        yield f"{trial_text}; {trial['note']}" if trial["note"] else trial_text
    if len(trial_frame) > reported_count or not len(trial_frame):
        yield f"{trials_answer.notes[0]}. {trials_answer.legend[0]}"


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
    from pneuma.analysis.planned import plan_answer
    from pneuma.search.promote import BASE, TUNED, find_trial, promotion_study, write_study
    from pneuma.store.index import RunIndex
    from pneuma.study.plan import Query

    store, search_record = location.store, location.read(name)
    promoted = find_trial(search_record, trial)
    study_text = promotion_study(search_record, promoted, seeds, steps)
    document = {"search": search_record.search.name, "trial": promoted.number, "params": promoted.params}
    results = results_words(store.root)
    if out is not None:
        check_file(out, (".toml",))
        if out.exists():
            raise UserError(f"--out {out}: already exists; name another, or remove it first")
        write_file(out, study_text.encode())
        train_with = f"Train it with: {command('study', 'run', out, *results)}"
        return Result({"study": out, **document}, notes=[f"wrote {out}", train_with])
    study_path = write_study(store, search_record, study_text)
    say(f"wrote {study_path}", quiet=quiet)
    planned, config = api.plan_study(Query(str(study_path)), store, say), opt.Resources(workers).config()
    for line in plan_answer(RunIndex(store), planned, config.workers).legend:
        say(line, quiet=quiet)
    trained = train_study(planned, store, config, retry_failed=True, quiet=quiet)
    notes = list(trained.notes)
    if not trained.code:
        notes.append(f"Compare them with: {command('study', 'compare', study_path, TUNED, BASE, *results)}")
    return replace(trained, document={**trained.document, "study": study_path, **document}, notes=notes)
