"""Forks that show a cause: from before what went wrong in several runs, each change of one thing alone.

runs and steps → Plan of the conditions control, change, change, … × (runs × fork seeds)

A condition's runs are forks of several parents, numbered in one order in every condition, so that run i
of a change and run i of the control begin with the same weights, worlds and optimizer.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from pneuma.config import Run
from pneuma.errors import UserError, counted
from pneuma.study.fork import CONTROL, changed_run, control_run, elsewhere
from pneuma.study.identity import run_id
from pneuma.study.plan import Cell, Plan, Selection
from pneuma.study.spec import Study
from pneuma.study.store import Store


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


def plan_cause_forks(
    store: Store,
    study: str,
    parents: Mapping[str, int],
    seeds: Sequence[int],
    causes: Mapping[str, Change] = CAUSES,
    trust: bool = False,
) -> Plan:
    """Plan the forks of several runs of a study, one condition for each change.

    Args:
        store: where the runs are.
        study: the name of theirs.
        parents: by run id, before what step each is to be forked.
        seeds: of the forks of each parent.
        causes: the changes by name; one that some parent cannot make is left out, and said.
        trust: whether what the stored runs name of their owner's may be imported and read.

    Raises:
        UserError: where no parent can be forked, or no change can be made.
    """
    forked, notes = _controls(store, parents, trust)
    conditions: dict[str, list[Run]] = {CONTROL: [control for _, control in forked]}
    for name, change in causes.items():
        try:
            conditions[name] = [changed_run(*pair, change.settings, change.reset) for pair in forked]
            _refuse_idle_reset(change, forked)
        except UserError as error:
            conditions.pop(name, None)
            notes.append(f"without {name}: {error}")
    if len(conditions) == 1:
        raise UserError(f"study {study}: none of {', '.join(causes)} changes anything in these runs")
    cells = tuple(
        Cell(name, place, own, run_id(own))
        for place, (parent, seed) in enumerate((i, seed) for i in range(len(forked)) for seed in seeds)
        for name, runs in conditions.items()
        for own in [replace(runs[parent], seed=seed)]
    )
    made = _study(study, [control for _, control in forked], conditions, causes)
    places = tuple(range(len(forked) * len(seeds)))
    return Plan(made, Selection(seeds=places), cells, (), tuple(notes))


def _controls(
    store: Store, parents: Mapping[str, int], trust: bool
) -> tuple[list[tuple[Run, Run]], list[str]]:
    """Return every parent that can be forked with its control, and what is to be said of the others."""
    forked, notes = [], []
    for parent, before in parents.items():
        try:
            forked.append(control_run(store, parent, before, trust))
        except UserError as error:
            notes.append(str(error))
        else:
            notes += elsewhere(store, parent)
    if not forked:
        raise UserError(notes[0] if notes else "there is no run to fork")
    return forked, list(dict.fromkeys(notes))


def _refuse_idle_reset(change: Change, forked: Sequence[tuple[Run, Run]]) -> None:
    """Refuse to begin XP anew where every episode does so."""
    if change.reset == "xp" and any(whole.xp_scope == "episode" for whole, _ in forked):
        raise UserError("XP begins anew with every episode of these runs")


def _study(
    study: str, controls: Sequence[Run], conditions: Mapping[str, object], causes: Mapping[str, Change]
) -> Study:
    told = "/".join([*(f"{run.parent}-{run.fork_step}" for run in controls), *conditions])
    name = f"{study}-forks-{hashlib.sha256(told.encode()).hexdigest()[:4]}"
    runs = counted(len(controls), "collapsed run")
    changes = {name: dict(causes[name].settings) for name in conditions if name != CONTROL}
    return Study(
        name=name,
        path=None,
        title=f"Forks of {runs} of {study}",
        section="",
        about="Each condition changes one thing from there on, beside an unchanged control.",
        figure=name,
        baseline=CONTROL,
        base="",
        shared={},
        conditions={CONTROL: {}, **changes},
    )
