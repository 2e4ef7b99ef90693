"""What published single runs say on a claim: one run against one, beside how far apart equal ones lie.

Some pairs of the published runs stand for one configuration by accident. Their differences give
the standard deviation from run to run, with as many degrees of freedom as there are pairs, and against it a
difference of two single runs is tested. Where those runs are in the pairs themselves, a great difference
makes the deviation great as well: the test errs on the strict side.
"""

from __future__ import annotations

import numpy as np
from scipy import special

from pneuma.analysis.claims import Claim, LogContrast, PublishedLogs
from pneuma.analysis.contrasts import Contrast, undecided
from pneuma.analysis.intervals import Interval

LEVEL = 0.95
SINGLE = (1, 1)
"""Runs of either arm."""


def run_to_run_deviation(logs: PublishedLogs, figure: str) -> float:
    """Return the standard deviation of a figure between runs of one configuration; NaN without pairs."""
    differences = _differences(logs, figure)
    return float(np.sqrt((differences**2).mean() / 2)) if differences.size else float("nan")


def compare_logs(logs: PublishedLogs, claim: Claim, own: LogContrast) -> Contrast:
    """Compare two published runs by Student's t with the deviation that equal pairs have."""
    pairs = _differences(logs, own.figure).size
    if (own.a, own.b) in logs.same or (own.b, own.a) in logs.same:
        return undecided(claim.kind, "A/A: both published runs stand for one configuration", SINGLE)
    if claim.kind != "mean":
        return undecided(claim.kind, f"one published run each: they have no {claim.kind} to compare", SINGLE)
    deviation = run_to_run_deviation(logs, own.figure)
    if not pairs or not deviation > 0:
        return undecided(claim.kind, "no published runs tell how far apart equal ones lie", SINGLE)
    effect = logs.runs[own.a][own.figure] - logs.runs[own.b][own.figure]
    error = deviation * np.sqrt(2)
    half = float(special.stdtrit(pairs, (1 + LEVEL) / 2)) * error
    return Contrast(
        claim.kind,
        effect,
        Interval(effect - half, effect + half, LEVEL, "Student, deviation of equal pairs"),
        p_greater=float(special.stdtr(pairs, -effect / error)),
        p_less=float(special.stdtr(pairs, effect / error)),
        p_equivalent=1.0,
        seeds=SINGLE,
    )


def _differences(logs: PublishedLogs, figure: str) -> np.ndarray:
    return np.array(
        [
            logs.runs[a][figure] - logs.runs[b][figure]
            for a, b in logs.same
            if figure in logs.runs[a] and figure in logs.runs[b]
        ]
    )
