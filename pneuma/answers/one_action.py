"""Runs in one action: when they enter it for good, and the share of training that they are in it."""

from __future__ import annotations

import pandas as pd

from pneuma.analysis.measures import LATE, ONE_ACTION
from pneuma.analysis.one_action import runs_not_staying, time_in_one_action
from pneuma.analysis.study_data import StudyData
from pneuma.answers.answer import StudyAnswer
from pneuma.answers.notes import notes_on_runs


def find_one_action(study_data: StudyData) -> StudyAnswer:
    """Return how many runs of each condition do not yet stay in one action, and the time in one.

    Returns:
        The table `staying` is Kaplan's and Meier's estimate over steps, `time` the share of evaluations over
        the fifths of training, with 95 % intervals.
    """
    survival_tables, time_tables = [], []
    for condition in study_data.conditions:
        if study_data.of_condition(condition):
            survival_tables.append(runs_not_staying(study_data, condition).assign(condition=condition))
            time_table = time_in_one_action(study_data, condition).frame("ci").assign(condition=condition)
            time_tables.append(time_table.rename(columns={"mean": "share"}))
    tables = {
        "staying": pd.concat(survival_tables, ignore_index=True),
        "time": pd.concat(time_tables, ignore_index=True),
    }
    definition = (
        f"A run is in one action if that action takes over {100 * ONE_ACTION:g} % of an evaluation's steps"
    )
    notes = [
        f"{definition}; it stays there from the first of {LATE} such evaluations in a row.",
        *notes_on_runs(study_data),
    ]
    return StudyAnswer(
        study_data.full_title, study_data.about, tables, [tables["time"]], notes, data=study_data
    )
