"""An exact test of two shares: how many runs of each arm had an event, as collapse.

The test is unconditional (Barnard 1945): tables are ordered by a score, and the p-value is the chance
of one as extreme, at that common share which makes it greatest. It holds its level at every number of
runs, and finds more than Fisher's, which conditions on the total.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy import special

SHARES = 201
"""On how many common shares the greatest chance is looked for."""


def p_share_greater(
    counts_a: np.ndarray, runs_a: int, counts_b: np.ndarray, runs_b: int, difference: float = 0.0
) -> np.ndarray:
    """Return the p-values that the share of a exceeds that of b by more than a difference, (samples,)."""
    return _p_table(runs_a, runs_b, difference)[counts_a, counts_b]


@lru_cache(maxsize=256)
def _p_table(runs_a: int, runs_b: int, difference: float) -> np.ndarray:
    """Return the p-value of every table, (runs_a + 1, runs_b + 1)."""
    score = _score(runs_a, runs_b, difference).ravel()
    order = np.argsort(-score, kind="stable")
    share_b = np.linspace(max(0.0, -difference), min(1.0, 1.0 - difference), SHARES)
    chance_a = _chances(runs_a, np.clip(share_b + difference, 0, 1))  # (shares, runs_a + 1)
    chance_b = _chances(runs_b, share_b)
    both = (chance_a[:, :, None] * chance_b[:, None, :]).reshape(SHARES, -1)[:, order]
    greatest = np.minimum(both.cumsum(axis=1).max(axis=0), 1.0)
    ranked = score[order]
    last = np.searchsorted(-ranked, -ranked + 1e-9, side="right") - 1  # ties count together
    table = np.empty_like(score)
    table[order] = greatest[last]
    return table.reshape(runs_a + 1, runs_b + 1)


def _score(runs_a: int, runs_b: int, difference: float) -> np.ndarray:
    """Return how far each table lies beyond the difference, in standard errors, (runs_a + 1, runs_b + 1).

    Half a run is added to either outcome in the error, so that no table has an error of zero.
    """
    a, b = np.arange(runs_a + 1)[:, None], np.arange(runs_b + 1)[None, :]
    error_a, error_b = ((k + 0.5) * (n - k + 0.5) / (n + 1) ** 2 / n for k, n in ((a, runs_a), (b, runs_b)))
    return (a / runs_a - b / runs_b - difference) / np.sqrt(error_a + error_b)


def _chances(runs: int, share: np.ndarray) -> np.ndarray:
    """Return the binomial chances of every count, (shares, runs + 1)."""
    count = np.arange(runs + 1)
    log_ways = special.gammaln(runs + 1) - special.gammaln(count + 1) - special.gammaln(runs - count + 1)
    logs = special.xlogy(count, share[:, None]) + special.xlog1py(runs - count, -share[:, None])
    return np.exp(log_ways + logs)


def p_share_above(count: int, runs: int, share: float) -> float:
    """Return the exact binomial p-value that one arm's share is above a constant."""
    return float(special.bdtrc(count - 1, runs, share)) if count else 1.0


def p_share_below(count: int, runs: int, share: float) -> float:
    """Return the exact binomial p-value that one arm's share is below a constant."""
    return float(special.bdtr(count, runs, share))
