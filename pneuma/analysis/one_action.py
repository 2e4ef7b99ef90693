"""When runs come to stay in one action, and how much of training they are in it.

A run is in one action at an evaluation in which that takes more than `ONE_ACTION` of the steps, and comes to
stay in it at the first of `LATE` such evaluations in a row.
"""

from __future__ import annotations

import warnings

import numpy as np
import pandas as pd
from scipy import stats

from pneuma.analysis.curves import Curve
from pneuma.analysis.intervals import LEVEL
from pneuma.analysis.measures import ONE_ACTION, lasting_one_action
from pneuma.analysis.study_data import StudyData
from pneuma.errors import UserError

COLUMN = "commonest_action"
PARTS = 5
"""Of training, over which the time in one action is measured."""


def runs_not_staying(data: StudyData, condition: str) -> pd.DataFrame:
    """Return the share of a condition's runs that do not yet stay in one action (Kaplan and Meier 1958).

    Returns:
        A row for each step at which the share may change: x, share, and the ends low and high of its 95 %
        interval (log-log), NaN where there is none.
    """
    runs = data.of_condition(condition)
    came = np.array([lasting_one_action(run) for run in runs])
    if np.isnan(came).any():
        raise UserError(f"study {data.study.name}: {data.what} has no evaluations with {COLUMN}")
    last = np.array([run.evaluations("step")[-1] for run in runs])
    stays = np.isfinite(came)
    share = stats.ecdf(stats.CensoredData(uncensored=came[stays], right=last[~stays])).sf
    with warnings.catch_warnings(action="ignore"):  # there is no interval before the first run stays
        ends = share.confidence_interval(LEVEL, method="log-log")
    return pd.DataFrame({
        "x": [0.0, *share.quantiles],
        "share": [1.0, *share.probabilities],
        "low": [np.nan, *ends.low.probabilities],
        "high": [np.nan, *ends.high.probabilities],
    })  # fmt: skip


def time_in_one_action(data: StudyData, condition: str) -> Curve:
    """Return in which share of the evaluations runs are in one action, over the fifths of training."""
    shares: list[list[float]] = []
    for run in data.of_condition(condition):
        steps, actions = run.known_evaluations(COLUMN)
        fifth = np.ceil(PARTS * steps / run.budget).clip(1, PARTS)
        by_part = pd.Series(actions > ONE_ACTION).groupby(fifth).mean()
        shares.append(by_part.reindex(range(1, PARTS + 1)).tolist())
    return Curve(condition, pd.DataFrame(np.transpose(shares), range(1, PARTS + 1)))
