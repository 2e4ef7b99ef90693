"""`pneuma search …`: find hyperparameters, and see what was found."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pneuma.cli import search_promote, search_run
from pneuma.cli.figure_files import Formats, draw_files, read_formats
from pneuma.cli.options import Json, Results, WorldName, print_json, read_path
from pneuma.cli.plain_text import command, plain
from pneuma.cli.study_output import check_choice
from pneuma.cli.study_records import study_record
from pneuma.errors import UserError, counted
from pneuma.study.store import Store

if TYPE_CHECKING:
    from pneuma.analysis.tables import StudyData
    from pneuma.search.recorded import Begun
    from pneuma.search.spec import Search

app = typer.Typer(
    help="Find hyperparameters over several seeds, and confirm them on fresh ones.",
    short_help="Find hyperparameters, and confirm them on fresh seeds.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
RESULTS = Path("results")
PLOTS = ("history", "importances", "slices", "parallel", "contour", "front")

app.command(short_help="Search for hyperparameters, or go on with a search.")(search_run.run)
app.command(short_help="Train a search's winner on fresh seeds.")(search_promote.promote)
app.command(short_help="Write a study of several searches' winners.")(search_promote.winners)
app.command(short_help="Publish what searches tried and found.")(search_promote.publish)


@app.command("list")
def list_(json: Json = False) -> None:
    """List the shipped searches."""
    from pneuma.search.spec import list_searches, load_search

    searches = [load_search(name) for name in list_searches()]
    if json:
        rows = [{"search": s.name, "title": s.title, "section": s.section} for s in searches]
        return print_json({"schema": 1, "searches": rows})
    for search in searches:
        section = f"thesis section {search.section}" if search.section else ""
        print(f"{search.name:<18} {search.title:<44} {section}")
    return None


@app.command()
def show(name: search_run.SearchName, world: WorldName = None, json: Json = False) -> None:
    """Show what a search varies, what it seeks, and its presets."""
    from pneuma.search.spec import load_search

    search = load_search(name, world)
    if json:
        return print_json({"schema": 1, **_as_document(search)})
    print(search.title + (f" (thesis section {search.section})" if search.section else ""))
    if search.about:
        print(f"\n{search.about}")
    document = _as_document(search)
    print("\nSpace:")
    for parameter in document["space"]:
        print(f"  {parameter['name']:<22} {_told_domain(parameter)}")
    print("\nObjectives:")
    for own in search.objectives:
        print(f"  {own.direction} the {own.over_seeds} over seeds of {own.outcome}")
    for kind in ("sampler", "pruner"):
        options = document[kind]
        if options["name"]:
            told = ", ".join(f"{key} {value}" for key, value in options.items() if key != "name")
            print(f"{kind.capitalize()}: {options['name']}" + (f" ({told})" if told else ""))
    print(f"Trials are asked for {search.generation} at a time.")
    for preset, budget in search.presets.items():
        seeds = counted(len(budget.seeds), "seed")
        print(f"  {preset:<9} {budget.trials} trials, {seeds} each, {budget.steps:,} steps a run")
    return None


@app.command()
def status(
    name: search_run.SearchName, world: WorldName = None, results: Results = RESULTS, json: Json = False
) -> None:
    """Show how far a search is, and the best that it has found."""
    from dataclasses import asdict

    from pneuma.search.record import is_published
    from pneuma.search.recorded import begun_runs

    store = Store(results)
    record = search_run.recorded(store, name, world)
    begun = begun_runs(store, record)
    if json:
        kept = ("search", "trials", "best", "storage", "optuna_study", "seeds", "steps", "trials_asked")
        return print_json({"schema": 1, **{key: record[key] for key in kept}, "begun": asdict(begun)})
    trials = record["trials"]
    print(f"{len(trials)} of {record['trials_asked']} trials, {counted(len(record['seeds']), 'seed')} each")
    print(f"Values: {', '.join(map(_told_objective, record['identity']['objectives']))}")
    for trial in trials:
        print(f"  {_told_trial(trial, record['best'])}")
    _tell_begun(begun)
    _tell_best(record, name, world, store.root)
    if is_published(record):
        print("This is the published record: the search was not run in this folder.")
    else:
        print(f"Look closer with: optuna-dashboard {plain(record['storage'])}")
    return None


@app.command(short_help="Draw a search.")
def plot(
    name: search_run.SearchName,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out", metavar="DIR", parser=read_path, help="Where to write (default: RESULTS/figures)."
        ),
    ] = None,
    what: Annotated[
        list[str] | None,
        typer.Option(
            "--what", metavar="|".join(PLOTS), help="Which figures (may be repeated; default: all)."
        ),
    ] = None,
    sensitivity: Annotated[
        bool,
        typer.Option(
            "--sensitivity",
            help="Draw each hyperparameter alone, as trained by `run --sensitivity`.",
        ),
    ] = False,
    world: WorldName = None,
    format: Formats = None,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Draw a search: history, importances, slices, parallel coordinates, contour and Pareto front."""
    formats = read_formats(format)
    for value in what or ():
        check_choice("--what", value, PLOTS)
    store, stem = Store(results), search_run.record_name(name, world)
    if sensitivity:
        from pneuma.figures.sensitivity import draw_sensitivity

        if what:
            raise UserError(f"--what {what[0]}: does not go with --sensitivity, which is one figure")
        data, document = _sensitivity(store, stem, search_run.called_by_file(name, world))
        paths = draw_files(store, out, lambda folder: draw_sensitivity(data, document, folder, formats))
    else:
        from pneuma.figures.search import draw_search

        record = search_run.recorded(store, name, world)
        wanted = tuple(what or PLOTS)
        paths = draw_files(store, out, lambda folder: draw_search(record, folder, wanted, formats))
        drawn = {path.stem.rpartition(f"search-{record['search']}-")[2] for path in paths}
        lacking = [name for name in wanted if name not in drawn] if what or not paths else []
        if lacking:
            print(_why_nothing(record, lacking), file=sys.stderr)
    if json:
        return print_json({"schema": 1, "figures": [str(path) for path in paths]})
    for path in paths:
        print(f"wrote {plain(str(path))}")
    return None


def _why_nothing(record: Mapping[str, Any], wanted: Sequence[str]) -> str:
    """Say why a search has not the figures that were asked for."""
    from pneuma.figures.search import NEEDS

    if record["best"] in (None, []):
        return "nothing to draw yet: no trial is complete"
    return "not drawn: " + "; ".join(f"{name} needs {NEEDS[name]}" for name in wanted)


def _sensitivity(store: Store, search: str, called: str) -> tuple[StudyData, dict[str, Any]]:
    """Return the runs of a search's sensitivity study, and what its conditions are."""
    from pneuma.analysis.sources import open_study
    from pneuma.search.sensitivity import read_points, sensitivity_study

    document = read_points(store, search, called)
    return open_study(store, study_record(store, sensitivity_study(search), None)), document


def _as_document(search: Search) -> dict[str, Any]:
    from dataclasses import asdict

    from pneuma.search.space import Range

    space = []
    for parameter in search.space.parameters:
        domain = parameter.domain
        own = asdict(domain) if isinstance(domain, Range) else {"choices": dict(domain.settings_of)}
        space.append({"name": parameter.name, **own, "when": dict(parameter.when)})
    return {
        "search": search.name,
        "title": search.title,
        "section": search.section,
        "about": search.about,
        "base": search.space.base,
        "fixed": dict(search.space.fixed),
        "space": space,
        "objectives": [asdict(objective) for objective in search.objectives],
        "start": list(search.start_names),
        "generation": search.generation,
        "sampler": dict(search.sampler),
        "pruner": dict(search.pruner),
        "presets": {name: asdict(budget) for name, budget in search.presets.items()},
    }


def _told_domain(parameter: Mapping[str, Any]) -> str:
    if "choices" in parameter:
        told = "one of " + ", ".join(parameter["choices"])
    else:
        told = f"{parameter['low']:g} to {parameter['high']:g}" + (
            ", logarithmic" if parameter["log"] else ""
        )
    when = " and ".join(f"{k} is {' or '.join(map(str, v))}" for k, v in parameter["when"].items())
    return told + (f", where {when}" if when else "")


def _told_trial(trial: Mapping[str, Any], best: object) -> str:
    params = ", ".join(f"{key}={_short(value)}" for key, value in trial["params"].items())
    among = trial["number"] in best if isinstance(best, list) else trial["number"] == best
    note = f"  ({trial['note']})" if trial["note"] else ""
    mark = "*" if among else " "
    return plain(
        f"{mark} {trial['number']:>4}  {trial['state']:<9} {search_run.told_value(trial):<16} {params}{note}"
    )


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _told_objective(objective: Mapping[str, Any]) -> str:
    return plain(
        f"{objective['direction']} the {objective['over_seeds']} over seeds of {objective['outcome']}"
    )


def _tell_begun(begun: Begun) -> None:
    if begun.runs:
        told = (
            f"trials {begun.trials[0]} to {begun.trials[-1]}: {begun.ended} of {begun.runs} runs have ended"
        )
        print(f"Now training {told}." if begun.searching else f"Stopped in {told}; `run` goes on.")
    elif begun.searching:
        print("A process is searching now.")


def _tell_best(record: Mapping[str, Any], name: str, world: str | None, root: Path) -> None:
    from pneuma.search.spec import list_searches
    from pneuma.worlds import TEXT, split_world, world_option

    if record["best"] in (None, []):
        print("No trial is complete yet.")
    elif isinstance(record["best"], list):
        print(f"Pareto front (*): trials {', '.join(map(str, record['best']))}.")
    else:
        there = world_option(world or TEXT)
        own = name if split_world(name)[0] in list_searches() else record.get("path") or name
        told = command("search", "promote", own, *there, "--results", root)
        print(f"Best (*): trial {record['best']}. Confirm it with: {told}")
