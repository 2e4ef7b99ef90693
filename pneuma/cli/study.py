"""`pneuma study …`: which studies there are, what they compare, and how far their runs are."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from pneuma.cli import options as opt
from pneuma.cli import study_compare, study_output, study_run, study_summary, study_verify
from pneuma.cli.output import print_json, print_listed, print_table, say, write_file
from pneuma.cli.study_records import (
    RunState,
    each_study,
    is_shipped,
    known_studies,
    run_states,
    study_record,
)
from pneuma.cli.study_run import by_value
from pneuma.config import as_fields, make_run
from pneuma.errors import UserError, plain, unknown_name
from pneuma.study import plan, spec
from pneuma.study.provenance import stored_origins, unusual_origins
from pneuma.study.spec import Preset
from pneuma.study.store import Store
from pneuma.values import shown_value

app = typer.Typer(help="Compare conditions over many seeds.", no_args_is_help=True, rich_markup_mode=None)

app.command("plan", short_help="Say which runs are stored, and which would be trained.")(study_run.plan_)
app.command(short_help="Train a study's runs that are not stored yet.")(study_run.run)
app.command(short_help="Draw a study: curves over its steps, or a summary.")(study_output.plot)
app.command()(study_output.export)
app.command(short_help="Write a study's runs as one small table.")(study_output.publish)
app.command(short_help="Say what each condition's runs come to.")(study_summary.summary)
app.command(short_help="Compare two conditions.")(study_compare.compare)
app.command(short_help="Say which runs collapsed, when, and how often.")(study_summary.collapse)
app.command(short_help="Say in which other settings a contrast holds.")(study_summary.robustness)
app.command(short_help="Test what matters where settings are crossed.")(study_summary.effects)
app.command(short_help="Judge the thesis's claims by the runs they fix.")(study_verify.verify)


@app.command("list")
def list_(json: opt.Json = False) -> None:
    """List the shipped studies."""
    return print_listed("study", "studies", spec.studies_folder(), json)


@app.command(short_help="Write a study file to edit.")
def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="The new study's name.", show_default=False)],
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


@app.command(short_help="Show what a study compares, and its presets.")
def show(
    name: opt.StudyName,
    world: opt.WorldName = None,
    results: opt.Results = opt.RESULTS,
    json: opt.Json = False,
) -> None:
    """Show what a study compares: its conditions as resolved, and its presets."""
    if not is_shipped(name) and name in known_studies(Store(results)):
        return _show_record(study_record(Store(results), name, None, world), json)
    study = spec.load_study(name, world)
    differing = plan.differing_fields(plan.make_plan(study, plan.Selection(next(iter(study.presets)))))
    if json:
        about = {key: getattr(study, key) for key in ("title", "section", "about", "world", "baseline")}
        lists = {
            "worlds": list(study.worlds),
            "conditions": {name: study.fields(name) for name in study.conditions},
            "presets": {n: {"seeds": p.seeds, "steps": p.steps} for n, p in study.presets.items()},
        }
        return print_json({"schema": 1, "study": study.name, **about, **lists})
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
    from pneuma.study.claimed import fixed_amounts

    presets = [(name, {"": own, **own.conditions}) for name, own in study.presets.items()]
    presets += [(spec.CLAIMS, dict(own)) for own in fixed_amounts(study).values()]
    print_table(("", "", ""), [row for own in presets for row in _amounts(*own)])
    return None


def _amounts(preset: str, amounts: Mapping[str, Preset]) -> list[tuple[str, ...]]:
    """Return how much a preset runs: of all conditions, and of those named."""
    return [
        (f"  {preset}", condition, f"{len(own.seeds)} seeds x {own.steps:,} steps")
        for condition, own in amounts.items()
    ]


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


# --- status ---------------------------------------------------------------------------------------


@app.command(short_help="Say how far the runs of a study are.")
@opt.grouped
def status(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="A study; left out: all that were run.")
    ] = None,
    selection: opt.Selected = None,
    world: opt.OneWorld = None,
    results: opt.Results = opt.RESULTS,
    json: opt.Json = False,
) -> None:
    """Say how far the runs of a study are, as it was last run or as selected."""
    store = Store(results)
    jobs = _queued(store)

    def standing(study: str) -> tuple[dict[str, Any], list[RunState]]:
        record = study_record(store, study, selection, world)
        states = run_states(store, record)
        return _document(store, record["study"], states, jobs), states

    found = [standing(name)] if name else each_study(known_studies(store, world), standing)
    if json:
        documents = [document for document, _ in found]
        return print_json(documents[0] if name else {"schema": 1, "studies": documents})
    if not found:
        print(f"No study was run in {results} yet.")
    for document, states in found:
        counts = ", ".join(f"{n} {told}" for told, n in Counter(own.told for own in states).items())
        print(f"{plain(document['study'])}: {counts}")
        print_table([""] * 6, [_row(own, document) for own in states])
    return None


def _document(
    store: Store, study: str, states: Sequence[RunState], jobs: Mapping[str, Any]
) -> dict[str, Any]:
    """Return how the runs of a study stand: each, which are unlike most, and which are in Slurm's queue."""
    runs = [
        {
            **{key: own.run[key] for key in ("run_id", "condition", "seed")},
            **{"status": own.status, "step": own.step, "published": own.published, "trained": False},
        }
        for own in states
    ]
    ids = [run["run_id"] for run in runs]
    unlike = unusual_origins(stored_origins(store, ids))
    queued = {run_id: jobs[run_id] for run_id in ids if run_id in jobs}
    return {"schema": 1, "study": study, "runs": runs, "unlike_most": unlike, "jobs": queued}


def _row(own: RunState, document: Mapping[str, Any]) -> tuple[str, ...]:
    run_id, job = own.run["run_id"], document["jobs"].get(own.run["run_id"])
    unlike = document["unlike_most"].get(run_id)
    return (
        f"  {own.run['condition']}",
        f"seed {own.run['seed']}",
        run_id,
        " ".join(filter(None, [own.told, own.reached])),
        f"job {job['job']} {job['state'].lower()}" if job else "",
        f"({unlike} than most)" if unlike else "",
    )


def _queued(store: Store) -> dict[str, dict[str, Any]]:
    """Return the jobs of Slurm's queue by the runs that they train; say so where it cannot be asked."""
    from pneuma.study.executors.slurm import queued

    try:
        return {run_id: {"job": job.id, "state": job.state} for run_id, job in queued(store).items()}
    except UserError as error:
        say(f"Note: runs were submitted to Slurm, but its queue cannot be asked: {error}", aside=True)
        return {}
