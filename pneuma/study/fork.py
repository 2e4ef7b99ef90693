"""Forks: go on from checkpoints of stored runs with one thing changed, beside a control without.

runs, steps and changes → Plan of a control and a condition a change × fork seeds, each a run like any other
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import product
from typing import Any

from pneuma.config import (
    FORK_FIELDS,
    FORK_RESETS,
    OPTIMIZER_FIELDS,
    EnvConfig,
    Run,
    as_fields,
    make_run,
    read_field,
)
from pneuma.errors import UserError, counted, unknown_name
from pneuma.study.identity import own_things, run_id
from pneuma.study.plan import Cell, Plan, Selection
from pneuma.study.provenance import differences
from pneuma.study.spec import Study
from pneuma.study.store import Store
from pneuma.study.stored_runs import stored_settings

CONTROL = "control"
FIXED = (
    "env", "engine", "algorithm", "level", "random_levels", "players", "classes", "characters", "weapons",
    "magic", "observation", "observe_facing", "perceive", "slots", "horizon", "actor",
    "critic", "buffer_size", "learning_starts", "seed",
)  # fmt: skip
"""Settings that a checkpoint's arrays or steps hang on, so that a fork cannot change them."""
OF_TRANSITIONS = tuple(own.name for own in fields(EnvConfig))
"""Settings by which transitions in a replay buffer were made."""


@dataclass(frozen=True)
class Change:
    """One thing that a fork does other than its control: settings, or what it begins anew."""

    settings: Mapping[str, Any] = field(default_factory=dict)
    reset: str = ""


CAUSES: dict[str, Change] = {
    "reset optimizer": Change(reset="optimizer"),
    "betas 0.9, 0.9": Change({"betas": (0.9, 0.9)}),
    "reset critic": Change(reset="critic"),
    "reset xp": Change(reset="xp"),
    "gradient limit 0.5": Change({"gradient_limit": 0.5}),
    "learning rate 3e-5": Change({"learning_rate": 3e-5}),
    "entropy coefficient 0.1": Change({"entropy_coefficient": 0.1}),
    "tanh": Change({"activation": "tanh"}),
    "unit scale": Change({"scale": "unit"}),
}
"""What thesis chapter 6 and the published code suspect, one thing each."""


def plan_fork(
    store: Store, parent: str, at: int, change: Change, seeds: Sequence[int], trust: bool = False
) -> Plan:
    """Plan a fork from the parent's checkpoint nearest before step `at`, and its control, by fork seeds.

    Each seed begins fresh random streams. With `trust`, what the run names of its owner's may be read.

    Raises:
        UserError: for a parent without such a checkpoint, or a change that is none or cannot be made.
    """
    whole, control = _control_run(store, parent, at, trust)
    changed, step = _changed_run(whole, control, change), control.fork_step
    parts = [f"{key}={_shown(value)}" for key, value in change.settings.items()]
    condition = ", ".join([*parts, *([f"reset {change.reset}"] if change.reset else [])])
    name = f"fork-{parent[:8]}-{step}-{run_id(changed)[:4]}"
    about = f"Run {parent[:8]} from step {step:,}", f"{condition} from step {step:,} on"
    notes = (f"forked at step {step:,} of {whole.steps:,}", *_elsewhere(store, parent))
    return _plan(name, *about, {CONTROL: [control], condition: [changed]}, seeds, seeds, notes)


def plan_cause_forks(
    store: Store, study: str, parents: Mapping[str, int], seeds: Sequence[int], trust: bool = False
) -> Plan:
    """Plan the forks of several runs of a study, a condition for each of `CAUSES` that all of them can make.

    A condition's runs are numbered in one order in every condition, so that run i of a change and run i of
    the control begin with the same weights, worlds and optimizer. `parents` tells before what step each run
    is to be forked; one that cannot be is left out, and said.

    Raises:
        UserError: where no parent can be forked, or no change can be made.
    """
    forked: list[tuple[Run, Run]] = []
    notes: dict[str, None] = {}
    for parent, before in parents.items():
        try:
            forked.append(_control_run(store, parent, before, trust))
            notes |= dict.fromkeys(_elsewhere(store, parent))
        except UserError as error:
            notes[str(error)] = None
    if not forked:
        raise UserError(next(iter(notes), "there is no run to fork"))
    conditions = {CONTROL: [control for _, control in forked]}
    for name, change in CAUSES.items():
        try:
            if change.reset == "xp" and any(whole.xp_scope == "episode" for whole, _ in forked):
                raise UserError("XP begins anew with every episode of these runs")
            conditions[name] = [_changed_run(*pair, change) for pair in forked]
        except UserError as error:
            notes[f"without {name}: {error}"] = None
    if len(conditions) == 1:
        raise UserError(f"study {study}: none of {', '.join(CAUSES)} changes anything in these runs")
    told = [*(f"{control.parent}-{control.fork_step}" for _, control in forked), *conditions]
    own_name = f"{study}-forks-{hashlib.sha256('/'.join(told).encode()).hexdigest()[:4]}"
    about = f"Forks of {counted(len(forked), 'collapsed run')} of {study}", "Each condition changes one thing"
    return _plan(own_name, *about, conditions, seeds, range(len(forked) * len(seeds)), (*notes,))


def _plan(
    name: str,
    title: str,
    about: str,
    conditions: Mapping[str, Sequence[Run]],
    seeds: Sequence[int],
    places: Sequence[int],
    notes: tuple[str, ...],
) -> Plan:
    """Plan every parent's fork with every seed, numbered by places, as a study of its own."""
    study = Study(
        name=name,
        path=None,
        title=title,
        section="",
        about=f"{about}, beside an unchanged control.",
        figure=name,
        baseline=CONTROL,
        base="",
        shared={},
        conditions={condition: {} for condition in conditions},
    )
    cells = tuple(
        Cell(condition, place, own, run_id(own))
        for place, (parent, seed) in zip(places, product(range(len(conditions[CONTROL])), seeds), strict=True)
        for condition, runs in conditions.items()
        for own in [replace(runs[parent], seed=seed)]
    )
    return Plan(study, Selection(seeds=tuple(places)), cells, (), notes)


# --- Parents ---------------------------------------------------------------------------------------


def _control_run(store: Store, parent: str, at: int, trust: bool) -> tuple[Run, Run]:
    """Return a parent, and its fork from the checkpoint nearest before `at` with nothing changed.

    Nothing that the parent names is touched unless it is trusted.

    Raises:
        UserError: for a parent without such a checkpoint, or one that must not or cannot be forked.
    """
    status = store.status(parent)
    if not status.finished:
        raise UserError(f"run {parent} is {status.name}: only a finished run can be forked")
    settings = stored_settings(store, parent)
    if not settings:
        raise UserError(f"run {parent}: its run.json holds no configuration")
    own = own_things(settings)
    if own and not trust:
        raise UserError(f"run {parent}: a fork would {' and '.join(own.values())}; --trust allows it")
    whole = make_run(settings)
    if run_id(whole) != parent:
        raise UserError(
            f"run {parent} was trained by other rules or another engine, or its own files have changed: "
            "a fork would not go on from where it stood"
        )
    step = _checkpoint_step(store, parent, at, whole)
    return whole, make_run({**as_fields(whole), "parent": parent, "fork_step": step, "fork_reset": ""})


def _elsewhere(store: Store, parent: str) -> list[str]:
    """Say in what this machine differs from the one that trained the parent."""
    earlier = store.read_document(parent, "provenance.json")
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
    files = checkpoint_files(store.run_folder(parent))
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


# --- Changes ---------------------------------------------------------------------------------------


def _changed_run(whole: Run, control: Run, change: Change) -> Run:
    """Return a fork with settings changed, and what is begun anew, beside its control.

    Raises:
        UserError: for a change that is none or cannot be made.
    """
    if change.reset and change.reset not in FORK_RESETS:
        raise unknown_name("reset", change.reset, FORK_RESETS)
    changes = _read_changes(whole, change.settings)
    if not changes and not change.reset:
        raise UserError("nothing is changed: give --set KEY=VALUE or --reset")
    if change.reset == "optimizer" and not changes and whole.optimizer == "sgd" and not whole.momentum:
        raise UserError("--reset optimizer: changes nothing, because SGD without momentum keeps nothing")
    keys, base = ", ".join(changes), as_fields(control)
    fresh = change.reset == "optimizer"
    other = changes.get("optimizer", base["optimizer"]) != base["optimizer"]
    if other and not fresh:
        raise UserError("--set optimizer: another optimizer needs --reset optimizer")
    over = {**changes, "fork_reset": change.reset}
    own = {name for names in OPTIMIZER_FIELDS.values() for name in names} if other else ()
    changed = make_run({**base, **dict.fromkeys(own), **over})
    if not fresh and bool(changed.momentum) != bool(base["momentum"]):
        raise UserError("--set momentum: from or to 0 needs --reset optimizer")
    if changes and replace(changed, fork_reset="") == control:
        raise UserError(f"--set {keys}: changes nothing, because nothing in this run reads it")
    return changed


def _read_changes(run: Run, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Read what is to be changed in a run.

    Raises:
        UserError: for what cannot be changed at a fork, or is so already.
    """
    for key in settings:
        if key == "steps":
            raise UserError(
                f"--set steps: a fork ends where its parent does, at step {run.steps}; "
                "fork earlier, or train the parent's study with more --steps"
            )
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


def _shown(value: object) -> str:
    return "none" if value is None else str(value)
