"""Scores over environments: against what rliable 1.2 printed for the same scores, and by hand."""

from __future__ import annotations

import numpy as np
import pytest

from pneuma.analysis.environments import (
    AGGREGATES,
    bootstrap,
    by_environment,
    improvement,
    profile,
    references,
    scores,
)
from pneuma.store.store import Store

from ..hand_made import make_id, save_run, study_of

A = [
    np.array([0.34, 0.584, 0.389, 0.827, 0.308, 0.154, 0.374, 0.611, 0.582, 0.449]),
    np.array([0.668, 0.914, 0.722, 0.827, 0.96, 0.792, 0.751, 0.794, 0.883, 0.702]),
    np.array([1.001, 1.144, 1.399, 0.607, 1.181, 0.635, 0.815, 0.864, 0.443, 1.031]),
]
B = [
    np.array([0.142, 0.339, 0.182, 0.178, 0.0, 0.407, 0.353, 0.164, 0.334, 0.514]),
    np.array([0.802, 0.695, 0.664, 0.917, 0.827, 0.804, 0.774, 0.874, 0.716, 1.043]),
    np.array([0.885, 0.742, 0.99, 1.187, 0.459, 0.105, 1.285, 0.46, 1.479, 1.157]),
]
RLIABLE = {
    "mean": (0.725033, 0.655, 0.796),
    "median": (0.8013, 0.732, 0.855),
    "IQM": (0.729, 0.653, 0.8),
    "optimality gap": (0.300167, 0.243, 0.358),
}
"""What `rliable.library.get_interval_estimates` gives for A, with 20,000 resamples."""


@pytest.mark.parametrize("name", RLIABLE)
def test_aggregates_and_intervals_are_rliables(name: str) -> None:
    value, low, high = RLIABLE[name]
    assert AGGREGATES[name](A) == pytest.approx(value, abs=1e-6)
    assert bootstrap(AGGREGATES[name], A) == pytest.approx((low, high), abs=0.005)


def test_probability_of_improvement_and_profile_are_rliables() -> None:
    assert improvement(A, B) == pytest.approx(0.588333, abs=1e-6)
    assert bootstrap(improvement, A, B) == pytest.approx((0.443, 0.722), abs=0.01)
    thresholds = np.array([0.25, 0.5, 0.75, 1.0])
    np.testing.assert_allclose(profile(A, thresholds), [29 / 30, 23 / 30, 15 / 30, 5 / 30])
    low, high = bootstrap(lambda runs: profile(runs, thresholds), A)
    np.testing.assert_allclose(low, [0.9, 0.667, 0.333, 0.067], atol=0.035)
    np.testing.assert_allclose(high, [1.0, 0.867, 0.633, 0.267], atol=0.035)


def test_the_best_conditions_mean_scores_one_and_not_the_highest_run(store: Store) -> None:
    """Means are 5 and 6, and 9 is the highest run; the random player's 1 scores 0."""
    finals = {("a", 0): 1.0, ("a", 1): 9.0, ("b", 0): 5.5, ("b", 1): 6.5}
    for cell, value in finals.items():
        evaluations = [{"step": step, "return": value, "random_return": 1.0} for step in (500, 1000)]
        fields = {"env": "CartPole-v1", "seed": cell[1]}
        save_run(store, make_id(*cell), [], [], evaluations, 1000, fields=fields)
    parts = by_environment(study_of(store, {cell: make_id(*cell) for cell in finals}))
    assert references(parts) == {"CartPole-v1": (1.0, 6.0)}
    assert [[*scores(parts)[name][0]] for name in "ab"] == [[0.0, 1.6], [0.9, 1.1]]


def test_by_hand_with_unequal_numbers_of_runs() -> None:
    a = [np.array([0.0, 1.0]), np.array([2.0])]
    assert AGGREGATES["mean"](a) == pytest.approx(1.25)  # of 0.5 and 2
    assert AGGREGATES["optimality gap"](a) == pytest.approx(1 / 3)  # 2 counts as 1
    assert improvement(a, [np.array([0.5]), np.array([2.0])]) == pytest.approx(0.5)
