"""The runs that a study's name stands for: recorded in a results folder, or else published."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from pneuma.errors import UserError, unknown_name
from pneuma.study import spec
from pneuma.study.plan import Selection
from pneuma.study.store import Store
from pneuma.worlds import WORLDS, chosen_world, in_world, split_world

ALL = Selection()


def study_record(
    store: Store,
    name: str,
    picked: Selection = ALL,
    world: str | None = None,
    tell: Callable[[str], object] = lambda message: None,
) -> dict[str, Any]:
    """Return the record of a study or variant, with the runs that a selection picks.

    If the study was run with several budgets, this is the one with `picked.steps`, or else the one with the
    most finished runs. Of equal budgets, as after its file was edited, it is the latest. A study that was
    run only in another world is returned as it was run, even if its runs are published; one that was run
    only with changed fields likewise, if they are not. `tell` is then called.

    Raises:
        UserError: where nothing is stored, or nothing that is picked.
    """
    asked = world
    study, world = chosen_world(Path(name).stem if name.endswith(".toml") else name, world)
    stem = spec.name_in_world(study, world)
    # A study in the first world of its file has a name without a world.
    names = dict.fromkeys([stem, study] if world else [stem])

    def of_world(records: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
        return [record for record in records if world in (None, spec.world_of(record))]

    records = next(filter(None, (of_world(store.selections(each)) for each in names)), [])
    if records and name.endswith(".toml"):
        store.check_same_file(records[0], Path(name))
    otherwise = [] if records or asked else related_studies(store, stem)
    own_world = [other for other in otherwise if spec.VARIANT not in other and store.selections(other)]
    tables = [] if records or own_world else [each for each in names if store.published_path(each).exists()]
    if tables:
        from pneuma.analysis.published import read_published

        of_tables = (of_world([read_published(store, each).record]) for each in tables)
        records = next(filter(None, of_tables), [])
    if not records and (otherwise := own_world or otherwise):
        more = f" Stored too: {'; '.join(otherwise[1:])}." if otherwise[1:] else ""
        tell(f"Note: no runs of {stem} are stored; {otherwise[0]} is shown.{more}")
        return study_record(store, otherwise[0], picked)
    if not records:
        raise _unknown(store, name, stem, world)
    asked_for = (record for record in records if picked.steps is None or _has_steps(record, picked.steps))
    fitting = [*by_budget(asked_for).values()]
    if not fitting:
        stored = ", ".join(f"{steps:,}" for steps in by_budget(records))
        raise UserError(f"--steps {picked.steps}: study {records[0]['study']} has runs of {stored} steps")
    return _pick(fitting[0] if len(fitting) == 1 else max(fitting, key=store.finished), picked)


def related_studies(store: Store, study: str) -> list[str]:
    """Return the study's variants and other worlds that are stored, those of its own world first."""
    study_name, world = split_world(study)
    elsewhere = (in_world(study_name, other) for other in WORLDS)
    names = {*known_studies(store), *(name for name in elsewhere if store.published_path(name).exists())}
    found = [
        name
        for name in sorted(names - {study})
        if split_world(name)[0].partition(spec.VARIANT)[0] == study_name
    ]
    return sorted(found, key=lambda name: split_world(name)[1] != world)


def _pick(record: Mapping[str, Any], picked: Selection) -> dict[str, Any]:
    """Return a record with only the conditions and seeds of a selection, which also name its figures."""
    known = list(dict.fromkeys(run["condition"] for run in record["runs"]))
    for name in picked.conditions:
        if name not in known:
            raise unknown_name(f"condition of study {record['study']}", name, known)
    wanted = picked.conditions or known
    known_seeds = {run["seed"] for run in record["runs"]}
    seeds = known_seeds if picked.seeds is None else {*picked.seeds}
    runs = [run for run in record["runs"] if run["condition"] in wanted and run["seed"] in seeds]
    if record["runs"] and not runs:
        raise UserError(f"--seeds: study {record['study']} has none of these; it has {sorted(known_seeds)}")
    conditions = {run["condition"] for run in runs}
    same = [[name for name in names if name in conditions] for names in record["same"]]
    narrowed = [*(wanted if conditions < {*known} else ())]
    narrowed += ["seeds", *map(str, sorted(seeds & known_seeds))] if not known_seeds <= seeds else []
    same = [names for names in same if len(names) > 1]
    return {**record, "runs": runs, "same": same, "picked": narrowed, "every": known}


def _unknown(store: Store, name: str, stem: str, world: str | None) -> UserError:
    if is_shipped(stem):
        spec.load_study(split_world(stem)[0], world)  # refuses a world in which it is not run
    elif world and (store.selection(stem) or store.published_path(stem).exists()):
        return UserError(f"study {stem} has no runs of the world {world} in {store.root}")
    if store.selection_path(stem).exists():
        return UserError(f"{store.selection_path(stem)}: damaged; run, import or fork its runs anew")
    if name.endswith(".toml") and not Path(name).exists():
        return UserError(f"{name}: there is no such file, and no runs of it in {store.root}")
    if is_shipped(stem) or name.endswith(".toml"):
        ran = f"run `{spec.run_command(stem, name if name.endswith('.toml') else None)}` first"
        return UserError(f"study {stem} has no runs in {store.root}: {ran}, or give --results")
    if elsewhere := related_studies(store, stem):
        return UserError(f"study {stem} has no runs in {store.root}, which has {', '.join(elsewhere)}")
    return unknown_name("study", name, sorted({*spec.list_studies(), *known_studies(store)}))


# --- Names ------------------------------------------------------------------------------------------


def is_shipped(name: str) -> bool:
    """Return whether a name is that of a shipped study, in any world."""
    return split_world(name)[0] in spec.list_studies()


def known_studies(store: Store, world: str | None = None) -> list[str]:
    """Return the names of studies that were run, imported or published here, in `world` if given.

    Names that end in .toml are left out, as only users may name files.
    """
    names = {*store.studies(), *store.published(shipped=False)}
    return sorted(
        name
        for name in names
        if not name.endswith(".toml") and (world is None or world == _world_of(store, name))
    )


def _world_of(store: Store, name: str) -> str:
    """Return the world of a study that was run or published here; by its name alone if it is damaged."""
    from pneuma.analysis.published import read_published

    try:
        return spec.world_of(store.selection(name) or read_published(store, name).record)
    except UserError:
        return spec.world_of({"study": name})


def studies_run_here(store: Store, world: str | None = None) -> list[str]:
    """Return the names of studies that were run or imported here; if there are none, of published ones."""
    names, recorded = known_studies(store, world), {*store.studies()}
    return [name for name in names if name in recorded] or names


def steps_of(record: Mapping[str, Any]) -> int:
    """Return the steps that round up to the budget of every run; if none do, the largest budget."""
    steps = [run["run"]["steps"] for run in record["runs"]] or [0]
    return min(steps) if _rounded_up(min(steps), record) == steps else max(steps)


def by_budget(records: Iterable[dict[str, Any]]) -> dict[int, dict[str, Any]]:
    """Return the latest of a study's selections of each budget; they come latest first."""
    latest: dict[int, dict[str, Any]] = {}
    for record in records:
        latest.setdefault(steps_of(record), record)
    return latest


def _has_steps(record: Mapping[str, Any], steps: int) -> bool:
    """Return whether a record's runs have so many steps, rounded up; of unlike budgets, the largest."""
    budgets, rounded = [run["run"]["steps"] for run in record["runs"]], _rounded_up(steps, record)
    unlike = _rounded_up(steps_of(record), record) != budgets
    return rounded == budgets or (unlike and max(rounded) == max(budgets))


def _rounded_up(steps: int, record: Mapping[str, Any]) -> list[int]:
    """Return a number of steps rounded up to whole updates of each of a record's runs."""
    fields = [[run["run"].get(key) or 1 for key in ("horizon", "slots", "players")] for run in record["runs"]]
    return [math.ceil(steps / update) * update for update in map(math.prod, fields)]
