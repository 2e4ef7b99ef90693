"""The test of spread: whether the runs of one arm differ more among themselves than another's."""

from __future__ import annotations

import numpy as np

from pneuma.analysis.permutation import Relabelings


def log_ratios(a: np.ndarray, b: np.ndarray, ratios: np.ndarray, labels: Relabelings) -> np.ndarray:
    """Return the log ratio of deviations in every relabeling, (relabelings, ratios).

    Args:
        a: (runs,) of arm a, not all equal.
        b: (runs,) of arm b, not all equal.
        ratios: the ratio of deviations, a over b, that each column supposes: arm a is divided by it.
        labels: the relabelings of both arms' runs.
    """
    residual_a, residual_b = a - a.mean(), b - b.mean()
    samples = np.stack([np.concatenate([residual_a / ratio, residual_b]) for ratio in ratios])
    samples /= np.abs(samples).max(axis=1, keepdims=True)
    return _log_ratio(samples, labels)


def _log_ratio(samples: np.ndarray, labels: Relabelings) -> np.ndarray:
    size_a = labels.in_a[0].sum()
    size_b = samples.shape[1] - size_a
    sum_a, squares_a = labels.in_a @ samples.T, labels.in_a @ (samples**2).T
    sum_b, squares_b = samples.sum(axis=1) - sum_a, (samples**2).sum(axis=1) - squares_a
    variance_a = (squares_a - sum_a**2 / size_a) / (size_a - 1)
    variance_b = (squares_b - sum_b**2 / size_b) / (size_b - 1)
    return 0.5 * (np.log(np.maximum(variance_a, 1e-13)) - np.log(np.maximum(variance_b, 1e-13)))
