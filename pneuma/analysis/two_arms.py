"""The tests of two arms: p-values of a difference of means, a ratio of deviations, a difference of shares.

Each takes many samples at once, one a row, so that the tests of a list of claims and those of their
calibration are the same code.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy import special

from pneuma.analysis import incidence
from pneuma.analysis.estimates import welch_error
from pneuma.analysis.permutation import LEAST_VARIANCE, Relabelings, scaled, studentised_difference, tails

OneSided = tuple[np.ndarray, np.ndarray]
"""P-values of above and of below, each (samples,)."""


class PValues(NamedTuple):
    """One-sided p-values, each (samples,).

    Attributes:
        greater, less: that the effect is above no difference, and below it.
        equivalent: that it is within the margin on both sides; 1 where there is no margin.
        far_greater, far_less: that it is beyond the margin, above and below; likewise.
    """

    greater: np.ndarray
    less: np.ndarray
    equivalent: np.ndarray
    far_greater: np.ndarray
    far_less: np.ndarray


def p_values(at_zero: OneSided, at_margin: OneSided | None, at_minus_margin: OneSided | None) -> PValues:
    """Put together p-values of an effect being above, and below, three places.

    Args:
        at_zero: no difference, (samples,) each.
        at_margin: the margin; None where there is none.
        at_minus_margin: the margin the other way; likewise.
    """
    if at_margin is None or at_minus_margin is None:
        none = np.ones_like(at_zero[0])
        return PValues(*at_zero, none, none, none)
    equivalent = np.maximum(at_margin[1], at_minus_margin[0])
    return PValues(*at_zero, equivalent, at_margin[0], at_minus_margin[1])


def mean_p_values(a: np.ndarray, b: np.ndarray, margin: float | None, labels: Relabelings) -> PValues:
    """Test differences of means by Welch's t, against its relabelings and Student's distribution.

    The greater p-value counts. Relabelings are exact for arms alike but for the shift, and far off their
    level where the smaller arm spreads more; Student's distribution allows for that, if means are normal.

    Args:
        a: (samples, runs) of arm a.
        b: (samples, runs) of arm b.
        margin: within what a difference counts as none, or None.
        labels: relabelings of both arms' runs.
    """
    shifts = [0.0] if margin is None else [0.0, -margin, margin]
    rows = np.concatenate([np.hstack([a + shift, b]) for shift in shifts])
    relabeled = tails(studentised_difference(rows, labels))
    by_student = _student_tails(*np.split(scaled(rows), [a.shape[1]], axis=1))
    p_greater, p_less = map(np.maximum, relabeled, by_student)
    return two_one_sided(p_greater, p_less, len(a))


def _student_tails(a: np.ndarray, b: np.ndarray) -> OneSided:
    """Return Welch's p-values of scaled arms, each (samples,); 0 where none spreads, which bounds nothing."""
    error, freedom = welch_error(a, b)
    sure = error**2 > LEAST_VARIANCE
    t = np.divide(a.mean(axis=1) - b.mean(axis=1), error, out=np.zeros_like(error), where=sure)
    p_less = np.where(sure, special.stdtr(freedom, t), 0.0)
    p_greater = np.where(sure, special.stdtr(freedom, -t), 0.0)
    return p_greater, p_less


def spread_p_values(a: np.ndarray, b: np.ndarray, margin: float | None, labels: Relabelings) -> PValues:
    """Test ratios of standard deviations by permutation of their logs.

    The arms may differ in level, so each is set off from its middle first. That alone finds too much
    where a few runs lie far from the rest, for an arm may have none of them by chance. So a test of the
    runs as they are, exact where the levels are the same, must find it too; and of an even number of
    runs, both middle ones must do for the middle, since between them may be a gap that makes every run
    lie far off. The greatest p-value counts. Set off from means, it would be far off its level
    (docs/evidence.md).

    Args:
        a: (samples, runs) of arm a, none of equal runs.
        b: (samples, runs) of arm b, the same.
        margin: the ratio above 1 within which, either way, deviations count as alike, or None.
        labels: relabelings of both arms' runs.
    """
    scales = [1.0] if margin is None else [1.0, margin**-0.5, margin**0.5]
    greatest_greater, greatest_less = np.zeros(len(scales) * len(a)), np.zeros(len(scales) * len(a))
    for middle_a, middle_b, apart in _middles(a, b):
        rows = [np.hstack([(a - middle_a) * scale + apart, (b - middle_b) / scale]) for scale in scales]
        p_greater, p_less = tails(_log_ratios(np.concatenate(rows), labels))
        greatest_greater = np.maximum(greatest_greater, p_greater)
        greatest_less = np.maximum(greatest_less, p_less)
    return two_one_sided(greatest_greater, greatest_less, len(a))


def _middles(a: np.ndarray, b: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray | float]]:
    """Yield what to set the runs of either arm off from, and how far to leave the arms apart."""
    ranked_a, ranked_b = np.sort(a, axis=1), np.sort(b, axis=1)
    lower, upper = (
        [ranked[:, (ranked.shape[1] - odd) // 2, None] for ranked in (ranked_a, ranked_b)] for odd in (1, 0)
    )
    middle_a, middle_b = (np.median(arm, axis=1, keepdims=True) for arm in (a, b))
    yield middle_a, middle_b, middle_a - middle_b
    yield lower[0], lower[1], 0.0
    if a.shape[1] % 2 == 0 or b.shape[1] % 2 == 0:
        yield upper[0], upper[1], 0.0


def incidence_p_values(
    counts_a: np.ndarray, runs_a: int, counts_b: np.ndarray, runs_b: int, margin: float | None
) -> PValues:
    """Test differences of shares exactly, given the (samples,) counts of runs with the event."""

    def above(difference: float) -> np.ndarray:
        return incidence.p_share_greater(counts_a, runs_a, counts_b, runs_b, difference)

    def below(difference: float) -> np.ndarray:  # a below b by more: b above a by more
        return incidence.p_share_greater(counts_b, runs_b, counts_a, runs_a, difference)

    greater, less = above(0.0), below(0.0)
    if margin is None or margin >= 1:
        return p_values((greater, less), None, None)
    return p_values((greater, less), (above(margin), below(-margin)), (above(-margin), below(margin)))


def two_one_sided(p_greater: np.ndarray, p_less: np.ndarray, samples: int) -> PValues:
    """Sort out p-values of rows that were shifted by nothing, down by the margin, and up by it."""
    greater, less = p_greater.reshape(-1, samples), p_less.reshape(-1, samples)
    at_zero, *beyond = zip(greater, less, strict=True)
    return p_values(at_zero, *(beyond or (None, None)))


def _log_ratios(samples: np.ndarray, labels: Relabelings) -> np.ndarray:
    """Return the log ratio of variances of arm a and arm b in every relabeling, (relabelings, samples)."""
    level = samples.mean(axis=1, keepdims=True)
    values = (samples - level) / np.abs(samples - level).max(axis=1, keepdims=True)
    size_a = labels.in_a[0].sum()
    size_b = values.shape[1] - size_a
    sum_a, squares_a = labels.in_a @ values.T, labels.in_a @ (values**2).T
    sum_b, squares_b = values.sum(axis=1) - sum_a, (values**2).sum(axis=1) - squares_a
    variance_a = (squares_a - sum_a**2 / size_a) / (size_a - 1)
    variance_b = (squares_b - sum_b**2 / size_b) / (size_b - 1)
    return np.log(np.maximum(variance_a, LEAST_VARIANCE) / np.maximum(variance_b, LEAST_VARIANCE))
