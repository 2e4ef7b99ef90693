"""`pneuma study delete` and `pneuma run delete`: remove stored runs, after showing them and asking."""

from __future__ import annotations

import sys
from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import Annotated

from pneuma.cli import options as opt
from pneuma.cli.output import Result, say
from pneuma.errors import UserError, counted
from pneuma.store.last_queries import forget_query, last_query
from pneuma.store.store import Store
from pneuma.store.stored_runs import find_run
from pneuma.study.spec import LAST

Yes = Annotated[bool, opt.flag("--yes", "Remove them without asking.")]


def delete_study(name: opt.Study, picked: opt.RunFilter, yes: Yes = False) -> Result:
    """Remove the runs of a study's cells from the results folder.

    Runs of another study that was run here too stay until that one is removed. Published tables are not
    touched.
    """
    from pneuma.analysis.runs import studies_here

    index, data = picked.index, picked.find(name)
    study = data.study
    here = {*data.runs["run_id"][data.runs["where"] == ""]}
    studies_by_run: dict[str, str] = {}
    for other in studies_here(index):
        if (other.study.name, other.study.world) != (study.name, study.world):
            studies_by_run |= dict.fromkeys(other.runs["run_id"], other.where)
    kept = here & studies_by_run.keys()
    notes = []
    if kept:
        notes.append(f"Note: kept, as {studies_by_run[min(kept)]} has them too: {counted(len(kept), 'run')}.")
    result = _delete(index.store, sorted(here - kept), yes, notes, data.text(index.store.root))
    if {*result.document["removed"]} != here - kept:
        return result  # nobody agreed
    if study.path is None:
        if {*data.runs["run_id"]} <= here and not picked.condition and picked.seeds is None:
            index.store.remove(index.store.listing_path(study.name))
    elif not _is_any_left(picked, study.name, study.world, here):
        forget_query(index.store, study.name, study.world)
    return result


def _is_any_left(picked: opt.RunFilter, study: str, world: str, removed: Collection[str]) -> bool:
    """Return whether a run of a study's last query is stored that was not asked to be removed."""
    last = last_query(picked.store, study, world)
    if last is None:
        return False
    from pneuma.analysis.runs import plan_to_read

    plan = plan_to_read(picked.index, replace(last, preset=LAST))
    left = {cell.run_id for cell in plan.cells} - {*removed}
    return any(picked.store.status(run_id, quick=True).name != "planned" for run_id in left)


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
