"""Which runs a study's name stands for: its latest selection, one of its own, or what is published."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pneuma.errors import UserError, unknown_name
from pneuma.study import execute, plan, spec
from pneuma.study.store import Store


def study_record(store: Store, name: str, selection: plan.Selection | None) -> dict[str, Any]:
    """Return a study's latest record, or the one of a selection; what that leaves open is the latest's.

    A study that was never run here is the published one, where there is one.

    Raises:
        UserError: for a study that is nowhere, or a selection that it does not have.
    """
    stem = Path(name).stem if name.endswith(".toml") else name
    record = store.selection(stem) or _published_record(store, stem)
    if record is None and selection is None:
        raise _unknown(store, name, stem)
    if selection is None:
        return record or {}
    if record is not None and _only_picks(record, selection):
        return _pick(record, selection)
    own = name if name.endswith(".toml") or not record else record["path"] or name
    study = spec.load_study(own)
    latest = execute.recorded_selection(record) if record and "selection" in record else plan.Selection()
    return execute.selection_record(plan.make_plan(study, selection.over(latest)))


def known_studies(store: Store) -> list[str]:
    """Return the names of the studies that were run, imported or published here, sorted."""
    if not (store.root / "published").is_dir():
        return store.studies()
    from pneuma.analysis.published import published_studies

    return sorted({*store.studies(), *published_studies(store)})


def run_states(store: Store, record: Mapping[str, Any]) -> list[tuple[dict[str, Any], str]]:
    """Return every run of a record with the name of its status, as published where no run is stored.

    Raises:
        UserError: when the published table is damaged.
    """
    states = [(run, store.status(run["run_id"]).name) for run in record["runs"]]
    if any(state != "planned" for _, state in states):
        return states
    from pneuma.analysis.published import published_path, read_published

    if not published_path(store, record["study"]).exists():
        return states
    published = read_published(store, record["study"])
    return [(run, published.status(run["run_id"]).name) for run in record["runs"]]


def _published_record(store: Store, study: str) -> dict[str, Any] | None:
    if not (store.root / "published").is_dir():
        return None
    from pneuma.analysis.published import published_path, read_published

    return read_published(store, study).record if published_path(store, study).exists() else None


def _only_picks(record: Mapping[str, Any], selection: plan.Selection) -> bool:
    """Tell whether a selection is to be picked from a record of runs that no plan can name.

    Raises:
        UserError: where an option has no meaning for imported logs or forks.
    """
    others = {
        "--preset": selection.preset,
        "--steps": selection.steps,
        "--engine": selection.engine,
        "--set": selection.settings,
    }
    given = [option for option, value in others.items() if value]
    source = record.get("source", "runs")
    if source == "runs" and (record.get("path") or record["study"] in spec.list_studies()):
        return False
    if source in ("tensorboard", "runs") and given:
        what = "was imported" if source == "tensorboard" else "has no file of its own"
        raise UserError(f"{given[0]}: study {record['study']} {what}: --condition and --seeds alone pick")
    return not given


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


def _unknown(store: Store, name: str, stem: str) -> UserError:
    path = store.root / "studies" / f"{stem}.json"
    if path.exists():
        return UserError(f"{path}: damaged; `pneuma study run {name}` writes it anew")
    if stem not in spec.list_studies() and not name.endswith(".toml"):
        return unknown_name("study", name, sorted({*spec.list_studies(), *store.studies()}))
    return UserError(
        f"study {stem} has no runs in {store.root}: run `pneuma study run {name}` first, "
        "or name the folder with --results"
    )
