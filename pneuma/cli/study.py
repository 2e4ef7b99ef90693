"""`pneuma study …`: list, show and create studies, and say how far their runs are."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Any

import typer

from pneuma.cli import complete, study_files, study_results, study_run, study_summary, study_verify
from pneuma.cli import options as opt
from pneuma.cli.output import print_json, print_listed, print_table, say, tallied, write_file
from pneuma.errors import UserError, unknown_name
from pneuma.study import plan, spec
from pneuma.study.store import Store
from pneuma.values import shown_value

app = typer.Typer(help="Compare conditions over many seeds.", no_args_is_help=True, rich_markup_mode=None)

app.command("plan", short_help="Say which runs are stored, and which would be trained.")(study_run.plan_)
app.command(short_help="Train a study's runs that are not stored yet.")(study_run.run)
app.command(short_help="Draw a study: curves over its steps, or a summary.")(study_files.plot)
app.command()(study_files.export)
app.command(short_help="Write a study's runs as one small table.")(study_files.publish)
app.command(short_help="Say what each condition's runs come to.")(study_summary.summary)
app.command(short_help="Compare two conditions.")(study_summary.compare)
app.command(short_help="Say which runs collapsed, when, and how often.")(study_results.collapse)
app.command(short_help="Say in which other settings a contrast holds.")(study_results.robustness)
app.command(short_help="Test what matters where settings are crossed.")(study_results.effects)
app.command(short_help="Judge the thesis's claims by the runs they fix.")(study_verify.verify)


@app.command("list")
def list_(json: opt.Json = False) -> None:
    """List the shipped studies."""
    return print_listed("study", "studies", spec.studies_folder(), json)


@app.command(short_help="Write a study file to edit.")
def new(
    name: Annotated[str, opt.argument("NAME", "The new study's name.")],
    source: Annotated[
        str, opt.option("--from", "STUDY", "The shipped study to copy, without its words on the thesis.")
    ] = "activation",
) -> None:
    """Write NAME.toml into this folder: a copy of a shipped study, to be edited."""
    if not re.fullmatch(r"[\w-]+", name):
        raise UserError(f"{name}: a study's name has letters, digits, - and _ alone")
    path = Path(f"{name}.toml")
    spec.refuse_taken_name(path, spec.studies_folder() / path.name, "study")
    if path.exists():
        raise UserError(f"{path}: exists already; choose another name")
    if source not in spec.list_studies():
        raise unknown_name("shipped study", source, spec.list_studies())
    text = (spec.studies_folder() / f"{source}.toml").read_text(encoding="utf-8")
    text = re.sub(r'^about = """(?s:.*?)"""\n|^(section|figure) = .*\n|\A(#.*\n)+', "", text, flags=re.M)
    text = re.sub(r"^title = .*$", f'title = "{name}"', text, flags=re.M)
    write_file(path, f"# From the study {source}. docs/studies.md says what can be set.\n{text}".encode())
    print(f"wrote {path}: edit it, then run: pneuma study run {path}")


# --- show ------------------------------------------------------------------------------------------


@app.command(short_help="Show what a study compares, and its presets.")
def show(
    name: opt.StudyName,
    world: opt.WorldName = None,
    results: opt.Results = opt.RESULTS,
    json: opt.Json = False,
) -> None:
    """Show what a study compares: its conditions as resolved, and its presets."""
    from pneuma.analysis.asked import ask
    from pneuma.analysis.run_index import RunIndex

    asked = ask(RunIndex(Store(results)), name, world=world)
    study, fields = asked.study, asked.fields
    if json:
        about = {key: getattr(study, key) for key in ("section", "about", "world", "worlds")} if study else {}
        presets = {n: {"seeds": p.seeds, "steps": p.steps} for n, p in study.presets.items()} if study else {}
        head = {"study": asked.name, "title": asked.title, "baseline": asked.baseline}
        return print_json({**head, **about, "conditions": fields, "presets": presets})
    say(asked.title + (f" (thesis section {study.section})" if study and study.section else ""))
    if study:
        say(study.about)
    differing = plan.differing_fields(fields)
    if len(fields) > 1:
        print("\nThe conditions differ in:" if differing else "\nThe conditions do not differ: this is A/A.")
    for key, values in differing.items():
        having: dict[str, list[str]] = {}
        for condition, value in values.items():
            having.setdefault(shown_value(value), []).append(condition)
        names = (
            ", ".join(those) if len(those) <= 4 else f"{len(those)} conditions" for those in having.values()
        )
        each = map("{} ({})".format, having, names)
        say(f"  {key}: {'; '.join(each)}")
    if len(fields) > 1:
        say(f"Compared with: {asked.baseline}")
    print("\nAll conditions share:" if len(fields) > 1 else "\nThe one condition has:")
    for key, value in next(iter(fields.values()), {}).items():
        if key not in (*differing, "seed", "steps"):
            say(f"  {key} = {shown_value(value)}")
    if study is None:
        return say(f"Seeds: {', '.join(dict.fromkeys(str(seed) for _, seed in asked.listed.values()))}")
    from pneuma.analysis.claims_preset import fixed_amounts

    print(f"\nRuns in: {', '.join(study.worlds)} (here {study.world})\n\nPresets:")
    amounts = [(name, {"": amount, **amount.conditions}) for name, amount in study.presets.items()]
    amounts += [(spec.CLAIMS, dict(amount)) for amount in fixed_amounts(study).values()]
    rows = [
        (f"  {preset}", condition, f"{len(amount.seeds)} seeds x {amount.steps:,} steps")
        for preset, of_conditions in amounts
        for condition, amount in of_conditions.items()
    ]
    return print_table([""] * 3, rows)


# --- status ----------------------------------------------------------------------------------------


@app.command(short_help="Say how far the runs of a study are.")
@opt.grouped
def status(
    picked: opt.Chosen,
    name: Annotated[
        str | None, opt.argument("NAME", "A study; left out: all that were run.", complete.studies)
    ] = None,
    json: opt.Json = False,
) -> None:
    """Say how far the runs of a study are."""
    from pneuma.analysis.asked import answer, ask
    from pneuma.analysis.held import studies_here
    from pneuma.analysis.run_index import RunIndex

    index = RunIndex(picked.store)
    if name is None:
        held = studies_here(index, picked.world)
        if json:
            keys = ("run_id", "status", "step")
            return print_json({
                "studies": [
                    {"study": one.name, "world": one.world,
                     "runs": [{key: getattr(entry, key) for key in keys} for entry in one.entries]}
                    for one in held
                ]
            })  # fmt: skip
        rows = [(one.name, one.world, tallied(entry.status for entry in one.entries)) for one in held]
        return print_table([""] * 3, rows) if rows else print(f"No study was run in {picked.store.root} yet.")
    jobs = _queued(picked.store)
    shown = answer(index, ask(index, name, picked.selection, picked.world), picked.selection)
    say(shown.told(), aside=True)
    runs: list[dict[str, Any]] = []
    table = []
    for condition, seed, entry in shown.runs:
        about = {"run_id": entry.run_id, "condition": condition, "seed": seed}
        runs.append(
            {**about, "status": entry.status, "step": entry.step, "published": entry.table is not None}
        )
        label = f"{entry.status} as published" if entry.table else entry.status
        label += f" at step {entry.step:,}" if entry.step and not entry.finished else ""
        if job := jobs.get(entry.run_id):
            label += f" job {job['job']} {job['state'].lower()}"
        table.append((f"  {condition}", f"seed {seed}", entry.run_id, label))
    if json:
        queued = {run["run_id"]: jobs[run["run_id"]] for run in runs if run["run_id"] in jobs}
        return print_json({"study": shown.asked.name, "runs": runs, "jobs": queued})
    print_table([""] * 4, table)
    return print(tallied(entry.status for *_, entry in shown.runs))


def _queued(store: Store) -> dict[str, dict[str, Any]]:
    """Return Slurm's jobs by the runs that they train; print a note if the queue cannot be asked."""
    from pneuma.study.executors.slurm import queued

    try:
        return {run_id: {"job": job.id, "state": job.state} for run_id, job in queued(store).items()}
    except UserError as error:
        say(f"Note: runs were submitted to Slurm, but its queue cannot be asked: {error}", aside=True)
        return {}
