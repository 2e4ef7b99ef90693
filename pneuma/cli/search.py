"""`pneuma search …`: find hyperparameters, and see what was found."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pneuma.cli import search_promote, search_run
from pneuma.cli.figure_files import Formats, draw_files, read_formats
from pneuma.cli.options import Json, Results, WorldName, print_json, read_path
from pneuma.cli.plain_text import command, plain
from pneuma.cli.study_output import check_choice
from pneuma.errors import counted
from pneuma.study.store import Store
from pneuma.worlds import TEXT, world_option

if TYPE_CHECKING:
    from pneuma.search.spec import Search
    from pneuma.search.storage import Searched
    from pneuma.search.trials import Told

app = typer.Typer(
    help="Find hyperparameters over several seeds, and confirm them on fresh ones.",
    short_help="Find hyperparameters, and confirm them on fresh seeds.",
    no_args_is_help=True,
    rich_markup_mode=None,
)
RESULTS = Path("results")
PLOTS = ("history", "importances", "slices", "parallel", "front")

app.command(short_help="Search for hyperparameters, or go on with a search.")(search_run.run)
app.command(short_help="Train winners of searches on fresh seeds.")(search_promote.promote)


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
    document = _as_document(search)
    if json:
        return print_json({"schema": 1, **document})
    print(search.title + (f" (thesis section {search.section})" if search.section else ""))
    if search.about:
        print(f"\n{search.about}")
    print("\nSpace:")
    for parameter in document["space"]:
        print(f"  {parameter['name']:<22} {_told_domain(parameter)}")
    print("\nObjectives:")
    for own in search.objectives:
        print(f"  {own.direction} the {own.over_seeds} over seeds of {own.outcome}")
    for kind in ("sampler", "pruner"):
        options = dict(document[kind])
        if name := options.pop("name"):
            told = ", ".join(f"{key} {value}" for key, value in options.items())
            print(f"{kind.capitalize()}: {name}" + (f" ({told})" if told else ""))
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
    from pneuma.search.storage import trial_document

    store = Store(results)
    searched = search_promote.recorded(store, name, world)
    search, budget, best = searched.task.search, searched.task.budget, searched.best
    if json:
        document = {
            "schema": 1,
            "search": search.name,
            "trials": [trial_document(trial, search) for trial in searched.trials],
            "best": best,
            "storage": searched.storage,
            "optuna_study": searched.optuna_study,
            "seeds": list(budget.seeds),
            "steps": budget.steps,
            "trials_asked": budget.trials,
        }
        return print_json(document)
    print(f"{len(searched.trials)} of {budget.trials} trials, {counted(len(budget.seeds), 'seed')} each")
    for own in search.objectives:
        print(plain(f"Value: {own.direction} the {own.over_seeds} over seeds of {own.outcome}"))
    among = best if isinstance(best, list) else [best]
    for trial in searched.trials:
        print(_told_trial(trial, trial.number in among))
    _tell_best(searched, name, world, store.root)
    runs = command("study", "status", f"search-{search.name}", "--results", store.root)
    print(f"Its runs: {runs}")
    print(f"Look closer with: optuna-dashboard {plain(searched.storage)}")
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
    world: WorldName = None,
    format: Formats = None,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Draw a search by Optuna's plots: history, importances, slices, parallel coordinates, Pareto front."""
    formats = read_formats(format)
    for value in what or ():
        check_choice("--what", value, PLOTS)
    store, wanted = Store(results), tuple(what or PLOTS)
    searched = search_promote.recorded(store, name, world)
    from pneuma.figures.search import NEEDS, draw_search

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


def _as_document(search: Search) -> dict[str, Any]:
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
        log = ", logarithmic" if parameter["log"] else ""
        told = f"{parameter['low']:g} to {parameter['high']:g}{log}"
    when = " and ".join(f"{k} is {' or '.join(map(str, v))}" for k, v in parameter["when"].items())
    return told + (f", where {when}" if when else "")


def _told_trial(trial: Told, among: bool) -> str:
    params = ", ".join(
        f"{key}={value:.4g}" if isinstance(value, float) else f"{key}={value}"
        for key, value in trial.params.items()
    )
    note = f"  ({trial.note})" if trial.note else ""
    mark, value = "*" if among else " ", search_run.told_value(trial)
    return plain(f"  {mark} {trial.number:>4}  {trial.state:<9} {value:<16} {params}{note}")


def _tell_best(searched: Searched, name: str, world: str | None, root: Path) -> None:
    best = searched.best
    if best in (None, []):
        print("No trial is complete yet.")
    elif isinstance(best, list):
        print(f"Pareto front (*): trials {', '.join(map(str, best))}.")
    else:
        told = command("search", "promote", name, *world_option(world or TEXT), "--results", root)
        print(f"Best (*): trial {best}. Confirm it with: {told}")
