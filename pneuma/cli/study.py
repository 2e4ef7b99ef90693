"""`pneuma study …`: list, show and create studies, and show how far their runs are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Annotated, Any

from pneuma.analysis.answer import Answer
from pneuma.cli import delete, study_answers, study_check, study_files, study_run, study_verify
from pneuma.cli import options as opt
from pneuma.cli.output import Result, Table, answer_result, frame_table, listed_result, say
from pneuma.config import effective_fields, is_gymnasium_id
from pneuma.seeds import format_seeds
from pneuma.store.store import Store
from pneuma.study import shipped, spec

app = opt.Commands("study", "Compare conditions over many seeds.")

app.command("plan", short_help="Show which runs are stored and which would be trained.")(study_run.plan_)
app.command(short_help="Train a study's runs that are not stored yet.")(study_run.run)
app.command("delete", short_help="Delete a study's runs from the results folder.")(delete.delete_study)
app.command(short_help="Draw a study's learning curves, or a summary of its outcomes.")(study_files.plot)
app.command()(study_files.export)
app.command(short_help="Print one of the thesis's tables of hyperparameters.")(study_files.table)
app.command(short_help="Publish a study's finished runs as one small table.")(study_files.publish)
app.command(short_help="Summarize each condition's outcomes.")(study_answers.summary)
app.command(short_help="Compare two conditions.")(study_answers.compare)
app.command(short_help="Show which runs collapsed, when, and how often.")(study_answers.collapse)
app.command(short_help="Train published runs again, and compare them to the last bit.")(study_check.check)
app.command(short_help="Judge the thesis's claims on their preregistered runs.")(study_verify.verify)


@app.command("list")
def list_() -> Result:
    """List the shipped studies."""
    return listed_result("study", "studies", shipped.studies_folder())


@app.command(short_help="Copy a shipped study to a file of your own.")
def new(
    name: Annotated[str, opt.argument("NAME", "The new study's name.")],
    source: Annotated[str, opt.option("STUDY", "The shipped study to copy.", name="--from")] = "activation",
) -> Result:
    """Copy a shipped study to NAME.toml in this folder, to edit."""
    from pneuma import api

    path = api.new_study(name, source)
    return Result({"file": path}, [f"wrote {path}: edit it, then run: pneuma study run {path}"])


# --- show ------------------------------------------------------------------------------------------


@app.command(short_help="Show what a study compares, and its presets.")
def show(name: opt.Study, world: opt.World = None, results: opt.Results = opt.HERE) -> Result:
    """Show the conditions that a study compares, with all settings, and its presets."""
    from pneuma.analysis.runs import configurations_of
    from pneuma.store.index import RunIndex

    study, fields, configurations = configurations_of(RunIndex(Store(results)), name, world)
    for condition, run in configurations.items():
        affecting = effective_fields(run)
        fields[condition] = {key: value for key, value in fields[condition].items() if key in affecting}
    document: dict[str, Any] = {"study": study.name, "title": study.title, "baseline": study.baseline}
    if study.path:
        document |= {key: getattr(study, key) for key in ("section", "about", "world", "worlds")}
    document["conditions"] = fields
    document["presets"] = {preset: _amounts(study, preset) for preset in study.presets}
    is_in_own_worlds = any(not is_gymnasium_id(run.env) for run in configurations.values())
    return Result(document, _show(study, fields, is_in_own_worlds))


def _amounts(study: spec.Study, preset: str) -> dict[str, dict[str, Any]]:
    """Return the seeds and steps of each condition of a preset, in the study's world."""
    amounts = study.presets[preset].amounts(study.conditions, study.world)
    return {name: {"seeds": amount.seeds, "steps": amount.steps} for name, amount in amounts.items()}


def _show(
    study: spec.Study, fields_by_condition: Mapping[str, Mapping[str, Any]], is_in_own_worlds: bool
) -> Iterator[str | Table]:
    from pneuma.analysis.settings import compare_settings

    differing, shared_fields = compare_settings(fields_by_condition)
    yield study.title + (f" (thesis section {study.section})" if study.section else "")
    if study.path:
        yield study.about
    yield ""
    if len(fields_by_condition) > 1:
        if len(differing.columns) > 1:
            yield frame_table(differing)
        else:
            yield "The conditions do not differ."
        yield f"Compared with: {study.baseline}"
        yield ""
    yield "All conditions share:" if len(fields_by_condition) > 1 else "The one condition has:"
    for field_name, value_text in shared_fields.items():
        yield f"  {field_name} = {value_text}"
    if study.path is None:
        return
    yield ""
    if is_in_own_worlds:
        yield f"Runs in: {', '.join(study.worlds)} (here {study.world})"
        yield ""
    yield "Presets:"
    preset_rows: list[tuple[str, str, str]] = []
    for preset in study.presets:
        names_by_amount: dict[str, list[str]] = {}
        for condition, amount in _amounts(study, preset).items():
            amount_text = f"seeds {format_seeds(amount['seeds'])}, {amount['steps']:,} steps"
            names_by_amount.setdefault(amount_text, []).append(condition)
        for amount_text, conditions in names_by_amount.items():
            is_every = len(conditions) == len(study.conditions)
            preset_rows.append((f"  {preset}", amount_text, "" if is_every else ", ".join(conditions)))
    yield Table([""] * 3, preset_rows)


# --- status ----------------------------------------------------------------------------------------


@app.command(short_help="Show the progress of a study's runs.")
def status(
    selection: opt.RunFilter,
    name: Annotated[
        str | None, opt.argument("NAME[@PRESET]", "A study (default: all that were run).")
    ] = None,
    runs: Annotated[bool, opt.flag("--runs", "List each run.")] = False,
    format: opt.Format = opt.TABLE,
) -> Answer | Result:
    """Show how many runs of a study have ended, by preset and condition; with --runs, list them."""
    from pneuma.analysis.runs import find_study
    from pneuma.analysis.status import runs_status, studies_status, study_status

    if name is None:
        return replace(answer_result(studies_status(selection.index, selection.world)), numbers=None)
    study_data = find_study(selection.index, selection.query(name))
    say(study_data.coverage)
    for problem in selection.index.problems:
        say(f"Note: {problem}.")
    if runs or study_data.plan is None:
        return runs_status(study_data)
    return study_status(selection.index, study_data)
