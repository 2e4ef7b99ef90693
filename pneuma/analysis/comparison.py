"""Two conditions of a study beside each other: how far they lie apart, and how sure that is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pandas as pd

from pneuma.analysis.estimates import probability_of_improvement
from pneuma.analysis.frames import StudyData
from pneuma.analysis.intervals import difference_interval, no_interval
from pneuma.analysis.outcomes import PRIMARY, find_outcome, outcome_values, refuse_unlike_returns
from pneuma.analysis.run_view import common_step
from pneuma.errors import UserError

COMPARED = (PRIMARY, "final-return", "auc-return")
COLUMNS = (
    "outcome", "unit", "a", "b", "mean_a", "mean_b", "difference", "low", "high", "p_better", "seeds_a",
    "seeds_b", "without_value",
)  # fmt: skip


def compare_conditions(data: StudyData, a: str, b: str, outcomes: Sequence[str] = COMPARED) -> pd.DataFrame:
    """Compare two conditions of a study, one row for each outcome, in `COLUMNS`.

    The interval of the difference of means is Welch's, at 95 %. `p_better` is the probability that a run
    of a is better than one of b (ties count half), NaN for an outcome that has no better way. Runs that
    have no value are left out and counted in `without_value`. Runs of unlike budgets are compared at the
    last step that all reached.

    Args:
        data: the study.
        a: a condition.
        b: another one.
        outcomes: names of docs/outcomes.md.

    Raises:
        UserError: for an unknown name, twice the same condition, or conditions trained by different engines.
    """
    if a == b:
        raise UserError(f"{a} and {b} are one condition; name two of {', '.join(data.conditions)}")
    for name in outcomes:
        refuse_unlike_returns(data, name, (a, b))
    rows = list(_rows(data, a, b, outcomes))
    if data.engines(a) != data.engines(b):
        raise UserError(f"{a} and {b} were trained by different engines, which are never compared")
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _rows(data: StudyData, a: str, b: str, outcomes: Sequence[str]) -> Iterator[tuple[object, ...]]:
    at_step = common_step(data)
    for name in outcomes:
        found = find_outcome(name)
        every = [outcome_values(data, condition, name, at_step) for condition in (a, b)]
        first, second = (values[~np.isnan(values)] for values in every)
        means = [float(values.mean()) if len(values) else np.nan for values in (first, second)]
        told = min(len(first), len(second)) > 0
        finite = told and np.isfinite(means).all()  # steps to a threshold may be endless
        interval = difference_interval(first, second) if finite else no_interval()
        sign = {"higher": 1, "lower": -1}.get(found.better, 0)
        ranks = [np.searchsorted(np.unique([*first, *second]), values) * sign for values in (first, second)]
        better = probability_of_improvement(*ranks) if sign and told else np.nan
        counts = len(first), len(second), sum(map(len, every)) - len(first) - len(second)
        difference = means[0] - means[1] if finite else np.nan
        yield name, found.unit, a, b, *means, difference, interval.low, interval.high, better, *counts
