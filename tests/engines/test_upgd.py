"""UPGD: steps as plain NumPy takes them, and where its noise comes from."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pneuma.config import make_run
from pneuma.engines.batched.initial_weights import draw_normal, mix
from pneuma.engines.batched.optimizers import initial_state, take_step
from pneuma.engines.batched.update import run_numbers, used_panels

WIDTHS = np.array([2, 5])
"""Of two networks of one layer: a panel of three rows, of which five columns are used."""
USED = np.arange(96).reshape(2, 3, 16)[:, :, :5].ravel()
"""Where the used weights lie."""


def noise(step: int, count: int, seed: int = 0) -> np.ndarray:
    """Return the noise of a run's step, row by row."""
    noise_key = run_numbers(make_run({"optimizer": "upgd", "seed": seed}))["noise_key"][0]
    key = np.uint64(mix(noise_key, np.uint64(step)))
    numbers, counter = np.empty(count), np.uint64(0)
    for start in range(0, count, 5):
        counter = np.uint64(draw_normal(key, counter, numbers[start : start + 5]))
    return numbers


def test_steps_are_those_of_the_papers_formulas() -> None:
    """In double precision, with gradients that change, and the run's own noise; padding stays zero."""
    settings = {
        "learning_rate": 0.1,
        "utility_decay": 0.9,
        "noise": 0.1,
        "weight_decay": 0.5,
        "epsilon": 1e-12,
    }
    numbers: Any = run_numbers(make_run({"optimizer": "upgd", **settings}))[0]
    generator = np.random.default_rng(0)
    weights = generator.normal(size=30)
    parameters, gradients = np.zeros((2, 96), np.float32)
    parameters[USED] = weights
    state, panels = initial_state("upgd", 96), used_panels(WIDTHS, WIDTHS)
    mean, square, utility = np.zeros((3, 30))
    for step in range(1, 21):
        gradient = generator.normal(size=30)
        mean, square = 0.9 * mean + 0.1 * gradient, 0.999 * square + 0.001 * gradient**2
        utility = 0.9 * utility - 0.1 * gradient * weights
        useful = 1 / (1 + np.exp(-utility / (1 - 0.9**step) / utility.max()))
        adapted = mean / (1 - 0.9**step) / (np.sqrt(square / (1 - 0.999**step)) + 1e-12)
        weights = (1 - 0.1 * 0.5) * weights - 2 * 0.1 * (1 - useful) * (adapted + 0.1 * noise(step, 30))
        gradients[USED] = gradient
        take_step(parameters, gradients, state, numbers, 48, np.ones(2, np.float32), panels)
        assert parameters[USED] == pytest.approx(weights, abs=1e-4), step
    assert not np.delete(parameters, USED).any()
    assert state.steps.tolist() == [20]


def test_noise_is_normal_and_of_the_run_and_the_step() -> None:
    first = noise(1, 20_000)
    assert first.mean() == pytest.approx(0, abs=0.033)  # 4.7 standard errors
    assert first.std() == pytest.approx(1, rel=0.02)
    assert np.array_equal(first, noise(1, 20_000))
    late = 2**24  # where float32 stops counting
    for other in (noise(2, 20_000), noise(1, 20_000, seed=1), noise(late, 20_000), noise(late + 1, 20_000)):
        assert abs(np.corrcoef(first, other)[0, 1]) < 0.05
    assert not np.isclose(noise(late, 20_000), noise(late + 1, 20_000)).all()
