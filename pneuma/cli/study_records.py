"""Which runs a study's name stands for: those of its latest record here, of a new selection, or published."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

from pneuma.cli.options import Chosen, selecting_words
from pneuma.cli.output import say
from pneuma.errors import UserError, counted, unknown_name
from pneuma.study import execute, plan, spec
from pneuma.study.identity import own_things
from pneuma.study.store import FINISHED, Status, Store
from pneuma.worlds import chosen_world, in_world, split_world

if TYPE_CHECKING:
    from pneuma.analysis.frames import StudyData

Read = TypeVar("Read")
NOTHING = plan.Selection()


def find_study(
    store: Store, name: str, selection: plan.Selection = NOTHING, world: str | None = None
) -> tuple[spec.Study, plan.Selection]:
    """Return the study that a name stands for, to be planned, and the selection with what a variant changes.

    A name is a shipped study's, its figure's or section's, a path, or what a study of this folder or a file
    of the current one is called. Of a record, which may be untrusted, nothing is taken that names a user's
    own code or files.

    Raises:
        UserError: for a study that is nowhere, or whose file has to be named.
    """
    if name.endswith(".toml"):
        return spec.load_study(name, world), selection
    name = shipped_name(name)
    own, world = chosen_world(name, world)
    own, _, variant = own.partition(spec.VARIANT)
    if variant:
        record = store.selection(spec.name_in_world(f"{own}{spec.VARIANT}{variant}", world))
        if record is None:
            raise _unknown(store, name, name, world)
        held = execute.recorded_selection(record)
        _refuse_own(held.settings or {}, f"variant {name}", "repeat its --set")
        if not selection.settings:
            selection = replace(selection, settings=held.settings, variant=variant)
    if own in spec.list_studies():
        return spec.load_study(own, world), selection
    path = (store.selection(spec.name_in_world(own, world)) or {}).get("path")
    if not isinstance(path, str) or not os.path.isfile(path):
        raise _unknown(store, name, own, world)
    study = spec.load_study(path, world)
    for condition in study.conditions:
        _refuse_own(study.fields(condition), f"study {own}", f"give its file: {path}")
    return study, selection


def _refuse_own(fields: Mapping[str, Any], what: str, mend: str) -> None:
    """Refuse fields that a record leads to where they name a user's own code or files."""
    if own := own_things(fields):
        raise UserError(f"{what} would {' and '.join(own.values())}; if you trust it, {mend}")


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
    store: Store, name: str, selection: plan.Selection = NOTHING, world: str | None = None
) -> dict[str, Any]:
    """Return what is held of a study, the runs that a selection picks of it, or those that it plans anew.

    Of several amounts that were run it is the one of most finished runs. Conditions and seeds pick; a
    preset, steps, an engine or fields plan what `study run` would train, and stand for what was run of
    that. A study that was never run here is the published one, where there is one. A world has records of
    its own; where none is named and the usual one has no record, another's is shown, and said to be.

    Raises:
        UserError: for a study that is nowhere, or a selection or world that it does not have.
    """
    name = shipped_name(name)
    if is_shipped(name):
        stem = spec.load_study(name, world).name
    else:
        stem = spec.name_in_world(Path(name).stem if name.endswith(".toml") else name, world)
    planning = {
        "--preset": selection.preset,
        "--steps": selection.steps,
        "--engine": selection.engine,
        "--set": selection.settings,
    }
    given = [option for option, value in planning.items() if value]
    record = _stored(store, name, stem)
    if given and _plannable(name, record):
        study, wanted = find_study(store, name, selection, world)
        fewer = all(own in study.conditions for own in wanted.conditions)
        planned = plan.make_plan(study, wanted if fewer else replace(wanted, conditions=()))
        anew = execute.selection_record(planned)
        stored = [own for own in store.selections(planned.study.name) if execute.alike(own, anew)]
        if not (selection.preset or selection.steps or selection.engine):
            stored = [own for own in [store.shown_selection(planned.study.name)] if own]
        return _pick(anew if selection.preset or not stored else stored[0], selection)
    elsewhere = dict(split_world(own) for own in known_studies(store) if own != stem)
    if record is None and world is None and stem in elsewhere:
        say(f"Note: {stem} has no runs in its usual world; shown is {elsewhere[stem]}.", aside=True)
        return study_record(store, name, selection, elsewhere[stem])
    variants = _variants(store, stem)
    if record is None and len(variants) == 1:
        say(f"Note: {stem} has no runs as it stands; shown is the variant {variants[0]}.", aside=True)
        return study_record(store, variants[0], selection)
    if record is None and variants:
        raise UserError(f"study {stem} has no runs as it stands; name one of {', '.join(variants)}")
    if record is None:
        raise _unknown(store, name, stem, world)
    if given:
        raise UserError(f"{given[0]}: study {stem} is not planned here: --condition and --seeds alone pick")
    return _pick(record, selection)


def tell_shown(store: Store, record: Mapping[str, Any]) -> None:
    """Say what is shown of a study where more is stored: other amounts, and variants."""
    study, others = record["study"], []
    for own in store.selections(study):
        if not execute.alike(own, record) and (count := store.finished(own)):
            asked = {key: own["selection"].get(key) for key in ("preset", "steps", "engine")}
            words = selecting_words(plan.Selection(**asked))
            others.append(f"{_runs_told(own, count)} ({' '.join(words) or '--preset quick'})")
    if variants := _variants(store, study):
        others.append(f"the variant{'s' * (len(variants) > 1)} {', '.join(variants)}")
    if others:
        shown = _runs_told(record, len(record["runs"]))
        say(f"Note: shown of {study}: {shown}. Stored too: {'; '.join(others)}.", aside=True)


def _variants(store: Store, study: str) -> list[str]:
    """Return the names of a study's variants in its world; a variant has none."""
    own, world = split_world(study)
    names = (name for name in known_studies(store, world) if name.startswith(f"{own}{spec.VARIANT}"))
    return [name for name in names if spec.VARIANT not in own]


def _runs_told(record: Mapping[str, Any], count: int) -> str:
    steps = max(run["run"]["steps"] for run in record["runs"])
    return f"{counted(count, 'run')} of {steps:,} steps"


def open_data(chosen: Chosen, name: str, published: bool = True) -> StudyData:
    """Open a study's data, published or not, and say how many runs of the selection are left out."""
    record = study_record(chosen.store, name, chosen.selection, chosen.world)
    tell_shown(chosen.store, record)
    from pneuma.analysis.run_index import open_study

    data = open_study(chosen.store, record, "all" if published else "none")
    tell_left_out(data)
    return data


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
    """How a run of a record stands.

    Attributes:
        run: its entry in the record.
        status: of the run here, or else as it is published.
        published: whether the status is the published one.
        damaged: whether what lies here of the run is.
    """

    run: dict[str, Any]
    status: Status
    published: bool
    damaged: bool

    @property
    def told(self) -> str:
        """How it stands, for people."""
        here = ", damaged here" if self.damaged else ""
        return f"{self.status.name} as published{here}" if self.published else self.status.name

    @property
    def reached(self) -> str:
        """How far it is, for people; '' of one that has ended, or has kept nothing yet."""
        unfinished = self.status.step and self.status.name not in FINISHED
        return f"at step {self.status.step:,}" if unfinished else ""


def run_states(store: Store, record: Mapping[str, Any]) -> list[RunState]:
    """Return how every run of a record stands, here or in a published table."""
    states = {run["run_id"]: store.status(run["run_id"]) for run in record["runs"]}
    published: dict[str, Status] = {}
    if not all(status.finished for status in states.values()):
        from pneuma.analysis.run_index import RunIndex

        found = RunIndex(store).of_record(record)
        published = {run_id: own.status for run_id, own in found.items() if own.published}
    damaged = {run_id for run_id, status in states.items() if status.name == "damaged"}
    states |= published
    return [
        RunState(run, states[run["run_id"]], run["run_id"] in published, run["run_id"] in damaged)
        for run in record["runs"]
    ]


def _stored(store: Store, name: str, stem: str) -> dict[str, Any] | None:
    """Return the record of what was run here, or else of what is published; None without either.

    Raises:
        UserError: where it is the record of another file of the same name, or the table is damaged.
    """
    record, table = store.shown_selection(stem), store.published_path(stem)
    if record is not None and name.endswith(".toml"):
        execute.check_same_file(record, Path(name), store)
    if record is not None or not table.exists():
        return record
    if store.selection_path(stem).exists():
        path = store.selection_path(stem)
        say(f"Note: {path} is damaged; what is published of {stem} is taken instead.", aside=True)
    from pneuma.analysis.published import read_published

    return read_published(store, stem).record


def _plannable(name: str, record: Mapping[str, Any] | None) -> bool:
    """Tell whether a study can be planned: a shipped one, a file, or recorded with its file."""
    own = split_world(name)[0].partition(spec.VARIANT)[0]
    return name.endswith(".toml") or own in spec.list_studies() or bool((record or {}).get("path"))


def _pick(record: Mapping[str, Any], selection: plan.Selection) -> dict[str, Any]:
    """Return a record with only the conditions and seeds of a selection."""
    if not selection.conditions and selection.seeds is None:
        return dict(record)
    known = list(dict.fromkeys(run["condition"] for run in record["runs"]))
    for name in selection.conditions:
        if name not in known:
            raise unknown_name(f"condition of study {record['study']}", name, known)
    runs = [
        run
        for run in record["runs"]
        if run["condition"] in (selection.conditions or known)
        and (selection.seeds is None or run["seed"] in selection.seeds)
    ]
    if not runs:
        seeds = sorted({run["seed"] for run in record["runs"]})
        raise UserError(f"--seeds: study {record['study']} has none of these; it has {seeds}")
    kept = {run["condition"] for run in runs}
    same = [[name for name in names if name in kept] for names in record["same"]]
    return {**record, "runs": runs, "same": [names for names in same if len(names) > 1]}


def _unknown(store: Store, name: str, stem: str, world: str | None) -> UserError:
    told = f"`pneuma study run {name}{f' --world {world}' if world else ''}`"
    if store.selection_path(stem).exists():
        anew = f"{told} writes it" if _plannable(name, None) else "import or fork its runs"
        return UserError(f"{store.selection_path(stem)}: damaged; {anew} anew")
    if not _plannable(name, None):
        known = sorted({*spec.list_studies(), *store.studies(), *spec.files_called(name)})
        return unknown_name("study", name, known)
    return UserError(
        f"study {stem} has no runs in {store.root}: run {told} first, or name the folder with --results"
    )
