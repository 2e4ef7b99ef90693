"""What is stored of a study: the runs recorded under its name here, or else published."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from pneuma.cli.options import Chosen
from pneuma.cli.output import say
from pneuma.errors import UserError, counted, unknown_name
from pneuma.study import execute, plan, spec
from pneuma.study.identity import own_things
from pneuma.study.store import Status, Store
from pneuma.worlds import chosen_world, in_world, split_world

if TYPE_CHECKING:
    from pneuma.analysis.frames import StudyData

Read = TypeVar("Read")
ALL = plan.Selection()


def shipped_name(name: str) -> str:
    """Return the shipped study that a figure or section stands for, as fig-6-4 or 6.1; or the name itself.

    Raises:
        UserError: naming the studies, where they are several.
    """
    figure, world = split_world(name)
    if not re.fullmatch(r"(fig|table)-[\w-]+|\d(\.\d+)?", figure):
        return name
    tables = {own: spec.read_head(own) for own in spec.list_studies()}
    numbered = (figure, f"fig-{figure.replace('.', '-')}")
    found = [own for own, head in tables.items() if head["figure"] in numbered]
    found = found or [own for own, head in tables.items() if figure in head["section"].split(" and ")]
    if len(found) > 1:
        raise UserError(f"{name} is of several studies: name one of {', '.join(found)}")
    return in_world(found[0], world) if found else name


def study_record(
    store: Store, name: str, picked: plan.Selection = ALL, world: str | None = None
) -> dict[str, Any]:
    """Return the stored runs that a selection picks of a study or a variant, which the name stands for.

    Of several amounts that were run it is the one of `picked.steps`, or of most finished runs. A study that
    was only run in another world, or with changed settings, is shown as it was run.

    Raises:
        UserError: where nothing is stored, or nothing that is picked.
    """
    asked = world
    own, world = chosen_world(Path(name).stem if name.endswith(".toml") else shipped_name(name), world)
    stem = spec.name_in_world(own, world)
    records = store.selections(stem)
    if records and name.endswith(".toml"):
        execute.check_same_file(records[0], Path(name), store)
    if not records and store.published_path(stem).exists():
        from pneuma.analysis.published import read_published

        records = [read_published(store, stem).record]
    otherwise = [] if records or asked else _related(store, stem)
    if otherwise:
        say(
            f"Note: {stem} was not run as it stands; shown is {otherwise[0]}, of {', '.join(otherwise)}.",
            aside=True,
        )
        return study_record(store, otherwise[0], picked)
    if not records:
        raise _unknown(store, name, stem)
    fitting = [record for record in records if picked.steps is None or _has_steps(record, picked.steps)]
    if not fitting:
        stored = ", ".join(f"{_steps(record):,}" for record in records)
        raise UserError(f"--steps {picked.steps}: study {stem} has runs of {stored} steps")
    return _pick(fitting[0] if len(fitting) == 1 else max(fitting, key=store.finished), picked)


def _related(store: Store, study: str) -> list[str]:
    """Return what else there is of a study: in other worlds, and its variants, those of its world first."""
    own, world = split_world(study)
    found = [name for name in known_studies(store) if split_world(name)[0].partition(spec.VARIANT)[0] == own]
    return sorted((name for name in found if name != study), key=lambda name: split_world(name)[1] != world)


def file_of(store: Store, name: str, world: str | None) -> tuple[str, str | None]:
    """Return what a study is loaded by, and in which world: the path if it was run by that, else its name.

    Raises:
        UserError: where the file names a user's own code or files, as the record may be untrusted.
    """
    own, asked = chosen_world(name, world)
    path = (store.selection(spec.name_in_world(own, asked)) or {}).get("path")
    if name.endswith(".toml") or is_shipped(name) or not isinstance(path, str) or not Path(path).is_file():
        return name, world
    study = spec.load_study(path, asked)
    for condition in study.conditions:
        if deeds := own_things(study.fields(condition)):
            does = " and ".join(deeds.values())
            raise UserError(f"study {own} would {does}; if you trust it, give its file: {path}")
    return path, asked


def _steps(record: Mapping[str, Any]) -> int:
    return max((run["run"]["steps"] for run in record["runs"]), default=0)


def _has_steps(record: Mapping[str, Any], steps: int) -> bool:
    """Tell whether a record is of runs of so many steps, rounded up to whole updates."""
    some: Mapping[str, Any] = next((run["run"] for run in record["runs"]), {})
    horizon = math.prod(some.get(key) or 1 for key in ("horizon", "slots", "players"))
    return math.ceil(steps / horizon) * horizon == _steps(record)


def _pick(record: Mapping[str, Any], picked: plan.Selection) -> dict[str, Any]:
    """Return a record with only the conditions and seeds of a selection."""
    known = list(dict.fromkeys(run["condition"] for run in record["runs"]))
    for name in picked.conditions:
        if name not in known:
            raise unknown_name(f"condition of study {record['study']}", name, known)
    wanted = picked.conditions or known
    seeds = {run["seed"] for run in record["runs"]} if picked.seeds is None else {*picked.seeds}
    runs = [run for run in record["runs"] if run["condition"] in wanted and run["seed"] in seeds]
    if record["runs"] and not runs:
        held = sorted({run["seed"] for run in record["runs"]})
        raise UserError(f"--seeds: study {record['study']} has none of these; it has {held}")
    kept = {run["condition"] for run in runs}
    same = [[name for name in names if name in kept] for names in record["same"]]
    return {**record, "runs": runs, "same": [names for names in same if len(names) > 1]}


def _unknown(store: Store, name: str, stem: str) -> UserError:
    if store.selection_path(stem).exists():
        return UserError(f"{store.selection_path(stem)}: damaged; run, import or fork its runs anew")
    if is_shipped(stem) or name.endswith(".toml"):
        ran = f"run `{spec.run_command(stem, name if name.endswith('.toml') else None)}` first"
        return UserError(f"study {stem} has no runs in {store.root}: {ran}, or give --results")
    return unknown_name("study", name, sorted({*spec.list_studies(), *known_studies(store)}))


# --- What is shown, and what else there is --------------------------------------------------------


def open_data(picked: Chosen, name: str, published: bool = True) -> StudyData:
    """Open a study's data, published or not, and say what of it is left out."""
    record = study_record(picked.store, name, picked.selection, picked.world)
    tell_shown(picked.store, record)
    from pneuma.analysis.run_index import open_study

    data = open_study(picked.store, record, "all" if published else "none")
    tell_left_out(data)
    return data


def tell_shown(store: Store, record: Mapping[str, Any]) -> None:
    """Say what else is stored of a study than what is shown: other amounts, and variants."""
    study, shown = record["study"], _steps(record)
    amounts = {_steps(own): own for own in store.selections(study) if not execute.alike(own, record)}
    others = [
        f"{counted(store.finished(own), 'run')} of {steps:,} steps (--steps {steps})"
        for steps, own in amounts.items()
        if steps != shown and store.finished(own)
    ]
    world = split_world(study)[1]
    others += [name for name in _related(store, study) if split_world(name)[1] == world]
    if others:
        told = f"{counted(len(record['runs']), 'run')} of {shown:,} steps"
        say(f"Note: shown of {study}: {told}. Stored too: {'; '.join(others)}.", aside=True)


def tell_left_out(data: StudyData) -> None:
    """Say how many runs of a selection are not shown, or not here, if any."""
    of = f"of {data.left_out + len(data.runs)} runs of {data.study}"
    if 0 < len(data.published) < len(data.runs):
        say(f"Note: {len(data.published)} {of} are not here, but published.", aside=True)
    if data.left_out:
        say(f"Note: {data.left_out} {of} are not here, not finished or damaged, and left out.", aside=True)


def is_shipped(name: str) -> bool:
    """Tell whether a name stands for a shipped study, in any world."""
    return split_world(name)[0] in spec.list_studies()


def known_studies(store: Store, world: str | None = None) -> list[str]:
    """Return the names of the studies that were run, imported or published here, of a world if one is named.

    What looks like a study's file is none of them: such a name is for a person to give.
    """
    names = {*store.studies(), *(path.stem for path in (store.root / "published").glob("*.parquet"))}
    return sorted(
        name for name in names if not name.endswith(".toml") and world in (None, split_world(name)[1])
    )


def nothing_yet(store: Store, world: str | None = None) -> str:
    """Return what to say where no study was run, imported or published here; '' where one was."""
    if known_studies(store, world):
        return ""
    return f"no study was run or published in {store.root} yet: run `pneuma study run activation` first"


def each_study(names: Sequence[str], read: Callable[[str], Read]) -> list[Read]:
    """Read studies that nobody named one by one; of those that cannot be read only say so.

    Raises:
        UserError: where none of several can be read: what hinders the first.
    """
    found, hindered = [], []
    for name in names:
        try:
            found.append(read(name))
        except UserError as error:
            hindered.append(error)
    if hindered and not found:
        raise hindered[0]
    for hindrance in hindered:
        say(f"Note: {hindrance}.", aside=True)
    return found


class RunState(NamedTuple):
    """How a run of a record stands: its entry there, its status here or as published, and how to say that."""

    run: dict[str, Any]
    status: Status
    published: bool
    told: str


def run_states(store: Store, record: Mapping[str, Any]) -> list[RunState]:
    """Return how every run of a record stands, here or in a published table."""
    here = {run["run_id"]: store.status(run["run_id"]) for run in record["runs"]}
    published: dict[str, Status] = {}
    if not all(status.finished for status in here.values()):
        from pneuma.analysis.run_index import RunIndex

        found = RunIndex(store).of_record(record)
        published = {run_id: own.status for run_id, own in found.items() if own.published}
    states = []
    for run in record["runs"]:
        run_id = run["run_id"]
        status, told = published.get(run_id, here[run_id]), here[run_id].name
        if run_id in published:
            told = f"{status.name} as published" + ", damaged here" * (told == "damaged")
        states.append(RunState(run, status, run_id in published, told))
    return states
