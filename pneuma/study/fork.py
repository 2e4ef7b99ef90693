"""Fork a run: go on from one of its checkpoints with one thing changed, beside a control without.

run, step and change → Plan of two conditions × fork seeds, each a run like any other
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

from pneuma.config import (
    ENGINES,
    FORK_FIELDS,
    FORK_RESETS,
    OPTIMIZER_FIELDS,
    EnvConfig,
    Run,
    as_fields,
    beyond_engine,
    make_run,
    read_field,
)
from pneuma.errors import UserError, unknown_name
from pneuma.study.identity import run_id
from pneuma.study.plan import Cell, Plan, Selection
from pneuma.study.provenance import differences
from pneuma.study.spec import Study
from pneuma.study.store import Store
from pneuma.study.stored_runs import read_document, stored_settings
from pneuma.study.trust import own_things

CONTROL = "control"
FIXED = (
    "env", "engine", "algorithm", "level", "random_levels", "players", "classes", "characters", "weapons",
    "magic", "observation", "observe_facing", "perceive", "slots", "learners", "horizon", "actor",
    "critic", "buffer_size", "learning_starts", "seed",
)  # fmt: skip
"""Settings that a checkpoint's arrays or steps hang on, so that a fork cannot change them."""
OF_TRANSITIONS = tuple(own.name for own in fields(EnvConfig))
"""Settings by which transitions in a replay buffer were made."""


def plan_fork(
    store: Store,
    parent: str,
    at: int,
    settings: Mapping[str, Any],
    reset: str,
    seeds: Sequence[int],
    trust: bool = False,
) -> Plan:
    """Plan a fork from the parent's checkpoint nearest before `at`, and its control.

    Args:
        store: where the parent is.
        parent: its run id.
        at: agent steps.
        settings: fields of the run to change.
        reset: one of `FORK_RESETS`, or empty.
        seeds: of the fork: each begins fresh random streams.
        trust: whether what the stored run names of its owner's may be imported and read.

    Raises:
        UserError: for a parent without such a checkpoint, or a change that is none or cannot be made.
    """
    whole, control = control_run(store, parent, at, trust)
    step, changed = control.fork_step, changed_run(whole, control, settings, reset)
    changes = {**settings, **({"fork_reset": reset} if reset else {})}
    name = ", ".join(
        [f"{key}={_shown(value)}" for key, value in settings.items()] + ([f"reset {reset}"] if reset else [])
    )
    cells = tuple(
        Cell(condition, seed, own, run_id(own))
        for seed in seeds
        for condition, run in ((CONTROL, control), (name, changed))
        for own in [replace(run, seed=seed)]
    )
    study = _study(parent, step, run_id(changed)[:4], name, changes)
    notes = (f"forked at step {step:,} of {whole.steps:,}", *elsewhere(store, parent))
    return Plan(study, Selection(seeds=tuple(seeds)), cells, (), notes)


def control_run(store: Store, parent: str, at: int, trust: bool = False) -> tuple[Run, Run]:
    """Return a parent, and its fork from the checkpoint nearest before `at` with nothing changed.

    Raises:
        UserError: for a parent without such a checkpoint, or one that must not or cannot be forked.
    """
    whole = _parent_run(store, parent, trust)
    step = _checkpoint_step(store, parent, at, whole)
    return whole, make_run({**as_fields(whole), "parent": parent, "fork_step": step, "fork_reset": ""})


def changed_run(whole: Run, control: Run, settings: Mapping[str, Any], reset: str) -> Run:
    """Return a fork with settings changed, and what is begun anew, beside its control.

    Raises:
        UserError: for a change that is none or cannot be made.
    """
    changes = {**_changes(whole, settings), **({"fork_reset": _reset(reset)} if reset else {})}
    if not changes:
        raise UserError("nothing is changed: give --set KEY=VALUE or --reset")
    if reset == "optimizer" and not settings and whole.optimizer == "sgd" and not whole.momentum:
        raise UserError("--reset optimizer: changes nothing, because SGD without momentum keeps nothing")
    changed = _forked(as_fields(control), changes)
    if settings and replace(changed, fork_reset="") == control:
        raise UserError(f"--set {', '.join(settings)}: changes nothing, because nothing in this run reads it")
    return changed


def _study(parent: str, step: int, digits: str, name: str, changes: Mapping[str, Any]) -> Study:
    return Study(
        name=f"fork-{parent[:8]}-{step}-{digits}",
        path=None,
        title=f"Run {parent[:8]} from step {step:,}",
        section="",
        about=f"{name} from step {step:,} on, beside an unchanged control.",
        figure=f"fork-{parent[:8]}-{step}-{digits}",
        baseline=CONTROL,
        base="",
        shared={},
        conditions={CONTROL: {}, name: changes},
    )


def _parent_run(store: Store, parent: str, trust: bool) -> Run:
    """Return the run that is to be forked; nothing that it names is touched unless it is trusted."""
    status = store.status(parent)
    if not status.finished:
        raise UserError(f"run {parent} is {status.name}: only a finished run can be forked")
    settings = stored_settings(store, parent)
    if not settings:
        raise UserError(f"run {parent}: its run.json holds no configuration")
    own = own_things(settings)
    if own and not trust:
        raise UserError(f"run {parent}: a fork would {' and '.join(own.values())}; --trust allows it")
    run = make_run(settings)
    if run_id(run) != parent:
        raise UserError(
            f"run {parent} was trained by other rules or another engine, or its own files have changed: "
            "a fork would not go on from where it stood"
        )
    return run


def elsewhere(store: Store, parent: str) -> list[str]:
    """Say in what this machine differs from the one that trained the parent."""
    earlier = read_document(store, parent, "provenance.json")
    changed = differences(earlier, but="device") if earlier else []  # this process computes on none
    if not changed:
        return []
    return [f"the parent was trained with another {', '.join(changed)}: what follows may have other bits"]


def _checkpoint_step(store: Store, parent: str, at: int, whole: Run) -> int:
    """Return the step of the parent's checkpoint nearest before `at`, which leaves something to train."""
    from pneuma.study.checkpoints import checkpoint_files, read_checkpoint

    if at >= whole.steps:
        raise UserError(
            f"--at {at}: run {parent} ends at step {whole.steps}, so nothing would be left to train"
        )
    files = sorted(checkpoint_files(store.run_folder(parent)), key=lambda file: file.step, reverse=True)
    if not files and whole.parent:
        raise UserError(
            f"run {parent} keeps no checkpoints, as it is a fork: fork run {whole.parent} with both changes"
        )
    if not files:
        raise UserError(
            f"run {parent} kept no checkpoints: remove {store.run_folder(parent)} and run a study of it "
            "whose file has keep_checkpoints = 20 at the top; it ends with the same bits"
        )
    before = [file for file in files if file.step <= at]
    if not before:
        raise UserError(f"--at {at}: the first checkpoint of run {parent} is at step {files[-1].step}")
    sound = next((file.step for file in before if read_checkpoint(file)), None)
    if sound is None:
        raise UserError(f"--at {at}: the checkpoints of run {parent} up to there are damaged")
    return sound


def _changes(run: Run, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Check what is to be changed."""
    if "steps" in settings:
        raise UserError(
            f"--set steps: a fork ends where its parent does, at step {run.steps}; "
            "fork earlier, or train the parent's study with more --steps"
        )
    for key in settings:
        if key in (*FIXED, *FORK_FIELDS):
            raise UserError(f"--set {key}: cannot change at a fork, because the checkpoint hangs on it")
        if run.buffer_size and key in OF_TRANSITIONS:
            raise UserError(
                f"--set {key}: cannot change at a fork, because transitions of before are replayed"
            )
    read = {key: read_field(Run, key, value) for key, value in settings.items()}
    for key, value in read.items():
        if getattr(run, key) == value:
            raise UserError(f"--set {key}: is {_shown(value)} in run {run_id(run)} already")
    return read


def _forked(base: Mapping[str, Any], changes: Mapping[str, Any]) -> Run:
    """Return the changed run; an optimizer that keeps other moments needs a reset."""
    kept = changes.get("fork_reset") != "optimizer"
    other = changes.get("optimizer", base["optimizer"]) != base["optimizer"]
    if other and kept:
        raise UserError("--set optimizer: another optimizer needs --reset optimizer")
    if base["engine"] == ENGINES[0] and (fault := beyond_engine(Run(**{**base, **changes}))):
        keys = ", ".join(key for key in changes if key != "fork_reset")
        raise UserError(f"--set {keys}: the engine {ENGINES[0]}, which a fork keeps, cannot train {fault}")
    own = {name for names in OPTIMIZER_FIELDS.values() for name in names} if other else ()
    run = make_run({**base, **dict.fromkeys(own), **changes})
    if kept and bool(run.momentum) != bool(base["momentum"]):
        raise UserError("--set momentum: from or to 0 needs --reset optimizer")
    return run


def _reset(name: str) -> str:
    if name not in FORK_RESETS:
        raise unknown_name("reset", name, FORK_RESETS)
    return name


def _shown(value: object) -> str:
    return "none" if value is None else str(value)
