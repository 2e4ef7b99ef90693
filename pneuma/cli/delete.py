"""`pneuma study delete` and `pneuma run delete`: remove stored runs, after showing them and asking."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

from pneuma.cli import options as opt
from pneuma.cli.output import Result, say
from pneuma.errors import UserError, counted
from pneuma.study.store import Store
from pneuma.study.stored_runs import find_run

Yes = Annotated[bool, opt.flag("--yes", "Remove them without asking.")]


def delete_study(name: opt.Study, picked: opt.StoredFilter, yes: Yes = False) -> Result:
    """Remove a study's runs from the results folder; without --steps those that are shown.

    Runs of another study that was run here too stay until that one is removed. Published tables are not
    touched.
    """
    from pneuma.analysis.runs import find_study, runs_of_budget, studies_here

    index, data = picked.index, picked.choose(name)
    here, study = {*data.runs["run_id"][data.runs["where"] == ""]}, data.study
    others = {
        run_id: other.where
        for other in studies_here(index)
        if (other.study.name, other.study.variant) != (study.name, study.variant)
        for run_id in other.runs["run_id"]
    }
    kept = here & others.keys()
    notes = [f"Note: kept, as {others[min(kept)]} has them too: {counted(len(kept), 'run')}."] if kept else []
    result = _delete(index.store, sorted(here - kept), yes, notes, data.text(index.store.root))
    if {*result.document["removed"]} != here - kept:
        return result  # nobody agreed
    every = find_study(index, name, replace(picked.selection, conditions=()), picked.world)
    if study.path is None:
        if {*every.runs["run_id"]} <= here:
            index.store.remove(index.store.listing_path(study.name))
    else:
        every = replace(every, runs=every.runs[every.runs["where"] == ""])
        noted = index.store.noted_steps(study.name).get(study.variant, [])
        left = [steps for steps in noted if {*runs_of_budget(every, steps)["run_id"]} - here]
        index.store.note_steps(study.name, study.variant, left)
    return result


def delete_run(name: opt.RunId, yes: Yes = False, results: opt.Results = opt.HERE) -> Result:
    """Remove one stored run."""
    store = Store(results)
    return _delete(store, [find_run(store, name)], yes)


def _delete(
    store: Store, names: Sequence[str], yes: bool, notes: Sequence[str] = (), about: str = ""
) -> Result:
    if not names and not notes:
        raise UserError(f"nothing to remove: no such run is stored in {store.root}")
    statuses = {name: store.status(name, quick=True) for name in names}
    if running := [name for name, status in statuses.items() if status.name == "running"]:
        raise UserError(f"run {running[0]} trains now: stop its study first")
    if not names:
        return Result({"removed": []}, ["Nothing was removed."], notes=notes)
    if not yes and not sys.stdin.isatty():
        raise UserError("--yes is needed where nobody can be asked")
    if about:
        say(about)
    for name, status in statuses.items():
        seed = f", seed {status.identity.seed}" if status.identity else ""
        say(f"  {name}  {status.name}, {status.step:,} steps{seed}")
    if not yes and not _agreed(f"Remove {counted(len(names), 'run')}? [y/N] "):
        return Result({"removed": []}, ["Nothing was removed."])
    for name in names:
        store.delete_run(name)
    text = f"Removed {counted(len(names), 'run')} from {store.root}."
    return Result({"removed": [*names]}, [text], notes=notes)


def _agreed(question: str) -> bool:
    print(question, end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")
