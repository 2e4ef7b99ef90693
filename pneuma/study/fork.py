"""Forks: continue stored runs from a checkpoint with one change, and a control without it.

runs, steps and changes → Plan of a control and a condition a change × fork seeds, each a run like any other
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any

from pneuma.algorithms import OF_OPTIMIZERS
from pneuma.config import FORK_FIELDS, FORK_RESETS, OF_GYMNASIUM, OF_WORLDS, Run, as_fields, make_run
from pneuma.env.fields import read_field
from pneuma.errors import UserError, counted, unknown_name
from pneuma.presets import TEXT, WORLDS
from pneuma.study.identity import run_id
from pneuma.study.plan import Cell, Plan
from pneuma.study.spec import Study
from pneuma.study.store import Store
from pneuma.study.stored_runs import trusted_settings

CONTROL = "control"
FIXED = (
    "env", "engine", "algorithm", "level", "random_levels", "monsters", "players", "classes", "characters",
    "magic", "learners", "observation", "observe_facing",
    "perceive", "slots", "horizon", "actor", "critic", "first_layer_scale", "buffer_size", "learning_starts",
    "seed", "steps", *OF_GYMNASIUM,
)  # fmt: skip
"""Fields on which the arrays in a checkpoint depend; a fork cannot change them."""


@dataclass(frozen=True)
class Change:
    """The one difference between a fork and its control: changed fields, or a part that is reset."""

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
"""Possible causes of collapse that thesis chapter 6 and the published code suggest, one change each."""


def plan_fork(
    store: Store, parent: str, at: int, change: Change, seeds: Sequence[int], trust: bool = False
) -> Plan:
    """Plan forks, and their control, from the parent's last checkpoint before step `at`.

    Each seed starts fresh random streams. Files and code that the run names are used only with `trust`.
    """
    control = _control_run(store, parent, at, trust)
    changed, step = _changed_run(control, change), control.fork_step
    parts = [f"{key}={'none' if value is None else value}" for key, value in change.settings.items()]
    condition = ", ".join([*parts, *([f"reset {change.reset}"] if change.reset else [])])
    name = f"fork-{parent[:8]}-{step}-{run_id(changed)[:4]}"
    about = f"Run {parent[:8]} from step {step:,}", f"{condition} from step {step:,} on"
    notes = (f"forked at step {step:,} of {control.steps:,}",)
    return _plan(name, *about, {CONTROL: [control], condition: [changed]}, seeds, notes)


def plan_cause_forks(
    store: Store, study: str, parents: Mapping[str, int], seeds: Sequence[int], trust: bool = False
) -> Plan:
    """Plan forks of several runs of a study: a condition for each of `CAUSES` that all runs can have.

    Runs have the same order in every condition, so that run i of a change and run i of the control start with
    the same weights, worlds and optimizer. `parents` gives the step before which each run is forked. Runs
    that cannot be forked are left out, with a note; one at least must be left.
    """
    controls: list[Run] = []
    notes: dict[str, None] = {}
    for parent, before in parents.items():
        try:
            controls.append(_control_run(store, parent, before, trust))
        except UserError as error:
            notes[str(error)] = None
    if not controls:
        raise UserError(next(iter(notes), "there is no run to fork"))
    conditions = {CONTROL: controls}
    for name, change in CAUSES.items():
        try:
            if change.reset == "xp" and any(control.xp_scope == "episode" for control in controls):
                raise UserError("XP begins anew with every episode of these runs")
            conditions[name] = [_changed_run(control, change) for control in controls]
        except UserError as error:
            notes[f"without {name}: {error}"] = None
    if len(conditions) == 1:
        raise UserError(f"study {study}: none of {', '.join(CAUSES)} changes anything in these runs")
    parts = [*(f"{control.parent}-{control.fork_step}" for control in controls), *conditions]
    name = f"{study}-forks-{hashlib.sha256('/'.join(parts).encode()).hexdigest()[:4]}"
    title = f"Forks of {counted(len(controls), 'collapsed run')} of {study}"
    return _plan(name, title, "Each condition changes one thing", conditions, seeds, (*notes,))


def _plan(
    name: str,
    title: str,
    about: str,
    conditions: Mapping[str, Sequence[Run]],
    seeds: Sequence[int],
    notes: tuple[str, ...],
) -> Plan:
    """Plan forks of every parent with every seed as a study.

    Forks of several parents are numbered in one sequence.
    """
    about = f"{about}, beside an unchanged control."
    env = conditions[CONTROL][0].env
    world = next((world for world, known in WORLDS.items() if known.env == env), TEXT)
    study = Study.without_file(name, title, conditions, about=about, world=world)
    forks = [*product(range(len(conditions[CONTROL])), seeds)]
    places = tuple(seeds if len(conditions[CONTROL]) == 1 else range(len(forks)))
    cells = tuple(
        Cell(condition, place, run, run_id(run))
        for place, (parent, seed) in zip(places, forks, strict=True)
        for condition, runs in conditions.items()
        for run in [replace(runs[parent], seed=seed)]
    )
    return Plan(study, cells, notes)


# --- Parents ---------------------------------------------------------------------------------------


def _control_run(store: Store, parent: str, at: int, trust: bool) -> Run:
    """Return the fork of a parent from the checkpoint nearest before `at` with nothing changed."""
    status = store.status(parent)
    if not status.finished:
        raise UserError(f"run {parent} is {status.name}: only a finished run can be forked")
    whole = make_run(trusted_settings(store, parent, trust))
    if run_id(whole) != parent:
        why = "was imported, or trained by other rules or another engine, or its own files have changed"
        raise UserError(f"run {parent} {why}: a fork would not go on from where it stood")
    step = _checkpoint_step(store, parent, at, whole)
    return make_run({**as_fields(whole), "parent": parent, "fork_step": step, "fork_reset": ""})


def _checkpoint_step(store: Store, parent: str, at: int, whole: Run) -> int:
    """Return the step of the parent's last checkpoint before `at` that leaves something to train."""
    from pneuma.study.checkpoints import checkpoint_files, sound_checkpoint

    if at >= whole.steps:
        ends = f"run {parent} ends at step {whole.steps}"
        raise UserError(f"--at {at}: {ends}, so nothing would be left to train")
    files = checkpoint_files(store.run_folder(parent))
    if not files:
        hint = "add `keep_checkpoints = 20` to its study's file and train anew; forks keep none"
        raise UserError(f"run {parent} kept no checkpoints: {hint}")
    sound = sound_checkpoint(store.run_folder(parent), at)
    if sound is None:
        first = f"the first checkpoint of run {parent} is at step {files[-1].step}"
        raise UserError(f"--at {at}: none is sound up to there; {first}")
    return sound.step


# --- Changes ---------------------------------------------------------------------------------------


def _changed_run(control: Run, change: Change) -> Run:
    if change.reset and change.reset not in FORK_RESETS:
        raise unknown_name("reset", change.reset, FORK_RESETS)
    if not change.settings and not change.reset:
        raise UserError("nothing is changed: give --set KEY=VALUE or --reset")
    for key in change.settings:
        of_transitions = control.buffer_size and key in OF_WORLDS  # those of a replay buffer
        if key in (*FIXED, *FORK_FIELDS) or of_transitions:
            raise UserError(f"--set {key}: cannot change at a fork, because the checkpoint hangs on it")
    changes = {key: read_field(Run, key, value) for key, value in change.settings.items()}
    fresh = change.reset == "optimizer"
    other = changes.get("optimizer", control.optimizer) != control.optimizer
    if other and not fresh:
        raise UserError("--set optimizer: another optimizer needs --reset optimizer")
    given_up = dict.fromkeys(OF_OPTIMIZERS) if other else {}
    changed = make_run({**as_fields(control), **given_up, **changes, "fork_reset": change.reset})
    if not fresh and bool(changed.momentum) != bool(control.momentum):
        raise UserError("--set momentum: from or to 0 needs --reset optimizer")
    if changes and replace(changed, fork_reset="") == control:
        raise UserError(f"--set {', '.join(changes)}: changes nothing in this run")
    return changed
