"""`pneuma run …`: list stored runs, show what produced one, and export its policy."""

from __future__ import annotations

import json as json_module
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from pneuma.algorithms import TABULAR
from pneuma.cli.fork import fork
from pneuma.cli.options import Json, Results, print_json, read_path
from pneuma.cli.out_files import check_file, write_file
from pneuma.cli.plain_text import plain
from pneuma.config import Run, make_run
from pneuma.errors import UserError
from pneuma.study import stored_runs
from pneuma.study.provenance import stored_origins, unusual_origins
from pneuma.study.store import Store
from pneuma.study.stored_runs import ListedRun, StoredRun
from pneuma.values import shown_value

app = typer.Typer(
    help="Look at single runs and take them along.", no_args_is_help=True, rich_markup_mode=None
)

app.command("fork", short_help="Go on from a checkpoint with something changed.")(fork)

RESULTS = Path("results")
EXPORTS = (".zip", ".onnx")

RunName = Annotated[
    str, typer.Argument(metavar="RUN_ID", help="A stored run's id, or its first digits (4 at least).")
]


@app.command("list", short_help="List the stored runs.")
def list_(results: Results = RESULTS, json: Json = False) -> None:
    """List the stored runs: status, steps, seed, and which studies hold them."""
    runs = stored_runs.list_runs(Store(results))
    if json:
        return print_json({"schema": 1, "runs": [_row(run, run.seed) for run in runs]})
    if not runs:
        none = "" if results.is_dir() else ": there is no such folder"
        print(f"No run is stored in {results} yet{none}.")
    for run in runs:
        held = ", ".join(f"{plain(h.study)}/{plain(h.condition)}" for h in run.holders) or "of no study"
        seed = "?" if run.seed is None else run.seed
        step = f"{run.status.step:>12,} steps"
        print(f"{run.run_id:<16}  {plain(run.status.name):<9} {step}  seed {seed:<6} {held}")
    return None


@app.command(short_help="Show what produced a stored run.")
def show(
    name: RunName,
    all_: Annotated[bool, typer.Option("--all", help="Show every field, defaults too.")] = False,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Show what produced a stored run: configuration, machine, packages, time, files."""
    store = Store(results)
    run = stored_runs.stored_run(store, stored_runs.find_run(store, name))
    usual = stored_runs.default_settings(run.settings)
    if json:
        resumed = any(resume.get("differences") for resume in run.resumes)
        document = {
            "settings": dict(run.settings),
            "defaults": {key: usual.get(key) for key in run.settings if run.settings[key] != usual.get(key)},
            "provenance": dict(run.provenance),
            "resumed_elsewhere": resumed,
            "files": [{"name": f.name, "bytes": f.size_bytes, "state": f.state} for f in run.files],
        }
        return print_json({"schema": 1, **_row(run, run.settings.get("seed")), **document})
    detail = f" ({plain(run.status.detail)})" if run.status.detail else ""
    print(f"run {run.run_id}: {plain(run.status.name)}{detail}, {run.status.step:,} steps trained")
    for held in run.holders:
        print(f"study {plain(held.study)}, condition {plain(held.condition)}, seed {held.seed}")
    _print_fields(run, usual, all_)
    _print_provenance(run)
    for study, word in _unlike_most(store, run).items():
        print(f"  unlike     {word} than most runs of study {plain(study)}: its bits could differ")
    print("\nFiles")
    for file in run.files:
        print(f"  {plain(file.name):<24} {file.size_bytes:>12,} bytes  {file.state}")
    return None


@app.command(short_help="Write a run's final policy for other programs.")
def export(
    name: RunName,
    out: Annotated[
        Path,
        typer.Option(
            "--out", metavar="FILE", parser=read_path, help="A .zip for Stable-Baselines3, or an .onnx."
        ),
    ],
    trust: Annotated[
        bool, typer.Option("--trust", help="Open the run's own level and characters files, for its bounds.")
    ] = False,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Write a run's final policy for Stable-Baselines3 (.zip) or as ONNX (.onnx)."""
    check_file(out, EXPORTS)
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


# --- Export ----------------------------------------------------------------------------------------


def _exported(store: Store, run: StoredRun, suffix: str, trust: bool) -> tuple[bytes, str]:
    """Return the file's contents, and what a person should know about them."""
    if not run.status.finished:
        raise UserError(f"run {run.run_id} is {plain(run.status.name)}: it has no final policy to export")
    from pneuma.engines import export as exports
    from pneuma.engines.policy import POLICY_FILE, read_sound_policy

    if POLICY_FILE not in [file.name for file in run.files]:
        raise UserError(f"run {run.run_id} {plain(run.status.name)}: it left no policy to export")
    data = store.read_file(run.run_id, POLICY_FILE)

    try:
        settings, policy = _resolved(run), read_sound_policy(data)
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


def _resolved(run: StoredRun) -> Run:
    if not run.settings:
        raise UserError("run.json: holds no configuration")
    return make_run(run.settings)


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
        if key not in ("resumes", "attempts"):
            print(f"  {plain(key):<12} {_value(value)}")
    for resume in run.resumes:
        differences = resume.get("differences") or []
        same = f"NOT as before, its bits could differ: {_value(differences)}" if differences else "as before"
        print(f"  resumed      at step {_value(resume.get('step'))}, {_value(resume.get('at'))}: {same}")


def _unlike_most(store: Store, run: StoredRun) -> dict[str, str]:
    """Return, by each study that holds a run, in what it was trained otherwise than most of that study."""
    found = {}
    for study in dict.fromkeys(held.study for held in run.holders):
        runs = (store.selection(study) or {"runs": []})["runs"]
        marks = unusual_origins(stored_origins(store, (each["run_id"] for each in runs)))
        if run.run_id in marks:
            found[study] = marks[run.run_id]
    return found


def _row(run: StoredRun | ListedRun, seed: Any) -> dict[str, Any]:
    """Return what `list` and `show` say of a run, as JSON has it."""
    status, studies = run.status, [asdict(holder) for holder in run.holders]
    return {
        "run_id": run.run_id, "status": status.name, "step": status.step, "seed": seed, "studies": studies,
    }  # fmt: skip


def _value(value: object) -> str:
    """Write a value for people."""
    return plain(json_module.dumps(value) if isinstance(value, dict) else shown_value(value))
