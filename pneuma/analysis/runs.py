"""The runs of exactly a plan's cells.

    Query → `plan_to_read`: as the study was last run here, or else its preset `paper`
    Plan and `RunIndex.frame` → `runs_of_plan`: the run of each cell, here or published
    `open_study` → StudyData: those that have finished, with their rows

A run counts for a cell if its fields are the cell's. Nothing else is shown: no other seed or budget, and no
run that another study trained for itself. Studies without a file (imported logs, published forks) list their
runs.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from pneuma.analysis.study_data import StudyData
from pneuma.config import Run, as_fields
from pneuma.errors import UserError, unknown_name
from pneuma.presets import TEXT
from pneuma.store.index import RunIndex
from pneuma.store.last_queries import last_query, noted_studies, on_top_of_last
from pneuma.store.store import FINISHED
from pneuma.study.identity import config_id
from pneuma.study.plan import Plan, Query, configure, default_preset, make_plan, query_words
from pneuma.study.shipped import list_studies
from pneuma.study.spec import CLAIMS, LAST, PAPER, Study, load_study, results_words

Say = Callable[[str], object]
UNSET: tuple[Any, ...] = (None, False, 0, "", [], {})
"""Values of fields that a version of Pneuma knew which this one does not, if they were not set."""
FORMER_DEFAULTS = {"weapons": ["own"], "bodies": "block", "coast": "wall", "slow_factor": 0.5}
"""The same, of fields that had another default."""


def silent(message: str) -> None:
    """Say nothing."""


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
    preset = query.preset or (PAPER if PAPER in study.presets else default_preset(study))
    return _make_plan(index, study, replace(query, preset=preset))


def _make_plan(index: RunIndex, study: Study, query: Query) -> Plan:
    if query.preset == CLAIMS:
        from pneuma.analysis.claims.fixed_runs import with_claims

        study = with_claims(study, query.steps)
    return make_plan(study, query, index.engine_of)


# --- Which runs ----------------------------------------------------------------------------------------


def find_study(index: RunIndex, query: Query) -> StudyData:
    """Return the runs of a query's cells, finished or not; there may be none.

    Raises:
        UserError: as `plan_to_read`.
    """
    of_file = query.study in list_studies() or query.study.endswith(".toml")
    if not of_file and (listing := index.listing(query.study)) is not None:
        return _find_listed(index, listing, query)
    plan = plan_to_read(index, query)
    data = runs_of_plan(index, plan)
    return replace(data, asked=query, other_presets=_count_other_presets(index, plan))


def configurations_of(
    index: RunIndex, name: str, world: str | None
) -> tuple[Study, dict[str, Mapping[str, Any]], Mapping[str, Run]]:
    """Return a study, and the fields and configuration of all its conditions.

    A study without a file has no configurations.
    """
    if (listing := index.listing(name)) is not None and name not in list_studies():
        data = _find_listed(index, listing, Query(study=name))
        return data.study, dict(data.fields), {}
    study = load_study(name, world, index.listings(), index.store.studies)
    runs = configure(study, {}, engine=index.engine_of).runs
    return study, {condition: without_amount(as_fields(run)) for condition, run in runs.items()}, runs


def runs_of_plan(index: RunIndex, plan: Plan) -> StudyData:
    """Return the runs of a plan's cells, finished or not.

    Of a cell that has no run of the present version of rules, engine and the user's own files, the newest one
    of another version counts.
    """
    cells = _cell_frame(plan)
    columns = ["run_id", "config_id", "seed", "steps", "status", "end", "where"]
    stored = index.frame[columns].reset_index(drop=True)
    runs = cells.merge(stored, on=["config_id", "seed", "steps"], how="inner")
    lacking = cells.merge(runs[["condition", "seed", "steps"]], how="left", indicator=True)
    lacking = lacking[lacking["_merge"] == "left_only"]
    if len(lacking):
        older = _runs_of_older_versions(index, stored, lacking, plan.configurations)
        runs = pd.concat([runs, older], ignore_index=True)
    order = cells.reset_index().rename(columns={"index": "place"})[["condition", "seed", "place"]]
    runs = runs.merge(order, on=["condition", "seed"]).sort_values("place", kind="stable", ignore_index=True)
    fields = {condition: without_amount(as_fields(run)) for condition, run in plan.configurations.items()}
    return StudyData(plan.study, fields, runs.drop(columns="place"), plan.configurations, plan=plan)


def _cell_frame(plan: Plan) -> pd.DataFrame:
    """Return the cells of a plan: condition, seed, steps and config_id."""
    ids = {condition: config_id(run) for condition, run in plan.configurations.items()}
    rows = [(cell.condition, cell.seed, cell.run.steps, ids[cell.condition]) for cell in plan.cells]
    return pd.DataFrame(rows, columns=["condition", "seed", "steps", "config_id"])


def _runs_of_older_versions(
    index: RunIndex, stored: pd.DataFrame, lacking: pd.DataFrame, configurations: Mapping[str, Run]
) -> pd.DataFrame:
    """Return finished runs that have the fields of cells, but were trained by other versions."""
    finished = stored[stored["status"].isin(FINISHED)]
    candidates = lacking[["condition", "seed", "steps"]].merge(finished, on=["seed", "steps"])
    kept = []
    for (condition, _), runs in candidates.groupby(["condition", "config_id"], sort=False):
        run_id = str(runs["run_id"].iloc[0])
        if have_same_fields(as_fields(configurations[str(condition)]), index.fields_of(run_id)):
            kept.append(runs.assign(started=[index.started(each) for each in runs["run_id"]]))
    if not kept:
        return candidates.iloc[:0]
    newest_first = pd.concat(kept).sort_values("started", ascending=False, kind="stable")
    return newest_first.drop_duplicates(["condition", "seed"]).drop(columns="started")


def have_same_fields(fields: Mapping[str, Any], stored: Mapping[str, Any]) -> bool:
    """Return whether a stored run has the fields of a run, apart from seed and steps.

    Files and modules of the user's own count by their names.
    """
    if not stored:
        return False
    wanted, defaults = without_amount(fields), as_fields(Run())
    for name, value in without_amount(stored).items():
        if name not in wanted:
            if value not in UNSET and value != FORMER_DEFAULTS.get(name):
                return False
        elif _with_bare_names(value) != _with_bare_names(wanted[name]):
            return False
    return all(wanted[name] == defaults[name] for name in wanted if name not in stored)


def _with_bare_names(value: Any) -> Any:
    """Return a field's value with the user's own files by their names alone."""
    if isinstance(value, list | tuple):
        return tuple(_with_bare_names(part) for part in value)
    if isinstance(value, str) and value.startswith("/"):
        file, colon, inside = value.partition(":")
        return Path(file).name.removesuffix(".py") + colon + inside
    return value


def without_amount(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields without seed and steps."""
    return {name: value for name, value in fields.items() if name not in ("seed", "steps")}


def _count_other_presets(index: RunIndex, plan: Plan) -> dict[str, int]:
    """Return how many finished runs the other presets of a plan's study have, where there are any."""
    finished = index.frame[index.frame["status"].isin(FINISHED)]
    keys = {*zip(finished["config_id"], finished["seed"], finished["steps"], strict=True)}
    counts: dict[str, int] = {}
    if plan.query.settings:
        return counts
    for preset in plan.study.presets:
        if preset != plan.preset:
            other = _cell_frame(make_plan(plan.study, Query(preset=preset), index.engine_of))
            cells = zip(other["config_id"], other["seed"], other["steps"], strict=True)
            count = sum(cell in keys for cell in cells)
            if count:
                counts[preset] = count
    return counts


def _find_listed(index: RunIndex, listing: Mapping[str, Any], query: Query) -> StudyData:
    """Return the runs of a study without a file, which lists them."""
    name = listing["study"]
    every: dict[str, dict[str, Any]] = {run["condition"]: {} for run in listing["runs"]}
    for condition in query.conditions:
        if condition not in every:
            raise unknown_name(f"condition of study {name}", condition, every)
    if query.settings or query.preset:
        raise UserError(f"study {name} has no file: it has neither presets nor fields that can be changed")
    listed = pd.DataFrame(listing["runs"])[["run_id", "condition", "seed"]]
    listed = listed.drop_duplicates("run_id", keep="last")
    listed = listed[listed["condition"].isin(query.conditions or every)]
    if query.seeds is not None:
        listed = listed[listed["seed"].isin(query.seeds)]
    runs = listed.merge(index.frame.drop(columns="seed").reset_index(drop=True), on="run_id")
    if query.steps:
        runs = runs[runs["steps"] == query.steps]
    runs = runs.sort_values("seed", kind="stable", ignore_index=True)
    study = _listed_study(listing, every)
    finished = finished_rows(index, StudyData(study, {}, runs)).runs
    fields: dict[str, Mapping[str, Any]] = {
        condition: {} for condition in every if condition in {*listed["condition"]}
    }
    for condition, row in zip(finished["condition"], finished["row"], strict=True):
        fields[condition] = without_amount(row.fields)
    return StudyData(study, fields, runs, asked=query)


def _listed_study(listing: Mapping[str, Any], conditions: Mapping[str, Any]) -> Study:
    name, title, baseline = listing["study"], listing["title"], listing["baseline"]
    return Study.without_file(name, title, conditions, baseline=baseline, worlds=(TEXT,))


# --- Their rows -----------------------------------------------------------------------------------------


def finished_rows(index: RunIndex, data: StudyData) -> StudyData:
    """Return a study with its finished runs alone, and their rows; there may be none."""
    runs = data.finished
    rows = pd.Series([index.row(run_id) for run_id in runs["run_id"]], runs.index, dtype=object)
    return replace(data, runs=runs.assign(row=rows).dropna(subset="row").reset_index(drop=True))


def read_runs(index: RunIndex, data: StudyData, say: Say = silent) -> StudyData:
    """Return a study with its finished runs and their rows; a UserError if there are none."""
    finished = finished_rows(index, data)
    for problem in index.problems:
        say(f"Note: {problem}.")
    if not len(finished.runs):
        raise UserError(_nothing_text(index, data))
    return finished


def open_study(index: RunIndex, query: Query, say: Say = silent) -> StudyData:
    """Return the finished runs of a query's cells, with their rows.

    Args:
        index: the runs of a results folder, and published ones.
        query: its study may be listed, a shipped one, or a file.
        say: is called with a line on what is shown, and with notes.

    Raises:
        UserError: as `plan_to_read`, or when none of the cells has a finished run.
    """
    data = find_study(index, query)
    opened = read_runs(index, data)
    say(data.text(index.store.root))
    for problem in index.problems:
        say(f"Note: {problem}.")
    return opened


def _nothing_text(index: RunIndex, data: StudyData) -> str:
    """Return the message that no cell has a finished run: what trains them, and what else there is."""
    if data.plan is None:
        return f"study {data.study.name} has no finished run in {index.store.root}"
    problems = "".join(f" {problem}." for problem in index.problems)
    words = ["pneuma", "study", "run", *query_words(data.plan), *results_words(index.store.root)]
    return f"{data.text(index.store.root)} Train them with `{shlex.join(words)}`.{problems}"


def studies_here(index: RunIndex, world: str | None = None) -> Iterator[StudyData]:
    """Yield the studies that were run in the results folder, in each world: the runs of their last query."""
    for name, noted_world in noted_studies(index.store):
        if world in (None, noted_world):
            with suppress(UserError, OSError, ValueError):  # its file is damaged or has gone
                yield find_study(index, Query(name, noted_world, LAST))
    if world is None:
        for name in index.store.listings():
            with suppress(UserError):
                data = find_study(index, Query(name))
                if (data.runs["where"] == "").any():
                    yield data
