"""How many seeds an arm needs, by the interval that decides a comparison."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
from scipy import special, stats

from pneuma.analysis.intervals import LEVEL
from pneuma.analysis.outcomes import outcome_values
from pneuma.analysis.study_data import StudyData
from pneuma.errors import UserError

POWER = 0.8
ENOUGH_RUNS = 10
"""Of ten normal runs the true deviation is 0.7 to 1.8 times that seen, and seeds go with its square."""
MOST_SEEDS, MOST_OF_SHARES = 1_000_000, 2_000
"""Most seeds that are looked at; of shares fewer, as each number of them is summed over all outcomes."""


def seeds_table(data: StudyData, outcome: str, difference: float) -> pd.DataFrame:
    """Return as text how many seeds find a difference of each condition from the baseline, by its runs."""
    values = {name: outcome_values(data, name, outcome) for name in data.conditions}
    known = {name: each[np.isfinite(each)] for name, each in values.items()}
    base = data.study.baseline if data.study.baseline in known else data.conditions[0]
    rows = []
    for name in data.conditions:
        if name != base:
            pair = known[base], known[name]
            deviations = [f"{each.std(ddof=1):.3g}" if len(each) > 1 else "–" for each in pair]
            runs = f"{len(pair[0])} and {len(pair[1])}"
            rows.append((base, name, *deviations, runs, _seeds(pair, difference)))
    if not rows:
        raise UserError(f"study {data.study.name} has one condition: there is nothing to compare it with")
    return pd.DataFrame(rows, columns=["", "against", "SD", "its SD", "runs", "seeds"])


def _seeds(pair: tuple[np.ndarray, np.ndarray], difference: float) -> str:
    if min(map(len, pair)) < 2:
        return "needs 2 runs of each"
    if all(np.isin(each, (0, 1)).all() for each in pair):  # whether a run has something
        share = float(pair[0].mean())
        other = share + difference if share + difference <= 1 else share - difference
        return seeds_text(seeds_for_shares(share, other))
    if not any(np.ptp(each) for each in pair):
        return "runs are all equal"
    return seeds_text(seeds_for_means(difference, *(float(each.std(ddof=1)) for each in pair)))


def seeds_text(seeds: int | None) -> str:
    return "more than can be trained" if seeds is None else f"{seeds:,}"


def seeds_for_means(difference: float, sd_a: float, sd_b: float, power: float = POWER) -> int | None:
    """Return the fewest runs an arm with which Welch's 95 % interval leaves out 0 that often.

    Runs are normal, with the standard deviations of each arm, which must not both be 0. None if it takes
    more than `MOST_SEEDS`. Source: the noncentral t of Welch's statistic, with its own degrees of freedom.
    """
    return _fewest(lambda seeds: power_of_means(difference, sd_a, sd_b, seeds), power, MOST_SEEDS)


def power_of_means(difference: float, sd_a: float, sd_b: float, seeds: int) -> float:
    a, b = sd_a**2, sd_b**2
    freedom = (seeds - 1) * (a + b) ** 2 / (a**2 + b**2)
    away = abs(difference) / np.sqrt((a + b) / seeds)
    limit = special.stdtrit(freedom, (1 + LEVEL) / 2)
    return float(special.nctdtr(freedom, away, -limit) + 1 - special.nctdtr(freedom, away, limit))


def seeds_for_shares(share_a: float, share_b: float, power: float = POWER) -> int | None:
    """Return the fewest runs an arm with which Newcombe's interval of two shares leaves out 0 that often.

    None if it takes more than `MOST_OF_SHARES`.
    """
    return _fewest(lambda seeds: power_of_shares(share_a, share_b, seeds), power, MOST_OF_SHARES)


def power_of_shares(share_a: float, share_b: float, seeds: int) -> float:
    """Return how often the interval of `incidence_difference_interval` leaves out 0, summed exactly."""
    counts = np.arange(seeds + 1)
    share, tail = counts / seeds, (1 - LEVEL) / 2
    low = np.where(counts, special.betaincinv(np.maximum(counts, 1), seeds - counts + 1, tail), 0.0)
    left = np.maximum(seeds - counts, 1)
    high = np.where(counts < seeds, special.betaincinv(counts + 1, left, 1 - tail), 1.0)
    below, above = (share - low)[:, None] ** 2, (high - share)[:, None] ** 2
    centre = share[:, None] - share
    apart = (centre - np.sqrt(below + above.T) > 0) | (centre + np.sqrt(above + below.T) < 0)
    chances = [stats.binom.pmf(counts, seeds, each) for each in (share_a, share_b)]
    return float(chances[0] @ apart @ chances[1])


def _fewest(power_of: Callable[[int], float], power: float, most: int) -> int | None:
    low, high = 1, 2
    while power_of(high) < power:
        low, high = high, 2 * high
        if low >= most:
            return None
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if power_of(middle) >= power else (middle, high)
    return high
