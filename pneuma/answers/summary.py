"""Summaries of each condition's outcomes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import pandas as pd

from pneuma.analysis.environments import OUTCOME, by_environment, over_environments
from pneuma.analysis.intervals import LEAST_RUNS
from pneuma.analysis.outcomes import reason, with_unit
from pneuma.analysis.study_data import StudyData
from pneuma.analysis.summaries import summary_table
from pneuma.answers.answer import Answer
from pneuma.answers.cells import NO_CELL, condition_cells, pivot_cells, with_cells
from pneuma.errors import counted

SHOWN = 3
"""Outcomes whose means are shown by default."""
FAILURES = ("collapsed", "diverged")
STANDING_FOR = ("mean", "share", "median")
"""Statistics that stand for an outcome in a column of its own: the first of them that it has."""
FEW_EPISODES = 10
"""With fewer, the last point of a return is noted to average few."""
SCALE = (
    "Scores are 0 and 1 at the numbers of [scores] in the study's file, or else at the random player's mean",
    "and the best condition's. Intervals over all are of the stratified bootstrap (Agarwal et al. 2021).",
)


def summarize(data: StudyData, outcomes: Sequence[str] = (), paper_cells: str = "") -> Answer:
    """Summarize the outcomes of each condition.

    Args:
        data: an opened study.
        outcomes: names from docs/outcomes.md, of which all statistics are shown; default: the means of the
            first usual ones.
        paper_cells: one of `CELL_FORMS` for the table of a paper: a column for each outcome.

    Returns:
        The table `summary` has a row for each condition, outcome and statistic. In a crossed study of several
        environments, `scores` are those over all of them.

    Raises:
        UserError: for an unknown outcome.
    """
    data_by_env = by_environment(data)
    if len(data_by_env) > 1 and data.study.factors and len(outcomes) <= 1:
        return _summarize_environments(data, data_by_env, (*outcomes, OUTCOME)[0], paper_cells or "interval")
    table = summary_table(data, outcomes)
    legend: list[str] = []
    if paper_cells:
        cells = _paper_cells(data, with_cells(table, paper_cells), outcomes)
    elif outcomes:
        cells = _statistics_cells(data, with_cells(table), outcomes)
    else:
        cells = _overview_cells(data, with_cells(table))
        legend = _overview_legend(data, table, cells)
    notes = [data.ends] + _missing_values(data, table, outcomes) + [few_episodes(data, outcomes)]
    return Answer(data.full_title, data.about, {"summary": table}, [cells], notes, legend)


def _summarize_environments(
    data: StudyData, data_by_env: Mapping[str, StudyData], outcome: str, form: str
) -> Answer:
    """Summarize an outcome: the mean of each condition in each environment, and its scores over all."""
    frames = []
    for env, env_data in data_by_env.items():
        frames.append(with_cells(summary_table(env_data, [outcome]), form).assign(environment=env))
    summary = pd.concat(frames, ignore_index=True)
    summary = summary[(summary["outcome"] == outcome) & (summary["statistic"] == "mean")]
    scores = over_environments(data_by_env, outcome)
    conditions = list(summary["condition"].unique())
    means = pivot_cells(summary, ["condition"], ["environment"], conditions, list(data_by_env))
    statistics = list(scores["statistic"].unique())
    over_all = pivot_cells(with_cells(scores), ["condition"], ["statistic"], conditions, statistics)
    cells = pd.concat([means, over_all], axis=1)
    cells.columns = pd.Index(list(data_by_env) + statistics)
    runs = []
    for condition in conditions:
        runs.append(
            ", ".join(str(len(env_data.of_condition(condition))) for env_data in data_by_env.values())
        )
    cells.insert(0, "runs", runs)
    legend = [f"{with_unit(outcome)} in each environment, then scores over all."] + list(SCALE)
    tables = {"summary": summary.drop(columns="cell"), "scores": scores}
    notes = [data.ends, few_runs(data_by_env)]
    return Answer(data.full_title, data.about, tables, [cells.reset_index()], notes, legend)


# --- Cells ----------------------------------------------------------------------------------------


def _statistics_cells(data: StudyData, summary: pd.DataFrame, outcomes: Sequence[str]) -> pd.DataFrame:
    """Return a row for each outcome and condition, with all statistics."""
    summary = summary[summary["outcome"].isin(outcomes)]
    runs = summary.groupby(["outcome", "condition"])["runs"].first()
    pairs = [(name, condition) for name in outcomes for condition in data.conditions]
    pairs = [pair for pair in pairs if pair in runs]
    statistics = list(summary["statistic"].unique())
    table = pivot_cells(summary, ["outcome", "condition"], ["statistic"], pairs, statistics)
    table.insert(0, "n", runs)
    table = table.reset_index().rename_axis(columns=None)
    return table.assign(outcome=table["outcome"].map(with_unit))


def _overview_cells(data: StudyData, summary: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each condition: means of the first outcomes, and shares of runs that failed, if any.

    It has at most five columns, so that a terminal shows words whole.
    """
    failed = [(name, "share") for name in FAILURES if (_failed_shares(summary, name) > 0).any()]
    names = summary["outcome"][summary["statistic"] == "mean"].unique()[: SHOWN - len(failed)]
    means = [(name, "mean") for name in names]
    return condition_cells(data, summary, means + failed).reset_index()


def _paper_cells(data: StudyData, summary: pd.DataFrame, outcomes: Sequence[str]) -> pd.DataFrame:
    """Return a row for each condition that has one of the outcomes, and a column for each outcome.

    The conditions of a crossed study have a column for each factor.
    """
    standing = summary[summary["statistic"].isin(STANDING_FOR)]
    statistics = standing.groupby("outcome", sort=False)["statistic"].first()
    names = outcomes or statistics.index[statistics == "mean"][:SHOWN]
    table = condition_cells(data, summary, [(name, statistics.get(name, "")) for name in names])
    table = table[(table.drop(columns="runs") != NO_CELL).any(axis=1)]
    if data.study.levels:
        levels = pd.DataFrame([data.study.levels[name] for name in table.index])
        levels.columns = levels.columns.str.replace("_", " ")
        table.index = pd.MultiIndex.from_frame(levels)
    return table.reset_index()


# --- Notes ----------------------------------------------------------------------------------------


def _overview_legend(data: StudyData, table: pd.DataFrame, cells: pd.DataFrame) -> list[str]:
    """Return the ways in which no run failed, and what the cells mean."""
    legend = []
    never = []
    for name in FAILURES:
        shares = _failed_shares(table, name)
        if shares.notna().any() and not (shares > 0).any():
            never.append(name)
    if never:
        legend.append(f"No run {' or '.join(never)}.")
    text = "Means and shares of runs, with 95 % confidence intervals."
    if (cells == NO_CELL).any(axis=None):
        text += " –: no run has a value."
    if any(len(data.of_condition(name)) < LEAST_RUNS for name in data.conditions):
        text += f" Means of fewer than {LEAST_RUNS} runs have no interval."
    return legend + [text]


def _failed_shares(summary: pd.DataFrame, name: str) -> pd.Series:
    return summary["value"][(summary["outcome"] == name) & (summary["statistic"] == "share")]


def _missing_values(data: StudyData, table: pd.DataFrame, outcomes: Sequence[str]) -> list[str]:
    """Return which conditions have no value of an outcome that was asked for, and why."""
    pairs_with_values = set(zip(table["outcome"], table["condition"], strict=True))
    notes = []
    untrained = [condition for condition in data.conditions if not data.of_condition(condition)]
    if untrained:
        notes.append(f"no finished run of {'; '.join(untrained)}")
    for condition in data.conditions:
        for outcome in outcomes:
            if condition not in untrained and (outcome, condition) not in pairs_with_values:
                cause = reason(data.of_condition(condition)[0], outcome)
                notes.append(f"{outcome}, {condition}: {cause}")
    return notes


def few_episodes(data: StudyData, outcomes: Sequence[str]) -> str:
    """Return how many runs' last returns average few episodes; empty if none do."""
    last_counts = [run.statistic("episodes", "last") for run in data.rows]
    counts = sorted(count for count in last_counts if 0 < count < FEW_EPISODES)
    if not counts or "final-return" not in outcomes:
        return ""
    between = f"{counts[0]:.0f}"
    if counts[0] < counts[-1]:
        between += f" to {counts[-1]:.0f}"
    return f"final-return of {counted(len(counts), 'run')} averages few episodes: {between}."


def few_runs(data_by_env: Mapping[str, StudyData]) -> str:
    """Return that intervals over environments are of few runs; empty if they are not."""
    counts = []
    for env_data in data_by_env.values():
        counts += [len(env_data.of_condition(condition)) for condition in env_data.conditions]
    if min(counts) >= LEAST_RUNS:
        return ""
    return f"Bootstrap intervals are too narrow if an environment has fewer than {LEAST_RUNS} runs."
