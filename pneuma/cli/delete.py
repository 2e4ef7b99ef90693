"""`pneuma study delete` and `pneuma run delete`: remove stored runs, after showing them and asking."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from pneuma.cli import options as opt
from pneuma.cli.output import Result, say
from pneuma.errors import UserError, counted
from pneuma.study.spec import load_study
from pneuma.study.store import Store
from pneuma.study.stored_runs import find_run

if TYPE_CHECKING:
    from pneuma.analysis.asked import Asked
    from pneuma.analysis.run_index import RunIndex

YES = opt.flag("--yes", "Remove them without asking.")


def delete_study(picked: opt.Picked, name: str = opt.STUDY, yes: bool = YES) -> Result:
    """Remove a study's runs from the results folder; without --steps those that are shown.

    Runs that another study has, which was run here too, stay. Published tables are not touched.
    """
    from pneuma.analysis.asked import answer, ask
    from pneuma.analysis.run_index import RunIndex

    index = RunIndex(picked.store)
    shown = answer(index, ask(index, name, picked.selection, picked.world), picked.selection)
    here = {entry.run_id for *_, entry in shown.runs if entry.table is None}
    others = {run_id: other for other, ids in _of_others(index, shown.asked) for run_id in ids}
    kept = here & others.keys()
    notes = [f"Note: kept, as {others[min(kept)]} has them too: {counted(len(kept), 'run')}."] if kept else []
    result = _delete(index.store, sorted(here - kept), yes, notes)
    if shown.asked.study.path is None and len(result.document["removed"]) == len(shown.runs):
        index.store.listing_path(name).unlink()
    return result


def delete_run(name: str = opt.RUN, yes: bool = YES, results: Path = opt.RESULTS) -> Result:
    """Remove one stored run."""
    store = Store(results)
    return _delete(store, [find_run(store, name)], yes)


def _of_others(index: RunIndex, asked: Asked) -> Iterator[tuple[str, set[str]]]:
    """Yield each other study that was run in the results folder, with the ids of its runs."""
    from pneuma.analysis.asked import ask, stored_runs

    for name in index.listings():
        if name != asked.study.name and (listing := index.listing(name)):
            yield name, {run["run_id"] for run in listing["runs"]}
    for name in index.store.last_studies():
        with suppress(UserError):  # the file is in another folder
            for world in load_study(name).worlds:
                if (name, world) != (asked.study.name, asked.study.world):
                    yield (
                        name,
                        {entry.run_id for *_, entry in stored_runs(index, ask(index, name, world=world))},
                    )


def _delete(store: Store, names: Sequence[str], yes: bool, notes: Sequence[str] = ()) -> Result:
    if not names:
        raise UserError(f"nothing to remove: no such run is stored in {store.root}")
    statuses = {name: store.status(name, quick=True) for name in names}
    if running := [name for name, status in statuses.items() if status.name == "running"]:
        raise UserError(f"run {running[0]} trains now: stop its study first")
    if not yes and not sys.stdin.isatty():
        raise UserError("--yes is needed where nobody can be asked")
    for name, status in statuses.items():
        seed = f", seed {status.identity.seed}" if status.identity else ""
        say(f"  {name}  {status.name}, {status.step:,} steps{seed}", aside=True)
    if not yes and not _agreed(f"Remove {counted(len(names), 'run')}? [y/N] "):
        return Result({"removed": []}, ["Nothing was removed."])
    for name in names:
        store.delete_run(name)
    told = f"Removed {counted(len(names), 'run')} from {store.root}."
    return Result({"removed": [*names]}, [told], notes=notes)


def _agreed(question: str) -> bool:
    print(question, end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")
