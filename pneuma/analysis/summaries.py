"""Summaries: statistics of each condition with intervals, and comparisons of two groups of runs.

    outcomes of every run → a tidy table: condition, outcome, statistic, value, low, high, interval, runs

Runs without a value of an outcome are left out of its statistics; `runs` counts the others. Each run counts
at its own end.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
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
"""Outcomes compared by default, after the study's primary one."""
LEAST_FOR_BETTER = 10
"""With fewer runs P(better) is too uncertain: with three against three, 1.00 means nothing."""

SummaryRow = tuple[str, str, float, Interval, int]
"""Outcome, statistic, value, interval and number of runs."""
Estimate = Callable[[ArrayLike], np.ndarray]


def summary_table(study_data: StudyData, outcomes: Sequence[str] = ()) -> pd.DataFrame:
    """Summarise each condition of a study: a row for each outcome and statistic.

    Args:
        study_data: an opened study.
        outcomes: names from docs/outcomes.md; default: those of the study's file, or the default ones.

    Returns:
        A table with `COLUMNS`. The shares of runs that diverged and collapsed are always in it. Steps to a
        threshold are infinite for a run that never reaches it, so that their median may be infinite;
        `reached` is the share of runs that reach it. `deviation` is that between seeds.
    """
    default_outcomes = SUMMARISED_ELSEWHERE if is_foreign(study_data) else SUMMARISED
    outcome_names = dict.fromkeys(outcomes or study_data.study.outcomes or default_outcomes)
    outcome_names.pop("collapsed", None)  # it is always there
    table_rows = []
    for condition in study_data.conditions:
        for outcome, statistic, value, interval, run_count in _summary_rows(
            study_data, condition, list(outcome_names)
        ):
            interval_cells = (interval.low, interval.high, interval.method)
            table_rows.append((condition, outcome, statistic, value, *interval_cells, run_count))
    return pd.DataFrame(table_rows, columns=COLUMNS)


def _summary_rows(study_data: StudyData, condition: str, outcomes: Sequence[str]) -> Iterator[SummaryRow]:
    runs = study_data.of_condition(condition)
    yield "runs", "count", float(len(runs)), no_interval(), len(runs)
    yield _share("diverged", "share", [run.status == "diverged" for run in runs])
    collapsed = known_values(study_data, condition, "collapsed")
    if len(collapsed):
        yield _share("collapsed", "share", collapsed)
    for outcome in outcomes:
        run_values = outcome_values(study_data, condition, outcome)
        if outcome.startswith("steps-to"):  # infinite where it was never reached
            steps_needed = run_values[~np.isnan(run_values)]
            if len(steps_needed):
                yield _share(outcome, "reached", np.isfinite(steps_needed))
                yield outcome, "median", float(np.median(steps_needed)), no_interval(), len(steps_needed)
            continue
        run_values = run_values[np.isfinite(run_values)]
        if len(run_values):
            yield from _statistics(condition, outcome, run_values)


def _share(outcome: str, statistic: str, events: ArrayLike) -> SummaryRow:
    event_count, run_count = int(np.sum(events)), np.size(events)
    share = event_count / (run_count or np.nan)
    return outcome, statistic, share, intervals.incidence_interval(event_count, run_count), run_count


def _statistics(condition: str, outcome: str, run_values: np.ndarray) -> Iterator[SummaryRow]:
    run_count = len(run_values)
    interval = no_interval()
    if run_count >= LEAST_RUNS:
        interval = intervals.within(intervals.mean_interval(run_values), *find_outcome(outcome).bounds)
    yield outcome, "mean", float(run_values.mean()), interval, run_count
    # Each outcome of each condition has a stream of its own, so that rows do not depend on each other.
    generator = np.random.default_rng(stream_seed("summary", f"{condition}/{outcome}"))
    estimates: dict[str, Estimate] = {
        "median": partial(np.median, axis=-1),
        "iqm": intervals.interquartile_mean,
    }
    for statistic, estimate in estimates.items():
        interval = intervals.bootstrap_interval(run_values, estimate, generator)
        yield outcome, statistic, float(estimate(run_values)), interval, run_count
    interval = intervals.deviation_interval(run_values)
    yield outcome, "deviation", intervals.deviation(run_values), interval, run_count


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
    default_outcomes = a.data.study.outcomes or (primary(a.data), *COMPARED)
    if len(_units_of_return(a, b)) <= 1:
        return list(default_outcomes)
    without_returns = [outcome for outcome in default_outcomes if not find_outcome(outcome).is_return]
    return without_returns or list(default_outcomes)


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
    refuse_different_returns(_units_of_return(a, b), outcome)
    all_values_a = outcome_values(a.data, a.condition, outcome)
    all_values_b = outcome_values(b.data, b.condition, outcome)
    values_a, values_b = all_values_a[~np.isnan(all_values_a)], all_values_b[~np.isnan(all_values_b)]
    smaller_size = min(len(values_a), len(values_b))
    mean_a, mean_b = _mean(values_a), _mean(values_b)
    difference, p_better, interval = np.nan, np.nan, no_interval()
    if np.isfinite([mean_a, mean_b]).all():  # steps to a threshold may be infinite
        difference = mean_a - mean_b
        if smaller_size >= LEAST_RUNS:
            width = declared.bounds[1] - declared.bounds[0]
            interval = intervals.within(intervals.difference_interval(values_a, values_b), -width, width)
    if declared.better and smaller_size >= LEAST_FOR_BETTER:
        sign = 1 if declared.better == "higher" else -1
        p_better = float(intervals.probability_of_improvement(sign * values_a, sign * values_b))
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
        "seeds_a": len(values_a),
        "seeds_b": len(values_b),
        "without_value": len(all_values_a) + len(all_values_b) - len(values_a) - len(values_b),
    }


def refuse_different_returns(units_of_return: Collection[str], outcome: str) -> None:
    """Refuse an outcome that is a return, where returns have several units."""
    if find_outcome(outcome).is_return and len(units_of_return) > 1:
        raise UserError(
            f"outcome {outcome}: returns with different rewards or numbers of players cannot be compared; "
            "name another, such as final-share-killed"
        )


def _mean(run_values: np.ndarray) -> float:
    if not len(run_values):
        return np.nan
    return float(run_values.mean())
