"""Runs in one action: when they come to stay in it, and how much of training they are in it."""

from __future__ import annotations

import pandas as pd

from pneuma.analysis.measures import LATE, ONE_ACTION
from pneuma.analysis.one_action import runs_not_staying, time_in_one_action
from pneuma.analysis.study_data import StudyData
from pneuma.answers.answer import StudyAnswer
from pneuma.answers.notes import notes_on_runs


def find_one_action(data: StudyData) -> StudyAnswer:
    """Return how many runs of each condition do not yet stay in one action, and the time in one.

    Returns:
        The table `staying` is Kaplan's and Meier's estimate over steps, `time` the share of evaluations over
        the fifths of training, with 95 % intervals.
    """
    staying, times = [], []
    for condition in data.conditions:
        if data.of_condition(condition):
            staying.append(runs_not_staying(data, condition).assign(condition=condition))
            time = time_in_one_action(data, condition).frame("ci").rename(columns={"mean": "share"})
            times.append(time.assign(condition=condition))
    tables = {"staying": pd.concat(staying, ignore_index=True), "time": pd.concat(times, ignore_index=True)}
    state = (
        f"A run is in one action if that action takes over {100 * ONE_ACTION:g} % of an evaluation's steps"
    )
    notes = [
        f"{state}; it stays there from the first of {LATE} such evaluations in a row.",
        *notes_on_runs(data),
    ]
    return StudyAnswer(data.full_title, data.about, tables, [tables["time"]], notes, data=data)
