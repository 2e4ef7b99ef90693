"""The runs of exactly a plan's cells.

    Query → `plan_to_read`: as the study was last run here, or else its preset `paper`
    Plan and `RunIndex.frame` → `runs_of_plan`: the run of each cell, here or published
    `open_study` → StudyData: those that have finished, with their rows

A run counts for a cell if its fields are the cell's. Nothing else is shown: no other seed or budget, and no
run that another study trained for itself. Studies without a file (imported logs) list their runs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from typing import Any

import pandas as pd

from pneuma.analysis.study_data import StudyData
from pneuma.config import Run, as_fields
from pneuma.errors import Say, UserError, silent, unknown_name
from pneuma.presets import TEXT
from pneuma.store.index import COLUMNS, RunIndex, StoredRun
from pneuma.store.last_queries import last_query, noted_studies, on_top_of_last
from pneuma.store.store import FINISHED
from pneuma.study.identity import comparable_fields, config_id
from pneuma.study.plan import Cell, Plan, Query, configure, default_preset, make_plan
from pneuma.study.shipped import list_studies
from pneuma.study.spec import CLAIMS, LAST, PAPER, Study, load_study

# --- Which plan ----------------------------------------------------------------------------------------


def plan_to_read(index: RunIndex, query: Query) -> Plan:
    """Return the plan of a query of a study with a file.

    What the query leaves open is as in the study's last `study run` here, in this world; if there was none,
    as in its preset `paper`, or else as `study run` would train it.

    Raises:
        UserError: for an unknown study, world, preset or condition, or fields that do not go together.
    """
    study = load_study(query.study, query.world, index.listings(), index.store.studies)
    if query.preset == LAST:
        return _make_plan(index, study, on_top_of_last(index.store, study.name, study.world, query))
    if query.preset is None and last_query(index.store, study.name, study.world):
        with suppress(UserError):  # the study's file may have changed since
            return _make_plan(index, study, on_top_of_last(index.store, study.name, study.world, query))
    preset = PAPER if PAPER in study.presets else default_preset(study)
    return _make_plan(index, study, replace(query, preset=query.preset or preset))


def _make_plan(index: RunIndex, study: Study, query: Query) -> Plan:
    if query.preset == CLAIMS:
        from pneuma.analysis.claims.preset import with_claims  # which loads SciPy

        study = with_claims(study, query.steps)
    return make_plan(study, query, index.engine_of)


# --- Which runs ----------------------------------------------------------------------------------------


def find_study(index: RunIndex, query: Query) -> StudyData:
    """Return the runs of a query's cells, finished or not; there may be none.

    Raises:
        UserError: as `plan_to_read`.
    """
    listing = _listing(index, query.study)
    if listing is not None:
        return _find_listed(index, listing, query)
    plan = plan_to_read(index, query)
    study_data = runs_of_plan(index, plan)
    return replace(study_data, query=query, other_presets=_count_other_presets(index, plan))


def open_study(index: RunIndex, query: Query, say: Say = silent) -> StudyData:
    """Return the finished runs of a query's cells, with their rows.

    Args:
        index: the runs of a results folder, and published ones.
        query: its study may be listed, a shipped one, or a file.
        say: is called with a message on what is shown, and with notes.

    Raises:
        UserError: as `plan_to_read`, or when none of the cells has a finished run.
    """
    study_data = find_study(index, query)
    opened = finished_rows(index, study_data)
    problems = [f" {problem}." for problem in index.problems]
    if len(opened.runs):
        say(study_data.coverage)
        for problem in problems:
            say(f"Note:{problem}")
        return opened
    if study_data.plan is None:
        raise UserError(f"study {study_data.study.name} has no finished run in {index.store.root}")
    hint = study_data.call("run_study", index.store.root)
    where = f" None is in {index.store.root.resolve()}. Train them with `"
    seeds = query.seeds or ()
    if len(seeds) > 1 and seeds == tuple(range(len(seeds))):
        problems.insert(0, f" {len(seeds)} is a count of seeds; the seed alone is '{len(seeds)},'.")
    raise UserError(*study_data.coverage.parts, where, hint, "`.", *problems)


def finished_rows(index: RunIndex, study_data: StudyData) -> StudyData:
    """Return a study with its finished runs alone, and their rows; there may be none."""
    runs = study_data.finished
    rows = pd.Series(index.rows(runs["run_id"].tolist()), runs.index, dtype=object)
    return replace(study_data, runs=runs.assign(row=rows).dropna(subset="row").reset_index(drop=True))


def studies_here(index: RunIndex, world: str | None = None) -> Iterator[StudyData]:
    """Yield the studies that were run in the results folder, in each world: the runs of their last query."""
    for study_name, noted_world in noted_studies(index.store):
        if world in (None, noted_world):
            with suppress(UserError, OSError, ValueError):  # its file is damaged or has gone
                yield find_study(index, Query(study_name, noted_world, LAST))
    if world is None:
        for study_name in index.store.listings():
            with suppress(UserError):
                study_data = find_study(index, Query(study_name))
                if (study_data.runs["where"] == "").any():
                    yield study_data


def configurations_of(
    index: RunIndex, study_name: str, world: str | None
) -> tuple[Study, dict[str, Mapping[str, Any]], Mapping[str, Run]]:
    """Return a study, and the fields and configuration of all its conditions.

    A study without a file has no configurations.
    """
    listing = _listing(index, study_name)
    if listing is not None:
        study_data = _find_listed(index, listing, Query(study=study_name))
        return study_data.study, dict(study_data.fields), {}
    study = load_study(study_name, world, index.listings(), index.store.studies)
    runs = configure(study, {}, engine=index.engine_of).runs
    return study, _fields_by_condition(runs), runs


def _fields_by_condition(runs: Mapping[str, Run]) -> dict[str, Mapping[str, Any]]:
    return {condition: without_amount(as_fields(run)) for condition, run in runs.items()}


def without_amount(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields without seed and steps."""
    return {field_name: value for field_name, value in fields.items() if field_name not in ("seed", "steps")}


# --- Of a plan -----------------------------------------------------------------------------------------


def runs_of_plan(index: RunIndex, plan: Plan, registered: bool = False) -> StudyData:
    """Return the runs of a plan's cells, finished or not.

    Of a cell that has no run of the present version of rules, engine and the user's own files, the newest one
    of an earlier version counts.

    Args:
        index: the runs of a results folder, and published ones.
        plan: the cells; some may have no run.
        registered: whether the runs on which claims were registered count first: of a cell that was published
            by earlier versions, the earliest. A later one is a replication, which cannot change a verdict.
    """
    configurations = plan.configurations
    config_ids = {condition: config_id(run) for condition, run in configurations.items()}
    fields = {condition: comparable_fields(as_fields(run)) for condition, run in configurations.items()}
    run_rows = []
    for cell in plan.cells:
        cell_id = config_ids[cell.condition]
        runs = [run for run in index.runs_at(cell.seed, cell.run.steps) if run.config_id == cell_id]
        if registered or not runs:
            older_runs = _runs_of_earlier_versions(index, cell, cell_id, fields[cell.condition])
            runs += reversed(older_runs)
            if registered:
                runs = [run for run in older_runs if run.where] + runs
        if runs:
            run_rows.append((cell.condition, *runs[0]))
    run_frame = pd.DataFrame(run_rows, columns=["condition", *COLUMNS])
    return StudyData(plan.study, _fields_by_condition(configurations), run_frame, configurations, plan)


def _runs_of_earlier_versions(
    index: RunIndex, cell: Cell, cell_id: str, fields: Mapping[str, Any]
) -> list[StoredRun]:
    """Return finished runs that have a cell's fields, but were trained by other versions, oldest first.

    Versions before batched 4 and sb3 3 rounded a budget up to whole updates: to what now is trained for it.
    """
    steps, update_steps = cell.run.steps, cell.run.steps_per_update
    rounded_steps = math.ceil(steps / update_steps) * update_steps
    older_runs = []
    for stored_steps in dict.fromkeys((steps, rounded_steps)):
        for stored_run in index.runs_at(cell.seed, stored_steps):
            is_older = stored_run.config_id != cell_id and stored_run.status in FINISHED
            if is_older and index.comparable_fields(stored_run) == fields:
                older_runs.append(stored_run)
    if len(older_runs) > 1:
        older_runs.sort(key=lambda run: str(index.document("provenance", run.run_id).get("started", "")))
    return older_runs


def _count_other_presets(index: RunIndex, plan: Plan) -> dict[str, int]:
    """Return how many finished runs the other presets of a plan's study have, where there are any."""
    run_counts: dict[str, int] = {}
    if plan.query.settings:
        return run_counts
    for preset in plan.study.presets:
        if preset != plan.preset:
            run_count = _count_finished(index, make_plan(plan.study, Query(preset=preset), index.engine_of))
            if run_count:
                run_counts[preset] = run_count
    return run_counts


def _count_finished(index: RunIndex, plan: Plan) -> int:
    """Return how many cells have a finished run of the present version."""
    config_ids = {condition: config_id(run) for condition, run in plan.configurations.items()}
    finished_count = 0
    for cell in plan.cells:
        for run in index.runs_at(cell.seed, cell.run.steps):
            if run.config_id == config_ids[cell.condition] and run.status in FINISHED:
                finished_count += 1
    return finished_count


# --- Of a list -----------------------------------------------------------------------------------------


def _listing(index: RunIndex, study_name: str) -> Mapping[str, Any] | None:
    """Return the record of a study without a file; None for a study with one."""
    return None if study_name in list_studies() or study_name.endswith(".toml") else index.listing(study_name)


def _find_listed(index: RunIndex, listing: Mapping[str, Any], query: Query) -> StudyData:
    """Return the runs of a study without a file, which lists them."""
    study_name, listed_runs = listing["study"], pd.DataFrame(listing["runs"])
    listed_runs = listed_runs[["run_id", "condition", "seed"]].drop_duplicates("run_id", keep="last")
    conditions = list(listed_runs["condition"].unique())
    for condition in query.conditions:
        if condition not in conditions:
            raise unknown_name(f"condition of study {study_name}", condition, conditions)
    if query.settings or query.preset:
        raise UserError(
            f"study {study_name} has no study file, so it has no presets and its settings cannot be changed"
        )
    study = Study.without_file(
        study_name, listing["title"], conditions, baseline=listing["baseline"], worlds=(TEXT,)
    )
    runs = listed_runs.merge(index.frame.drop(columns="seed").reset_index(drop=True), on="run_id")
    if query.conditions:
        conditions = [condition for condition in conditions if condition in query.conditions]
    is_selected = runs["condition"].isin(conditions)
    if query.seeds is not None:
        is_selected &= runs["seed"].isin(query.seeds)
    if query.steps:
        is_selected &= runs["steps"] == query.steps
    runs = runs[is_selected].sort_values("seed", kind="stable", ignore_index=True)
    fields_by_condition: dict[str, Mapping[str, Any]] = dict.fromkeys(conditions, {})
    finished_runs = finished_rows(index, StudyData(study, {}, runs)).runs
    for condition, row in zip(finished_runs["condition"], finished_runs["row"], strict=True):
        fields_by_condition[condition] = without_amount(row.fields)
    return StudyData(study, fields_by_condition, runs, query=query)
