"""`pneuma run …`: list stored runs, show what produced one, fork it, and export its policy."""

from __future__ import annotations

import json as json_module
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

import typer

from pneuma.algorithms import TABULAR
from pneuma.cli import options as opt
from pneuma.cli.output import check_file, print_json, print_table, write_file
from pneuma.cli.study_run import train
from pneuma.config import FORK_RESETS, make_run
from pneuma.errors import UserError, plain
from pneuma.study import stored_runs
from pneuma.study.executors.base import Supervision
from pneuma.study.fork import Change, plan_fork
from pneuma.study.store import Store
from pneuma.study.stored_runs import StoredRun
from pneuma.values import shown_value

app = typer.Typer(
    help="Look at single runs and take them along.", no_args_is_help=True, rich_markup_mode=None
)


@app.command("list", short_help="List the stored runs.")
def list_(results: opt.Results = opt.RESULTS, json: opt.Json = False) -> None:
    """List the stored runs: status, steps, seed, and which studies hold them."""
    runs = stored_runs.list_runs(Store(results))
    if json:
        return print_json({"schema": 1, "runs": [_row(run, run.seed) for run in runs]})
    if not runs:
        none = "" if results.is_dir() else ": there is no such folder"
        print(f"No run is stored in {results} yet{none}.")
    rows = []
    for run in runs:
        held = ", ".join(f"{own.study}/{own.condition}" for own in run.holders) or "of no study"
        seed = "?" if run.seed is None else run.seed
        rows.append((run.run_id, run.status.name, f"{run.status.step:>12,} steps", f"seed {seed}", held))
    print_table([""] * 5, rows)
    return None


@app.command(short_help="Show what produced a stored run.")
def show(
    name: opt.RunName,
    all_: Annotated[bool, opt.flag("--all", "Show every field, defaults too.")] = False,
    results: opt.Results = opt.RESULTS,
    json: opt.Json = False,
) -> None:
    """Show what produced a stored run: configuration, machine, packages, time, files."""
    store = Store(results)
    run = stored_runs.stored_run(store, stored_runs.find_run(store, name))
    usual = stored_runs.default_settings(run.settings)
    if json:
        document = {
            "settings": dict(run.settings),
            "defaults": {key: usual.get(key) for key in run.settings if run.settings[key] != usual.get(key)},
            "provenance": dict(run.provenance),
            "files": [{"name": f.name, "bytes": f.size_bytes, "state": f.state} for f in run.files],
        }
        return print_json({"schema": 1, **_row(run, run.settings.get("seed")), **document})
    detail = f" ({plain(run.status.detail)})" if run.status.detail else ""
    print(f"run {run.run_id}: {plain(run.status.name)}{detail}, {run.status.step:,} steps trained")
    for held in run.holders:
        print(f"study {plain(held.study)}, condition {plain(held.condition)}, seed {held.seed}")
    _print_fields(run, usual, all_)
    _print_provenance(run)
    print("\nFiles")
    print_table([""] * 3, [(f"  {f.name}", f"{f.size_bytes:>12,} bytes", f.state) for f in run.files])
    return None


@app.command(short_help="Go on from a checkpoint with something changed.")
def fork(
    name: opt.RunName,
    at: Annotated[str, opt.option("--at", "STEP", "Go on from the checkpoint nearest before this step.")],
    set_: opt.Settings = None,
    reset: Annotated[
        str, opt.option("--reset", "|".join(FORK_RESETS), "What to begin anew at the fork.")
    ] = "",
    seeds: opt.OwnSeeds = "3",
    workers: opt.Workers = None,
    trust: opt.Trust = False,
    results: opt.Results = opt.RESULTS,
    json: opt.Json = False,
    quiet: opt.Quiet = False,
) -> int:
    """Go on from a run's checkpoint with something changed, and without: fresh random streams for each seed.

    The fork is a study of its own, of the conditions `control` and what was changed: `status`, `plot` and
    `export` take its name.
    """
    store, change = Store(results), Change(opt.read_settings_options(set_), reset)
    parent, step = stored_runs.find_run(store, name), opt.read_count("--at", at)
    plan = plan_fork(store, parent, step, change, opt.read_seeds_option(seeds), trust)
    plan = replace(plan, notes=tuple(map(plain, plan.notes)))
    how = Supervision(workers=opt.read_workers(workers))
    return train(plan, store, how, retry_failed=True, json=json, quiet=quiet)


# --- export ----------------------------------------------------------------------------------------


@app.command(short_help="Write a run's final policy for other programs.")
def export(
    name: opt.RunName,
    out: Annotated[Path, opt.path_option("--out", "FILE", "A .zip for Stable-Baselines3, or an .onnx.")],
    trust: opt.Trust = False,
    results: opt.Results = opt.RESULTS,
    json: opt.Json = False,
) -> None:
    """Write a run's final policy for Stable-Baselines3 (.zip) or as ONNX (.onnx)."""
    check_file(out, (".zip", ".onnx"))
    store = Store(results)
    run = stored_runs.stored_run(store, stored_runs.find_run(store, name))
    data, note = _exported(store, run, out.suffix.lower(), trust)
    write_file(out, data)
    if json:
        return print_json(
            {"schema": 1, "run_id": run.run_id, "file": str(out), "bytes": len(data), "note": note}
        )
    if note:
        print(f"Note: {note}.")
    print(f"wrote {out}: {len(data):,} bytes, the policy of run {run.run_id} after {run.status.step:,} steps")
    return None


def _exported(store: Store, run: StoredRun, suffix: str, trust: bool) -> tuple[bytes, str]:
    """Return the file's contents, and what a person should know about them."""
    from pneuma.engines import export as exports
    from pneuma.engines.policy import POLICY_FILE, read_sound_policy

    if not run.status.finished:
        raise UserError(f"run {run.run_id} is {plain(run.status.name)}: it has no final policy to export")
    if POLICY_FILE not in [file.name for file in run.files]:
        raise UserError(f"run {run.run_id} {plain(run.status.name)}: it left no policy to export")
    if not run.settings:
        raise UserError(f"run {run.run_id}: run.json: holds no configuration")
    try:
        settings, policy = make_run(run.settings), read_sound_policy(store.read_file(run.run_id, POLICY_FILE))
    except UserError as error:
        raise UserError(f"run {run.run_id}: {error}") from None
    if suffix == ".onnx":
        about = {"run_id": run.run_id, "env": settings.env}
        if settings.algorithm not in TABULAR:
            about["observation"] = settings.observation
        return exports.to_onnx(policy, about), ""
    space = exports.observation_space(policy, settings, trust)
    bounded = trust or exports.reads_only_shipped_files(settings)
    note = (
        "the run names level or characters files of its own, which were not opened: the observation "
        "space in the file has no bounds, so load it without env=, or export again with --trust"
    )
    return exports.to_sb3(policy, settings, space), "" if bounded else note


# --- Showing ---------------------------------------------------------------------------------------


def _print_fields(run: StoredRun, usual: Mapping[str, Any], all_: bool) -> None:
    """Print the fields that are not as usual, then on demand the others."""
    if not run.settings:
        print("\nIts configuration is missing or damaged.")
        return
    differing = {key: value for key, value in run.settings.items() if value != usual.get(key)}
    print("\nFields that are not the environment's and optimizer's defaults")
    for key, value in differing.items():
        print(f"  {plain(key)} = {_value(value)}   (default {_value(usual.get(key))})")
    print("\nFields at their defaults" if all_ else "  (--all shows the others)")
    for key, value in run.settings.items():
        if all_ and key not in differing:
            print(f"  {plain(key)} = {_value(value)}")


def _print_provenance(run: StoredRun) -> None:
    about = run.provenance
    if about:
        print("\nProvenance")
    elif run.status.finished or run.status.name == "damaged":
        print("\nIts provenance is missing or damaged.")
    else:
        print("\nNo provenance: it is written when a run has ended.")
    for key, value in about.items():
        if isinstance(value, dict):
            value = ", ".join(f"{name} {own}" for name, own in value.items())
        if key == "attempts" and isinstance(value, list):
            value = f"{len(value)} (--json tells the machine of each)"
        print(f"  {plain(key):<12} {_value(value)}")


def _row(run: StoredRun, seed: Any) -> dict[str, Any]:
    """Return what `list` and `show` say of a run, as JSON has it."""
    status, studies = run.status, [asdict(holder) for holder in run.holders]
    return {
        "run_id": run.run_id, "status": status.name, "step": status.step, "seed": seed, "studies": studies,
    }  # fmt: skip


def _value(value: object) -> str:
    """Write a value for people."""
    return plain(json_module.dumps(value) if isinstance(value, dict) else shown_value(value))
