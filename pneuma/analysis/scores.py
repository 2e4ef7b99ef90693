"""Scores over several environments, and their intervals, as rliable defines them (Agarwal et al. 2021).

A run's score is its outcome on the scale of its environment, on which 0 and 1 are two reference scores. The
functions take the scores of one condition, or of many resamples of them: an array (…, runs) for each
environment. Intervals are of the stratified bootstrap: runs are drawn anew within each environment.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from pneuma.analysis.intervals import LEVEL, Interval, interquartile_mean

Scores = Sequence[np.ndarray]
"""(…, runs) for each environment."""
RESAMPLES = 10_000


def normalized(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """Return values on the scale on which `low` is 0 and `high` is 1."""
    return (np.asarray(values, float) - low) / (high - low)


def mean_score(scores: Scores) -> np.ndarray:
    """Return the mean over environments of the mean over runs."""
    return np.mean([each.mean(axis=-1) for each in scores], axis=0)


def median_score(scores: Scores) -> np.ndarray:
    """Return the median over environments of the mean over runs."""
    return np.median([each.mean(axis=-1) for each in scores], axis=0)


def iqm_score(scores: Scores) -> np.ndarray:
    """Return the mean of the middle half of all runs of all environments."""
    return interquartile_mean(np.concatenate(scores, axis=-1))


def optimality_gap(scores: Scores) -> np.ndarray:
    """Return by how much all runs miss a score of 1, in the mean; what lies above 1 does not count."""
    return 1.0 - np.minimum(np.concatenate(scores, axis=-1), 1.0).mean(axis=-1)


def profile(scores: Scores, thresholds: np.ndarray) -> np.ndarray:
    """Return the share of all runs with scores above each threshold: (…, thresholds)."""
    runs = np.concatenate(scores, axis=-1)
    return (runs[..., None, :] > thresholds[:, None]).mean(axis=-1)


def improvement(a: Scores, b: Scores) -> np.ndarray:
    """Return the probability that a run of `a` is above one of `b` in the same environment, a tie a half.

    The mean over environments, which stand in the same order in both.
    """
    return np.mean([_above(first, second) for first, second in zip(a, b, strict=True)], axis=0)


def _above(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    first, second = a[..., :, None], b[..., None, :]
    return ((first > second) + 0.5 * (first == second)).mean(axis=(-2, -1))


AGGREGATES: Mapping[str, Callable[[Scores], np.ndarray]] = {
    "mean": mean_score,
    "median": median_score,
    "IQM": iqm_score,
    "optimality gap": optimality_gap,
}


def bootstrap(statistic: Callable[..., np.ndarray], *groups: Scores, seed: int = 0) -> Interval:
    """Return the 95 % interval of a statistic of one or several groups of scores."""
    low, high = np.quantile(_resampled(statistic, groups, seed), _ends(), axis=0)
    return Interval(float(low), float(high), "stratified bootstrap")


def profile_band(scores: Scores, thresholds: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return the pointwise 95 % band of a performance profile: two arrays (thresholds,)."""
    drawn = _resampled(lambda each: profile(each, thresholds), [scores], seed, RESAMPLES // 10)
    low, high = np.quantile(drawn, _ends(), axis=0)
    return low, high


def _ends() -> tuple[float, float]:
    return (1 - LEVEL) / 2, (1 + LEVEL) / 2


def _resampled(
    statistic: Callable[..., np.ndarray], groups: Sequence[Scores], seed: int, count: int = RESAMPLES
) -> np.ndarray:
    generator = np.random.default_rng(seed)
    drawn = [
        [each[generator.integers(len(each), size=(count, len(each)))] for each in scores] for scores in groups
    ]
    return statistic(*drawn)
