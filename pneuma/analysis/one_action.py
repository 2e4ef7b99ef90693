"""Runs in one action: when they enter it for good, and the share of training that they are in it.

A run is in one action at an evaluation in which that takes more than `ONE_ACTION` of the steps, and comes to
stay in it at the first of `LATE` such evaluations in a row. In training it is in one action in an update
whose rollout has that sign of collapse. Where XP is never reset, these are unlike: evaluations begin with no
XP, which agents observe, and training does not come back there.
"""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd
from scipy import stats

from pneuma.analysis.answer import Answer
from pneuma.analysis.curves import Curve
from pneuma.analysis.drawing import drawing_of
from pneuma.analysis.intervals import LEVEL
from pneuma.analysis.measures import LATE, ONE_ACTION, lasting_one_action, one_action_updates
from pneuma.analysis.notes import notes_on_runs
from pneuma.analysis.study_data import StudyData
from pneuma.errors import UserError
from pneuma.store.series import MOST_OF_ONE

COLUMN = "commonest_action"
PARTS = 5
"""Parts of training over each of which the time in one action is measured."""


def find_one_action(study_data: StudyData) -> Answer:
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
    return Answer(
        study_data.full_title,
        study_data.about,
        tables,
        [tables["updates"]],
        notes,
        drawing=drawing_of({"": study_data}, "one-action"),
    )


def _shares(curve: Curve) -> pd.DataFrame:
    """Return the mean over runs of a curve of shares, with its interval."""
    return curve.frame("ci").assign(condition=curve.condition).rename(columns={"mean": "share"})


def runs_not_staying(study_data: StudyData, condition: str) -> pd.DataFrame:
    """Return the share of a condition's runs that do not yet stay in one action (Kaplan and Meier 1958).

    Returns:
        A row for each step at which the share may change: x, share, and the ends low and high of its 95 %
        interval (log-log), NaN where there is none.
    """
    runs = study_data.of_condition(condition)
    staying_steps = np.array(list(map(lasting_one_action, runs)))
    if np.isnan(staying_steps).any():
        raise UserError(
            f"study {study_data.study.name}: {study_data.origin} has no evaluations with {COLUMN}"
        )
    last_steps = np.array([run.evaluations("step")[-1] for run in runs])
    ever_stays = np.isfinite(staying_steps)
    survival = stats.ecdf(
        stats.CensoredData(uncensored=staying_steps[ever_stays], right=last_steps[~ever_stays])
    ).sf
    with warnings.catch_warnings(action="ignore"):  # there is no interval before the first run stays
        interval_ends = survival.confidence_interval(LEVEL, method="log-log")
    return pd.DataFrame({
        "x": np.insert(survival.quantiles, 0, 0.0),
        "share": np.insert(survival.probabilities, 0, 1.0),
        "low": np.insert(interval_ends.low.probabilities, 0, np.nan),
        "high": np.insert(interval_ends.high.probabilities, 0, np.nan),
    })  # fmt: skip


def time_in_one_action(study_data: StudyData, condition: str) -> Curve:
    """Return in which share of the evaluations runs are in one action, over the fifths of training."""
    shares_by_run: list[list[float]] = []
    for run in study_data.of_condition(condition):
        steps, actions = run.evaluation_points(COLUMN)
        # an evaluation follows the update in which a share of the budget is reached
        update_starts = steps - (run.update_steps or 1)
        fifths = 1 + np.floor(PARTS * update_starts / run.budget).clip(0, PARTS - 1)
        share_by_fifth = pd.Series(actions > ONE_ACTION).groupby(fifths).mean()
        shares_by_run.append(share_by_fifth.reindex(range(1, PARTS + 1)).tolist())
    return Curve(condition, pd.DataFrame(np.transpose(shares_by_run), range(1, PARTS + 1)))


def updates_in_one_action(study_data: StudyData, condition: str) -> Curve:
    """Return in which share of their updates runs are in one action, over the fifths of training."""
    shares_by_run: list[list[float]] = []
    for run in study_data.of_condition(condition):
        ends = run.budget * np.arange(PARTS + 1) / PARTS
        fifths = zip(ends[:-1], ends[1:], strict=True)
        shares_by_run.append([one_action_updates(run, first, last) for first, last in fifths])
    return Curve(condition, pd.DataFrame(np.transpose(shares_by_run), range(1, PARTS + 1)))
