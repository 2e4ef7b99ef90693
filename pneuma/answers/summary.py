"""Summaries of each condition's outcomes."""

from __future__ import annotations

from collections.abc import Container, Iterable, Mapping, Sequence

import pandas as pd

from pneuma.analysis.answer import NO_CELL, Answer
from pneuma.analysis.cells import condition_cells, pivot_cells, with_cells
from pneuma.analysis.environments import OUTCOME, by_environment, over_environments
from pneuma.analysis.intervals import LEAST_RUNS
from pneuma.analysis.notes import MOST_NAMED, notes_on_ends, notes_on_few_episodes, notes_on_few_runs
from pneuma.analysis.outcomes import reason, with_unit
from pneuma.analysis.study_data import StudyData
from pneuma.analysis.summaries import summary_table
from pneuma.errors import Hint, UserError

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
    notes = (
        notes_on_ends(study_data)
        + _missing_values(study_data, summary, outcomes)
        + notes_on_few_episodes(study_data, outcomes)
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
    scores = over_environments(data_by_env, outcome)
    conditions = list(summary["condition"].unique())
    mean_cells = pivot_cells(summary, ["condition"], ["environment"], conditions, list(data_by_env))
    statistics = list(scores["statistic"].unique())
    score_cells = pivot_cells(with_cells(scores), ["condition"], ["statistic"], conditions, statistics)
    cells = pd.concat([mean_cells, score_cells], axis=1)
    cells.columns = pd.Index(list(data_by_env) + statistics)
    run_counts = []
    for condition in conditions:
        run_counts.append(
            ", ".join(str(len(env_data.of_condition(condition))) for env_data in data_by_env.values())
        )
    cells.insert(0, "runs", run_counts)
    legend = [f"{with_unit(outcome)} in each environment, then scores over all."] + list(SCALE)
    tables = {"summary": summary.drop(columns="cell"), "scores": scores}
    notes = notes_on_ends(study_data) + notes_on_few_runs(data_by_env)
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
