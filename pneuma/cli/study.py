"""`pneuma study …`: list, show, plan, run, status, plot and export studies."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated, Any

import typer

from pneuma.cli import study_output
from pneuma.cli.options import (
    Conditions,
    EngineName,
    Json,
    Preset,
    Quiet,
    Results,
    Seeds,
    Settings,
    Steps,
    StudyName,
    print_json,
    read_count,
    read_selection,
    say,
)
from pneuma.cli.progress import ProgressDisplay
from pneuma.cli.study_output import study_record
from pneuma.config import as_settings, make_run
from pneuma.study import execute, plan, spec
from pneuma.study.executors.local import available_cores
from pneuma.study.store import Store

app = typer.Typer(help="Compare conditions over many seeds.", no_args_is_help=True, rich_markup_mode=None)

RESULTS = Path("results")
UNWELL = ("crashed", "killed")

app.command()(study_output.plot)
app.command()(study_output.export)
app.command()(study_output.publish)


@app.command("list")
def list_(json: Json = False) -> None:
    """List the shipped studies."""
    studies = [spec.load_study(name) for name in spec.list_studies()]
    if json:
        names = [{"study": s.name, "title": s.title, "section": s.section} for s in studies]
        return print_json({"schema": 1, "studies": names})
    for study in studies:
        section = f"thesis section {study.section}" if study.section else ""
        print(f"{study.name:<18} {study.title:<36} {section}")
    return None


@app.command()
def show(name: StudyName, json: Json = False) -> None:
    """Show what a study compares: its conditions as resolved, and its presets."""
    study = spec.load_study(name)
    selection = plan.Selection(preset=next(iter(study.presets), "quick"))
    differing = plan.differing_settings(plan.make_plan(study, selection))
    if json:
        return print_json(
            {
                "schema": 1,
                "study": study.name,
                "title": study.title,
                "section": study.section,
                "about": study.about,
                "baseline": study.baseline,
                "conditions": {c: study.settings(c) for c in study.conditions},
                "presets": {n: {"seeds": p.seeds, "steps": p.steps} for n, p in study.presets.items()},
            }
        )
    print(f"{study.title}" + (f" (thesis section {study.section})" if study.section else ""))
    if study.about:
        print(f"\n{study.about}")
    print("\nThe conditions differ in:" if differing else "\nThe conditions do not differ: this is A/A.")
    for key, values in differing.items():
        print(f"  {key}: " + ", ".join(f"{v} ({c})" for c, v in values.items()))
    print(f"Compared with: {study.baseline}")
    print("\nAll conditions share:")
    for key, value in as_settings(make_run(study.settings(study.baseline))).items():
        if key not in (*differing, "seed", "steps"):
            print(f"  {key} = {'none' if value is None else value}")
    print("\nPresets:")
    for preset, amount in study.presets.items():
        print(f"  {preset:<9} {len(amount.seeds)} seeds x {amount.steps:,} steps")
    return None


@app.command("plan")
def plan_(
    name: StudyName,
    preset: Preset = None,
    seeds: Seeds = None,
    steps: Steps = None,
    engine: EngineName = None,
    condition: Conditions = None,
    set_: Settings = None,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Say which runs are stored and which would be trained; train nothing."""
    selection = read_selection(preset, seeds, steps, engine, condition, set_) or plan.Selection()
    planned = plan.make_plan(spec.load_study(name), selection)
    store = Store(results)
    execute.check_environments(list(execute.missing(planned, store).values()))
    state = {
        cell.run_id: "stored" if store.status(cell.run_id).finished else "to-train" for cell in planned.cells
    }
    seconds = execute.expected_seconds(planned, store)
    if json:
        cells = [
            {**_cell(cell), "state": state[cell.run_id], "expected_seconds": seconds[cell.run_id]}
            for cell in planned.cells
        ]
        return print_json({"schema": 1, "study": planned.study.name, "runs": cells})
    for note in planned.notes:
        print(f"Note: {note}.")
    for key, values in plan.differing_settings(planned).items():
        print(f"Conditions differ in {key}: " + ", ".join(f"{v} ({c})" for c, v in values.items()))
    for cell in planned.cells:
        budget = f"{cell.run.steps:>12,} steps"
        print(f"{cell.condition:<18} seed {cell.seed:<6} {budget}  {cell.run_id}  {state[cell.run_id]}")
    counts = Counter(state.values())
    print(f"{counts['stored']} stored, {counts['to-train']} to train.")
    return None


@app.command()
def run(
    name: StudyName,
    preset: Preset = None,
    seeds: Seeds = None,
    steps: Steps = None,
    engine: EngineName = None,
    condition: Conditions = None,
    set_: Settings = None,
    workers: Annotated[
        str | None, typer.Option("--workers", metavar="N", help="Runs trained at once (default: one a core).")
    ] = None,
    results: Results = RESULTS,
    json: Json = False,
    quiet: Quiet = False,
) -> int:
    """Train a study's runs that are not stored yet."""
    selection = read_selection(preset, seeds, steps, engine, condition, set_) or plan.Selection()
    planned = plan.make_plan(spec.load_study(name), selection)
    at_once = available_cores() if workers is None else read_count("--workers", workers)
    store = Store(results)
    todo = execute.prepare(planned, store)
    for note in planned.notes:
        say(f"Note: {note}.", as_json=True, quiet=quiet)
    try:
        with ProgressDisplay(planned, set(todo), quiet) as display:
            outcomes = execute.execute(planned, todo, store, at_once, display.update)
    except KeyboardInterrupt:
        say("Stopped. Finished runs are kept; the same command goes on with the others.", as_json=True)
        return 130
    _tell_outcomes(planned, outcomes, store, json, quiet)
    if json:
        _print_runs(planned.study.name, [(o.cell, o.status.name, o.trained) for o in outcomes])
    return 1 if any(outcome.status.name in UNWELL for outcome in outcomes) else 0


@app.command()
def status(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="A study; left out: all that were run.")
    ] = None,
    preset: Preset = None,
    seeds: Seeds = None,
    steps: Steps = None,
    engine: EngineName = None,
    condition: Conditions = None,
    set_: Settings = None,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Say how far the runs of a study are, as it was last run or as selected."""
    selection = read_selection(preset, seeds, steps, engine, condition, set_)
    store = Store(results)
    names = [name] if name else store.studies()
    if not names and not json:
        print(f"No study was run in {results} yet.")
    documents = []
    for study in names:
        record = study_record(store, study, selection)
        states = [(run, store.status(run["run_id"]).name) for run in record["runs"]]
        runs = [{**_identity(run), "status": state, "trained": False} for run, state in states]
        documents.append({"schema": 1, "study": record["study"], "runs": runs})
        if not json:
            counts = Counter(state for _, state in states)
            print(f"{record['study']}: " + ", ".join(f"{n} {state}" for state, n in counts.items()))
            for run, state in states:
                print(f"  {run['condition']:<18} seed {run['seed']:<6} {run['run_id']}  {state}")
    if json:
        print_json(documents[0] if name else {"schema": 1, "studies": documents})


# --- Helpers -------------------------------------------------------------------------------------


def _cell(cell: plan.Cell) -> dict[str, Any]:
    return {"run_id": cell.run_id, "condition": cell.condition, "seed": cell.seed}


def _identity(run: dict[str, Any]) -> dict[str, Any]:
    return {key: run[key] for key in ("run_id", "condition", "seed")}


def _print_runs(study: str, runs: list[tuple[plan.Cell, str, bool]]) -> None:
    rows = [{**_cell(cell), "status": state, "trained": trained} for cell, state, trained in runs]
    print_json({"schema": 1, "study": study, "runs": rows})


def _tell_outcomes(
    planned: plan.Plan, outcomes: list[execute.Outcome], store: Store, as_json: bool, quiet: bool
) -> None:
    for outcome in outcomes:
        cell, state = outcome.cell, outcome.status
        if state.name == "diverged":
            say(
                f"{cell.condition} seed {cell.seed} diverged at step {state.step:,}; its records count",
                as_json,
            )
        if state.name in UNWELL:
            trace = store.run_folder(cell.run_id) / "error.txt"
            say(f"{cell.condition} seed {cell.seed} {state.name}: {trace}", as_json)
    trained = sum(outcome.trained for outcome in outcomes)
    counts = Counter(outcome.status.name for outcome in outcomes)
    states = ", ".join(f"{n} {state}" for state, n in counts.items())
    kept = len(outcomes) - trained
    say(f"{planned.study.name}: {states}; {trained} trained now, {kept} were stored.", as_json, quiet)
    if not any(counts[name] for name in UNWELL):
        say(f"Draw it with: pneuma study plot {planned.study.name} --results {store.root}", as_json, quiet)
