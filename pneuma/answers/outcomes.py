"""The outcomes of every run of a study, with means: what a figure of its summary shows."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from pneuma.analysis.answer import Answer
from pneuma.analysis.curves import curve_names, random_levels, random_returns
from pneuma.analysis.intervals import LEAST_RUNS
from pneuma.analysis.notes import merge_notes, notes_on_ends, notes_on_runs
from pneuma.analysis.outcomes import PRIMARY, find_outcome, is_foreign, known_values, primary
from pneuma.analysis.study_data import StudyData
from pneuma.analysis.summaries import summary_table

WITHOUT_EVALUATIONS = "final-return"
SHOWN_STATISTICS = ("mean", "iqm")


@dataclass(frozen=True)
class OutcomeColumn:
    """One outcome of the runs of a study.

    Attributes:
        values: known ones of each condition that has runs, (runs,).
        summary: the rows of `summary_table` for means and interquartile means.
        random_levels: of the random player, by condition.
    """

    data: StudyData
    outcome: str
    values: Mapping[str, np.ndarray]
    summary: pd.DataFrame
    random_levels: Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class OutcomesAnswer(Answer):
    """The outcomes of every run.

    Attributes:
        columns: by outcome or, if there are several, by environment or world.
    """

    columns: Mapping[str, OutcomeColumn]


def show_outcomes(studies: Mapping[str, StudyData]) -> OutcomesAnswer:
    """Return the outcomes of the runs of a study, all that its file names or the default one.

    Args:
        studies: its runs in each environment, by title; "" for a single one. Several show one outcome each.

    Returns:
        The table `runs` has the known value of each run, `summary` means and interquartile means.
    """
    outcomes: dict[str, tuple[StudyData, str]] = {}
    for title, study_data in studies.items():
        outcome_names = study_data.study.outcomes or [default_outcome(study_data)]
        if len(studies) > 1:
            if len(outcome_names) > 1:
                outcome_names = [default_outcome(study_data)]
            outcomes[title] = study_data, outcome_names[0]
            continue
        headings = [re.split(r",| \(", words_of(outcome_name))[0] for outcome_name in outcome_names]
        for outcome_name, heading in zip(outcome_names, headings, strict=True):
            column_title = heading if headings.count(heading) == 1 else words_of(outcome_name)
            outcomes[column_title] = study_data, outcome_name
    columns: dict[str, OutcomeColumn] = {}
    notes_by_title: dict[str, list[str]] = {}
    descriptions: list[str] = []
    run_frames, summaries = [], []
    for title, (study_data, outcome) in outcomes.items():
        column = columns[title] = _column(study_data, outcome)
        notes_by_title[title] = _notes(column)
        if title != words_of(outcome):
            descriptions.append(f"{words_of(outcome)}.")
        for condition, values in column.values.items():
            run_frames.append(pd.DataFrame({"column": title, "condition": condition, "value": values}))
        summaries.append(column.summary.assign(column=title))
    first_data = next(iter(studies.values()))
    shown_studies = {title: column.data for title, column in columns.items()}
    summary = pd.concat(summaries, ignore_index=True)
    return OutcomesAnswer(
        title=first_data.full_title,
        about=first_data.about,
        tables={"summary": summary, "runs": pd.concat(run_frames, ignore_index=True)},
        cells=[summary],
        notes=list(dict.fromkeys([*descriptions, *merge_notes(shown_studies, notes_by_title)])),
        columns=columns,
    )


def default_outcome(study_data: StudyData) -> str:
    """Return the share killed at the end, or a return if there are no monsters or no evaluations."""
    if is_foreign(study_data) and study_data.evaluated:
        return primary(study_data)
    return PRIMARY if "share_killed" in curve_names(study_data) else WITHOUT_EVALUATIONS


def words_of(outcome: str) -> str:
    """Return the description of an outcome as a sentence begins."""
    words = find_outcome(outcome).words
    return words[:1].upper() + words[1:]


def _column(study_data: StudyData, outcome: str) -> OutcomeColumn:
    values_by_condition: dict[str, np.ndarray] = {}
    for condition in study_data.conditions:
        if study_data.of_condition(condition):
            values_by_condition[condition] = known_values(study_data, condition, outcome)
    summary_rows = summary_table(study_data, [outcome])
    summary = summary_rows[
        (summary_rows["outcome"] == outcome) & summary_rows["statistic"].isin(SHOWN_STATISTICS)
    ]
    return OutcomeColumn(
        study_data, outcome, values_by_condition, summary, _random_levels(study_data, outcome)
    )


def _random_levels(study_data: StudyData, outcome: str) -> dict[str, float]:
    """Return the random player's outcome for each condition, where it was measured."""
    if outcome.endswith("share-killed"):
        return random_levels(study_data, "share_killed")
    if outcome == "evaluated-return":
        return random_levels(study_data, "evaluated_return")
    returns = random_returns(study_data, study_data.budget)
    if outcome != WITHOUT_EVALUATIONS or returns is None or returns.empty:
        return {}
    return {"": float(returns.iloc[-1])}


def _notes(column: OutcomeColumn) -> list[str]:
    study_data = column.data
    notes = notes_on_runs(study_data, find_outcome(column.outcome).is_return) + notes_on_ends(study_data)
    value_counts = [len(values) for values in column.values.values()]
    for condition, value_count in zip(column.values, value_counts, strict=True):
        run_count = len(study_data.of_condition(condition))
        if value_count < run_count:
            notes.append(f"{run_count - value_count} of {run_count} runs of {condition} have no value.")
    if min(value_counts) < LEAST_RUNS:
        notes.append(f"Of fewer than {LEAST_RUNS} runs there is no interval.")
    if max(value_counts) >= LEAST_RUNS:
        notes.append("Intervals: Student's t for means, else bootstrap.")
    return notes
