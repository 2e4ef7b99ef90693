"""`pneuma study delete` and `pneuma run delete`: remove stored runs, after showing them and asking."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated

from pneuma.cli import options as opt
from pneuma.cli.output import Result, say
from pneuma.errors import UserError, counted
from pneuma.store.last_queries import forget_query
from pneuma.store.store import Store
from pneuma.store.stored_runs import find_run
from pneuma.study.plan import Query

Yes = Annotated[bool, opt.flag("--yes", "Delete without asking.")]


def delete_study(name: opt.Study, selection: opt.RunFilter, yes: Yes = False) -> Result:
    """Delete a study's runs from the results folder.

    Runs that another study here also uses are kept until that study is deleted. Published tables are not
    changed.
    """
    from pneuma.analysis.runs import find_study, studies_here

    index = selection.index
    data = find_study(index, selection.query(name))
    study, store = data.study, index.store
    stored_ids = set(data.runs["run_id"][data.runs["where"] == ""])
    holders: dict[str, str] = {}
    for holder in studies_here(index):
        if (holder.study.name, holder.study.world) != (study.name, study.world):
            holders |= dict.fromkeys(stored_ids.intersection(holder.runs["run_id"]), holder.description)
    run_ids = sorted(stored_ids - holders.keys())
    if not stored_ids:
        raise UserError(f"nothing to delete: no such run is stored in {store.root}")
    result = _delete(store, run_ids, yes, data.coverage)
    if result.document["removed"] == run_ids:
        all_runs = find_study(index, Query(study.file, study.world)).runs
        if stored_ids.issuperset(all_runs["run_id"][all_runs["where"] == ""]):
            if study.path:
                forget_query(store, study.name, study.world)
            else:
                store.remove(store.listing_path(study.name))
    if not holders:
        return result
    note = f"Note: kept, as {holders[min(holders)]} has them too: {counted(len(holders), 'run')}."
    return replace(result, notes=[note])


def delete_run(name: opt.RunId, yes: Yes = False, results: opt.Results = opt.HERE) -> Result:
    """Delete one stored run."""
    store = Store(results)
    return _delete(store, [find_run(store, name)], yes)


def _delete(store: Store, run_ids: Sequence[str], yes: bool, coverage: str = "") -> Result:
    """Delete runs, after showing them and asking."""
    shown_lines = [coverage] if coverage else []
    for run_id in run_ids:
        status = store.status(run_id, quick=True)
        if status.name == "running":
            raise UserError(f"run {run_id} is training now: stop its study first")
        seed_text = f", seed {status.identity.seed}" if status.identity else ""
        shown_lines.append(f"  {run_id}  {status.name}, {status.step:,} steps{seed_text}")
    is_agreed = yes
    if run_ids and not yes:
        if not sys.stdin.isatty():
            raise UserError("--yes is required because this is not a terminal")
        for shown_line in shown_lines:
            say(shown_line)
        print(f"Remove {counted(len(run_ids), 'run')}? [y/N] ", end="", file=sys.stderr, flush=True)
        is_agreed = sys.stdin.readline().strip().lower() in ("y", "yes")
    if not (run_ids and is_agreed):
        return Result({"removed": []}, ["Nothing was deleted."])
    for run_id in run_ids:
        store.delete_run(run_id)
    removed_line = f"Removed {counted(len(run_ids), 'run')} from {store.root}."
    return Result({"removed": list(run_ids)}, [removed_line])
