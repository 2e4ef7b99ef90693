"""P-values of one or two arms of runs, for means and shares.

Each test of two arms takes many samples at once, one per row, so that verdicts and their calibration use the
same code. docs/evidence.md explains which test is used when, and its assumptions.

If there are few relabelings all are enumerated, otherwise they are drawn at random. The observed one is
always included, so that no p-value is zero.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations
from math import comb
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from pneuma.analysis.intervals import distances, pooled_error, welch_error

MOST_COUNTED = 200_000
"""With more relabelings than this, some are drawn at random. Ten runs against ten have 184,756."""
DRAWS = 100_000
"""Relabelings drawn: enough that whether a claim is decided hardly depends on them. A list of 170 contrasts
needs 3e-4. Two p-values can both be the smallest possible; `judgement.significant_direction` decides."""
FEW_COUNTED = 20_000
"""Up to this many relabelings are enumerated, however few draws are asked for."""
_AT_ONCE = 20_000
"""Relabelings drawn at once, which limits memory."""

_SLACK = 1e-9
"""Tolerance for a statistic to count as extreme: sums in another order differ in their last bits."""
ROUNDING = 1e-13
"""Values closer than this share of the greatest magnitude are equal but for rounding."""
LEAST_VARIANCE = 1e-13
"""Below this variance of values scaled to at most 1, an arm has no spread but rounding."""
SHARES = 201
"""Common shares on which the greatest probability of a table is searched."""

OneSided = tuple[np.ndarray, np.ndarray]
"""P-values of an effect above and below, each (samples,)."""


P = TypeVar("P", float, np.ndarray)


class PValues(NamedTuple, Generic[P]):
    """One-sided p-values: numbers of one sample, or (samples,) each.

    Attributes:
        greater, less: the effect is above zero, or below it.
        equivalent: it is within the margin on both sides; 1 without a margin.
        far_greater, far_less: it is beyond the margin, above or below; likewise.
        no_less: it is above zero, or below it by less than the margin; likewise.
    """

    greater: P
    less: P
    equivalent: P
    far_greater: P
    far_less: P
    no_less: P


ManyPValues = PValues[np.ndarray]


def p_values(p_greater: ArrayLike, p_less: ArrayLike, samples: int) -> ManyPValues:
    """Combine p-values of an effect above and below zero, and each margin if there is one."""
    greater, less = np.reshape(p_greater, (-1, samples)), np.reshape(p_less, (-1, samples))
    if len(greater) == 1:
        return PValues(greater[0], less[0], *np.ones((4, samples)))
    equivalent = np.maximum(less[1], greater[2])
    return PValues(greater[0], less[0], equivalent, greater[1], less[2], greater[2])


def shifts(margin: float | None) -> list[float]:
    """Return the shifts of the first arm for an effect of zero, and of either margin."""
    return [0.0] if margin is None else [0.0, -margin, margin]


# --- Relabelings -----------------------------------------------------------------------------------


def relabel(size_a: int, size_b: int, generator: np.random.Generator, draws: int = DRAWS) -> np.ndarray:
    """Return which runs are relabeled as arm a, 1.0 or 0.0, (relabelings, runs); the observed one first.

    These are all ways to assign the runs to the arms, or random draws if there are too many.
    """
    if comb(size_a + size_b, size_a) <= (MOST_COUNTED if draws >= DRAWS else FEW_COUNTED):
        return _every(size_a, size_b)
    in_a = np.zeros((1 + draws, size_a + size_b))
    in_a[0, :size_a] = 1.0
    for first in range(1, 1 + draws, _AT_ONCE):
        rows = in_a[first : first + _AT_ONCE]
        keys = generator.random(rows.shape)
        rows[:] = keys <= np.partition(keys, size_a - 1, axis=1)[:, size_a - 1 : size_a]
    return in_a


@lru_cache(maxsize=8)  # 30 MB for ten runs against ten
def _every(size_a: int, size_b: int) -> np.ndarray:
    chosen = np.array(list(combinations(range(size_a + size_b), size_a)))
    in_a = np.zeros((len(chosen), size_a + size_b))
    np.put_along_axis(in_a, chosen, 1.0, axis=1)
    in_a.flags.writeable = False
    return in_a


def sign_flips(runs: int, generator: np.random.Generator, draws: int = DRAWS) -> np.ndarray:
    """Return all sign flips of so many values, or some at random, (flips, runs); the observed one first."""
    if 2**runs <= (MOST_COUNTED if draws >= DRAWS else FEW_COUNTED):
        return 1.0 - 2.0 * (np.arange(2**runs)[:, None] >> np.arange(runs) & 1)
    drawn = generator.integers(0, 2, (draws, runs)) * 2.0 - 1.0
    return np.concatenate([np.ones((1, runs)), drawn])


def tails(statistics: np.ndarray) -> OneSided:
    """Return the shares of relabelings at least, and at most, as great as the observed one, each (samples,).

    `statistics` are (relabelings, samples), the observed one first.
    """
    seen = statistics[0]
    slack = _SLACK * (1 + np.abs(seen))
    return (statistics >= seen - slack).mean(axis=0), (statistics <= seen + slack).mean(axis=0)


def scaled(samples: np.ndarray) -> np.ndarray:
    """Return each row less its mean, divided by its greatest magnitude; zeros if it is constant.

    Values that differ by rounding alone, such as 0.3 and 0.1 + 0.2, count as constant.
    """
    centred = samples - samples.mean(axis=1, keepdims=True)
    size = np.abs(centred).max(axis=1, keepdims=True)
    differs = size > ROUNDING * np.abs(samples).max(axis=1, keepdims=True)
    return np.divide(centred, size, out=np.zeros_like(centred), where=differs)


# --- Means -----------------------------------------------------------------------------------------


def mean_p_values(a: np.ndarray, b: np.ndarray, margin: float | None, labels: np.ndarray) -> ManyPValues:
    """Test differences of means by Welch's t, with permutations and with Student's distribution.

    The greater p-value counts. Relabeling is exact for arms that differ by a shift only, and far from its
    level if the smaller arm has the larger spread. Student's distribution allows for that, if means are
    normal. Arms are (samples, runs) each, `labels` those of `relabel`; smaller differences than the margin
    count as none.
    """
    rows = np.concatenate([np.hstack([a + shift, b]) for shift in shifts(margin)])
    relabeled = tails(_welch(rows, labels))
    arm_a, arm_b = np.split(scaled(rows), [a.shape[1]], axis=1)
    by_student = student_tails(arm_a.mean(axis=1) - arm_b.mean(axis=1), *welch_error(arm_a, arm_b))
    p_greater, p_less = map(np.maximum, relabeled, by_student)
    return p_values(p_greater, p_less, len(a))


def _welch(samples: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Return Welch's t of arm a against arm b for every relabeling, (relabelings, samples)."""
    size_a = labels[0].sum()
    size_b = samples.shape[1] - size_a
    values = scaled(samples)
    sum_a, squares_a = labels @ values.T, labels @ (values**2).T
    sum_b, squares_b = values.sum(axis=1) - sum_a, (values**2).sum(axis=1) - squares_a
    variance_a = (squares_a - sum_a**2 / size_a) / (size_a - 1)
    variance_b = (squares_b - sum_b**2 / size_b) / (size_b - 1)
    variance = variance_a / size_a + variance_b / size_b
    return (sum_a / size_a - sum_b / size_b) / np.sqrt(np.maximum(variance, LEAST_VARIANCE))


def student_tails(effect: np.ndarray, error: np.ndarray, freedom: np.ndarray | float) -> OneSided:
    """Return p-values of effects by Student's distribution, each (samples,); 0 if nothing varies."""
    sure = error**2 > LEAST_VARIANCE
    t = np.divide(effect, error, out=np.zeros_like(error), where=sure)
    p_less = np.where(sure, special.stdtr(freedom, t), 0.0)
    p_greater = np.where(sure, special.stdtr(freedom, -t), 0.0)
    return p_greater, p_less


def one_mean_p_values(samples: np.ndarray, margin: float | None, flips: np.ndarray) -> ManyPValues:
    """Test means of (samples, runs) against 0 by sign flips and by Student's distribution.

    The greater p-value counts. Sign flips, which `sign_flips` gives, assume that values are symmetric about
    their mean, Student's distribution that they are normal.
    """
    rows = np.concatenate([samples + shift for shift in shifts(margin)])
    size = np.abs(rows).max() or 1.0  # so that units do not matter for equality
    deviation = samples.std(axis=1, ddof=1)
    deviation[deviation <= ROUNDING * np.abs(samples).max(axis=1)] = 0  # equal but for rounding
    errors = np.tile(deviation, len(rows) // len(samples)) / np.sqrt(samples.shape[1]) / size
    by_student = student_tails(rows.mean(axis=1) / size, errors, samples.shape[1] - 1)
    p_greater, p_less = map(np.maximum, tails(flips @ (rows / size).T), by_student)
    return p_values(p_greater, p_less, len(samples))


def spread_p_values(a: np.ndarray, b: np.ndarray, margin: float | None) -> ManyPValues:
    """Test how far (samples, runs) of two arms lie from their medians (Brown and Forsythe 1974).

    With two arms the F test is the square of Student's t with one variance for both.
    """
    from_a, from_b = map(distances, (a, b))
    size = np.maximum(from_a.max(axis=-1), from_b.max(axis=-1))
    size = np.where(size > 0, size, 1.0)  # so that units do not matter
    error, freedom = pooled_error(from_a, from_b)
    effect = from_a.mean(axis=-1) - from_b.mean(axis=-1)
    shifted = [student_tails((effect + shift) / size, error / size, freedom) for shift in shifts(margin)]
    return p_values([above for above, _ in shifted], [below for _, below in shifted], len(a))


# --- Shares ----------------------------------------------------------------------------------------


def incidence_p_values(
    counts_a: np.ndarray, runs_a: int, counts_b: np.ndarray, runs_b: int, margin: float | None
) -> ManyPValues:
    """Test differences of shares exactly, given the (samples,) counts of runs with the event."""

    def above(difference: float) -> np.ndarray:
        return share_table(runs_a, runs_b, difference)[counts_a, counts_b]

    def below(difference: float) -> np.ndarray:  # a below b by more: b above a by more
        return share_table(runs_b, runs_a, difference)[counts_b, counts_a]

    at = [0.0] if margin is None or margin >= 1 else [0.0, margin, -margin]
    return p_values([above(level) for level in at], [below(-level) for level in at], len(counts_a))


@lru_cache(maxsize=256)
def share_table(runs_a: int, runs_b: int, difference: float = 0.0) -> np.ndarray:
    """Return p-values that the share of a exceeds that of b by more, (runs_a + 1, runs_b + 1).

    The test is exact and unconditional (Barnard 1945): tables are ordered by a score, and the p-value is the
    probability of a table at least as extreme, at the common share that maximizes it.
    """
    score = _score(runs_a, runs_b, difference).ravel()
    order = np.argsort(-score, kind="stable")
    share_b = np.linspace(max(0.0, -difference), min(1.0, 1.0 - difference), SHARES)
    chance_a = count_chances(runs_a, np.clip(share_b + difference, 0, 1))  # (shares, runs_a + 1)
    chance_b = count_chances(runs_b, share_b)
    both = (chance_a[:, :, None] * chance_b[:, None, :]).reshape(SHARES, -1)[:, order]
    greatest = np.minimum(both.cumsum(axis=1).max(axis=0), 1.0)
    ranked = score[order]
    last = np.searchsorted(-ranked, -ranked + 1e-9, side="right") - 1  # ties count together
    table = np.empty_like(score)
    table[order] = greatest[last]
    return table.reshape(runs_a + 1, runs_b + 1)


def _score(runs_a: int, runs_b: int, difference: float) -> np.ndarray:
    """Return each table's distance beyond the difference, in standard errors, (runs_a + 1, runs_b + 1).

    Half a run is added to both outcomes in the error, so that no table has an error of zero.
    """
    a, b = np.arange(runs_a + 1)[:, None], np.arange(runs_b + 1)[None, :]
    error_a, error_b = ((k + 0.5) * (n - k + 0.5) / (n + 1) ** 2 / n for k, n in ((a, runs_a), (b, runs_b)))
    return (a / runs_a - b / runs_b - difference) / np.sqrt(error_a + error_b)


def count_chances(runs: int, share: np.ndarray) -> np.ndarray:
    """Return the binomial probability of every count, (shares, runs + 1)."""
    count = np.arange(runs + 1)
    log_ways = special.gammaln(runs + 1) - special.gammaln(count + 1) - special.gammaln(runs - count + 1)
    logs = special.xlogy(count, share[:, None]) + special.xlog1py(runs - count, -share[:, None])
    return np.exp(log_ways + logs)


def one_share_p_values(counts: np.ndarray, runs: int, value: float, margin: float | None) -> ManyPValues:
    """Test shares of one arm against a constant by the exact binomial test, given the (samples,) counts."""

    def one_sided(share: float) -> OneSided:
        if share != value and not 0 < share < 1:  # no share is beyond a margin that reaches an end
            sure, never = np.zeros(counts.shape), np.ones(counts.shape)
            return (sure, never) if share <= 0 else (never, sure)
        above = np.where(counts > 0, special.bdtrc(np.maximum(counts - 1, 0), runs, share), 1.0)
        return above, special.bdtr(counts, runs, share)

    at = [value] if margin is None else [value, value + margin, value - margin]
    sided = np.array([one_sided(level) for level in at])  # (shares, 2, samples)
    return p_values(sided[:, 0], sided[:, 1], len(counts))


# --- Many tests at once ----------------------------------------------------------------------------


def holm(p: ArrayLike) -> np.ndarray:
    """Return p-values adjusted by Holm's method, (tests,), to compare with the list's error rate.

    Each p-value must be against a single hypothesis; for the smaller of two, only Bonferroni's correction
    holds (`pneuma.analysis.judgement`). The smallest is multiplied by their number, the next by one less, and
    so on, and none is smaller than the one before it (Holm 1979).
    """
    p = np.asarray(p, dtype=float)
    order = np.argsort(p, kind="stable")
    stepped = np.maximum.accumulate(p[order] * (p.size - np.arange(p.size)))
    adjusted = np.empty_like(p)
    adjusted[order] = np.minimum(stepped, 1.0)
    return adjusted
