"""Which runs collapsed."""

from __future__ import annotations

import pandas as pd

from pneuma.analysis.collapse import diagnoses, incidence
from pneuma.analysis.study_data import StudyData
from pneuma.answers.answer import Answer
from pneuma.answers.cells import NO_CELL
from pneuma.values import per_cent


def find_collapses(data: StudyData) -> Answer:
    """Diagnose every run of an opened study.

    Returns:
        The table `runs` has the diagnosis of each run, `incidence` the counts and shares of each condition.
    """
    runs = diagnoses(data)
    shares = incidence(data, runs)
    collapsed = runs[runs["collapsed"].fillna(False)]
    steps = collapsed["onset_step"].map("{:,}".format)
    signs = collapsed[["condition", "seed", "run_id", "signs"]].rename(columns={"run_id": "run"})
    signs.insert(3, "step", steps)
    rows = []
    for row in shares.to_dict("records"):
        interval = NO_CELL
        if row["runs"]:
            interval = f"{per_cent(round(row['low'], 2))} to {per_cent(round(row['high'], 2))}"
        rows.append((row["condition"], f"{row['collapsed']} of {row['runs']}", interval, row["unknown"]))
    counts = pd.DataFrame(
        rows, columns=["condition", "collapsed", "95 % interval", "without a sign recorded"]
    )
    cells = [signs, counts] if len(signs) else [counts]
    title = f"{data.full_title}: collapse"
    return Answer(title, data.about, {"runs": runs, "incidence": shares}, cells)
