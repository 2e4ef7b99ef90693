"""Summaries: statistics of each condition with intervals, and comparisons of two groups of runs.

    outcomes of every run → a tidy table: condition, outcome, statistic, value, low, high, interval, runs
    StudyData → `summarize`, or of a figure `show_outcomes` → an answer

Runs without a value of an outcome are left out of its statistics; `runs` counts the others. Each run counts
at its own end.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Container, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from pneuma.analysis import intervals
from pneuma.analysis.answer import NO_CELL, Answer
from pneuma.analysis.cells import condition_cells, pivot_cells, with_cells
from pneuma.analysis.curves import curve_names, random_levels, random_returns
from pneuma.analysis.drawing import drawing_of, short_names
from pneuma.analysis.environments import OUTCOME, by_environment, environment_names, over_environments
from pneuma.analysis.intervals import LEAST_RUNS, Interval, no_interval
from pneuma.analysis.notes import (
    MOST_NAMED,
    merge_notes,
    notes_on_ends,
    notes_on_few_runs,
    notes_on_outcomes,
    notes_on_runs,
    notes_on_zero_xp,
)
from pneuma.analysis.outcomes import (
    PRIMARY,
    find_outcome,
    is_foreign,
    kinds_of_return,
    known_values,
    outcome_values,
    primary,
    reason,
    with_unit,
)
from pneuma.analysis.study_data import StudyData
from pneuma.config import stream_seed
from pneuma.errors import Hint, UserError

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


# --- The answer -------------------------------------------------------------------------------------

SHOWN = 3
"""Outcomes whose means are shown by default."""
FAILURES = ("collapsed", "diverged")
STANDING_FOR = ("mean", "share", "median")
"""Statistics that stand for an outcome in a column of its own: the first of them that it has."""
SCALE = (
    "Scores are 0 and 1 at the numbers of [scores] in the study's file, or else at the random player's mean",
    "and the best condition's. Intervals over all are of the stratified bootstrap (Agarwal et al. 2021).",
)


def summarize(
    study_data: StudyData,
    outcomes: Sequence[str] = (),
    for_paper: bool = False,
    cell_form: str | None = None,
) -> Answer:
    """Summarize the outcomes of each condition.

    Args:
        study_data: an opened study.
        outcomes: names from docs/outcomes.md, whose statistics are all shown; default: the means of the first
            default ones.
        for_paper: whether the cells are a paper's table: a column for each outcome.
        cell_form: one of `CELL_FORMS`, for a paper; default: `sd`, or `interval` with scores over
            environments, which have no standard deviation.

    Returns:
        The table `summary` has a row for each condition, outcome and statistic. In a crossed study of several
        environments, `scores` are those over all of them.

    Raises:
        UserError: for an unknown outcome, or deviations of scores.
    """
    data_by_env = by_environment(study_data)
    if len(data_by_env) > 1 and study_data.study.factors and len(outcomes) <= 1:
        if cell_form == "sd":
            raise UserError(Hint("cells", "sd"), ": scores over environments have no standard deviation")
        return _summarize_environments(study_data, data_by_env, (*outcomes, OUTCOME)[0])
    summary = summary_table(study_data, outcomes)
    legend: list[str] = []
    if for_paper:
        cells = _paper_cells(study_data, with_cells(summary, cell_form or "sd"), outcomes)
    elif outcomes:
        cells = _statistics_cells(study_data, with_cells(summary), outcomes)
    else:
        cells = _overview_cells(study_data, with_cells(summary))
        legend = _overview_legend(study_data, summary, cells)
    means = summary["outcome"][summary["statistic"] == "mean"].unique()
    shown_outcomes = outcomes or [outcome for outcome in means if outcome in cells]
    notes = (
        notes_on_ends(study_data)
        + _missing_values(study_data, summary, outcomes)
        + notes_on_outcomes(study_data, shown_outcomes)
    )
    shown_cells = [study_data.with_labels(cells)]
    return Answer(study_data.full_title, study_data.about, {"summary": summary}, shown_cells, notes, legend)


def _summarize_environments(
    study_data: StudyData, data_by_env: Mapping[str, StudyData], outcome: str
) -> Answer:
    """Summarize an outcome: the mean of each condition in each environment, and its scores over all."""
    env_summaries = []
    for env, env_data in data_by_env.items():
        env_summaries.append(with_cells(summary_table(env_data, [outcome])).assign(environment=env))
    summary = pd.concat(env_summaries, ignore_index=True)
    summary = summary[(summary["outcome"] == outcome) & (summary["statistic"] == "mean")]
    conditions = list(summary["condition"].unique())
    cells = pivot_cells(summary, ["condition"], ["environment"], conditions, list(data_by_env))
    names = environment_names(study_data)
    cells.columns = pd.Index([names[env] for env in data_by_env])
    tables = {"summary": summary.drop(columns="cell")}
    legend = [f"{with_unit(outcome)} in each environment."]
    notes = notes_on_ends(study_data)
    try:
        scores = tables["scores"] = over_environments(data_by_env, outcome)
    except UserError as missing_scale:
        notes.append(f"No scores over all: {missing_scale}.")
    else:
        statistics = list(scores["statistic"].unique())
        score_cells = pivot_cells(with_cells(scores), ["condition"], ["statistic"], conditions, statistics)
        score_cells.columns = pd.Index(statistics)
        cells = pd.concat([cells, score_cells], axis=1)
        legend = [f"{with_unit(outcome)} in each environment, then scores over all.", *SCALE]
        notes += notes_on_few_runs(data_by_env)
    run_counts = []
    for condition in conditions:
        run_counts.append(
            ", ".join(str(len(env_data.of_condition(condition))) for env_data in data_by_env.values())
        )
    cells.insert(0, "runs", run_counts)
    shown_cells = [study_data.with_labels(cells.reset_index())]
    return Answer(study_data.full_title, study_data.about, tables, shown_cells, notes, legend)


# --- Cells ----------------------------------------------------------------------------------------


def _statistics_cells(study_data: StudyData, summary: pd.DataFrame, outcomes: Sequence[str]) -> pd.DataFrame:
    """Return a row for each outcome and condition, with all statistics."""
    summary = summary[summary["outcome"].isin(outcomes)]
    run_counts = summary.groupby(["outcome", "condition"])["runs"].first()
    row_labels = [(outcome, condition) for outcome in outcomes for condition in study_data.conditions]
    row_labels = [row_label for row_label in row_labels if row_label in run_counts]
    statistics = list(summary["statistic"].unique())
    cell_table = pivot_cells(summary, ["outcome", "condition"], ["statistic"], row_labels, statistics)
    cell_table.insert(0, "n", run_counts)
    cell_table = cell_table.reset_index().rename_axis(columns=None)
    return cell_table.assign(outcome=cell_table["outcome"].map(with_unit))


def _overview_cells(study_data: StudyData, summary: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each condition: means of the first outcomes, and shares of runs that failed, if any.

    It has at most five columns, so that a terminal shows words whole.
    """
    failed = [(outcome, "share") for outcome in FAILURES if (_failed_shares(summary, outcome) > 0).any()]
    outcome_names = summary["outcome"][summary["statistic"] == "mean"].unique()[: SHOWN - len(failed)]
    mean_columns = [(outcome, "mean") for outcome in outcome_names]
    return condition_cells(study_data, summary, mean_columns + failed).reset_index()


def _paper_cells(study_data: StudyData, summary: pd.DataFrame, outcomes: Sequence[str]) -> pd.DataFrame:
    """Return a row for each condition that has one of the outcomes, and a column for each outcome.

    The conditions of a crossed study have a column for each factor.
    """
    standing_rows = summary[summary["statistic"].isin(STANDING_FOR)]
    statistics = standing_rows.groupby("outcome", sort=False)["statistic"].first()
    outcome_names = outcomes or statistics.index[statistics == "mean"][:SHOWN]
    cell_table = condition_cells(
        study_data, summary, [(outcome, statistics.get(outcome, "")) for outcome in outcome_names]
    )
    cell_table = cell_table[(cell_table.drop(columns="runs") != NO_CELL).any(axis=1)]
    if study_data.study.levels:
        rows = []
        for condition in cell_table.index:
            condition_levels = study_data.study.levels[condition].items()
            rows.append({factor: study_data.labelled(level, factor) for factor, level in condition_levels})
        levels = pd.DataFrame(rows)
        levels.columns = levels.columns.str.replace("_", " ")
        cell_table.index = pd.MultiIndex.from_frame(levels)
    return cell_table.reset_index()


# --- Notes ----------------------------------------------------------------------------------------


def _overview_legend(study_data: StudyData, summary: pd.DataFrame, cells: pd.DataFrame) -> list[str]:
    """Return the ways in which no run failed, and what the cells mean."""
    legend = []
    unseen_failures = []
    for outcome in FAILURES:
        shares = _failed_shares(summary, outcome)
        if shares.notna().any() and not (shares > 0).any():
            unseen_failures.append(outcome)
    if unseen_failures:
        legend.append(f"No run {' or '.join(unseen_failures)}.")
    explanation = "Means and shares of runs, with 95 % confidence intervals."
    if (cells == NO_CELL).any(axis=None):
        explanation += " –: no run has a value."
    if any(len(study_data.of_condition(condition)) < LEAST_RUNS for condition in study_data.conditions):
        explanation += f" Means of fewer than {LEAST_RUNS} runs have no interval."
    return legend + [explanation]


def _failed_shares(summary: pd.DataFrame, outcome: str) -> pd.Series:
    return summary["value"][(summary["outcome"] == outcome) & (summary["statistic"] == "share")]


def _missing_values(study_data: StudyData, summary: pd.DataFrame, outcomes: Sequence[str]) -> list[str]:
    """Return which conditions have no value of a named outcome, and why."""
    pairs_with_values = set(zip(summary["outcome"], summary["condition"], strict=True))
    notes = []
    untrained = [condition for condition in study_data.conditions if not study_data.of_condition(condition)]
    if untrained:
        notes.append(f"no finished run of {'; '.join(untrained)}")
    for condition in study_data.conditions:
        for outcome in outcomes:
            if condition not in untrained and (outcome, condition) not in pairs_with_values:
                cause = reason(study_data.of_condition(condition)[0], outcome) or "no run gets there"
                notes.append(f"{outcome}, {condition}: {cause}")
    means = summary["outcome"][summary["statistic"] == "mean"]
    return notes + _runs_without_value(study_data, pairs_with_values, outcomes or means[:1])


def _runs_without_value(
    study_data: StudyData, pairs_with_values: Container[tuple[str, str]], outcomes: Iterable[str]
) -> list[str]:
    """Return which single runs lack a value that others of their condition have, and why."""
    left_out = []
    for outcome in outcomes:
        for condition, seed, run in study_data.runs[["condition", "seed", "row"]].itertuples(index=False):
            cause = (outcome, condition) in pairs_with_values and reason(run, outcome)
            if cause:
                left_out.append(
                    f"{outcome}: {condition} seed {seed}, to step {run.end:,}, is left out: {cause}"
                )
    if len(left_out) > MOST_NAMED:
        left_out[MOST_NAMED:] = [f"{len(left_out) - MOST_NAMED} more runs are left out"]
    return left_out


# --- Every run's outcomes ---------------------------------------------------------------------------

WITHOUT_EVALUATIONS = "final-return"
SHOWN_STATISTICS = ("mean", "iqm")


def show_outcomes(studies: Mapping[str, StudyData]) -> Answer:
    """Return the outcomes of the runs of a study, all that its file names or the default one.

    Args:
        studies: its runs in each environment, by title; "" for a single one. Several show one outcome each.

    Returns:
        The table `runs` has the known value of each run, `summary` means and interquartile means. For a
        figure, `panels` has the outcome and environment of each column, `reference` the random player.
    """
    outcomes: dict[str, tuple[str, str]] = {}
    for title, study_data in studies.items():
        outcome_names = study_data.study.outcomes or [default_outcome(study_data)]
        if len(studies) > 1:
            if len(outcome_names) > 1:
                outcome_names = [default_outcome(study_data)]
            outcomes[title] = title, outcome_names[0]
            continue
        headings = [re.split(r",| \(", words_of(outcome_name))[0] for outcome_name in outcome_names]
        for outcome_name, heading in zip(outcome_names, headings, strict=True):
            column_title = heading if headings.count(heading) == 1 else words_of(outcome_name)
            outcomes[column_title] = title, outcome_name
    shown_studies: dict[str, StudyData] = {}
    notes_by_title: dict[str, list[str]] = {}
    descriptions: list[str] = []
    run_frames, summaries = [], []
    panel_rows: list[tuple[str, str, str]] = []
    level_rows: list[tuple[str, str, float]] = []
    for title, (environment, outcome) in outcomes.items():
        study_data = shown_studies[title] = studies[environment]
        panel_rows.append((title, environment, outcome))
        if title != words_of(outcome):
            descriptions.append(f"{words_of(outcome)}.")
        values_by_condition: dict[str, np.ndarray] = {}
        for condition in study_data.conditions:
            if study_data.of_condition(condition):
                values = values_by_condition[condition] = known_values(study_data, condition, outcome)
                run_frames.append(pd.DataFrame({"column": title, "condition": condition, "value": values}))
        notes_by_title[title] = _notes(study_data, outcome, values_by_condition)
        for condition, level in _random_levels(study_data, outcome).items():
            level_rows.append((title, condition, level))
        summary = summary_table(study_data, [outcome]).assign(column=title)
        is_shown = (summary["outcome"] == outcome) & summary["statistic"].isin(SHOWN_STATISTICS)
        summaries.append(summary[is_shown])
    first_data, (names, factors) = next(iter(studies.values())), short_names(studies.values())
    summary = pd.concat(summaries, ignore_index=True)
    return Answer(
        title=first_data.full_title,
        about=first_data.about,
        tables={"summary": summary, "runs": pd.concat(run_frames, ignore_index=True)},
        cells=[summary],
        notes=list(dict.fromkeys([*descriptions, *merge_notes(shown_studies, notes_by_title)])),
        drawing=drawing_of(
            studies,
            "summary",
            names=names,
            factors=factors,
            panels=pd.DataFrame(panel_rows, columns=["column", "environment", "outcome"]),
            reference=pd.DataFrame(level_rows, columns=["column", "condition", "value"]),
        ),
    )


def default_outcome(study_data: StudyData) -> str:
    """Return the share killed at the end, or a return if there are no monsters or no evaluations."""
    if is_foreign(study_data) and study_data.evaluated:
        return primary(study_data)
    return PRIMARY if "share_killed" in curve_names(study_data) else WITHOUT_EVALUATIONS


def words_of(outcome: str) -> str:
    """Return the description of an outcome as a sentence begins."""
    words = find_outcome(outcome).words
    return words[:1].upper() + words[1:]


def _random_levels(study_data: StudyData, outcome: str) -> dict[str, float]:
    """Return the random player's outcome for each condition, where it was measured."""
    if outcome.endswith("share-killed"):
        return random_levels(study_data, "share_killed")
    if outcome == "evaluated-return":
        return random_levels(study_data, "evaluated_return")
    returns = random_returns(study_data, study_data.budget)
    if outcome != WITHOUT_EVALUATIONS or returns is None or returns.empty:
        return {}
    return {"": float(returns.iloc[-1])}


def _notes(study_data: StudyData, outcome: str, values_by_condition: Mapping[str, np.ndarray]) -> list[str]:
    declared = find_outcome(outcome)
    notes = notes_on_runs(study_data, declared.is_return) + notes_on_ends(study_data)
    if declared.column:
        notes += notes_on_zero_xp(study_data)
    value_counts = [len(values) for values in values_by_condition.values()]
    for condition, value_count in zip(values_by_condition, value_counts, strict=True):
        run_count = len(study_data.of_condition(condition))
        if value_count < run_count:
            notes.append(f"{run_count - value_count} of {run_count} runs of {condition} have no value.")
    if min(value_counts) < LEAST_RUNS:
        notes.append(f"Of fewer than {LEAST_RUNS} runs there is no interval.")
    if max(value_counts) >= LEAST_RUNS:
        notes.append("Intervals: Student's t for means, else bootstrap.")
    return notes
