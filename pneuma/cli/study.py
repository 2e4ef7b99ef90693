"""`pneuma study …`: list, show and create studies, and say how far their runs are."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.cli import delete, study_answers, study_files, study_run, study_verify
from pneuma.cli import options as opt
from pneuma.cli.output import Result, Table, listed_result, rows_of, say, tallied, write_file
from pneuma.config import is_gymnasium_id, reads
from pneuma.errors import UserError, unknown_name
from pneuma.files import create_whole
from pneuma.store.store import FINISHED, Store
from pneuma.study import plan, shipped, spec
from pneuma.study.plan import Query
from pneuma.values import shown_seeds, shown_settings, shown_value

if TYPE_CHECKING:
    from pneuma.analysis.study_data import StudyData

STATES = ("done", "diverged", "published", "running", "partial", "crashed", "killed", "damaged", "planned")
"""States of runs, in the order of columns; those of another kind are only in the document."""

app = opt.Commands("study", "Compare conditions over many seeds.")

app.command("plan", short_help="Say which runs are stored, and which would be trained.")(study_run.plan_)
app.command(short_help="Train a study's runs that are not stored yet.")(study_run.run)
app.command("delete", short_help="Remove a study's runs from the results folder.")(delete.delete_study)
app.command(short_help="Draw a study: curves over its steps, or a summary.")(study_files.plot)
app.command()(study_files.export)
app.command(short_help="Print one of the thesis's tables of hyperparameters.")(study_files.table)
app.command(short_help="Write a study's runs as one small table.")(study_files.publish)
app.command(short_help="Summarize each condition's outcomes.")(study_answers.summary)
app.command(short_help="Compare two conditions.")(study_answers.compare)
app.command(short_help="Show which runs collapsed, when, and how often.")(study_answers.collapse)
app.command(short_help="Judge the thesis's claims by the runs they fix.")(study_verify.verify)


@app.command("list")
def list_() -> Result:
    """List the shipped studies."""
    return listed_result("study", "studies", shipped.studies_folder())


@app.command(short_help="Write a study file to edit.")
def new(
    name: Annotated[str, opt.argument("NAME", "The new study's name.")],
    source: Annotated[str, opt.option("STUDY", "The shipped study to copy.", name="--from")] = "activation",
) -> Result:
    """Write NAME.toml into this folder: a copy of a shipped study, to be edited."""
    if not re.fullmatch(r"[\w-]+", name):
        raise UserError(f"{name}: a study's name has letters, digits, - and _ alone")
    path = Path(f"{name}.toml")
    shipped.refuse_taken_name(path, shipped.studies_folder() / path.name, "study")
    if path.exists():
        raise UserError(f"{path}: exists already; choose another name")
    if source not in shipped.list_studies():
        raise unknown_name("shipped study", source, shipped.list_studies())
    text = (shipped.studies_folder() / f"{source}.toml").read_text(encoding="utf-8")
    text = re.sub(r'^about = """(?s:.*?)"""\n|^(section|figure) = .*\n|\A(#.*\n)+', "", text, flags=re.M)
    text = re.sub(r"^title = .*$", f'title = "{name}"', text, flags=re.M)
    write_file(path, f"# From the study {source}. docs/studies.md says what can be set.\n{text}".encode())
    for module in re.findall(r'"(\w+):\w+"', text):  # a study's own files are beside it
        if (source_file := shipped.studies_folder() / f"{module}.py").is_file():
            create_whole(path.with_name(source_file.name), source_file.read_bytes())
    return Result({"file": path}, [f"wrote {path}: edit it, then run: pneuma study run {path}"])


# --- show ------------------------------------------------------------------------------------------


@app.command(short_help="Show what a study compares, and its presets.")
def show(name: opt.Study, world: opt.World = None, results: opt.Results = opt.HERE) -> Result:
    """Show what a study compares: its conditions as resolved, and its presets."""
    from pneuma.analysis.runs import configurations_of
    from pneuma.store.index import RunIndex

    study, fields, configurations = configurations_of(RunIndex(Store(results)), name, world)
    for condition, run in configurations.items():
        affecting = reads(run)
        fields[condition] = {key: value for key, value in fields[condition].items() if key in affecting}
    document: dict[str, Any] = {"study": study.name, "title": study.title, "baseline": study.baseline}
    if study.path:
        document |= {key: getattr(study, key) for key in ("section", "about", "world", "worlds")}
    document["conditions"] = fields
    document["presets"] = {preset: _amounts(study, preset) for preset in study.presets}
    own = any(not is_gymnasium_id(run.env) for run in configurations.values())
    return Result(document, _show(study, fields, own))


def _amounts(study: spec.Study, preset: str) -> dict[str, dict[str, Any]]:
    """Return the seeds and steps of each condition of a preset, in the study's world."""
    amounts = study.presets[preset].amounts(study.conditions, study.world)
    return {name: {"seeds": amount.seeds, "steps": amount.steps} for name, amount in amounts.items()}


def _show(study: spec.Study, fields: Mapping[str, Mapping[str, Any]], own: bool) -> Iterator[str | Table]:
    several, differing = len(fields) > 1, plan.differing_fields(fields)
    yield study.title + (f" (thesis section {study.section})" if study.section else "")
    if study.path:
        yield study.about
    if several:
        yield ""
        yield "The conditions differ in:" if differing else "The conditions do not differ."
    for key, values in differing.items():
        yield f"  {key}: {_who_has(values)}"
    if several:
        yield f"Compared with: {study.baseline}"
    yield ""
    yield "All conditions share:" if several else "The one condition has:"
    for key, value in next(iter(fields.values()), {}).items():
        if key not in (*differing, "seed", "steps"):
            yield f"  {key} = {shown_value(value)}"
    if study.path is None:
        return
    yield ""
    if own:
        yield f"Runs in: {', '.join(study.worlds)} (here {study.world})"
        yield ""
    yield "Presets:"
    rows: list[tuple[str, str, str]] = []
    for preset in study.presets:
        by_amount: dict[str, list[str]] = {}
        for condition, amount in _amounts(study, preset).items():
            text = f"seeds {shown_seeds(amount['seeds'])}, {amount['steps']:,} steps"
            by_amount.setdefault(text, []).append(condition)
        for text, conditions in by_amount.items():
            is_every = len(conditions) == len(study.conditions)
            rows.append((f"  {preset}", text, "" if is_every else ", ".join(conditions)))
    yield Table([""] * 3, rows)


def _who_has(values: Mapping[str, Any]) -> str:
    """Return the values of a field, each with the conditions that have it, or their number."""
    having: dict[str, list[str]] = {}
    for condition, value in values.items():
        having.setdefault(shown_value(value), []).append(condition)
    names = (", ".join(each) if len(each) <= 4 else f"{len(each)} conditions" for each in having.values())
    return "; ".join(map("{} ({})".format, having, names))


# --- status ----------------------------------------------------------------------------------------


@app.command(short_help="Show the progress of a study's runs.")
def status(
    picked: opt.RunFilter,
    name: Annotated[str | None, opt.argument("NAME[@PRESET]", "A study; default: all that were run.")] = None,
    runs: Annotated[bool, opt.flag("--runs", "List each run.")] = False,
    format: opt.Format = opt.TABLE,
) -> Result:
    """Show how many runs of a study have ended, by preset and condition; with --runs, list them."""
    if name is None:
        return _every_status(picked)
    from pneuma.analysis.runs import find_study

    data = picked.find(name)
    say(data.text(picked.store.root))
    for problem in picked.index.problems:
        say(f"Note: {problem}.")
    if runs or data.plan is None:
        return _status_of_runs(data)
    query = data.plan.query
    is_preset = not (query.seeds or query.steps or query.conditions or query.settings)
    states = _states(data.plan.preset if is_preset else "as asked", data)
    for preset in data.study.presets:
        if not (is_preset and preset == data.plan.preset):
            other = find_study(picked.index, Query(data.study.file, data.study.world, preset))
            states += _states(preset, other)
    names = [state for state in STATES if any(state in row for row in states)]
    heads = ["preset", "condition", "runs", *names]
    rows = [[row.get(head, "") for head in heads] for row in states]
    document = {"study": data.study.name, "world": data.world or None, "presets": states}
    return Result(document, [Table(heads, rows)], table=states)


def _states(preset: str, data: StudyData) -> list[dict[str, Any]]:
    """Return how many runs of each condition of a preset are in which state; one row if none is stored."""
    assert data.plan is not None
    planned = Counter(cell.condition for cell in data.plan.cells)
    if not len(data.runs):
        total = planned.total()
        return [{"preset": preset, "condition": f"all {len(planned)}", "runs": total, "planned": total}]
    rows: list[dict[str, Any]] = []
    for condition, count in planned.items():
        runs = data.runs[data.runs["condition"] == condition]
        states = runs["status"].where(runs["where"] == "", "published")
        row: dict[str, Any] = {"preset": preset, "condition": condition, "runs": count}
        row |= Counter(states)
        if count > len(runs):
            row["planned"] = row.get("planned", 0) + count - len(runs)
        rows.append(row)
    return rows


def _status_of_runs(data: StudyData) -> Result:
    """Return each run of a study's cells with its state."""
    frame = data.runs.assign(step=data.runs["end"], published=data.runs["where"] != "")
    runs = rows_of(frame[["run_id", "condition", "seed", "status", "step", "published"]])
    table = []
    for run in runs:
        label = f"{run['status']} as published" if run["published"] else run["status"]
        if run["step"] and run["status"] not in FINISHED:
            label += f" at step {run['step']:,}"
        table.append((f"  {run['condition']}", f"seed {run['seed']}", run["run_id"], label))
    text: list[str | Table] = [Table([""] * 4, table), tallied(run["status"] for run in runs)]
    return Result({"study": data.study.name, "runs": runs}, text, table=runs)


def _every_status(picked: opt.RunFilter) -> Result:
    from pneuma.analysis.runs import studies_here

    studies, table = [], []
    for data in studies_here(picked.index, picked.world):
        world = data.study.world if data.study.path else ""
        changed = shown_settings(data.study.settings)
        about = {"study": data.study.own_path or data.study.name, "world": world, "changed": changed}
        runs = data.runs.drop_duplicates("run_id").rename(columns={"end": "step"})
        studies.append({**about, "runs": runs[["run_id", "status", "step"]].to_dict("records")})
        table.append({**about, "runs": tallied(runs["status"])})
    nothing = f"No study was run in {picked.store.root} yet."
    shown = Table([""] * 4, [[*row.values()] for row in table]) if table else nothing
    return Result({"studies": studies}, [shown], table=table)
