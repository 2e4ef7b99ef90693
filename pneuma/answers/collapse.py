"""Which runs collapsed."""

from __future__ import annotations

import pandas as pd

from pneuma.analysis.collapse import diagnoses, incidence
from pneuma.analysis.study_data import StudyData
from pneuma.answers.answer import Answer
from pneuma.answers.cells import NO_CELL, with_labels
from pneuma.values import per_cent


def find_collapses(study_data: StudyData) -> Answer:
    """Diagnose every run of an opened study.

    Returns:
        The table `runs` has the diagnosis of each run, `incidence` the counts and shares of each condition.
    """
    diagnosed_runs = diagnoses(study_data)
    incidence_table = incidence(study_data, diagnosed_runs)
    collapsed_runs = diagnosed_runs[diagnosed_runs["collapsed"].fillna(False)]
    onset_steps = collapsed_runs["onset_step"].map("{:,}".format)
    sign_table = collapsed_runs[["condition", "seed", "run_id", "signs"]].rename(columns={"run_id": "run"})
    sign_table.insert(3, "step", onset_steps)
    count_rows = []
    for row in incidence_table.to_dict("records"):
        interval = NO_CELL
        if row["runs"]:
            interval = f"{per_cent(round(row['low'], 2))} to {per_cent(round(row['high'], 2))}"
        count_rows.append(
            (row["condition"], f"{row['collapsed']} of {row['runs']}", interval, row["unknown"])
        )
    count_table = pd.DataFrame(
        count_rows, columns=["condition", "collapsed", "95 % interval", "without a sign recorded"]
    )
    cells = [sign_table, count_table] if len(sign_table) else [count_table]
    cells = [with_labels(study_data, table) for table in cells]
    title = f"{study_data.full_title}: collapse"
    return Answer(title, study_data.about, {"runs": diagnosed_runs, "incidence": incidence_table}, cells)
