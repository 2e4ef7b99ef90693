"""Calibration of the statistics, shown: how often a verdict is false, and how often an interval covers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from pneuma.bench import claim_lists, coverage

LISTS = 2_000
COVERED_PER_LIST = 10


def bench_calibration(lists: int = LISTS, seed: int = 0) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield rows of two tables as they come: ("coverage", row), then ("false_verdicts", row).

    Args:
        lists: how many lists of claims to simulate in each setting.
        seed: of the generators of everything that is drawn; equivalence, means and stages have their own.
    """
    generator = np.random.default_rng(seed)
    for row in coverage.coverages(lists * COVERED_PER_LIST, generator):
        yield "coverage", row
    for row in claim_lists.false_verdicts(lists, generator):
        yield "false_verdicts", row
    equal = np.random.default_rng([seed, 2])
    for row in claim_lists.false_verdicts_on_equivalence(lists, equal):
        yield "false_verdicts", row
    for row in claim_lists.false_verdicts_on_means(lists, np.random.default_rng([seed, 3])):
        yield "false_verdicts", row
    for row in claim_lists.staged_verdicts(lists, np.random.default_rng([seed, 1])):
        yield "false_verdicts", row
