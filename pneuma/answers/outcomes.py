"""The outcomes of every run of a study, with means: what a figure of its summary shows."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd

from pneuma.analysis.curves import curve_names, random_levels, random_returns
from pneuma.analysis.intervals import LEAST_RUNS
from pneuma.analysis.outcomes import PRIMARY, find_outcome, is_foreign, is_return, known_values, primary
from pneuma.analysis.study_data import StudyData
from pneuma.analysis.summaries import summary_table
from pneuma.answers.answer import Answer
from pneuma.answers.notes import merge_notes, notes_on_runs

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
        studies: its runs in each environment, by title, of which one outcome is shown; "" for a single one.

    Returns:
        The table `runs` has the known value of each run, `summary` means and interquartile means.
    """
    outcomes: dict[str, tuple[StudyData, str]] = {}
    for title, data in studies.items():
        names = data.study.outcomes or [default_outcome(data)]
        if len(studies) > 1:
            outcomes[title] = data, names[0] if len(names) == 1 else default_outcome(data)
            continue
        headings = [re.split(r",| \(", words_of(name))[0] for name in names]
        for name, heading in zip(names, headings, strict=True):
            outcomes[heading if headings.count(heading) == 1 else words_of(name)] = data, name
    columns: dict[str, OutcomeColumn] = {}
    notes: dict[str, list[str]] = {}
    descriptions: list[str] = []
    runs, summaries = [], []
    for title, (data, outcome) in outcomes.items():
        column = columns[title] = _column(data, outcome)
        notes[title] = _notes(column)
        if title != words_of(outcome):
            descriptions.append(f"{words_of(outcome)}.")
        for condition, values in column.values.items():
            runs.append(pd.DataFrame({"column": title, "condition": condition, "value": values}))
        summaries.append(column.summary.assign(column=title))
    first = next(iter(studies.values()))
    shown_studies = {title: column.data for title, column in columns.items()}
    summary = pd.concat(summaries, ignore_index=True)
    return OutcomesAnswer(
        title=first.full_title,
        about=first.about,
        tables={"summary": summary, "runs": pd.concat(runs, ignore_index=True)},
        cells=[summary],
        notes=list(dict.fromkeys([*descriptions, *merge_notes(shown_studies, notes)])),
        columns=columns,
    )


def default_outcome(data: StudyData) -> str:
    """Return the share killed at the end, or a return if there are no monsters or no evaluations."""
    if is_foreign(data) and data.evaluated:
        return primary(data)
    return PRIMARY if "share_killed" in curve_names(data) else WITHOUT_EVALUATIONS


def words_of(outcome: str) -> str:
    """Return the description of an outcome as a sentence begins."""
    words = find_outcome(outcome).words
    return words[:1].upper() + words[1:]


def _column(data: StudyData, outcome: str) -> OutcomeColumn:
    values: dict[str, np.ndarray] = {}
    for condition in data.conditions:
        if data.of_condition(condition):
            values[condition] = known_values(data, condition, outcome)
    table = summary_table(data, [outcome])
    summary = table[(table["outcome"] == outcome) & table["statistic"].isin(SHOWN_STATISTICS)]
    return OutcomeColumn(data, outcome, values, summary, _random_levels(data, outcome))


def _random_levels(data: StudyData, outcome: str) -> dict[str, float]:
    """Return what the random player comes to for each condition, where it was measured."""
    if outcome.endswith("share-killed"):
        return random_levels(data, "share_killed")
    if outcome == "evaluated-return":
        return random_levels(data, "evaluated_return")
    returns = random_returns(data, data.budget)
    if outcome != WITHOUT_EVALUATIONS or returns is None or returns.empty:
        return {}
    return {"": float(returns.iloc[-1])}


def _notes(column: OutcomeColumn) -> list[str]:
    data = column.data
    notes = [*notes_on_runs(data, is_return(column.outcome)), data.ends]
    counts = [len(values) for values in column.values.values()]
    for name, count in zip(column.values, counts, strict=True):
        total = len(data.of_condition(name))
        if count < total:
            notes.append(f"{total - count} of {total} runs of {name} have no value.")
    if min(counts) < LEAST_RUNS:
        notes.append(f"Of fewer than {LEAST_RUNS} runs there is no interval.")
    if max(counts) >= LEAST_RUNS:
        notes.append("Intervals: Student's t for means, else bootstrap.")
    return notes
