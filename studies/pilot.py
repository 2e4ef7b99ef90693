"""Print how far runs of one condition spread, for the design check of claims; and no mean.

    python studies/pilot.py RESULTS [STUDY …] > spreads.csv

Each row is one outcome of a condition: the standard deviation between its runs. Without names all studies of
the folder are read; one without a record in the folder is read from its published table.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator, Sequence

import numpy as np
from pneuma.analysis.published import read_published

from pneuma.analysis.outcomes import outcome_values
from pneuma.analysis.run_index import open_study
from pneuma.study.store import Store

OUTCOMES = (
    "final-return", "late-share-killed", "auc-return", "auc-share-killed", "curve-roughness",
    "fall-from-best", "late-slope", "mean-kl", "stuck-share", "grad-norm-growth", "log-max-grad-norm",
    "final-died", "final-hp", "final-action-4",
)  # fmt: skip


def spreads(store: Store, studies: Sequence[str]) -> Iterator[tuple[str, str, str, int, str]]:
    """Yield study, condition, outcome, number of runs and standard deviation."""
    for study in studies or store.studies():
        data = open_study(store, store.selection(study) or read_published(store, study).record)
        for condition in data.conditions:
            for name in OUTCOMES:
                values = outcome_values(data, condition, name)
                values = values[np.isfinite(values)]
                if values.size > 1:
                    yield data.study, condition, name, values.size, f"{values.std(ddof=1):.3g}"


if __name__ == "__main__":
    rows = csv.writer(sys.stdout, lineterminator="\n")
    rows.writerow(("study", "condition", "outcome", "runs", "deviation"))
    rows.writerows(spreads(Store(sys.argv[1]), sys.argv[2:]))
