"""`pneuma run …`: list stored runs, show what produced one, and export its policy."""

from __future__ import annotations

import json as json_module
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Annotated, Any

import typer

from pneuma.algorithms import TABULAR
from pneuma.cli.fork import fork
from pneuma.cli.options import Json, Results, print_json, read_path
from pneuma.cli.out_files import check_file, write_file
from pneuma.cli.plain_text import plain
from pneuma.config import EnvConfig, Run, make_run
from pneuma.errors import UserError
from pneuma.study import stored_runs
from pneuma.study.origins import stored_origins, unusual_origins
from pneuma.study.store import Store
from pneuma.study.stored_runs import Holder, StoredRun
from pneuma.values import shown_value

app = typer.Typer(
    help="Look at single runs and take them along.", no_args_is_help=True, rich_markup_mode=None
)

app.command("fork", short_help="Go on from a checkpoint with something changed.")(fork)

RESULTS = Path("results")
EXPORTS = (".zip", ".onnx")

GROUPS: dict[str, tuple[str, ...]] = {
    "environment": ("env", *(field.name for field in fields(EnvConfig)), "action_slip", "reward_noise"),
    "budget": ("engine", "algorithm", "seed", "steps", "slots", "evaluation_episodes"),
    "network": ("actor", "critic", "activation"),
    "optimizer": (
        *("optimizer", "learning_rate", "betas", "epsilon", "momentum", "dampening", "smoothing"),
        *("utility_decay", "noise", "weight_decay", "gradient_limit", "clip"),
    ),
    "action values": (
        *("exploration", "exploration_fraction", "buffer_size", "learning_starts", "train_every"),
        *("gradient_steps", "target_every"),
    ),
    "fork": ("parent", "fork_step", "fork_reset"),
    "learner": (),
}
"""Settings of a run as they are shown together; what is in no other group belongs to the last."""

RunName = Annotated[
    str, typer.Argument(metavar="RUN_ID", help="A stored run's id, or its first digits (4 at least).")
]


@app.command("list", short_help="List the stored runs.")
def list_(results: Results = RESULTS, json: Json = False) -> None:
    """List the stored runs: status, steps, seed, and which studies hold them."""
    runs = stored_runs.list_runs(Store(results))
    if json:
        rows = [
            {"run_id": run.run_id, **_standing(run.status), "seed": run.seed, "studies": _rows(run.holders)}
            for run in runs
        ]
        return print_json({"schema": 1, "runs": rows})
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
    all_: Annotated[bool, typer.Option("--all", help="Show every setting, defaults too.")] = False,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Show what produced a stored run: configuration, machine, packages, time, files."""
    store = Store(results)
    run = stored_runs.stored_run(store, stored_runs.find_run(store, name))
    usual = stored_runs.default_settings(run.settings)
    differing = {key: value for key, value in run.settings.items() if value != usual.get(key)}
    if json:
        return print_json(_document(run, {key: usual.get(key) for key in differing}))
    detail = f" ({plain(run.status.detail)})" if run.status.detail else ""
    print(f"run {run.run_id}: {plain(run.status.name)}{detail}, {run.status.step:,} steps trained")
    for held in run.holders:
        print(f"study {plain(held.study)}, condition {plain(held.condition)}, seed {held.seed}")
    _print_settings(run.settings, differing, usual, all_)
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
    player: Annotated[
        int | None, typer.Option("--player", min=0, help="Whose, where each player has its own policy.")
    ] = None,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Write a run's final policy for Stable-Baselines3 (.zip) or as ONNX (.onnx)."""
    check_file(out, EXPORTS)
    store = Store(results)
    run = stored_runs.stored_run(store, stored_runs.find_run(store, name))
    data, note = _exported(store, run, out.suffix.lower(), trust, player)
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


def _exported(
    store: Store, run: StoredRun, suffix: str, trust: bool, player: int | None
) -> tuple[bytes, str]:
    """Return the file's contents, and what a person should know about them."""
    if not run.status.finished:
        raise UserError(f"run {run.run_id} is {plain(run.status.name)}: it has no final policy to export")
    data = store.read_file(run.run_id, _policy_file(run, player))
    from pneuma.engines import export as exports
    from pneuma.engines.policy import read_sound_policy

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


def _policy_file(run: StoredRun, player: int | None) -> str:
    """Return the name of the file of the policy meant."""
    from pneuma.engines.team import policy_names

    names = policy_names([file.name for file in run.files])
    if not names:
        raise UserError(f"run {run.run_id} {plain(run.status.name)}: it left no policy to export")
    if len(names) == 1:
        if player is not None:
            raise UserError(f"--player {player}: all players of run {run.run_id} share one policy")
        return names[0]
    if player is None or player >= len(names):
        given = "each player has its own policy" if player is None else f"there is no player {player}"
        raise UserError(f"run {run.run_id}: {given}; choose --player 0 to {len(names) - 1}")
    return names[player]


def _resolved(run: StoredRun) -> Run:
    if not run.settings:
        raise UserError("run.json: holds no configuration")
    return make_run(run.settings)


# --- Showing ---------------------------------------------------------------------------------------


def _print_settings(
    settings: Mapping[str, Any], differing: Mapping[str, Any], usual: Mapping[str, Any], all_: bool
) -> None:
    """Print the settings in groups: those that differ from the defaults, then on demand the others."""
    if not settings:
        print("\nIts configuration is missing or damaged.")
        return
    print("\nSettings that are not the environment's and optimizer's defaults")
    for group, key in _grouped(differing):
        print(f"  {group:<12} {plain(key)} = {_value(settings[key])}   (default {_value(usual.get(key))})")
    if not differing:
        print("  none")
    if not all_:
        print("  (--all shows the others)")
        return
    print("\nSettings at their defaults")
    for group, key in _grouped({key: value for key, value in settings.items() if key not in differing}):
        print(f"  {group:<12} {plain(key)} = {_value(settings[key])}")


def _grouped(settings: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Return (group, key) of settings, in the groups' order; the group is told once."""
    named = {key for keys in GROUPS.values() for key in keys}
    ordered = [(group, key) for group, keys in GROUPS.items() for key in keys if key in settings]
    ordered += [(next(reversed(GROUPS)), key) for key in settings if key not in named]
    told = ["", *(group for group, _ in ordered)]
    return [
        ("" if group == before else group, key) for (group, key), before in zip(ordered, told, strict=False)
    ]


def _print_provenance(run: StoredRun) -> None:
    about = run.provenance
    if about:
        print("\nProvenance")
    elif run.status.finished or run.status.name == "damaged":
        print("\nIts provenance is missing or damaged.")
    else:
        print("\nNo provenance: it is written when a run has ended.")
    rows = {
        "imported": about.get("imported"),
        "started": about.get("started"),
        "wall time": f"{about['wall_seconds']} s" if "wall_seconds" in about else None,
        "commit": about.get("commit"),
        "machine": _machine(about),
        "python": about.get("python"),
        "packages": _pairs(about.get("packages")),
    }
    for key, value in rows.items():
        if value is not None:
            print(f"  {key:<10} {_value(value)}")
    for resume in run.resumes:
        differences = resume.get("differences") or []
        flag = "as before" if not differences else "NOT as before, its bits could differ: "
        where = f"at step {_value(resume.get('step'))}, {_value(resume.get('at'))}"
        print(f"  resumed    {where}: {flag}{_several(differences)}")


def _unlike_most(store: Store, run: StoredRun) -> dict[str, str]:
    """Return, by each study that holds a run, in what it was trained otherwise than most of that study."""
    found = {}
    for study in dict.fromkeys(held.study for held in run.holders):
        runs = (store.selection(study) or {"runs": []})["runs"]
        marks = unusual_origins(stored_origins(store, (each["run_id"] for each in runs)))
        if run.run_id in marks:
            found[study] = marks[run.run_id]
    return found


def _machine(about: Mapping[str, Any]) -> str | None:
    parts = [str(about[key]) for key in ("system", "cpu") if about.get(key)]
    parts += [f"{about['cores']} cores"] if about.get("cores") else []
    parts += (
        [f"{about['threads']} thread" + ("s" if about["threads"] != 1 else "")] if "threads" in about else []
    )
    return ", ".join(parts) or None


def _pairs(packages: object) -> str | None:
    if not isinstance(packages, dict):
        return None
    return ", ".join(f"{name} {version}" for name, version in packages.items())


def _several(differences: object) -> str:
    rows = differences if isinstance(differences, list) else [differences]
    return "; ".join(_value(row) for row in rows)


def _document(run: StoredRun, defaults: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "schema": 1,
        "run_id": run.run_id,
        **_standing(run.status),
        "seed": run.settings.get("seed"),
        "studies": _rows(run.holders),
        "settings": dict(run.settings),
        "defaults": dict(defaults),
        "provenance": dict(run.provenance),
        "resumed_elsewhere": any(resume.get("differences") for resume in run.resumes),
        "files": [{"name": f.name, "bytes": f.size_bytes, "state": f.state} for f in run.files],
    }


def _standing(status: Any) -> dict[str, Any]:
    return {"status": status.name, "step": status.step}


def _rows(held: tuple[Holder, ...]) -> list[dict[str, Any]]:
    return [asdict(holder) for holder in held]


def _value(value: object) -> str:
    """Write a value for people."""
    return plain(json_module.dumps(value) if isinstance(value, dict) else shown_value(value))
