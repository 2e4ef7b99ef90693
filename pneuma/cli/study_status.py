"""`pneuma study status`: how far the runs of a study are, or those of every study in a results folder."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pneuma.cli.options import Json, NamedWorld, Results, Selected, print_json, say, selects
from pneuma.cli.plain_text import plain
from pneuma.cli.study_records import RunState, each_study, known_studies, run_states, study_record
from pneuma.errors import UserError
from pneuma.study.provenance import stored_origins, unusual_origins
from pneuma.study.store import Store

if TYPE_CHECKING:
    from pneuma.study.executors.slurm import Job

RESULTS = Path("results")


@dataclass(frozen=True)
class _Standing:
    """How the runs of a study's record stand; by run, how it is unlike most, and its job in Slurm's queue."""

    record: Mapping[str, Any]
    states: list[RunState]
    unlike_most: Mapping[str, str]
    jobs: Mapping[str, Job]

    def document(self) -> dict[str, Any]:
        """Return it as one JSON object."""
        runs = [
            {
                **{key: own.run[key] for key in ("run_id", "condition", "seed")},
                **{"status": own.status, "step": own.step, "published": own.published, "trained": False},
            }
            for own in self.states
        ]
        jobs = {run_id: {"job": job.id, "state": job.state} for run_id, job in self.jobs.items()}
        study = self.record["study"]
        return {"schema": 1, "study": study, "runs": runs, "unlike_most": self.unlike_most, "jobs": jobs}

    def tell(self) -> None:
        """Print it: a line of counts, then a line a run."""
        counts = ", ".join(f"{n} {told}" for told, n in Counter(own.told for own in self.states).items())
        print(f"{plain(self.record['study'])}: {counts}")
        width = max((len(plain(own.run["condition"])) for own in self.states), default=0)
        for own in self.states:
            run_id, seed = own.run["run_id"], own.run["seed"]
            parts = [f"  {plain(own.run['condition']):<{width}} seed {seed:<6} {run_id}", own.told]
            if own.reached:
                parts.append(own.reached)
            if job := self.jobs.get(run_id):
                parts.append(f"job {job.id} {job.state.lower()}")
            if run_id in self.unlike_most:
                parts.append(f"({self.unlike_most[run_id]} than most)")
            print("  ".join(parts))


@selects
def status(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="A study; left out: all that were run.")
    ] = None,
    selection: Selected = None,
    world: NamedWorld = None,
    results: Results = RESULTS,
    json: Json = False,
) -> None:
    """Say how far the runs of a study are, as it was last run or as selected."""
    store = Store(results)
    jobs = _queued(store)

    def standing(study: str) -> _Standing:
        record = study_record(store, study, selection, world)
        states = run_states(store, record)
        ids = [state.run["run_id"] for state in states]
        own = {run_id: jobs[run_id] for run_id in ids if run_id in jobs}
        return _Standing(record, states, unusual_origins(stored_origins(store, ids)), own)

    if name:
        found = [standing(name)]
    else:
        found = [own for _, own in each_study(known_studies(store, world), standing)]
        if not found and not json:
            print(f"No study was run in {results} yet.")
    if json:
        documents = [own.document() for own in found]
        return print_json(documents[0] if name else {"schema": 1, "studies": documents})
    for own in found:
        own.tell()
    return None


def _queued(store: Store) -> dict[str, Job]:
    """Return the jobs of Slurm's queue by the runs that they train; say so where it cannot be asked."""
    from pneuma.study.executors.slurm import queued

    try:
        return queued(store)
    except UserError as error:
        say(f"Note: runs were submitted to Slurm, but its queue cannot be asked: {error}", aside=True)
        return {}
