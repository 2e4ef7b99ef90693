"""The runs of a study that are stored in a results folder, the best first."""

from __future__ import annotations

import pandas as pd

from pneuma.analysis.outcomes import check_outcome, find_outcome, outcome, primary
from pneuma.analysis.study_data import StudyData
from pneuma.errors import UserError


def ranked_runs(study_data: StudyData, outcome_name: str = "") -> tuple[str, pd.DataFrame]:
    """Rank the finished runs of a study that are stored here, and not only published, by an outcome.

    Args:
        study_data: an opened study.
        outcome_name: the outcome; default: the study's primary one.

    Returns:
        The outcome; and run_id, condition, seed and value of each run, the best first.

    Raises:
        UserError: for an unknown outcome, or if no run is stored here.
    """
    outcome_name = outcome_name or primary(study_data)
    check_outcome(outcome_name, study_data.environments)
    stored_runs = study_data.runs[study_data.runs["where"] == ""]
    if not len(stored_runs):
        train = study_data.call("run_study")
        raise UserError(f"{study_data.label}: none of its runs is stored here; train them with `", train, "`")
    outcome_values = [outcome(row, outcome_name) for row in stored_runs["row"]]
    ranked = stored_runs[["run_id", "condition", "seed"]].assign(value=outcome_values)
    is_lower_better = find_outcome(outcome_name).better == "lower"
    return outcome_name, ranked.sort_values(
        "value", ascending=is_lower_better, kind="stable", ignore_index=True
    )
