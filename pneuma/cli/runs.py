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
    from pneuma.analysis.study_data import StudyData
    from pneuma.store.index import RunIndex

app = opt.Commands("run", "Look at single runs and take them along.")
app.command("delete", short_help="Remove a stored run.")(delete.delete_run)


@app.command("list", short_help="List the stored runs.")
def list_(
    study: Annotated[
        str | None, opt.option("NAME[@PRESET]", "Only the finished runs of this study, ranked by an outcome.")
    ] = None,
    sort: Annotated[
        str | None, opt.option("OUTCOME", "With --study: the outcome (default: primary).")
    ] = None,
    world: opt.World = None,
    results: opt.Results = opt.HERE,
) -> Result:
    """List the stored runs: status, steps, seed, and which studies hold them.

    With --study, list the runs of one study, the best first.
    """
    from pneuma.store.index import RunIndex

    if study is not None:
        return _ranked(opt.RunFilter(world=world, results=results).open(study), sort)
    if sort is not None:
        raise UserError("--sort requires --study")
    index = RunIndex(Store(results))
    labels, here = _labels(index), index.frame[index.frame["where"] == ""]
    here = here.rename(columns={"end": "step"})[["run_id", "status", "step", "seed"]]
    runs = [{**run, "studies": labels.get(run["run_id"], [])} for run in rows_of(here)]
    rows = []
    for run in runs:
        studies = ", ".join(f"{label['study']}/{_condition(label)}" for label in run["studies"])
        amount = f"{run['step']:>12,} steps", f"seed {run['seed']}"
        rows.append((run["run_id"], run["status"], *amount, studies or "of no study"))
    nothing = f"No run is stored in {results} yet."
    return Result({"runs": runs}, [Table([""] * 5, rows) if rows else nothing])


def _ranked(data: StudyData, sort: str | None) -> Result:
    from pneuma.analysis.outcomes import primary
    from pneuma.analysis.ranking import ranked_runs

    name = sort or primary(data)
    runs = rows_of(ranked_runs(data, name))
    rows = [(run["run_id"], run["condition"], f"seed {run['seed']}", f"{run['value']:.4g}") for run in runs]
    return Result({"outcome": name, "runs": runs}, [Table(("run", "condition", "", name), rows)])


def _labels(index: RunIndex) -> dict[str, list[dict[str, Any]]]:
    """Return the studies, worlds and conditions of each run in the results folder, by its id."""
    from pneuma.analysis.runs import studies_here

    found: dict[str, list[dict[str, Any]]] = {}
    for data in studies_here(index):
        about: dict[str, Any] = {"study": data.study.name}
        about |= {"world": data.study.world} if data.study.path else {}
        about |= {"settings": dict(data.study.settings)} if data.study.settings else {}
        for run in data.runs.to_dict("records"):
            label = {**about, "condition": run["condition"], "seed": run["seed"]}
            found.setdefault(run["run_id"], []).append(label)
    return found


def _condition(label: Mapping[str, Any]) -> str:
    """Return a condition with the fields that were changed, unless its name tells them."""
    settings, condition = label.get("settings", {}), label["condition"]
    changed = {key: value for key, value in settings.items() if f"{key}=" not in condition}
    return condition + (f" with {shown_settings(changed)}" if changed else "")


@app.command(short_help="Show what produced a stored run.")
def show(
    name: opt.RunId,
    all_: Annotated[bool, opt.flag("--all", "Show every field, defaults too.")] = False,
    results: opt.Results = opt.HERE,
) -> Result:
    """Show what produced a stored run: configuration, machine, packages, time, files."""
    store = Store(results)
    run_id = find_run(store, name)
    status, settings = store.status(run_id), stored_settings(store, run_id)
    from pneuma.store.index import RunIndex

    held = _labels(RunIndex(store)).get(run_id, [])
    usual = default_settings(settings)
    differing = {key: value for key, value in settings.items() if value != usual.get(key)}
    provenance = store.read_document(run_id, "provenance.json")
    defaults, files = {key: usual.get(key) for key in differing}, run_files(store, run_id)

    def shown() -> Iterator[str | Table]:
        detail = f" ({status.detail})" if status.detail else ""
        yield f"run {run_id}: {status.name}{detail}, {status.step:,} steps trained"
        for study in held:
            yield f"study {study['study']}, condition {_condition(study)}, seed {study['seed']}"
        yield ""
        yield "Fields" if all_ else "Fields that are not at their defaults (--all shows the others)"
        for key, value in (settings if all_ else differing).items():
            default = f"   (default {shown_value(defaults[key])})" if key in defaults else ""
            yield f"  {key} = {shown_value(value)}{default}"
        yield ""
        yield "Provenance" + ("" if provenance else ": none, or damaged; it is written when a run has ended")
        yield from _provenance_lines(provenance)
        yield ""
        yield "Files"
        rows = [(f"  {file['name']}", f"{file['bytes']:>12,} bytes", file["state"]) for file in files]
        yield Table([""] * 3, rows)

    head = {"run_id": run_id, "status": status.name, "step": status.step, "studies": held}
    about = {"settings": settings, "defaults": defaults, "provenance": provenance}
    return Result({**head, **about, "files": files}, shown())


def _provenance_lines(provenance: Mapping[str, Any]) -> Iterator[str]:
    for key, value in provenance.items():
        if isinstance(value, dict):
            value = ", ".join(f"{name} {version}" for name, version in value.items())
        if key == "attempts" and isinstance(value, list):
            value = f"{len(value)} (--json tells the machine of each)"
        yield f"  {key:<12} {shown_value(value)}"


# --- export ----------------------------------------------------------------------------------------


@app.command(short_help="Write a run's final policy for other programs.")
def export(
    name: opt.RunId,
    out: Annotated[Path, opt.option("FILE", "A .zip for Stable-Baselines3.")],
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
