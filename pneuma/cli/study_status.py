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
from pneuma.study.origins import stored_origins, unusual_origins
from pneuma.study.store import Store

if TYPE_CHECKING:
    from pneuma.study.executors.slurm import Job

RESULTS = Path("results")


@dataclass(frozen=True)
class _Standing:
    """How a study stands.

    Attributes:
        record: of its runs.
        states: of each of them.
        marks: by run, in what it was trained otherwise than most.
        jobs: by run, its job in Slurm's queue.
    """

    record: Mapping[str, Any]
    states: list[RunState]
    marks: Mapping[str, str]
    jobs: Mapping[str, Job]

    def document(self) -> dict[str, Any]:
        """Return it as one JSON object."""
        runs = [
            {
                **{key: state.run[key] for key in ("run_id", "condition", "seed")},
                "status": state.status,
                "step": state.step,
                "published": state.published,
                "trained": False,
            }
            for state in self.states
        ]
        jobs = {run_id: {"job": job.id, "state": job.state} for run_id, job in self.jobs.items()}
        study = self.record["study"]
        return {"schema": 1, "study": study, "runs": runs, "unlike_most": self.marks, "jobs": jobs}

    def tell(self) -> None:
        """Print it: a line of counts, then a line a run."""
        counts = ", ".join(f"{n} {told}" for told, n in Counter(state.told for state in self.states).items())
        print(f"{plain(self.record['study'])}: {counts}")
        if "adaptive" in self.record:
            _tell_looks(self.record)
        width = max((len(plain(state.run["condition"])) for state in self.states), default=0)
        for state in self.states:
            run_id = state.run["run_id"]
            job = self.jobs.get(run_id)
            notes = (
                state.reached,
                f"job {job.id} {job.state.lower()}" if job else "",
                f"({self.marks[run_id]} than most)" if run_id in self.marks else "",
            )
            who = f"{plain(state.run['condition']):<{width}} seed {state.run['seed']:<6} {run_id}"
            print("  ".join(["", who, state.told, *filter(None, notes)]))


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


def _tell_looks(record: Mapping[str, Any]) -> None:
    from pneuma.analysis.sequential import looks_that_count

    at = ", ".join(map(str, looks_that_count(record)))
    if at:
        print(f"  seeds were added by --until-decided, which looked at {at} of them")


def _queued(store: Store) -> dict[str, Job]:
    """Return the jobs of Slurm's queue by the runs that they train; say so where it cannot be asked."""
    from pneuma.study.executors.slurm import queued

    try:
        return queued(store)
    except UserError as error:
        say(f"Note: runs were submitted to Slurm, but its queue cannot be asked: {error}", aside=True)
        return {}
