"""Runs in one action: when they enter it for good, and the share of training that they are in it."""

from __future__ import annotations

import pandas as pd

from pneuma.analysis.curves import Curve
from pneuma.analysis.measures import LATE, ONE_ACTION
from pneuma.analysis.one_action import runs_not_staying, time_in_one_action, updates_in_one_action
from pneuma.analysis.study_data import StudyData
from pneuma.answers.answer import StudyAnswer
from pneuma.answers.notes import notes_on_runs
from pneuma.store.series import MOST_OF_ONE


def find_one_action(study_data: StudyData) -> StudyAnswer:
    """Return how many runs of each condition do not yet stay in one action, and the time in one.

    Returns:
        The table `staying` is Kaplan's and Meier's estimate over steps, by evaluations. Over the fifths of
        training `time` is the share of evaluations, and `updates` that of training's updates. All have 95 %
        intervals.
    """
    survival_tables, time_tables, update_tables = [], [], []
    for condition in study_data.conditions:
        if study_data.of_condition(condition):
            survival_tables.append(runs_not_staying(study_data, condition).assign(condition=condition))
            time_tables.append(_shares(time_in_one_action(study_data, condition)))
            update_tables.append(_shares(updates_in_one_action(study_data, condition)))
    tables = {
        "staying": pd.concat(survival_tables, ignore_index=True),
        "time": pd.concat(time_tables, ignore_index=True),
        "updates": pd.concat(update_tables, ignore_index=True),
    }
    definition = (
        f"A run is in one action if that action takes over {100 * ONE_ACTION:g} % of an evaluation's steps"
    )
    notes = [
        f"{definition}; it stays there from the first of {LATE} such evaluations in a row. In training it is "
        f"in one action in updates whose rollout is at least {100 * MOST_OF_ONE:g} % one action.",
        *notes_on_runs(study_data),
    ]
    return StudyAnswer(
        study_data.full_title, study_data.about, tables, [tables["updates"]], notes, data=study_data
    )


def _shares(curve: Curve) -> pd.DataFrame:
    """Return the mean over runs of a curve of shares, with its interval."""
    return curve.frame("ci").assign(condition=curve.condition).rename(columns={"mean": "share"})
