"""The runs of a study that are stored in a results folder, the best first."""

from __future__ import annotations

import pandas as pd

from pneuma.analysis.outcomes import check_outcome, find_outcome, outcome, primary
from pneuma.analysis.study_data import StudyData
from pneuma.errors import UserError


def ranked_runs(data: StudyData, name: str = "") -> tuple[str, pd.DataFrame]:
    """Rank the finished runs of a study that are stored here, and not only published, by an outcome.

    Args:
        data: an opened study.
        name: the outcome; default: the study's primary one.

    Returns:
        The outcome; and run_id, condition, seed and value of each run, the best first.

    Raises:
        UserError: for an unknown outcome, or if no run is stored here.
    """
    name = name or primary(data)
    check_outcome(name, data.environments)
    stored = data.runs[data.runs["where"] == ""]
    if not len(stored):
        raise UserError(f"{data.label}: none of its runs is stored here")
    values = [outcome(row, name) for row in stored["row"]]
    ranked = stored[["run_id", "condition", "seed"]].assign(value=values)
    is_lower_better = find_outcome(name).better == "lower"
    return name, ranked.sort_values("value", ascending=is_lower_better, kind="stable", ignore_index=True)
