"""Numbers as text: the cells of tables that people read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from pneuma.analysis.answer import NO_CELL
from pneuma.analysis.intervals import decimals, number_text, number_with_interval
from pneuma.analysis.outcomes import with_unit
from pneuma.analysis.study_data import StudyData

CELL_FORMS = ("sd", "interval")
"""Means with the standard deviation of runs, as 0.68 ± 0.11, or with their interval."""


def with_cells(summary: pd.DataFrame, cell_form: str = "interval") -> pd.DataFrame:
    """Return a summary with a column `cell`: each value as text, in one of `CELL_FORMS`."""
    interval_values = zip(summary["value"], summary["low"], summary["high"], strict=True)
    cells = [number_with_interval(value, low, high) for value, low, high in interval_values]
    summary = summary.assign(cell=cells)
    if cell_form == "interval":
        return summary
    deviations = summary[summary["statistic"] == "deviation"].set_index(["condition", "outcome"])["value"]
    for row_label, row in summary[summary["statistic"] == "mean"].iterrows():
        mean, deviation = row["value"], deviations[row["condition"], row["outcome"]]
        if np.isfinite(deviation):
            digits = decimals(mean, mean - deviation, mean + deviation)
            summary.loc[row_label, "cell"] = f"{number_text(mean, digits)} ± {number_text(deviation, digits)}"
    return summary


def pivot_cells(
    summary: pd.DataFrame, rows: Sequence[str], columns: Sequence[str], row_labels: Any, column_labels: Any
) -> pd.DataFrame:
    """Return the cells of a summary as a table.

    Args:
        summary: of `with_cells`.
        rows: the columns of the summary that make the rows of the table.
        columns: those that make its columns.
        row_labels: the rows, in order; those without a cell have `NO_CELL`.
        column_labels: the same for columns.
    """
    cell_table = summary.pivot(index=list(rows), columns=list(columns), values="cell")
    return cell_table.reindex(index=row_labels, columns=column_labels).astype(object).fillna(NO_CELL)


def condition_cells(
    study_data: StudyData, summary: pd.DataFrame, statistics: Sequence[tuple[str, str]]
) -> pd.DataFrame:
    """Return a row for each condition with its number of runs, and a column for each outcome's statistic.

    A value of fewer runs than the condition has is followed by their number.
    """
    run_counts = {condition: len(study_data.of_condition(condition)) for condition in study_data.conditions}
    is_of_fewer = summary["runs"] < summary["condition"].map(run_counts)
    count_texts = summary["runs"].map(" (n = {})".format).where(is_of_fewer, "")
    summary = summary.assign(cell=summary["cell"] + count_texts)
    cell_table = pivot_cells(
        summary, ["condition"], ["outcome", "statistic"], study_data.conditions, list(statistics)
    )
    headings = []
    for outcome, statistic in statistics:
        heading = outcome if statistic == "share" else with_unit(outcome)
        headings.append(f"{heading}, median" if statistic == "median" else heading)
    cell_table.columns = pd.Index(headings)
    cell_table.insert(0, "runs", list(run_counts.values()))
    return cell_table


def comparison_cells(
    comparison_table: pd.DataFrame, headings: Sequence[str], first_heading: str
) -> pd.DataFrame:
    """Return the rows of a comparison as text.

    Args:
        comparison_table: rows of `compare_groups` with the column `shared`, what is compared in a row.
        headings: what is compared, for the columns of means.
        first_heading: the head of the column `shared`, which is left out if it is empty everywhere.
    """
    cell_rows = []
    for row in comparison_table.to_dict("records"):
        low, high = row["low"], row["high"]
        p_better = NO_CELL if np.isnan(row["p_better"]) else f"{row['p_better']:.2f}"
        cell_rows.append((
            row["shared"],
            with_unit(row["outcome"]),
            number_text(row["mean_a"], decimals(row["mean_a"], low, high)),
            number_text(row["mean_b"], decimals(row["mean_b"], low, high)),
            number_with_interval(row["difference"], low, high),
            p_better,
            f"{row['seeds_a']} and {row['seeds_b']}",
            row["without_value"],
        ))  # fmt: skip
    columns = [first_heading, "outcome", *headings, "difference", "P(better)", "runs", "no value"]
    cells = pd.DataFrame(cell_rows, columns=columns)
    if (comparison_table["shared"] == "").all():
        return cells.iloc[:, 1:]
    return cells
