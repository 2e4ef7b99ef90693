"""Summaries: statistics of each condition with intervals, and comparisons of two conditions.

    outcomes of every run → a tidy table: condition, outcome, statistic, value, low, high, interval, runs

Runs without a value of an outcome are left out of its statistics; `runs` counts the others. Each run counts
at its own end.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from pneuma.analysis import intervals
from pneuma.analysis.intervals import LEAST_RUNS, Interval, no_interval, shown
from pneuma.analysis.outcomes import (
    PRIMARY,
    find_outcome,
    have_one_return,
    is_foreign,
    is_return,
    known_values,
    outcome_values,
    primary,
    reason,
    refuse_unlike_returns,
    with_unit,
)
from pneuma.analysis.study_data import StudyData
from pneuma.config import stream_seed
from pneuma.errors import UserError, counted

SUMMARISED = (
    PRIMARY,
    "auc-share-killed",
    "greedy-share-killed",
    "normalised-score",
    "final-return",
    "auc-return",
)
OF_FOREIGN = (
    "evaluated-return", "final-success", "greedy-return", "final-return", "auc-return", "final-length",
)  # fmt: skip
"""The outcomes in environments that are not Pneuma's."""
THRESHOLDS = ("steps-to:0.1", "steps-to:0.25", "steps-to:0.5")

COLUMNS = ("condition", "outcome", "statistic", "value", "low", "high", "interval", "runs")
# Of the statistics, iqm is the mean of the middle half, deviation that between seeds; those of runs are
# reached and share.

SummaryRow = tuple[str, str, float, Interval, int]
"""Outcome, statistic, value, interval and number of runs."""


def summary_table(data: StudyData, outcomes: Sequence[str] = ()) -> pd.DataFrame:
    """Summarise each condition of a study in `COLUMNS`, one row per outcome and statistic.

    Steps to a threshold are infinite for a run that never reaches it, so that their median may be inf.
    `reached` is the share of runs that reach it.

    The shares of runs that diverged and collapsed are included, whichever outcomes are named.
    """
    usual = OF_FOREIGN if is_foreign(data) else (*SUMMARISED, *THRESHOLDS)
    asked = (outcomes,) if isinstance(outcomes, str) else outcomes or data.study.outcomes or usual
    names = [name for name in dict.fromkeys(asked) if name != "collapsed"]
    rows = [
        (condition, name, statistic, value, interval.low, interval.high, interval.method, runs)
        for condition in data.conditions
        for name, statistic, value, interval, runs in _rows(data, condition, names)
    ]
    return pd.DataFrame(rows, columns=list(COLUMNS))


def _rows(data: StudyData, condition: str, outcomes: Sequence[str]) -> Iterator[SummaryRow]:
    runs = data.of_condition(condition)
    yield "runs", "count", float(len(runs)), no_interval(), len(runs)
    yield _share("diverged", "share", [run.status == "diverged" for run in runs])
    collapsed = known_values(data, condition, "collapsed")
    if len(collapsed):
        yield _share("collapsed", "share", collapsed)
    for name in outcomes:
        if name.startswith("steps-to"):  # infinite where it was never reached
            values = outcome_values(data, condition, name)
            if len(steps := values[~np.isnan(values)]):
                yield _share(name, "reached", np.isfinite(steps))
                yield name, "median", float(np.median(steps)), no_interval(), len(steps)
        elif len(known := known_values(data, condition, name)):
            yield from _statistics(condition, name, known)


def _share(name: str, statistic: str, events: ArrayLike) -> SummaryRow:
    count, runs = int(np.sum(events)), np.size(events)
    value = count / runs if runs else float("nan")
    return name, statistic, value, intervals.incidence_interval(count, runs), runs


def _statistics(condition: str, name: str, values: np.ndarray) -> Iterator[SummaryRow]:
    generator = _generator(condition, name)
    interval = no_interval()
    if len(values) >= LEAST_RUNS:
        interval = intervals.within(intervals.mean_interval(values), *find_outcome(name).bounds)
    yield name, "mean", float(intervals.mean(values)), interval, len(values)
    for statistic, estimate in (("median", intervals.median), ("iqm", intervals.interquartile_mean)):
        interval = intervals.bootstrap_interval(values, estimate, generator)
        yield name, statistic, float(estimate(values)), interval, len(values)
    spread = intervals.deviation(values), intervals.deviation_interval(values)
    yield name, "deviation", *spread, len(values)


def _generator(*words: str) -> np.random.Generator:
    """Return a random generator for one row, so that rows do not depend on each other."""
    return np.random.default_rng(stream_seed("summary", "/".join(words)))


# --- In words ---------------------------------------------------------------------------------------

NO_CELL = "–"
SHOWN = 3
"""Outcomes of which means are shown unless others are asked for."""
FAILURES = ("collapsed", "diverged")
TOLD_BY = ("mean", "share", "median")
"""Statistics that stand for an outcome in a thesis's table: the first of them that it has."""
FEW_EPISODES = 10
"""With fewer, the last point of a return is said to average few."""


def with_cells(found: pd.DataFrame, form: str = "interval") -> pd.DataFrame:
    """Return a summary with a column `cell`: each value as text, with its interval if it has one.

    In the form `sd` means stand with the deviation, as in 0.68 ± 0.11, if there is one.
    """
    numbers = zip(found["value"], found["low"], found["high"], strict=True)
    found = found.assign(cell=[intervals.shown_with_interval(*row) for row in numbers])
    if form == "interval":
        return found
    deviations = found[found["statistic"] == "deviation"].set_index(["condition", "outcome"])["value"]
    for place, row in found[found["statistic"] == "mean"].iterrows():
        value, deviation = row["value"], deviations[row["condition"], row["outcome"]]
        if np.isfinite(deviation):
            places = intervals.decimals(value, value - deviation, value + deviation)
            found.loc[place, "cell"] = f"{shown(value, places)} ± {shown(deviation, places)}"
    return found


def wide(
    found: pd.DataFrame,
    rows: list[Any],
    columns: list[Any],
    by: Sequence[str] = ("condition",),
    of: Sequence[str] = ("outcome", "statistic"),
) -> pd.DataFrame:
    """Return the cells of a summary as a table: rows by some of its columns, columns by others."""
    table = found.pivot(index=[*by], columns=[*of], values="cell")
    return table.reindex(index=rows, columns=columns).astype(object).fillna(NO_CELL)


def statistics_cells(data: StudyData, found: pd.DataFrame, outcomes: Sequence[str]) -> pd.DataFrame:
    """Return a row for each outcome and condition, with all statistics."""
    asked, rows = found[found["outcome"].isin(outcomes)], ["outcome", "condition"]
    runs = asked.groupby(rows)["runs"].first()
    pairs = [pair for pair in product(outcomes, data.conditions) if pair in runs]
    table = wide(asked, pairs, [*asked["statistic"].unique()], rows, ["statistic"])
    table.insert(0, "n", runs)
    table = table.reset_index().rename_axis(columns=None)
    return table.assign(outcome=table["outcome"].map(with_unit))


def overview_cells(data: StudyData, found: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each condition: means of the first outcomes, and shares of runs that failed, if any.

    It has at most five columns, so that a terminal shows words whole.
    """
    failed = [(name, "share") for name in FAILURES if (_failed_shares(found, name) > 0).any()]
    names = found["outcome"][found["statistic"] == "mean"].unique()[: SHOWN - len(failed)]
    means = [(name, "mean") for name in names]
    return _condition_cells(data, found, means + failed).reset_index()


def failures_text(found: pd.DataFrame) -> str:
    """Return the ways in which no run failed, as a sentence; empty if there is none."""
    without = []
    for name in FAILURES:
        shares = _failed_shares(found, name)
        if len(shares.dropna()) and not (shares > 0).any():
            without.append(name)
    return f"No run {' or '.join(without)}." if without else ""


def _failed_shares(found: pd.DataFrame, name: str) -> pd.Series:
    return found["value"][(found["outcome"] == name) & (found["statistic"] == "share")]


def thesis_cells(
    data: StudyData, found: pd.DataFrame, outcomes: Sequence[str], by_factor: bool
) -> pd.DataFrame:
    """Return a row for each condition that has one of the outcomes, and a column for each, as a thesis has.

    A value of fewer runs than the condition has says of how many. If asked for, the conditions of a crossed
    study have a column for each factor.
    """
    stands = found[found["statistic"].isin(TOLD_BY)].groupby("outcome", sort=False)["statistic"].first()
    pairs = [(name, stands.get(name, "")) for name in outcomes or stands.index[stands == "mean"][:SHOWN]]
    runs = found["condition"].map({name: len(data.of_condition(name)) for name in data.conditions})
    fewer = found["runs"].map(" (n = {})".format).where(found["runs"] < runs, "")
    table = _condition_cells(data, found.assign(cell=found["cell"] + fewer), pairs)
    table = table[(table.drop(columns="runs") != NO_CELL).any(axis=1)]
    if by_factor and data.study.levels:
        levels = pd.DataFrame([data.study.levels[name] for name in table.index])
        table.index = pd.MultiIndex.from_frame(levels.rename(columns=lambda name: name.replace("_", " ")))
    return table.reset_index()


def _condition_cells(data: StudyData, found: pd.DataFrame, pairs: list[tuple[str, str]]) -> pd.DataFrame:
    """Return a row for each condition with its number of runs, and a column for each outcome's statistic."""
    table = wide(found, data.conditions, pairs)
    heads = [name if statistic == "share" else with_unit(name) for name, statistic in pairs]
    medians = [", median" * (statistic == "median") for _, statistic in pairs]
    table.columns = [head + median for head, median in zip(heads, medians, strict=True)]
    table.insert(0, "runs", [len(data.of_condition(condition)) for condition in data.conditions])
    return table


def lacks_text(data: StudyData, found: pd.DataFrame, outcomes: Sequence[str]) -> list[str]:
    """Say which conditions have no value of an outcome that was asked for, and why."""
    known, text = {*zip(found["outcome"], found["condition"], strict=True)}, []
    runs = {condition: data.of_condition(condition) for condition in data.conditions}
    if untrained := "; ".join(condition for condition, its in runs.items() if not its):
        text.append(f"no run has finished of {untrained}")
    for (condition, its), outcome in product(runs.items(), outcomes):
        if its and (outcome, condition) not in known:
            text.append(f"{outcome}, {condition}: {reason(its[0], outcome)}")
    return text


def episodes_text(data: StudyData, outcomes: Iterable[str]) -> str:
    """Say how many runs' last returns average few episodes; empty if none do."""
    counts = sorted(run.last_episodes for run in data.rows if 0 < run.last_episodes < FEW_EPISODES)
    if not counts or "final-return" not in outcomes:
        return ""
    between = f"{counts[0]:.0f} to {counts[-1]:.0f}" if counts[0] < counts[-1] else f"{counts[0]:.0f}"
    return f"final-return of {counted(len(counts), 'run')} is a mean of few episodes: {between}."


# --- Two conditions ---------------------------------------------------------------------------------

COMPARED = ("final-return", "auc-return")
"""Outcomes compared by default, beside the study's primary one."""
LEAST_FOR_BETTER = 10
"""Fewer runs say too little of how often one is better; of three against three 1.00 means nothing."""


def compare_conditions(data: StudyData, a: str, b: str, outcomes: Sequence[str] = ()) -> pd.DataFrame:
    """Compare two conditions of a study: one row per outcome.

    The 95 % interval of the difference of means is Welch's. `p_better` is the probability that a run of a is
    better than one of b (ties count half), NaN for an outcome without a better direction, and for fewer than
    `LEAST_FOR_BETTER` runs. Runs without a value are left out and counted in `without_value`.
    """
    if a == b:
        raise UserError(f"{a} and {b} are one condition; name two of {', '.join(data.conditions)}")
    names = outcomes or _usual_outcomes(data, a, b)
    for name in names:
        refuse_unlike_returns(data, name, (a, b))
    return pd.DataFrame([_compared(data, a, b, name) for name in names])


def _usual_outcomes(data: StudyData, a: str, b: str) -> Sequence[str]:
    usual = data.study.outcomes or (primary(data), *COMPARED)
    unlike = not have_one_return(data, (a, b))
    return [name for name in usual if not (unlike and is_return(name))] or usual


def _compared(data: StudyData, a: str, b: str, name: str) -> dict[str, Any]:
    found = find_outcome(name)
    every = [outcome_values(data, condition, name) for condition in (a, b)]
    first, second = (values[~np.isnan(values)] for values in every)
    fewer = min(len(first), len(second))
    means = [float(values.mean()) if len(values) else np.nan for values in (first, second)]
    finite = np.isfinite(means).all()  # steps to a threshold may be infinite
    interval = no_interval()
    if finite and fewer >= LEAST_RUNS:
        width = found.bounds[1] - found.bounds[0]
        interval = intervals.within(intervals.difference_interval(first, second), -width, width)
    sign = {"higher": 1, "lower": -1}.get(found.better, 0)
    known = sign and fewer >= LEAST_FOR_BETTER
    return {
        "outcome": name,
        "unit": found.unit,
        "a": a,
        "b": b,
        "mean_a": means[0],
        "mean_b": means[1],
        "difference": means[0] - means[1] if finite else np.nan,
        "low": interval.low,
        "high": interval.high,
        "p_better": intervals.probability_of_improvement(sign * first, sign * second) if known else np.nan,
        "seeds_a": len(first),
        "seeds_b": len(second),
        "without_value": sum(map(len, every)) - len(first) - len(second),
    }


def compare_pairs(
    data: StudyData, pairs: Mapping[str, tuple[str, str]], outcomes: Sequence[str], first: Sequence[str] = ()
) -> pd.DataFrame:
    """Compare pairs of conditions, each called by what is compared in it, as `compare_conditions` does.

    Without outcomes, those in `first` stand before the usual ones.
    """
    tables = []
    for shared, (a, b) in pairs.items():
        names = dict.fromkeys([*first, *(outcomes or _usual_outcomes(data, a, b))])
        tables.append(compare_conditions(data, a, b, [*names]).assign(condition=shared))
    return pd.concat(tables, ignore_index=True)


def comparison_cells(table: pd.DataFrame, heads: Sequence[str]) -> pd.DataFrame:
    """Return the numbers of `compare_pairs` as text; `heads` are what is compared."""
    rows = []
    for row in table.to_dict("records"):
        ends = {} if np.isnan(row["low"]) else {"low": row["low"], "high": row["high"]}
        means = (shown(row[key], intervals.decimals(row[key], **ends)) for key in ("mean_a", "mean_b"))
        better = NO_CELL if np.isnan(row["p_better"]) else f"{row['p_better']:.2f}"
        difference = intervals.shown_with_interval(row["difference"], row["low"], row["high"])
        runs = f"{row['seeds_a']} and {row['seeds_b']}", row["without_value"]
        rows.append((row["condition"], row["outcome"], *means, difference, better, *runs))
    columns = ["", "outcome", *heads, "difference", "P(better)", "runs", "no value"]
    cells = pd.DataFrame(rows, columns=columns)
    return cells if cells[""].any() else cells.iloc[:, 1:]
