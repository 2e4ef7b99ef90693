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
from pneuma.values import shown_settings, shown_value

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

        name, ranked = ranked_runs(opt.RunFilter(world=world, results=results).open(study), sort or "")
        rows = []
        for run in ranked.to_dict("records"):
            rows.append((run["run_id"], run["condition"], f"seed {run['seed']}", f"{run['value']:.4g}"))
        return Result({"outcome": name, "runs": ranked}, [Table(("run", "condition", "", name), rows)])
    if sort is not None:
        raise UserError("--sort requires --study")
    from pneuma.store.index import RunIndex

    index = RunIndex(Store(results))
    labels, own_runs = _labels(index), index.frame[index.frame["where"] == ""]
    own_runs = own_runs.rename(columns={"end": "step"})[["run_id", "status", "step", "seed"]]
    runs = [{**run, "studies": labels.get(run["run_id"], [])} for run in rows_of(own_runs)]
    lines = []
    for run in runs:
        studies = ", ".join(f"{label['study']}/{_condition(label)}" for label in run["studies"])
        amount = f"{run['step']:>12,} steps", f"seed {run['seed']}"
        lines.append((run["run_id"], run["status"], *amount, studies or "of no study"))
    table = Table([""] * 5, lines) if lines else f"No run is stored in {results} yet."
    return Result({"runs": runs}, [table])


def _labels(index: RunIndex) -> dict[str, list[dict[str, Any]]]:
    """Return the studies, worlds and conditions of each run in the results folder, by its id."""
    from pneuma.analysis.runs import studies_here

    labels: dict[str, list[dict[str, Any]]] = {}
    for data in studies_here(index):
        about: dict[str, Any] = {"study": data.study.name}
        if data.study.path:
            about["world"] = data.study.world
        if data.study.settings:
            about["settings"] = dict(data.study.settings)
        for run in data.runs[["run_id", "condition", "seed"]].to_dict("records"):
            label = {**about, "condition": run["condition"], "seed": run["seed"]}
            labels.setdefault(run["run_id"], []).append(label)
    return labels


def _condition(label: Mapping[str, Any]) -> str:
    """Return a condition with the fields that were changed, unless its name has them."""
    condition, changed = str(label["condition"]), {}
    for key, value in label.get("settings", {}).items():
        if f"{key}=" not in condition:
            changed[key] = value
    return f"{condition} with {shown_settings(changed)}" if changed else condition


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
    defaults = {}
    for key, value in settings.items():
        if value != default_fields.get(key):
            defaults[key] = default_fields.get(key)
    document = {
        "run_id": run_id,
        "status": status.name,
        "step": status.step,
        "studies": _labels(RunIndex(store)).get(run_id, []),
        "settings": settings,
        "defaults": defaults,
        "provenance": store.read_document(run_id, "provenance.json"),
        "files": run_files(store, run_id),
    }
    detail = f" ({status.detail})" if status.detail else ""
    head = f"run {run_id}: {status.name}{detail}, {status.step:,} steps trained"
    return Result(document, [head] + list(_show(document, all_)))


def _show(run: Mapping[str, Any], all_fields: bool) -> Iterator[str | Table]:
    for study in run["studies"]:
        yield f"study {study['study']}, condition {_condition(study)}, seed {study['seed']}"
    yield ""
    yield "Fields" if all_fields else "Fields that are not at their defaults (--all shows the others)"
    for key, value in run["settings"].items():
        if key in run["defaults"]:
            yield f"  {key} = {shown_value(value)}   (default {shown_value(run['defaults'][key])})"
        elif all_fields:
            yield f"  {key} = {shown_value(value)}"
    yield ""
    yield "Provenance" if run["provenance"] else "Provenance: none, or damaged; it is written at a run's end"
    for key, value in run["provenance"].items():
        if isinstance(value, dict):
            value = ", ".join(f"{name} {version}" for name, version in value.items())
        if key == "attempts" and isinstance(value, list):
            value = f"{len(value)} (--json shows the machine of each)"
        yield f"  {key:<12} {shown_value(value)}"
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
    status, fields = store.status(run_id), trusted_settings(store, run_id, trust)
    try:
        data = _exported(store, run_id, fields)
    except UserError as error:
        raise UserError(f"run {run_id}: {error}") from None
    write_file(out, data)
    text = f"wrote {out}: {len(data):,} bytes, the policy of run {run_id} after {status.step:,} steps"
    return Result({"run_id": run_id, "file": out, "bytes": len(data)}, [text])


def _exported(store: Store, run_id: str, fields: Mapping[str, Any]) -> bytes:
    from pneuma.engines import export as exports
    from pneuma.engines.policy import LEARNER_FILE, POLICY_FILE, read_sound_policy

    if LEARNER_FILE in store.checksums(run_id):
        return store.read_file(run_id, LEARNER_FILE)
    if POLICY_FILE not in store.checksums(run_id) or not fields:
        raise UserError(f"is {store.status(run_id).name}: it has no policy to export")
    settings, policy = stored_run(fields), read_sound_policy(store.read_file(run_id, POLICY_FILE))
    if policy.players > 1:
        raise UserError(
            f"has a policy for each of {policy.players} players: a file for other programs holds one"
        )
    return exports.to_sb3(policy, settings, exports.observation_space(policy, settings))
