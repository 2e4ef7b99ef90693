"""Fork a run: go on from one of its checkpoints with one thing changed, beside a control without.

run, step and change → Plan of two conditions × fork seeds, each a run like any other
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from pneuma.config import FORK_RESETS, FORK_SETTINGS, Run, as_settings, make_run, read_setting
from pneuma.errors import UserError, unknown_name
from pneuma.study.identity import run_id
from pneuma.study.plan import Cell, Plan, Selection
from pneuma.study.spec import Study
from pneuma.study.store import Store

CONTROL = "control"
FIXED = (
    "env", "engine", "algorithm", "level", "random_levels", "players", "classes", "magic", "observation",
    "perceive", "slots", "horizon", "actor", "critic", "seed",
)  # fmt: skip
"""Settings that a checkpoint's arrays or steps hang on, so that a fork cannot change them."""


def plan_fork(
    store: Store, parent: str, at: int, settings: Mapping[str, Any], reset: str, seeds: Sequence[int]
) -> Plan:
    """Plan a fork from the parent's checkpoint nearest before `at`, and its control.

    Args:
        store: where the parent is.
        parent: its run id.
        at: agent steps.
        settings: fields of the run to change.
        reset: one of `FORK_RESETS`, or empty.
        seeds: of the fork: each begins fresh random streams.

    Raises:
        UserError: for a parent without such a checkpoint, or a change that is none or cannot be made.
    """
    whole = _parent_run(store, parent)
    step = _checkpoint_step(store, parent, at)
    changes = {**_changes(whole, settings), **({"fork_reset": _reset(reset)} if reset else {})}
    if not changes:
        raise UserError("nothing is changed: give --set KEY=VALUE or --reset")
    base = {**as_settings(whole), "parent": parent, "fork_step": step}
    changed = _forked(base, changes)
    name = ", ".join(
        [f"{key}={_shown(value)}" for key, value in settings.items()] + ([f"reset {reset}"] if reset else [])
    )
    conditions = {CONTROL: make_run(base), name: changed}
    cells = tuple(
        Cell(condition, seed, own, run_id(own))
        for seed in seeds
        for condition, run in conditions.items()
        for own in [replace(run, seed=seed)]
    )
    study = Study(
        name=f"fork-{parent[:8]}-{step}-{run_id(changed)[:4]}",
        path=None,
        title=f"Run {parent[:8]} from step {step:,}",
        section="",
        about=f"{name} from step {step:,} on, beside an unchanged control.",
        figure=f"fork-{parent[:8]}-{step}-{run_id(changed)[:4]}",
        baseline=CONTROL,
        base="",
        shared={},
        conditions={CONTROL: {}, name: changes},
    )
    return Plan(
        study, Selection(seeds=tuple(seeds)), cells, (), (f"forked at step {step:,} of {whole.steps:,}",)
    )


def _parent_run(store: Store, parent: str) -> Run:
    status = store.status(parent)
    if not status.finished:
        raise UserError(f"run {parent} is {status.name}: only a finished run can be forked")
    document = json.loads(store.read_file(parent, "run.json"))
    run = make_run(document["run"])
    if run_id(run) != parent:
        raise UserError(
            f"run {parent} was trained by other rules or another engine, or its own files have changed: "
            "a fork would not go on from where it stood"
        )
    return run


def _checkpoint_step(store: Store, parent: str, at: int) -> int:
    """Return the step of the parent's checkpoint nearest before `at`."""
    from pneuma.study.checkpoints import checkpoint_files

    steps = sorted(file.step for file in checkpoint_files(store.run_folder(parent)))
    if not steps:
        raise UserError(
            f"run {parent} kept no checkpoints: put keep_checkpoints = 20 at the top of its study's file, "
            f"remove {store.run_folder(parent)} and run the study again; it ends with the same bits"
        )
    if steps[0] > at:
        raise UserError(f"--at {at}: the first checkpoint of run {parent} is at step {steps[0]}")
    return max(step for step in steps if step <= at)


def _changes(run: Run, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Check what is to be changed."""
    for key in settings:
        if key in (*FIXED, *FORK_SETTINGS):
            raise UserError(f"--set {key}: cannot change at a fork, because the checkpoint hangs on it")
    read = {key: read_setting(Run, key, value) for key, value in settings.items()}
    for key, value in read.items():
        if getattr(run, key) == value:
            raise UserError(f"--set {key}: is {_shown(value)} in run {run_id(run)} already")
    return read


def _forked(base: Mapping[str, Any], changes: Mapping[str, Any]) -> Run:
    """Return the changed run; an optimizer of another kind has other settings and needs a reset."""
    other = changes.get("optimizer", base["optimizer"]) != base["optimizer"]
    if other and changes.get("fork_reset") != "optimizer":
        raise UserError("--set optimizer: another optimizer needs --reset optimizer")
    own = ("betas", "epsilon", "momentum", "dampening", "smoothing") if other else ()
    return make_run({**base, **dict.fromkeys(own), **changes})


def _reset(name: str) -> str:
    if name not in FORK_RESETS:
        raise unknown_name("reset", name, FORK_RESETS)
    return name


def _shown(value: object) -> str:
    return "none" if value is None else str(value)
