"""The stored runs of a study: opening them, and saying what is shown and what is left out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from pneuma.analysis.stored_studies import (
    by_budget,
    is_shipped,
    known_studies,
    related_studies,
    steps_of,
    study_record,
)
from pneuma.cli.options import Chosen
from pneuma.cli.output import say
from pneuma.errors import UserError, counted
from pneuma.study import execute, spec
from pneuma.study.identity import own_things
from pneuma.study.store import Status, Store
from pneuma.worlds import WORLDS, chosen_world, in_world, split_world

if TYPE_CHECKING:
    from pneuma.analysis.frames import StudyData

Read = TypeVar("Read")


def file_of(store: Store, name: str, world: str | None) -> tuple[str, str | None]:
    """Return the name or path by which a study is loaded, and its world.

    Raises:
        UserError: for a variant's name; and when the file names a user's own code or files, as the record may
            be untrusted.
    """
    own_name, asked = chosen_world(name, world)
    if spec.VARIANT in own_name and not name.endswith(".toml"):
        of = own_name.partition(spec.VARIANT)[0]
        raise UserError(f"{name} is a variant: name the study, {of}, and give --set as when it was made")
    if name.endswith(".toml") or is_shipped(name):
        return name, world
    recorded = [*filter(None, (store.selection(in_world(own_name, each)) for each in WORLDS))]
    path = next((record["path"] for record in recorded if record.get("path")), None)
    if recorded and path is None:
        raise UserError(f"{name} has no study file: repeat the command that forked, searched or imported it")
    if not isinstance(path, str) or not Path(path).is_file():
        return name, world
    study = spec.load_study(path, asked)
    for condition in study.conditions:
        if named_code := own_things(study.fields(condition)):
            does = " and ".join(named_code.values())
            raise UserError(f"study {own_name} would {does}; if you trust it, give its file: {path}")
    return path, asked


# --- What is shown, and what else there is --------------------------------------------------------


def open_data(picked: Chosen, name: str, published: bool = True) -> StudyData:
    """Open a study's data, published or not, and say what is left out."""
    record = study_record(picked.store, name, picked.selection, picked.world, partial(say, aside=True))
    tell_shown(picked.store, record)
    from pneuma.analysis.run_index import open_study

    data = open_study(picked.store, record, "all" if published else "none")
    tell_left_out(data)
    return data


def tell_shown(store: Store, record: Mapping[str, Any]) -> None:
    """Print what else is stored for a study: other budgets and variants."""
    study, shown = record["study"], steps_of(record)
    selections, ids = store.selections(study), {run["run_id"] for run in record["runs"]}
    amounts = by_budget(other for other in selections if not execute.can_join(other, record))
    others = [
        f"{counted(store.finished(other), 'run')} of {steps:,} steps (--steps {steps})"
        for steps, other in amounts.items()
        if steps != shown and store.finished(other)
    ]
    others_alike = (other for other in selections if steps_of(other) == shown)
    hidden = [other for other in others_alike if ids - {run["run_id"] for run in other["runs"]}]
    if count := sum(map(store.finished, hidden)):
        others.append(f"{counted(count, 'run')} of {shown:,} steps with other settings or code")
    world = split_world(study)[1]
    others += [name for name in related_studies(store, study) if split_world(name)[1] == world]
    if others:
        runs = f"{counted(len(record['runs']), 'run')} of {shown:,} steps"
        say(f"Note: {study} is shown with {runs}. Stored too: {'; '.join(others)}.", aside=True)


def tell_left_out(data: StudyData) -> None:
    """Print how many runs of a selection are only published, or left out."""
    of = f"of {data.left_out + len(data.runs)} runs of {data.study}"
    if data.published:
        say(f"Note: {len(data.published)} {of} are not here, but published.", aside=True)
    if data.left_out:
        say(f"Note: {data.left_out} {of} are not here, not finished or damaged, and left out.", aside=True)


def nothing_yet(store: Store, world: str | None = None) -> str:
    """Return a message if no study was run, imported or published here; empty otherwise."""
    if known_studies(store, world):
        return ""
    return f"no study was run or published in {store.root} yet: run `pneuma study run activation` first"


def each_study(names: Sequence[str], read: Callable[[str], Read]) -> list[Read]:
    """Read studies that the user did not name; print a note for those that cannot be read.

    Raises:
        UserError: when none can be read; the error of the first.
    """
    found, errors = [], []
    for name in names:
        try:
            found.append(read(name))
        except UserError as error:
            errors.append(error)
    if errors and not found:
        raise errors[0]
    for unread in errors:
        say(f"Note: {unread}.", aside=True)
    return found


class RunState(NamedTuple):
    """The state of a run in a record: its entry, its status here or as published, and a label."""

    run: dict[str, Any]
    status: Status
    published: bool
    label: str


def run_states(store: Store, record: Mapping[str, Any]) -> list[RunState]:
    """Return the state of each run of a record, here or in a published table."""
    stored = {run["run_id"]: store.status(run["run_id"]) for run in record["runs"]}
    published: dict[str, Status] = {}
    if not all(status.finished for status in stored.values()):
        from pneuma.analysis.run_index import RunIndex

        found = RunIndex(store).of_record(record)
        published = {run_id: records.status for run_id, records in found.items() if records.published}
    states = []
    for run in record["runs"]:
        run_id = run["run_id"]
        status, label = published.get(run_id, stored[run_id]), stored[run_id].name
        if run_id in published:
            label = f"{status.name} as published" + ", damaged here" * (label == "damaged")
        states.append(RunState(run, status, run_id in published, label))
    return states
