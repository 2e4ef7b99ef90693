"""`pneuma study …`: all that is done with studies; the larger commands have files of their own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

from pneuma.cli import (
    study_crossed,
    study_output,
    study_plot,
    study_run,
    study_status,
    study_summary,
    study_trajectories,
    study_verify,
)
from pneuma.cli.options import Json, Results, StudyName, WorldName, print_json, print_listed
from pneuma.cli.plain_text import plain
from pneuma.cli.study_records import is_shipped, known_studies, study_record
from pneuma.cli.study_run import by_value
from pneuma.config import as_fields, make_run
from pneuma.study import plan, spec
from pneuma.study.spec import Preset
from pneuma.study.store import Store
from pneuma.values import shown_value

app = typer.Typer(help="Compare conditions over many seeds.", no_args_is_help=True, rich_markup_mode=None)

RESULTS = Path("results")

app.command("plan", short_help="Say which runs are stored, and which would be trained.")(study_run.plan_)
app.command(short_help="Train a study's runs that are not stored yet.")(study_run.run)
app.command(short_help="Say how far the runs of a study are.")(study_status.status)
app.command(short_help="Draw a study: curves over its steps, or a summary.")(study_plot.plot)
app.command()(study_output.export)
app.command(short_help="Write a study's runs as one small table.")(study_output.publish)
app.command(short_help="Say what each condition's runs come to.")(study_summary.summary)
app.command(short_help="Say which runs collapsed, when, and how often.")(study_summary.collapse)
app.command(short_help="Say in which other settings a contrast holds.")(study_crossed.robustness)
app.command(short_help="Test what matters where settings are crossed.")(study_crossed.effects)
app.command(short_help="Say where trained policies go, and how that ends.")(study_trajectories.trajectories)
app.command(short_help="Judge the thesis's claims by the runs they fix.")(study_verify.verify)


@app.command("list")
def list_(json: Json = False) -> None:
    """List the shipped studies."""
    from pneuma.schema import read_toml

    tables = {name: read_toml(spec.studies_folder() / f"{name}.toml").data for name in spec.list_studies()}
    return print_listed("study", tables, json)


@app.command(short_help="Show what a study compares, and its presets.")
def show(name: StudyName, world: WorldName = None, results: Results = RESULTS, json: Json = False) -> None:
    """Show what a study compares: its conditions as resolved, and its presets."""
    if not is_shipped(name) and name in known_studies(Store(results)):
        return _show_record(study_record(Store(results), name, None, world), json)
    study = spec.load_study(name, world)
    selection = plan.Selection(preset=next(iter(study.presets), "quick"))
    differing = plan.differing_fields(plan.make_plan(study, selection))
    if json:
        return print_json(
            {
                "schema": 1,
                "study": study.name,
                "title": study.title,
                "section": study.section,
                "about": study.about,
                "world": study.world,
                "worlds": list(study.worlds),
                "baseline": study.baseline,
                "conditions": {c: study.fields(c) for c in study.conditions},
                "presets": {n: {"seeds": p.seeds, "steps": p.steps} for n, p in study.presets.items()},
            }
        )
    print(plain(study.title + (f" (thesis section {study.section})" if study.section else "")))
    if study.about:
        print(f"\n{plain(study.about)}")
    print("\nThe conditions differ in:" if differing else "\nThe conditions do not differ: this is A/A.")
    for key, values in differing.items():
        print(f"  {key}: {plain(by_value(values))}")
    print(f"Compared with: {plain(study.baseline)}")
    print(f"Runs in: {', '.join(study.worlds)} (here {study.world})")
    print("\nAll conditions share:")
    for key, value in as_fields(make_run(study.fields(study.baseline))).items():
        if key not in (*differing, "seed", "steps"):
            print(f"  {key} = {plain(shown_value(value))}")
    print("\nPresets:")
    for preset, amount in study.presets.items():
        _print_amounts(preset, {"": amount, **amount.conditions})
    from pneuma.study.claimed import fixed_amounts

    for amounts in fixed_amounts(study).values():
        _print_amounts(spec.CLAIMS, amounts)
    return None


def _print_amounts(preset: str, amounts: Mapping[str, Preset]) -> None:
    """Print how much a preset runs: of all conditions, and of those named."""
    for i, (condition, own) in enumerate(amounts.items()):
        told = f"{plain(condition)}: " if condition else ""
        print(f"  {'' if i else preset:<9} {told}{len(own.seeds)} seeds x {own.steps:,} steps")


def _show_record(record: dict[str, Any], json: bool) -> None:
    """Show a study that has no file here: a fork, imported logs, or a published one."""
    conditions = list(dict.fromkeys(run["condition"] for run in record["runs"]))
    seeds = list(dict.fromkeys(run["seed"] for run in record["runs"]))
    about = {"title": record["title"], "baseline": record["baseline"], "conditions": conditions}
    if json:
        return print_json({"schema": 1, "study": record["study"], **about, "seeds": seeds})
    print(plain(record["title"]))
    if record.get("source") == "tensorboard":
        print("\nImported logs: returns are means of 100 episodes, as Stable-Baselines3 logs them.")
    print(f"\nConditions: {plain(', '.join(conditions))}\nCompared with: {plain(record['baseline'])}")
    print(f"Seeds: {', '.join(map(str, seeds))}")
    return None
