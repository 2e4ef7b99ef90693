"""UPGD: a step worked out by hand in both engines, and where its noise comes from."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from pneuma.config import Run, make_run
from pneuma.engines.batched.optimizers import initial_state, upgd, upgd_noise
from pneuma.engines.batched.update import run_numbers
from pneuma.engines.upgd import UPGD

WEIGHTS, GRADIENTS = [1.0, -2.0], [0.5, 0.5]
SETTINGS: dict[str, Any] = {
    "optimizer": "upgd", "learning_rate": 0.1, "utility_decay": 0.5, "noise": 0.0, "weight_decay": 0.1,
    "epsilon": 1e-12,
}  # fmt: skip
# Utilities 0.5 · (-0.5, 1) = (-0.25, 0.5), corrected (-0.5, 1), over the greatest, 0.5: (-1, 2).
# A first step of Adam's is the gradient's sign, 1; so w ← 0.99 w - 0.2 (1 - sigmoid(-1, 2)).
MOVED = [0.99 - 0.2 * 0.731059, -1.98 - 0.2 * 0.119203]


def in_torch(run: Run, weights: list[float], gradients: list[float], steps: int = 1) -> np.ndarray:
    parameter = torch.tensor(weights, requires_grad=True)
    optimizer = UPGD(
        [parameter], run.stream, run.learning_rate, (0.9, 0.999), run.epsilon or 0, run.utility_decay or 0,
        run.noise or 0, run.weight_decay,
    )  # fmt: skip
    for _ in range(steps):
        parameter.grad = torch.tensor(gradients)
        optimizer.step()
    return parameter.detach().numpy()


def in_jax(run: Run, weights: list[float], gradients: list[float], steps: int = 1) -> np.ndarray:
    parameters: Any = (np.array(weights, np.float32),)
    state = initial_state("upgd", parameters)
    for _ in range(steps):
        parameters, state = upgd((np.array(gradients, np.float32),), parameters, state, run_numbers(run))
    return np.asarray(parameters[0])


@pytest.mark.parametrize("step", [in_torch, in_jax])
def test_a_step_by_hand(step: Any) -> None:
    assert step(make_run(SETTINGS), WEIGHTS, GRADIENTS) == pytest.approx(MOVED, abs=1e-6)


@pytest.mark.parametrize("step", [in_torch, in_jax])
def test_without_a_gradient_only_noise_moves_weights_and_half_of_it(step: Any) -> None:
    """No utility is above another: s = 1/2, so 2 α (1 - s) σ = α σ is the deviation of a step."""
    run = make_run({**SETTINGS, "noise": 3.0, "weight_decay": 0.0})
    moved = step(run, [0.0] * 20_000, [0.0] * 20_000)
    assert moved.mean() == pytest.approx(0, abs=0.01)  # 4.7 standard errors
    assert moved.std() == pytest.approx(0.1 * 3.0, rel=0.02)


@pytest.mark.parametrize("step", [in_torch, in_jax])
def test_noise_is_of_the_run_and_the_step(step: Any) -> None:
    def noise(steps: int, **settings: Any) -> np.ndarray:
        return step(make_run({**SETTINGS, "noise": 3.0, **settings}), [0.0] * 5, [0.0] * 5, steps)

    torch.manual_seed(5)
    first = noise(1)
    torch.manual_seed(6)
    assert np.array_equal(first, noise(1))
    assert not np.isclose(first, noise(1, seed=1)).any()
    assert not np.isclose(first, noise(2) - first).any()


def test_noise_goes_on_where_float32_stops_counting() -> None:
    numbers, parameters = run_numbers(make_run(SETTINGS)), (np.zeros(5, np.float32),)
    late, later = (upgd_noise(parameters, np.int32(2**24 + i), numbers)[0] for i in (0, 1))
    assert not np.isclose(late, later).any()
    assert initial_state("upgd", parameters)["steps"].dtype == np.int32
