"""UPGD: steps as plain NumPy takes them, and where its noise comes from."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pneuma.config import make_run
from pneuma.engines.batched.optimizers import initial_state, upgd, upgd_noise
from pneuma.engines.batched.update import run_numbers


def test_steps_are_those_of_the_papers_formulas() -> None:
    """In double precision, with gradients that change, and the run's own noise."""
    settings = {
        "learning_rate": 0.1,
        "utility_decay": 0.9,
        "noise": 0.1,
        "weight_decay": 0.5,
        "epsilon": 1e-12,
    }
    numbers = run_numbers(make_run({"optimizer": "upgd", **settings}))
    generator = np.random.default_rng(0)
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
    assert state["steps"].dtype == np.int32


def test_noise_is_normal_and_of_the_run_and_the_step() -> None:
    def noise(step: int, seed: int = 0) -> np.ndarray:
        numbers = run_numbers(make_run({"optimizer": "upgd", "seed": seed}))
        return np.asarray(upgd_noise((np.zeros(20_000, np.float32),), np.int32(step), numbers)[0])

    assert noise(1).mean() == pytest.approx(0, abs=0.033)  # 4.7 standard errors
    assert noise(1).std() == pytest.approx(1, rel=0.02)
    assert np.array_equal(noise(1), noise(1))
    late = 2**24  # where float32 stops counting
    for other in (noise(2), noise(1, seed=1), noise(late), noise(late + 1)):
        assert abs(np.corrcoef(noise(1), other)[0, 1]) < 0.05
    assert not np.isclose(noise(late), noise(late + 1)).all()
