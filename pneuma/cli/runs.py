"""`pneuma run …`: list stored runs, show what produced one, and export its policy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.cli import delete
from pneuma.cli import options as opt
from pneuma.cli.output import Result, Table, check_file, rows_of, write_file
from pneuma.errors import UserError
from pneuma.store.store import Store
from pneuma.store.stored_runs import (
    default_settings,
    find_run,
    run_files,
    stored_run,
    stored_settings,
    trusted_settings,
)
from pneuma.values import format_settings, format_value

if TYPE_CHECKING:
    from pneuma.store.index import RunIndex

app = opt.Commands("run", "Inspect, export and delete single runs.")
app.command("delete", short_help="Delete a stored run.")(delete.delete_run)


@app.command("list", short_help="List the stored runs.")
def list_(
    study: Annotated[
        str | None, opt.option("NAME[@PRESET]", "List only this study's finished runs, ranked by an outcome.")
    ] = None,
    sort: Annotated[
        str | None, opt.option("OUTCOME", "With --study: the outcome to rank by (default: the primary one).")
    ] = None,
    world: opt.World = None,
    results: opt.Results = opt.HERE,
) -> Result:
    """List the stored runs with their status, steps, seed and studies.

    With --study, list the finished runs of one study, the best first.
    """
    if study is not None:
        from pneuma.analysis.ranking import ranked_runs

        outcome, ranked = ranked_runs(opt.RunFilter(world=world, results=results).open(study), sort or "")
        rows = []
        for run in ranked.to_dict("records"):
            rows.append((run["run_id"], run["condition"], f"seed {run['seed']}", f"{run['value']:.4g}"))
        return Result({"outcome": outcome, "runs": ranked}, [Table(("run", "condition", "", outcome), rows)])
    if sort is not None:
        raise UserError("--sort requires --study")
    from pneuma.store.index import RunIndex

    index = RunIndex(Store(results))
    labels_by_run, own_runs = _labels(index), index.frame[index.frame["where"] == ""]
    own_runs = own_runs.rename(columns={"end": "step"})[["run_id", "status", "step", "seed"]]
    run_rows = [{**run, "studies": labels_by_run.get(run["run_id"], [])} for run in rows_of(own_runs)]
    table_rows = []
    for run in run_rows:
        studies = ", ".join(f"{label['study']}/{_condition(label)}" for label in run["studies"])
        amounts = f"{run['step']:>12,} steps", f"seed {run['seed']}"
        table_rows.append((run["run_id"], run["status"], *amounts, studies or "of no study"))
    table = Table([""] * 5, table_rows) if table_rows else f"No run is stored in {results} yet."
    return Result({"runs": run_rows}, [table])


def _labels(index: RunIndex) -> dict[str, list[dict[str, Any]]]:
    """Return the studies, worlds and conditions of each run in the results folder, by its id."""
    from pneuma.analysis.runs import studies_here

    labels_by_run: dict[str, list[dict[str, Any]]] = {}
    for study_data in studies_here(index):
        study_label: dict[str, Any] = {"study": study_data.study.name}
        if study_data.study.path:
            study_label["world"] = study_data.study.world
        if study_data.study.settings:
            study_label["settings"] = dict(study_data.study.settings)
        for run in study_data.runs[["run_id", "condition", "seed"]].to_dict("records"):
            run_label = {**study_label, "condition": run["condition"], "seed": run["seed"]}
            labels_by_run.setdefault(run["run_id"], []).append(run_label)
    return labels_by_run


def _condition(run_label: Mapping[str, Any]) -> str:
    """Return a condition with the fields that were changed, unless its name has them."""
    condition, changed_fields = str(run_label["condition"]), {}
    for field_name, field_value in run_label.get("settings", {}).items():
        if f"{field_name}=" not in condition:
            changed_fields[field_name] = field_value
    return f"{condition} with {format_settings(changed_fields)}" if changed_fields else condition


@app.command(short_help="Show how a stored run was produced.")
def show(
    name: opt.RunId,
    all_: Annotated[bool, opt.flag("--all", "Show every field, including defaults.")] = False,
    results: opt.Results = opt.HERE,
) -> Result:
    """Show how a stored run was produced: configuration, machine, packages, time, files."""
    from pneuma.store.index import RunIndex

    store = Store(results)
    run_id = find_run(store, name)
    status, settings = store.status(run_id), stored_settings(store, run_id)
    default_fields = default_settings(settings)
    changed_defaults = {}
    for field_name, field_value in settings.items():
        if field_value != default_fields.get(field_name):
            changed_defaults[field_name] = default_fields.get(field_name)
    index = RunIndex(store)
    row = index.row(run_id) if status.finished else None
    document = {
        "run_id": run_id,
        "status": status.name,
        "step": status.step,
        "policy": row.policy if row else None,
        "studies": _labels(index).get(run_id, []),
        "settings": settings,
        "defaults": changed_defaults,
        "provenance": store.read_document(run_id, "provenance.json"),
        "files": run_files(store, run_id),
    }
    detail = f" ({status.detail})" if status.detail else ""
    headline = f"run {run_id}: {status.name}{detail}, {status.step:,} steps trained"
    return Result(document, [headline] + list(_show(document, all_)))


def _show(run: Mapping[str, Any], all_fields: bool) -> Iterator[str | Table]:
    if run["policy"]:
        yield f"policy {run['policy']}"
    for study in run["studies"]:
        yield f"study {study['study']}, condition {_condition(study)}, seed {study['seed']}"
    yield ""
    yield "Fields" if all_fields else "Fields that are not at their defaults (--all shows the others)"
    for key, row_value in run["settings"].items():
        if key in run["defaults"]:
            yield f"  {key} = {format_value(row_value)}   (default {format_value(run['defaults'][key])})"
        elif all_fields:
            yield f"  {key} = {format_value(row_value)}"
    yield ""
    yield "Provenance" if run["provenance"] else "Provenance: none, or damaged; it is written at a run's end"
    for key, row_value in run["provenance"].items():
        if isinstance(row_value, dict):
            row_value = ", ".join(f"{name} {version}" for name, version in row_value.items())
        if key == "attempts" and isinstance(row_value, list):
            row_value = f"{len(row_value)} (--json shows the machine of each)"
        yield f"  {key:<12} {format_value(row_value)}"
    yield ""
    yield "Files"
    rows = [(f"  {file['name']}", f"{file['bytes']:>12,} bytes", file["state"]) for file in run["files"]]
    yield Table([""] * 3, rows)


# --- export ----------------------------------------------------------------------------------------


@app.command(short_help="Write a run's final policy for other programs.")
def export(
    name: opt.RunId,
    out: Annotated[Path, opt.option("FILE", "The .zip file to write.")],
    trust: opt.Trust = False,
    force: opt.Force = False,
    results: opt.Results = opt.HERE,
) -> Result:
    """Write a run's final policy as a .zip for Stable-Baselines3."""
    check_file(out, (".zip",), force)
    store = Store(results)
    run_id = find_run(store, name)
    status, run_fields = store.status(run_id), trusted_settings(store, run_id, trust)
    try:
        exported = _exported(store, run_id, run_fields)
    except UserError as error:
        raise UserError(f"run {run_id}: {error}") from None
    write_file(out, exported)
    text = f"wrote {out}: {len(exported):,} bytes, the policy of run {run_id} after {status.step:,} steps"
    return Result({"run_id": run_id, "file": out, "bytes": len(exported)}, [text])


def _exported(store: Store, run_id: str, run_fields: Mapping[str, Any]) -> bytes:
    from pneuma.engines import export as exports
    from pneuma.engines.policy import LEARNER_FILE, read_sound_policy
    from pneuma.engines.records import POLICY_FILE

    if LEARNER_FILE in store.checksums(run_id):
        return store.read_file(run_id, LEARNER_FILE)
    if POLICY_FILE not in store.checksums(run_id) or not run_fields:
        raise UserError(f"is {store.status(run_id).name}: it has no policy to export")
    settings, policy = stored_run(run_fields), read_sound_policy(store.read_file(run_id, POLICY_FILE))
    if policy.players > 1:
        raise UserError(
            f"has a policy for each of {policy.players} players: a file for other programs holds one"
        )
    return exports.to_sb3(policy, settings, exports.observation_space(policy, settings))
