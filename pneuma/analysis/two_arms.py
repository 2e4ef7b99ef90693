"""The tests of two arms: p-values of a difference of means, a ratio of deviations, a difference of shares.

Each takes many samples at once, one a row, so that the tests of a list of claims and those of their
calibration are the same code.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pneuma.analysis import incidence
from pneuma.analysis.permutation import LEAST_VARIANCE, Relabelings, studentised_difference, tails


class PValues(NamedTuple):
    """One-sided p-values, each (samples,)."""

    greater: np.ndarray
    less: np.ndarray
    equivalent: np.ndarray


def mean_p_values(a: np.ndarray, b: np.ndarray, margin: float | None, labels: Relabelings) -> PValues:
    """Test differences of means by permutation of Welch's t, which allows for unlike spread.

    Args:
        a: (samples, runs) of arm a.
        b: (samples, runs) of arm b.
        margin: within what a difference counts as none, or None.
        labels: relabelings of both arms' runs.
    """
    shifts = [0.0] if margin is None else [0.0, -margin, margin]
    rows = np.concatenate([np.hstack([a + shift, b]) for shift in shifts])
    return _two_one_sided(*tails(studentised_difference(rows, labels)), len(a))


def spread_p_values(a: np.ndarray, b: np.ndarray, margin: float | None, labels: Relabelings) -> PValues:
    """Test ratios of standard deviations by permutation of their logs.

    The arms may differ in level, so each is set off from its median first. That alone finds too much
    where a few runs lie far from the rest, for an arm may have none of them by chance: a test of the
    runs as they are, which is exact where the levels are the same, must find it too, and the greater
    p-value of both counts. Setting off from the mean would be far off its level (docs/evidence.md).

    Args:
        a: (samples, runs) of arm a, none of equal runs.
        b: (samples, runs) of arm b, the same.
        margin: the ratio above 1 within which, either way, deviations count as alike, or None.
        labels: relabelings of both arms' runs.
    """
    middle_a, middle_b = (np.median(arm, axis=1, keepdims=True) for arm in (a, b))
    ratios = [1.0] if margin is None else [1.0, 1 / margin, margin]
    centred = [np.hstack([(a - middle_a) * ratio, b - middle_b]) for ratio in ratios]
    as_they_are = [np.hstack([middle_a + (a - middle_a) * ratio, b]) for ratio in ratios]
    p_greater, p_less = tails(_log_ratios(np.concatenate(centred + as_they_are), labels))
    half = len(ratios) * len(a)
    return _two_one_sided(
        np.maximum(p_greater[:half], p_greater[half:]), np.maximum(p_less[:half], p_less[half:]), len(a)
    )


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
        return PValues(greater, less, np.ones_like(greater))
    return PValues(greater, less, np.maximum(above(-margin), below(-margin)))


def _two_one_sided(p_greater: np.ndarray, p_less: np.ndarray, samples: int) -> PValues:
    """Sort out p-values of rows that were shifted by nothing, down by the margin, and up by it."""
    greater, less = p_greater.reshape(-1, samples), p_less.reshape(-1, samples)
    equivalent = np.maximum(less[1], greater[2]) if len(greater) == 3 else np.ones(samples)
    return PValues(greater[0], less[0], equivalent)


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
