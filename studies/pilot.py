"""Print how far runs of one condition spread, for the design check of claims; and no mean.

    python studies/pilot.py RESULTS [KEY=VALUE …] > spreads.csv

Each row is one outcome of a condition: the standard deviation between its runs. Every study that a claim is
about is read in each of its worlds, with fields changed as by `--set`. Left out are conditions without runs,
stored or published, and those of which the runs have another number of environments than claims: four.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator, Mapping

import numpy as np

from pneuma.analysis.claims.claim_list import load_claims
from pneuma.analysis.outcomes import outcome_values
from pneuma.analysis.run_index import RunIndex
from pneuma.analysis.runs import open_study
from pneuma.analysis.study_data import StudyData
from pneuma.errors import UserError
from pneuma.study.plan import Selection
from pneuma.study.spec import load_study
from pneuma.study.store import Store
from pneuma.values import read_value

OUTCOMES = (
    "final-return", "late-share-killed", "curve-roughness", "fall-from-best", "log-max-kl",
    "low-entropy-share", "grad-norm-growth", "final-died", "final-hp", "final-action-4",
    "final-commonest-action", "early-explained-variance", "steps-to:0.23", "steps-to:0.34", "steps-to:0.43",
    "steps-to:0.47",
)  # fmt: skip
"""Those of the claims."""
SLOTS = 4
"""Environments of each run of a claim."""


def studies_of(results: str, settings: Mapping[str, object]) -> Iterator[StudyData]:
    """Yield every study of a claim of which runs are stored or published, in each of its worlds."""
    index = RunIndex(Store(results))
    for name in dict.fromkeys(claim.study for claim in load_claims().claims.values()):
        for world in load_study(name).worlds:
            try:
                data = open_study(index, name, Selection(settings=settings), world)
            except UserError:
                continue
            of_four = [
                condition
                for condition in data.conditions
                if {run.fields.get("slots") for run in data.of_condition(condition)} == {SLOTS}
            ]
            if of_four:
                yield data.of_conditions(of_four)


def spreads(data: StudyData) -> Iterator[tuple[str, str, str, int, str]]:
    """Yield study, condition, outcome, number of runs and standard deviation."""
    for condition in data.conditions:
        runs = data.of_condition(condition)
        for name in OUTCOMES:
            values = outcome_values(data, condition, name)
            values = np.where(np.isinf(values), [run.budget for run in runs], values)  # as claims count it
            values = values[~np.isnan(values)]
            if values.size > 1:
                yield data.table_name, condition, name, values.size, f"{values.std(ddof=1):.3g}"


if __name__ == "__main__":
    folder, *words = sys.argv[1:]
    changed = {key: read_value(value) for key, _, value in (word.partition("=") for word in words)}
    rows = csv.writer(sys.stdout, lineterminator="\n")
    rows.writerow(("study", "condition", "outcome", "runs", "deviation"))
    for each in studies_of(folder, changed):
        rows.writerows(spreads(each))
