"""Which runs a study's name stands for: its latest selection, one of its own, or what is published."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from pneuma.cli.options import say
from pneuma.errors import UserError, unknown_name
from pneuma.study import execute, plan, spec
from pneuma.study.identity import own_things
from pneuma.study.store import FINISHED, Status, Store
from pneuma.worlds import check_world, split_world

Read = TypeVar("Read")


def study_record(
    store: Store, name: str, selection: plan.Selection | None, world: str | None = None
) -> dict[str, Any]:
    """Return a study's latest record, or the one of a selection; what that leaves open is the latest's.

    A study that was never run here is the published one, where there is one. A world has records and
    published tables of its own.

    Raises:
        UserError: for a study that is nowhere, or a selection or world that it does not have.
    """
    stem = _record_name(name, world)
    record = _own_record(store, name, stem) or _published_record(store, stem)
    if record is None and selection is None:
        raise _unknown(store, name, stem, world)
    if selection is None:
        return record or {}
    if record is not None and _only_picks(record, selection, _is_asked_for(name)):
        return _pick(record, selection)
    study = spec.load_study(name, world)
    latest = recorded_selection(record) if record and "selection" in record else plan.Selection()
    planned = plan.make_plan(study, selection.over(latest))
    return execute.selection_record(planned)


def is_shipped(name: str) -> bool:
    """Tell whether a name stands for a shipped study, in any world."""
    return split_world(name)[0] in spec.list_studies()


def known_studies(store: Store, world: str | None = None) -> list[str]:
    """Return the names of the studies that were run, imported or published here, sorted.

    Only those of a world, where one is named.

    What looks like a study's file is none of them: such a name is for a person to give.
    """
    names = set(store.studies())
    if (store.root / "published").is_dir():
        from pneuma.analysis.published import published_studies

        names |= {*published_studies(store)}
    check_world(world)
    return sorted(
        name for name in names if not name.endswith(".toml") and world in (None, split_world(name)[1])
    )


def nothing_yet(store: Store, world: str | None = None) -> str:
    """Return what to say where no study was run, imported or published here; '' where one was."""
    if known_studies(store, world):
        return ""
    return f"no study was run or published in {store.root} yet: run `pneuma study run activation` first"


def each_study(names: Sequence[str], read: Callable[[str], Read]) -> list[tuple[str, Read]]:
    """Read studies that nobody named one by one; of those that cannot be read only say so.

    Raises:
        UserError: where none of several can be read: what hinders the first.
    """
    found, hindered = [], []
    for name in names:
        try:
            found.append((name, read(name)))
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
        status: the name of its status.
        published: whether that is told by the published table, as the run is not here, or damaged.
        step: agent steps of its records, or of its latest checkpoint.
        damaged: whether the run that lies here is.
    """

    run: dict[str, Any]
    status: str
    published: bool
    step: int
    damaged: bool = False

    @property
    def told(self) -> str:
        """How it stands, for people."""
        here = ", damaged here" if self.damaged else ""
        return f"{self.status} as published{here}" if self.published else self.status

    @property
    def reached(self) -> str:
        """How far it is, for people; '' of one that has ended, or has kept nothing yet."""
        return f"at step {self.step:,}" if self.step and self.status not in FINISHED else ""


def run_states(store: Store, record: Mapping[str, Any]) -> list[RunState]:
    """Return how every run of a record stands, here or in the published table of its study.

    Raises:
        UserError: when the published table is damaged.
    """
    taken: dict[str, Status] = {}
    if (store.root / "published").is_dir():
        from pneuma.analysis.run_index import RunIndex

        index = RunIndex(store)
        found, _ = index.of_record(record, others=False)
        here = {run_id: index(run_id).status for run_id in found}
        taken = {run_id: own.status for run_id, own in found.items() if own.published}
    else:
        here = {run["run_id"]: store.status(run["run_id"]) for run in record["runs"]}
    states = []
    for run in record["runs"]:
        own, run_id = here[run["run_id"]], run["run_id"]
        status = taken.get(run_id, own)
        states.append(RunState(run, status.name, run_id in taken, status.step, own.name == "damaged"))
    return states


def _record_name(name: str, world: str | None) -> str:
    """Return what the record of a study is called.

    Raises:
        UserError: for a world that there is not, or that a shipped study is not run in.
    """
    check_world(world)
    if is_shipped(name):
        return spec.load_study(name, world).name
    stem = Path(name).stem if name.endswith(".toml") else name
    return spec.name_in_world(stem, world)


def _own_record(store: Store, name: str, stem: str) -> dict[str, Any] | None:
    """Return the record of what was run here; None without one, or where it is damaged, which is told.

    Raises:
        UserError: where that is the record of another file of the same name.
    """
    record = store.selection(stem)
    if record is None and store.selection_path(stem).exists() and _has_table(store, stem):
        path = store.selection_path(stem)
        say(f"Note: {path} is damaged; what is published of {stem} is taken instead.", aside=True)
    if record is not None and name.endswith(".toml"):
        execute.check_same_file(record, Path(name), store)
    return record


def _published_record(store: Store, study: str) -> dict[str, Any] | None:
    if not _has_table(store, study):
        return None
    from pneuma.analysis.published import read_published

    return read_published(store, study).record


def _has_table(store: Store, study: str) -> bool:
    """Tell whether a study has a published table in a results folder, damaged or not."""
    if not (store.root / "published").is_dir():
        return False
    from pneuma.analysis.published import published_path

    return published_path(store, study).exists()


def _is_asked_for(name: str) -> bool:
    """Tell whether a name is a study that may be loaded: a shipped one, or a file that a person names.

    A file that a record names may be a stranger's, and loading it would run the reward that it names.
    """
    return name.endswith(".toml") or is_shipped(name)


def _only_picks(record: Mapping[str, Any], selection: plan.Selection, asked_for: bool) -> bool:
    """Tell whether a selection is to be picked from a record's runs, not planned.

    Raises:
        UserError: where an option would need a plan that cannot or must not be made.
    """
    others = {
        "--preset": selection.preset,
        "--steps": selection.steps,
        "--engine": selection.engine,
        "--set": selection.settings,
    }
    given = [option for option, value in others.items() if value]
    source = record.get("source", "runs")
    if source != "tensorboard" and asked_for:
        own = _brought_along(record, selection)
        if own and given:
            raise UserError(
                f"{given[0]}: the record of study {record['study']} would {' and '.join(own)}: give that by "
                "--set yourself, or pick with --condition and --seeds alone"
            )
        return not given and (source != "runs" or bool(own))
    if given:
        what = "was imported" if source == "tensorboard" else "is no shipped study"
        mend = "" if source == "tensorboard" else ", or name its file (….toml)"
        raise UserError(
            f"{given[0]}: study {record['study']} {what}: --condition and --seeds alone pick{mend}"
        )
    return True


def _brought_along(record: Mapping[str, Any], selection: plan.Selection) -> list[str]:
    """Return what a record's settings, and nothing that a person gives, would run or read."""
    if selection.preset or "selection" not in record:
        return []
    settings = recorded_selection(record).settings or {}
    given = selection.settings or {}
    return [said for key, said in own_things(settings).items() if given.get(key) != settings[key]]


def recorded_selection(record: Mapping[str, Any]) -> plan.Selection:
    """Return the selection of a record, which may be a stranger's.

    Raises:
        UserError: for one that makes no sense.
    """
    try:
        latest = execute.recorded_selection(record)
    except (KeyError, TypeError, ValueError):
        latest = None
    if latest is None or not _makes_sense(latest):
        raise UserError(f"the record of study {record['study']} is damaged: run the study again")
    return latest


def _makes_sense(selection: plan.Selection) -> bool:
    return (
        all(isinstance(text, str | None) for text in (selection.preset, selection.engine))
        and isinstance(selection.steps, int | None)
        and all(isinstance(name, str) for name in selection.conditions)
        and all(isinstance(seed, int) for seed in selection.seeds or ())
        and isinstance(selection.settings, dict | None)
    )


def _pick(record: Mapping[str, Any], selection: plan.Selection) -> dict[str, Any]:
    """Return a record with only the conditions and seeds of a selection."""
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
    path = store.selection_path(stem)
    told = f"{name} --world {world}" if world else name
    if path.exists():
        anew = f"`pneuma study run {told}` writes it" if _is_asked_for(name) else "import or fork its runs"
        return UserError(f"{path}: damaged; {anew} anew")
    if not _is_asked_for(name):
        known = sorted({*spec.list_studies(), *store.studies(), *spec.files_called(name)})
        where = "" if store.root.is_dir() else f"; and --results {store.root} is no folder"
        return UserError(f"{unknown_name('study', name, known)}{where}")
    return UserError(
        f"study {stem} has no runs in {store.root}: run `pneuma study run {told}` first, "
        "or name the folder with --results"
    )
