"""`pneuma search …`: what searches there are, and what they found."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pneuma.cli import search_run
from pneuma.cli.figure_files import Formats, draw_files, read_formats
from pneuma.cli.options import Json, Results, WorldName, print_json, read_path
from pneuma.cli.plain_text import command, plain
from pneuma.cli.search_run import SearchName, search_document, told_value
from pneuma.cli.study_output import check_choice
from pneuma.errors import counted
from pneuma.study.store import Store
from pneuma.worlds import TEXT, world_option

if TYPE_CHECKING:
    from pneuma.search.space import Parameter

app = typer.Typer(
    help="Find hyperparameters over several seeds, and confirm them on fresh ones.",
    short_help="Find hyperparameters, and confirm them on fresh seeds.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
RESULTS = Path("results")
PLOTS = ("history", "importances", "slices", "parallel", "front")

app.command(short_help="Search for hyperparameters, or go on with a search.")(search_run.run)
app.command(short_help="Train winners of searches on fresh seeds.")(search_run.promote)


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
def show(name: SearchName, world: WorldName = None, json: Json = False) -> None:
    """Show what a search varies, what it seeks, and its presets."""
    from pneuma.search.spec import load_search

    search = load_search(name, world)
    if json:
        document = {key: value for key, value in asdict(search).items() if key != "name"}
        return print_json({"schema": 1, "search": search.name, **document})
    print(plain(search.title) + (f" (thesis section {plain(search.section)})" if search.section else ""))
    if search.about:
        print(f"\n{plain(search.about)}")
    print("\nSpace:")
    for parameter in search.space.parameters:
        print(f"  {plain(parameter.name):<22} {plain(_domain(parameter))}")
    print("\nObjectives:")
    for own in search.objectives:
        print(f"  {own.direction} the {own.over_seeds} over seeds of {own.outcome}")
    for kind, chosen in (("Sampler", search.sampler), ("Pruner", search.pruner)):
        if chosen["name"]:
            print(f"{kind}: {', '.join(f'{key} {value}' for key, value in chosen.items())}")
    print(f"Trials are asked for {search.generation} at a time.")
    for preset, budget in search.presets.items():
        seeds = counted(len(budget.seeds), "seed")
        print(f"  {preset:<9} {budget.trials} trials, {seeds} each, {budget.steps:,} steps a run")
    return None


@app.command()
def status(name: SearchName, world: WorldName = None, results: Results = RESULTS, json: Json = False) -> None:
    """Show how far a search is, and the best that it has found."""
    from pneuma.search.storage import journal_path, read_record

    store = Store(results)
    searched = read_record(store, name, world)
    search, budget, best = searched.task.search, searched.task.budget, searched.best
    if json:
        document = search_document(searched.task, searched.trials, store)
        seeds, steps = list(budget.seeds), budget.steps
        return print_json({**document, "seeds": seeds, "steps": steps, "trials_asked": budget.trials})
    print(f"{len(searched.trials)} of {budget.trials} trials, {counted(len(budget.seeds), 'seed')} each")
    for own in search.objectives:
        print(plain(f"Value: {own.direction} the {own.over_seeds} over seeds of {own.outcome}"))
    among = best if isinstance(best, list) else [best]
    for trial in searched.trials:
        mark, note = "*" if trial.number in among else " ", f"  ({trial.note})" if trial.note else ""
        params = ", ".join(
            f"{key}={value:.4g}" if isinstance(value, float) else f"{key}={value}"
            for key, value in trial.params.items()
        )
        print(plain(f"  {mark} {trial.number:>4}  {trial.state:<9} {told_value(trial):<16} {params}{note}"))
    if isinstance(best, int):
        told = command("search", "promote", name, *world_option(world or TEXT), "--results", store.root)
        print(f"Best (*): trial {best}. Confirm it with: {told}")
    else:
        print(
            f"Pareto front (*): trials {', '.join(map(str, best))}." if best else "No trial is complete yet."
        )
    print(f"Its runs: {command('study', 'status', f'search-{search.name}', '--results', store.root)}")
    print(f"Look closer with: optuna-dashboard {plain(str(journal_path(store, search.name)))}")
    return None


@app.command(short_help="Draw a search.")
def plot(
    name: SearchName,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="DIR",
            parser=read_path,
            help="Where to write (default: RESULTS/figures).",
        ),
    ] = None,
    what: Annotated[
        list[str] | None,
        typer.Option(
            "--what", metavar="|".join(PLOTS), help="Which figures (may be repeated; default: all)."
        ),
    ] = None,
    world: WorldName = None,
    format: Formats = None,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Draw a search by Optuna's plots: history, importances, slices, parallel coordinates, Pareto front."""
    formats = read_formats(format)
    for value in what or ():
        check_choice("--what", value, PLOTS)
    from pneuma.figures.search import NEEDS, draw_search
    from pneuma.search.storage import read_record

    store, wanted = Store(results), tuple(what or PLOTS)
    searched = read_record(store, name, world)
    paths = draw_files(store, out, lambda folder: draw_search(searched, folder, wanted, formats))
    drawn = {path.stem.rpartition("-")[2] for path in paths}
    lacking = [own for own in wanted if own not in drawn] if what or not paths else []
    if lacking:
        told = "; ".join(f"{own} needs {NEEDS[own]}" for own in lacking)
        print(f"not drawn: {told}", file=sys.stderr)
    if json:
        return print_json({"schema": 1, "figures": [str(path) for path in paths]})
    for path in paths:
        print(f"wrote {plain(str(path))}")
    return None


def _domain(parameter: Parameter) -> str:
    from pneuma.search.space import Range

    domain = parameter.domain
    if isinstance(domain, Range):
        told = f"{domain.low:g} to {domain.high:g}{', logarithmic' if domain.log else ''}"
    else:
        told = "one of " + ", ".join(domain.settings_of)
    when = " and ".join(f"{k} is {' or '.join(map(str, v))}" for k, v in parameter.when.items())
    return told + (f", where {when}" if when else "")
