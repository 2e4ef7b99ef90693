"""How many seeds each group needs, by the interval that decides a comparison."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable

import numpy as np
import pandas as pd
from scipy import special, stats

from pneuma.analysis.intervals import LEVEL, exact_ends
from pneuma.analysis.outcomes import known_values
from pneuma.analysis.study_data import StudyData
from pneuma.errors import UserError

POWER = 0.8
ENOUGH_RUNS = 10
"""With ten normal runs the true deviation is 0.7 to 1.8 times the sample's, and seeds go with its square."""
MOST_SEEDS, MOST_SEEDS_OF_SHARES = 1_000_000, 2_000
"""Most seeds that are tried; fewer for shares, because each number is summed over all pairs of counts."""


def seeds_table(study_data: StudyData, outcome: str, difference: float, level: float = LEVEL) -> pd.DataFrame:
    """Return as text how many seeds find a difference of each condition from the baseline, by its runs.

    `level` is that of the interval that decides.
    """
    baseline = study_data.conditions[0]
    if study_data.study.baseline in study_data.conditions:
        baseline = study_data.study.baseline
    baseline_values = known_values(study_data, baseline, outcome)
    table_rows = []
    for condition in study_data.conditions:
        if condition != baseline:
            condition_values = known_values(study_data, condition, outcome)
            spreads = [
                f"{run_values.std(ddof=1):.3g}" if len(run_values) > 1 else "–"
                for run_values in (baseline_values, condition_values)
            ]
            run_counts = f"{len(baseline_values)} and {len(condition_values)}"
            seeds = _seeds(baseline_values, condition_values, difference, level)
            table_rows.append((baseline, condition, *spreads, run_counts, seeds))
    if not table_rows:
        raise UserError(
            f"study {study_data.study.name} has only one condition; add another to compare it with"
        )
    return pd.DataFrame(table_rows, columns=["", "against", "SD", "its SD", "runs", "seeds"])


def _seeds(baseline_values: np.ndarray, condition_values: np.ndarray, difference: float, level: float) -> str:
    if min(len(baseline_values), len(condition_values)) < 2:
        return "needs 2 runs of each"
    all_values = np.concatenate([baseline_values, condition_values])
    if np.isin(all_values, (0, 1)).all():  # whether a run has something
        share = float(baseline_values.mean())
        other_share = share + difference
        if other_share > 1:
            other_share = share - difference
        if other_share < 0:
            return "no shares differ so much"
        return seeds_text(seeds_for_shares(share, other_share, level=level))
    if np.ptp(baseline_values) == 0 and np.ptp(condition_values) == 0:
        return "runs are all equal"
    spreads = float(baseline_values.std(ddof=1)), float(condition_values.std(ddof=1))
    return seeds_text(seeds_for_means(difference, *spreads, level=level))


def seeds_text(seeds: int | None) -> str:
    return "more than can be trained" if seeds is None else f"{seeds:,}"


def seeds_for_means(
    difference: float, sd_a: float, sd_b: float, power: float = POWER, level: float = LEVEL
) -> int | None:
    """Return the fewest runs per group with which Welch's interval leaves out 0 that often.

    Runs are normal, with the groups' standard deviations, which must not both be 0. None if it takes
    more than `MOST_SEEDS`. Source: the noncentral t of Welch's statistic, with its own degrees of freedom.
    """
    return _fewest(lambda seeds: power_of_means(difference, sd_a, sd_b, seeds, level), power, MOST_SEEDS)


def power_of_means(difference: float, sd_a: float, sd_b: float, seeds: int, level: float = LEVEL) -> float:
    variance_a, variance_b = sd_a**2, sd_b**2
    freedom = (seeds - 1) * (variance_a + variance_b) ** 2 / (variance_a**2 + variance_b**2)
    noncentrality = abs(difference) / np.sqrt((variance_a + variance_b) / seeds)
    critical_value = special.stdtrit(freedom, (1 + level) / 2)
    # SciPy has NaN for some shares that are nearly 0
    share_below, share_above = np.nan_to_num(
        special.nctdtr(freedom, noncentrality, [-critical_value, critical_value])
    )
    return float(share_below + 1 - share_above)


def seeds_for_shares(
    share_a: float, share_b: float, power: float = POWER, level: float = LEVEL
) -> int | None:
    """Return the fewest runs per group with which Newcombe's interval of two shares leaves out 0 that often.

    None if it takes more than `MOST_SEEDS_OF_SHARES`.
    """
    return _fewest(lambda seeds: power_of_shares(share_a, share_b, seeds, level), power, MOST_SEEDS_OF_SHARES)


def power_of_shares(share_a: float, share_b: float, seeds: int, level: float = LEVEL) -> float:
    """Return how often the interval of `incidence_difference_interval` leaves out 0, summed exactly."""
    counts = np.arange(seeds + 1)
    share = counts / seeds
    low, high = exact_ends(counts, seeds, level)
    squares_below, squares_above = (share - low)[:, None] ** 2, (high - share)[:, None] ** 2
    centre = share[:, None] - share
    leaves_out_0 = (centre - np.sqrt(squares_below + squares_above.T) > 0) | (
        centre + np.sqrt(squares_above + squares_below.T) < 0
    )
    chances_a = stats.binom.pmf(counts, seeds, share_a)
    chances_b = stats.binom.pmf(counts, seeds, share_b)
    return float((chances_a[:, None] * leaves_out_0 * chances_b).sum())


def _fewest(power_of: Callable[[int], float], power: float, most_runs: int) -> int | None:
    """Return the fewest seeds with a power, found by doubling and bisection; None beyond a number."""
    high = 2
    while power_of(high) < power:
        if high >= most_runs:
            return None
        high *= 2
    return bisect_left(range(high), power, lo=high // 2 + 1, key=power_of)
