"""Summaries: statistics of each condition with intervals, and comparisons of two groups of runs.

    outcomes of every run → a tidy table: condition, outcome, statistic, value, low, high, interval, runs

Runs without a value of an outcome are left out of its statistics; `runs` counts the others. Each run counts
at its own end.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from pneuma.analysis import intervals
from pneuma.analysis.intervals import LEAST_RUNS, Interval, no_interval
from pneuma.analysis.outcomes import (
    PRIMARY,
    find_outcome,
    is_foreign,
    is_return,
    kinds_of_return,
    known_values,
    outcome_values,
    primary,
)
from pneuma.analysis.study_data import StudyData
from pneuma.config import stream_seed
from pneuma.errors import UserError

SUMMARISED = (
    PRIMARY, "auc-share-killed", "greedy-share-killed", "normalised-score", "final-return", "auc-return",
    "steps-to:0.1", "steps-to:0.25", "steps-to:0.5",
)  # fmt: skip
SUMMARISED_ELSEWHERE = (
    "evaluated-return", "final-success", "greedy-return", "final-return", "auc-return", "final-length",
)  # fmt: skip
"""The outcomes in environments that are not Pneuma's."""
COLUMNS = ["condition", "outcome", "statistic", "value", "low", "high", "interval", "runs"]
COMPARED = ("final-return", "auc-return")
"""Outcomes compared by default, beside the study's primary one."""
LEAST_FOR_BETTER = 10
"""With fewer runs P(better) is too uncertain: with three against three, 1.00 means nothing."""

SummaryRow = tuple[str, str, float, Interval, int]
"""Outcome, statistic, value, interval and number of runs."""
Estimate = Callable[[ArrayLike], np.ndarray]


def summary_table(data: StudyData, outcomes: Sequence[str] = ()) -> pd.DataFrame:
    """Summarise each condition of a study: a row for each outcome and statistic.

    Args:
        data: an opened study.
        outcomes: names from docs/outcomes.md; default: those of the study's file, or the usual ones.

    Returns:
        A table with `COLUMNS`. The shares of runs that diverged and collapsed are always in it. Steps to a
        threshold are infinite for a run that never reaches it, so that their median may be infinite;
        `reached` is the share of runs that reach it. `deviation` is that between seeds.
    """
    default = SUMMARISED_ELSEWHERE if is_foreign(data) else SUMMARISED
    names = dict.fromkeys(outcomes or data.study.outcomes or default)
    names.pop("collapsed", None)  # it is always there
    table = []
    for condition in data.conditions:
        for outcome, statistic, value, interval, runs in _summary_rows(data, condition, list(names)):
            ends = (interval.low, interval.high, interval.method)
            table.append((condition, outcome, statistic, value, *ends, runs))
    return pd.DataFrame(table, columns=COLUMNS)


def _summary_rows(data: StudyData, condition: str, outcomes: Sequence[str]) -> Iterator[SummaryRow]:
    runs = data.of_condition(condition)
    yield "runs", "count", float(len(runs)), no_interval(), len(runs)
    yield _share("diverged", "share", [run.status == "diverged" for run in runs])
    collapsed = known_values(data, condition, "collapsed")
    if len(collapsed):
        yield _share("collapsed", "share", collapsed)
    for name in outcomes:
        values = outcome_values(data, condition, name)
        if name.startswith("steps-to"):  # infinite where it was never reached
            steps = values[~np.isnan(values)]
            if len(steps):
                yield _share(name, "reached", np.isfinite(steps))
                yield name, "median", float(np.median(steps)), no_interval(), len(steps)
            continue
        values = values[np.isfinite(values)]
        if len(values):
            yield from _statistics(condition, name, values)


def _share(name: str, statistic: str, events: ArrayLike) -> SummaryRow:
    count, runs = int(np.sum(events)), np.size(events)
    value = count / runs if runs else float("nan")
    return name, statistic, value, intervals.incidence_interval(count, runs), runs


def _statistics(condition: str, name: str, values: np.ndarray) -> Iterator[SummaryRow]:
    count = len(values)
    interval = no_interval()
    if count >= LEAST_RUNS:
        interval = intervals.within(intervals.mean_interval(values), *find_outcome(name).bounds)
    yield name, "mean", float(values.mean()), interval, count
    # Each outcome of each condition has a stream of its own, so that rows do not depend on each other.
    generator = np.random.default_rng(stream_seed("summary", f"{condition}/{name}"))
    estimates: dict[str, Estimate] = {
        "median": partial(np.median, axis=-1),
        "iqm": intervals.interquartile_mean,
    }
    for statistic, estimate in estimates.items():
        interval = intervals.bootstrap_interval(values, estimate, generator)
        yield name, statistic, float(estimate(values)), interval, count
    yield name, "deviation", intervals.deviation(values), intervals.deviation_interval(values), count


# --- Two groups of runs -----------------------------------------------------------------------------


class Group(NamedTuple):
    """The runs of a condition of a study, and what they are called in a comparison."""

    data: StudyData
    condition: str
    name: str

    @property
    def run_ids(self) -> set[str]:
        return {run.run_id for run in self.data.of_condition(self.condition)}


def outcomes_to_compare(a: Group, b: Group) -> list[str]:
    """Return the outcomes that are compared by default: returns only if they have one unit."""
    default = a.data.study.outcomes or (primary(a.data), *COMPARED)
    if len(_units_of_return(a, b)) <= 1:
        return list(default)
    return [name for name in default if not is_return(name)] or list(default)


def _units_of_return(a: Group, b: Group) -> set[str]:
    return kinds_of_return(a.data, [a.condition]) | kinds_of_return(b.data, [b.condition])


def compare_groups(a: Group, b: Group, outcome: str) -> dict[str, Any]:
    """Compare the means of two groups of runs by an outcome.

    Returns:
        A row of a table. The interval of the difference is Welch's. `p_better` is the probability that a run
        of `a` is better than one of `b` (ties count half), NaN for an outcome without a better direction, and
        for fewer than `LEAST_FOR_BETTER` runs. `without_value` counts runs that are left out.

    Raises:
        UserError: for an unknown outcome, or returns that have different units.
    """
    declared = find_outcome(outcome)
    if is_return(outcome) and len(_units_of_return(a, b)) > 1:
        raise UserError(
            f"outcome {outcome}: returns with different rewards or numbers of players cannot be compared; "
            "name another, such as final-share-killed"
        )
    all_a = outcome_values(a.data, a.condition, outcome)
    all_b = outcome_values(b.data, b.condition, outcome)
    first, second = all_a[~np.isnan(all_a)], all_b[~np.isnan(all_b)]
    fewer = min(len(first), len(second))
    mean_a, mean_b = _mean(first), _mean(second)
    difference, p_better, interval = np.nan, np.nan, no_interval()
    if np.isfinite([mean_a, mean_b]).all():  # steps to a threshold may be infinite
        difference = mean_a - mean_b
        if fewer >= LEAST_RUNS:
            width = declared.bounds[1] - declared.bounds[0]
            interval = intervals.within(intervals.difference_interval(first, second), -width, width)
    if declared.better and fewer >= LEAST_FOR_BETTER:
        sign = 1 if declared.better == "higher" else -1
        p_better = float(intervals.probability_of_improvement(sign * first, sign * second))
    return {
        "outcome": outcome,
        "unit": declared.unit,
        "a": a.name,
        "b": b.name,
        "mean_a": mean_a,
        "mean_b": mean_b,
        "difference": difference,
        "low": interval.low,
        "high": interval.high,
        "p_better": p_better,
        "seeds_a": len(first),
        "seeds_b": len(second),
        "without_value": len(all_a) + len(all_b) - len(first) - len(second),
    }


def _mean(values: np.ndarray) -> float:
    return float(values.mean()) if len(values) else np.nan
