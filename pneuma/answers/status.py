"""The progress of studies' runs."""

from __future__ import annotations

from collections import Counter
from typing import Any

import pandas as pd

from pneuma.analysis.runs import plan_to_read, runs_of_plan, studies_here
from pneuma.analysis.study_data import StudyData
from pneuma.answers.answer import Answer
from pneuma.errors import tallied
from pneuma.store.index import RunIndex
from pneuma.store.store import FINISHED
from pneuma.study.plan import Query
from pneuma.values import shown_settings

STATES = ("done", "diverged", "published", "running", "partial", "crashed", "killed", "damaged", "planned")
"""States of runs, in the order of columns."""
HEADS = ["preset", "condition", "runs"]


def study_status(index: RunIndex, data: StudyData) -> Answer:
    """Count the runs of each condition of a study's presets by their states.

    Args:
        index: the runs of a results folder.
        data: of `find_study`; its plan is shown first.

    Returns:
        The table `presets` has a row for each preset and condition, or one for a preset without runs.
    """
    assert data.plan is not None, "a study that lists its runs has no presets"
    query, first = data.plan.query, data.plan.preset
    if query.seeds or query.steps or query.conditions or query.settings:
        first = "as asked"
    rows = _count_states(first, data)
    for preset in data.study.presets:
        if preset != first:
            plan = plan_to_read(index, Query(data.study.file, data.study.world, preset))
            rows += _count_states(preset, runs_of_plan(index, plan))
    table = pd.DataFrame(rows).fillna(0)
    states = [state for state in STATES if state in table]
    table = table[HEADS + states].astype(dict.fromkeys(states, int))
    cells = table.astype(object).replace(0, "")
    about = {"study": data.study.name, "world": data.world or None}
    return Answer("", about, {"presets": table}, [cells])


def _count_states(preset: str, data: StudyData) -> list[dict[str, Any]]:
    """Return how many runs of each condition are in which state; one row if none is stored."""
    assert data.plan is not None
    planned = Counter(cell.condition for cell in data.plan.cells)
    if not len(data.runs):
        total = planned.total()
        return [{"preset": preset, "condition": f"all {len(planned)}", "runs": total, "planned": total}]
    states = data.runs["status"].where(data.runs["where"] == "", "published")
    rows = []
    for condition, count in planned.items():
        counts = Counter(states[data.runs["condition"] == condition])
        counts["planned"] += count - counts.total()
        rows.append({"preset": preset, "condition": condition, "runs": count, **+counts})
    return rows


def runs_status(data: StudyData) -> Answer:
    """List each run of a study's cells with its state."""
    runs = data.runs[["run_id", "condition", "seed", "status"]]
    runs = runs.assign(step=data.runs["end"], published=data.runs["where"] != "")
    states = []
    for run in runs.to_dict("records"):
        state = run["status"]
        if run["published"]:
            state += " as published"
        elif state not in FINISHED and run["step"]:
            state += f" at step {run['step']:,}"
        states.append(state)
    cells = runs[["condition", "seed", "run_id"]].assign(state=states).rename(columns={"run_id": "run"})
    return Answer("", {"study": data.study.name}, {"runs": runs}, [cells])


def studies_status(index: RunIndex, world: str | None) -> Answer:
    """Count the runs of each study that was run in a results folder by their states."""
    studies, rows = [], []
    for data in studies_here(index, world):
        runs = data.runs.drop_duplicates("run_id").rename(columns={"end": "step"})
        study = {
            "study": data.study.own_path or data.study.name,
            "world": data.study.world if data.study.path else "",
            "changed": shown_settings(data.study.settings),
        }
        studies.append({**study, "runs": runs[["run_id", "status", "step"]].to_dict("records")})
        rows.append({**study, "runs": tallied(runs["status"])})
    title = "" if rows else f"No study was run in {index.store.root} yet."
    columns = ["study", "world", "changed", "runs"]
    table = pd.DataFrame(studies, columns=columns)
    return Answer(title, {}, {"studies": table}, [pd.DataFrame(rows, columns=columns)])
