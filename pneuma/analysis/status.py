"""The progress of studies' runs."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pandas as pd

from pneuma.analysis.answer import Answer
from pneuma.analysis.runs import plan_to_read, runs_of_plan, studies_here
from pneuma.analysis.study_data import StudyData
from pneuma.errors import tallied
from pneuma.store.index import RunIndex
from pneuma.store.store import FINISHED
from pneuma.study.plan import Query
from pneuma.values import format_settings

STATES = ("done", "diverged", "published", "running", "partial", "crashed", "killed", "damaged", "planned")
"""States of runs, in the order of columns."""
HEADS = ["preset", "condition", "runs"]


def study_status(index: RunIndex, study_data: StudyData) -> Answer:
    """Count the runs of each condition of a study's presets by their states.

    Args:
        index: the runs of a results folder.
        study_data: of `find_study`; its plan is shown first.

    Returns:
        The table `presets` has a row for each preset and condition, or one for a preset without runs.
    """
    assert study_data.plan is not None, "a study that lists its runs has no presets"
    query, first_preset = study_data.plan.query, study_data.plan.preset
    if query.seeds or query.steps or query.conditions or query.settings:
        first_preset = "as asked"
    count_rows = _count_states(first_preset, study_data)
    for preset in study_data.study.presets:
        if preset != first_preset:
            plan = plan_to_read(index, Query(study_data.study.file, study_data.study.world, preset))
            count_rows += _count_states(preset, runs_of_plan(index, plan))
    count_table = pd.DataFrame(count_rows).fillna(0)
    states = [state for state in STATES if state in count_table]
    count_table = count_table[HEADS + states].astype(dict.fromkeys(states, int))
    cells = count_table.astype(object).replace(0, "")
    about = {"study": study_data.study.name, "world": study_data.world or None}
    return Answer("", about, {"presets": count_table}, [cells])


def _count_states(preset: str, study_data: StudyData) -> list[dict[str, Any]]:
    """Return how many runs of each condition are in which state; one row if none is stored."""
    assert study_data.plan is not None
    planned_counts = Counter(cell.condition for cell in study_data.plan.cells)
    if not len(study_data.runs):
        total = planned_counts.total()
        all_conditions = f"all {len(planned_counts)}"
        return [{"preset": preset, "condition": all_conditions, "runs": total, "planned": total}]
    run_states = study_data.runs["status"].where(study_data.runs["where"] == "", "published")
    count_rows = []
    for condition, planned_count in planned_counts.items():
        state_counts = Counter(run_states[study_data.runs["condition"] == condition])
        state_counts["planned"] += planned_count - state_counts.total()
        count_rows.append({"preset": preset, "condition": condition, "runs": planned_count, **+state_counts})
    return count_rows


def runs_status(study_data: StudyData) -> Answer:
    """List each run of a study's cells with its state."""
    runs = study_data.runs[["run_id", "condition", "seed", "status"]]
    runs = runs.assign(step=study_data.runs["end"], published=study_data.runs["where"] != "")
    state_texts = []
    for run in runs.to_dict("records"):
        state = run["status"]
        if run["published"]:
            state += " as published"
        elif state not in FINISHED and run["step"]:
            state += f" at step {run['step']:,}"
        state_texts.append(state)
    cells = runs[["condition", "seed", "run_id"]].assign(state=state_texts).rename(columns={"run_id": "run"})
    return Answer("", {"study": study_data.study.name}, {"runs": runs}, [cells])


def studies_status(index: RunIndex, world: str | None) -> Answer:
    """Count the runs of each study that was run in a results folder by their states."""
    study_rows, cell_rows = [], []
    for study_data in studies_here(index, world):
        runs = study_data.runs.drop_duplicates("run_id").rename(columns={"end": "step"})
        study_facts = {
            "study": study_data.study.file,
            "world": study_data.study.world if study_data.study.path else "",
            "changed": format_settings(study_data.study.settings),
        }
        study_rows.append({**study_facts, "runs": runs[["run_id", "status", "step"]].to_dict("records")})
        cell_rows.append({**study_facts, "runs": tallied(runs["status"])})
    title = "" if cell_rows else f"No study was run in {index.store.root} yet."
    columns = ["study", "world", "changed", "runs"]
    study_table = pd.DataFrame(study_rows, columns=columns)
    return Answer(title, {}, {"studies": study_table}, [pd.DataFrame(cell_rows, columns=columns)])
