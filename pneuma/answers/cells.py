"""Numbers as text: the cells of tables that people read."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from pneuma.analysis.intervals import decimals, shown, shown_with_interval
from pneuma.analysis.outcomes import with_unit
from pneuma.analysis.study_data import StudyData

NO_CELL = "–"
CELL_FORMS = ("sd", "interval")
"""Means with the standard deviation of runs, as 0.68 ± 0.11, or with their interval."""


def with_cells(summary: pd.DataFrame, form: str = "interval") -> pd.DataFrame:
    """Return a summary with a column `cell`: each value as text, in one of `CELL_FORMS`."""
    values = zip(summary["value"], summary["low"], summary["high"], strict=True)
    cells = [shown_with_interval(value, low, high) for value, low, high in values]
    summary = summary.assign(cell=cells)
    if form == "interval":
        return summary
    deviations = summary[summary["statistic"] == "deviation"].set_index(["condition", "outcome"])["value"]
    for label, row in summary[summary["statistic"] == "mean"].iterrows():
        mean, deviation = row["value"], deviations[row["condition"], row["outcome"]]
        if np.isfinite(deviation):
            digits = decimals(mean, mean - deviation, mean + deviation)
            summary.loc[label, "cell"] = f"{shown(mean, digits)} ± {shown(deviation, digits)}"
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
    table = summary.pivot(index=list(rows), columns=list(columns), values="cell")
    return table.reindex(index=row_labels, columns=column_labels).astype(object).fillna(NO_CELL)


def condition_cells(
    data: StudyData, summary: pd.DataFrame, statistics: Sequence[tuple[str, str]]
) -> pd.DataFrame:
    """Return a row for each condition with its number of runs, and a column for each outcome's statistic.

    A value of fewer runs than the condition has is followed by their number.
    """
    runs = {condition: len(data.of_condition(condition)) for condition in data.conditions}
    is_of_fewer = summary["runs"] < summary["condition"].map(runs)
    fewer = summary["runs"].map(" (n = {})".format).where(is_of_fewer, "")
    summary = summary.assign(cell=summary["cell"] + fewer)
    table = pivot_cells(summary, ["condition"], ["outcome", "statistic"], data.conditions, list(statistics))
    heads = []
    for name, statistic in statistics:
        head = name if statistic == "share" else with_unit(name)
        heads.append(f"{head}, median" if statistic == "median" else head)
    table.columns = pd.Index(heads)
    table.insert(0, "runs", list(runs.values()))
    return table


def comparison_cells(table: pd.DataFrame, heads: Sequence[str], first_head: str) -> pd.DataFrame:
    """Return the rows of a comparison as text.

    Args:
        table: rows of `compare_groups` with the column `shared`, what is compared in a row.
        heads: what is compared, for the columns of means.
        first_head: the head of the column `shared`, which is left out if it is empty everywhere.
    """
    rows = []
    for row in table.to_dict("records"):
        low, high = row["low"], row["high"]
        p_better = NO_CELL if np.isnan(row["p_better"]) else f"{row['p_better']:.2f}"
        rows.append((
            row["shared"],
            with_unit(row["outcome"]),
            shown(row["mean_a"], decimals(row["mean_a"], low, high)),
            shown(row["mean_b"], decimals(row["mean_b"], low, high)),
            shown_with_interval(row["difference"], low, high),
            p_better,
            f"{row['seeds_a']} and {row['seeds_b']}",
            row["without_value"],
        ))  # fmt: skip
    columns = [first_head, "outcome", *heads, "difference", "P(better)", "runs", "no value"]
    cells = pd.DataFrame(rows, columns=columns)
    if (table["shared"] == "").all():
        return cells.iloc[:, 1:]
    return cells
