"""What figures of every kind need beside an answer's tables, so that they are drawn without a study.

StudyData of each column of panels → `drawing_of` → `Answer.drawing`
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import pandas as pd

from pneuma.analysis.study_data import StudyData
from pneuma.study.spec import CONDITION, Study

Columns = Mapping[str, StudyData]
"""A study's runs in each column of panels, by its title: an environment or world, or "" for a single one."""


def drawing_of(
    columns: Columns, *suffixes: str, names: Mapping[str, str] | None = None, **parts: Any
) -> dict[str, Any]:
    """Return an answer's `drawing`.

    Args:
        columns: what is drawn.
        suffixes: of the name of its files.
        names: of conditions without a label in a file; default: their own.
        parts: more tables and facts, which figures of this kind need.

    Returns:
        `title` of the study, which has the world if there is one column; `figure`, the study's name for its
        files, and `basename`, that of these; and the tables `conditions` and `runs`.
    """
    first_data = next(iter(columns.values()))
    return {
        "title": first_data.full_title if len(columns) == 1 else first_data.study.title,
        "figure": first_data.study.figure,
        "basename": first_data.basename(*suffixes),
        "conditions": condition_table(columns, names),
        "runs": run_table(columns),
        **parts,
    }


def condition_table(columns: Columns, names: Mapping[str, str] | None = None) -> pd.DataFrame:
    """Return condition, group, color and label of the conditions of all columns, in the files' order.

    Conditions of one group have one colour, unless a file names another; `color` is empty if it names none.
    The label has the number of runs, in each column if it differs, and is empty if there are none.

    Args:
        columns: what is drawn.
        names: of conditions without a label in a file; default: their own.
    """
    rows: dict[str, dict[str, str]] = {}
    for study_data in columns.values():
        study = study_data.study
        for condition in (*study.conditions, *study_data.conditions):
            row = rows.setdefault(
                condition, {"condition": condition, "group": _group(study, condition), "color": ""}
            )
            row["color"] = row["color"] or study.colors.get(condition) or study.colors.get(row["group"]) or ""
    for condition, row in rows.items():
        row["label"], run_counts = (names or {}).get(condition, condition), []
        for study_data in columns.values():
            row["label"] = study_data.study.labels.get(condition, row["label"])
            run_counts.append(len(study_data.of_condition(condition)))
        if len(set(run_counts)) == 1:
            run_counts = run_counts[:1]
        row["label"] += f" ({', '.join(map(str, run_counts))})"
        if not any(run_counts):
            row["label"] = ""
    return pd.DataFrame(list(rows.values()))


def _group(study: Study, condition: str) -> str:
    """Return the condition of a crossed study's file that a condition is of, or its last factor's value."""
    levels = study.levels.get(condition, {})
    return levels.get(CONDITION) or [condition, *levels.values()][-1]


def run_table(columns: Columns) -> pd.DataFrame:
    """Return environment (the column's title), study, condition, seed, config_id and steps of each run."""
    run_frames: list[pd.DataFrame] = []
    for title, study_data in columns.items():
        for condition in study_data.conditions:
            runs = study_data.runs[study_data.runs["condition"] == condition]
            run_facts = runs[["condition", "seed", "config_id", "steps"]]
            run_frames.append(run_facts.assign(environment=title, study=study_data.study.name))
    return pd.concat(run_frames, ignore_index=True)


def short_names(studies: Iterable[StudyData]) -> tuple[dict[str, str], str]:
    """Return names of conditions in rows, and what they consist of: of crossed ones the factors' values."""
    levels: dict[str, Mapping[str, str]] = {}
    for study_data in studies:
        for condition in study_data.conditions:
            levels[condition] = study_data.study.levels.get(condition, {})
    factors = {tuple(condition_levels) for condition_levels in levels.values()}
    if len(factors) > 1 or factors == {()}:
        return {}, ""
    names_by_condition = {
        condition: ", ".join(condition_levels.values()) for condition, condition_levels in levels.items()
    }
    return names_by_condition, ", ".join(factors.pop()).replace("_", " ")
