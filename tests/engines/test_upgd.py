"""UPGD: steps as plain NumPy takes them, and where its noise comes from."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pneuma.config import make_run
from pneuma.engines.batched.optimizers import initial_state, upgd, upgd_noise
from pneuma.engines.batched.update import run_numbers

SETTINGS: dict[str, Any] = {
    "optimizer": "upgd", "learning_rate": 0.1, "utility_decay": 0.5, "noise": 0.0, "weight_decay": 0.1,
    "epsilon": 1e-12,
}  # fmt: skip


def moved(steps: int, count: int = 5, **settings: Any) -> np.ndarray:
    """Return weights of 0 after some steps with noise and no gradient."""
    numbers = run_numbers(make_run({**SETTINGS, "noise": 3.0, **settings}))
    zeros = (np.zeros(count, np.float32),)
    parameters: Any = zeros
    state = initial_state("upgd", parameters)
    for _ in range(steps):
        parameters, state = upgd(zeros, parameters, state, numbers)
    return np.asarray(parameters[0])


def test_steps_are_those_of_the_papers_formulas() -> None:
    """In double precision, with gradients that change, and the run's own noise."""
    run = make_run({**SETTINGS, "utility_decay": 0.9, "noise": 0.1, "weight_decay": 0.5})
    numbers, generator = run_numbers(run), np.random.default_rng(0)
    weights = generator.normal(size=6)
    parameters: Any = (weights.astype(np.float32),)
    state = initial_state("upgd", parameters)
    mean, square, utility = np.zeros((3, 6))
    for step in range(1, 21):
        gradient = generator.normal(size=6)
        noise = np.asarray(upgd_noise(parameters, np.int32(step), numbers)[0], np.float64)
        mean, square = 0.9 * mean + 0.1 * gradient, 0.999 * square + 0.001 * gradient**2
        utility = 0.9 * utility - 0.1 * gradient * weights
        useful = 1 / (1 + np.exp(-utility / (1 - 0.9**step) / utility.max()))
        adapted = mean / (1 - 0.9**step) / (np.sqrt(square / (1 - 0.999**step)) + 1e-12)
        weights = (1 - 0.1 * 0.5) * weights - 2 * 0.1 * (1 - useful) * (adapted + 0.1 * noise)
        parameters, state = upgd((gradient.astype(np.float32),), parameters, state, numbers)
        assert np.asarray(parameters[0]) == pytest.approx(weights, abs=1e-4), step


def test_without_a_gradient_only_noise_moves_weights_and_half_of_it() -> None:
    """No utility is above another: s = 1/2, so 2 α (1 - s) σ = α σ is the deviation of a step."""
    ended = moved(1, 20_000, weight_decay=0.0)
    assert ended.mean() == pytest.approx(0, abs=0.01)  # 4.7 standard errors
    assert ended.std() == pytest.approx(0.1 * 3.0, rel=0.02)


def test_noise_is_of_the_run_and_the_step() -> None:
    first = moved(1)
    assert np.array_equal(first, moved(1))
    assert not np.isclose(first, moved(1, seed=1)).any()
    assert not np.isclose(first, moved(2) - first).any()


def test_noise_goes_on_where_float32_stops_counting() -> None:
    numbers, parameters = run_numbers(make_run(SETTINGS)), (np.zeros(5, np.float32),)
    late, later = (upgd_noise(parameters, np.int32(2**24 + i), numbers)[0] for i in (0, 1))
    assert not np.isclose(late, later).any()
    assert initial_state("upgd", parameters)["steps"].dtype == np.int32
