"""Print how far runs of one condition spread, for the design check of claims; and no mean.

    python studies/pilot.py RESULTS [KEY=VALUE …] > spreads.csv

Each row is one outcome of a condition: the standard deviation between its runs. Every study is read in each
of its worlds, with fields changed as by `--set`; those without runs, stored or published, are left out.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator, Mapping

import numpy as np

from pneuma.analysis.asked import open_study
from pneuma.analysis.frames import StudyData, table_name
from pneuma.analysis.outcomes import outcome_values
from pneuma.analysis.run_index import RunIndex
from pneuma.errors import UserError
from pneuma.study.plan import Selection
from pneuma.study.spec import list_studies, load_study
from pneuma.study.store import Store
from pneuma.values import read_value

OUTCOMES = (
    "final-return", "late-share-killed", "auc-return", "auc-share-killed", "curve-roughness",
    "fall-from-best", "late-slope", "mean-kl", "stuck-share", "grad-norm-growth", "log-max-grad-norm",
    "final-died", "final-hp", "final-action-4",
)  # fmt: skip


def studies_of(results: str, settings: Mapping[str, object]) -> Iterator[StudyData]:
    """Yield every study of which runs are stored or published, in each of its worlds."""
    index = RunIndex(Store(results))
    for name in list_studies():
        for world in load_study(name).worlds:
            try:
                yield open_study(index, name, Selection(settings=settings), world)
            except UserError:
                continue


def spreads(data: StudyData) -> Iterator[tuple[str, str, str, int, str]]:
    """Yield study, condition, outcome, number of runs and standard deviation."""
    for condition in data.conditions:
        for name in OUTCOMES:
            values = outcome_values(data, condition, name)
            values = values[np.isfinite(values)]
            if values.size > 1:
                yield table_name(data), condition, name, values.size, f"{values.std(ddof=1):.3g}"


if __name__ == "__main__":
    folder, *words = sys.argv[1:]
    changed = {key: read_value(value) for key, _, value in (word.partition("=") for word in words)}
    rows = csv.writer(sys.stdout, lineterminator="\n")
    rows.writerow(("study", "condition", "outcome", "runs", "deviation"))
    for each in studies_of(folder, changed):
        rows.writerows(spreads(each))
