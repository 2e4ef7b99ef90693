"""Every activation and optimizer in every backend."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch

from pneuma.algorithms import OPTIMIZERS
from pneuma.config import ACTIVATIONS, make_run
from pneuma.engines import mlp
from pneuma.engines.batched import optimizers
from pneuma.engines.batched.update import run_numbers, used_panels
from pneuma.engines.products import COLUMNS

DEFINITIONS: dict[str, Callable[[float], float]] = {
    "tanh": math.tanh,
    "relu": lambda x: max(x, 0.0),
    "leaky-relu": lambda x: x if x > 0 else 0.01 * x,  # thesis section 6.2
}
DEAD: dict[str, tuple[float, ...]] = {
    "tanh": (-30, 30),
    "relu": (-30, -2.5, -0.5, 0),
    "leaky-relu": (-30, -2.5, -0.5, 0),
}
"""The `INPUTS` whose outputs are those of a dead unit; tanh of 2.5 is 0.987."""
INPUTS = np.array([-30, -2.5, -0.5, 0, 0.5, 2.5, 30], np.float32)


def by_numba(activation: str, inputs: np.ndarray) -> np.ndarray:
    outputs = inputs.copy()
    mlp.activate(mlp.ACTIVATION_CODES[activation], outputs)
    return outputs


def by_torch(activation: str, inputs: np.ndarray) -> np.ndarray:
    outputs: np.ndarray = getattr(torch.nn, ACTIVATIONS[activation])()(torch.from_numpy(inputs)).numpy()
    return outputs


BACKENDS = (by_numba, by_torch)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_an_activation_is_what_its_name_says(
    activation: str, backend: Callable[[str, np.ndarray], np.ndarray]
) -> None:
    expected = [DEFINITIONS[activation](x) for x in INPUTS.tolist()]
    assert backend(activation, INPUTS) == pytest.approx(expected, rel=1e-6, abs=1e-7)  # float32 may cancel


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_a_unit_is_dead_at_the_outputs_that_its_activation_has(activation: str) -> None:
    """A network of one hidden unit, whose input is what its activation gets."""
    layers = ((np.ones((1, 1), np.float32), np.zeros(1, np.float32)),) * 2
    weights, widths, code = mlp.network(layers, activation)
    is_dead = [mlp.dead_units(weights[0], widths, code, np.full((3, 1), x)) == (1, 1) for x in INPUTS]
    assert tuple(INPUTS[is_dead].tolist()) == DEAD[activation]


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_slopes_are_those_of_torch(activation: str) -> None:
    x = torch.from_numpy(INPUTS).requires_grad_()
    outputs = getattr(torch.nn, ACTIVATIONS[activation])()(x)
    outputs.sum().backward()
    slopes = np.ones(len(INPUTS), np.float32)
    mlp.scale_by_slopes(mlp.ACTIVATION_CODES[activation], by_numba(activation, INPUTS), slopes)
    assert x.grad is not None
    assert slopes == pytest.approx(x.grad.numpy(), rel=1e-4, abs=1e-6)


FIRST_STEPS = {"adam": 0.1, "sgd": 0.3, "rmsprop": 1.0, "upgd": 0.1}
"""How far a weight of 0 moves for a gradient of 3 at a rate of 0.1. Adam divides the gradient by its size,
RMSProp by a tenth of it; UPGD's weights are equally useful, and its noise is small."""


def stepped(settings: dict[str, Any], weights: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Return the weights of an actor and a critic, each of one panel, after one step."""
    run = make_run(settings)
    widths = np.array([1, COLUMNS])  # two rows: biases and weights
    moved = weights.astype(np.float32)
    optimizers.take_step(
        moved, gradient.astype(np.float32), optimizers.initial_state(run.optimizer, len(moved)),
        run_numbers(run)[0], len(moved) // 2, np.ones(2, np.float32), used_panels(widths, widths),
    )  # fmt: skip
    return moved


@pytest.mark.parametrize("name", OPTIMIZERS)
def test_an_optimizer_takes_the_first_step_that_it_should(name: str) -> None:
    gradient = np.resize([3.0, -3.0], 64)
    moved = stepped({"optimizer": name, "learning_rate": 0.1}, np.zeros(64), gradient)
    assert moved == pytest.approx(np.resize([-FIRST_STEPS[name], FIRST_STEPS[name]], 64), abs=1e-3)


DECAYS = {"adam": 0.1, "sgd": 0.1, "rmsprop": 1.0, "upgd": 0.1}
"""How far a weight of 2 moves for no gradient but a decay of 0.5, at a rate of 0.1. Torch's take it as a
gradient of 1, UPGD as a share of the weight."""


@pytest.mark.parametrize("name", OPTIMIZERS)
def test_an_optimizer_decays_weights_once(name: str) -> None:
    settings: dict[str, Any] = {"optimizer": name, "learning_rate": 0.1, "weight_decay": 0.5}
    if "noise" in OPTIMIZERS[name].defaults:
        settings["noise"] = 0.0
    weights = np.resize([2.0, 0.0], 64)
    moved = stepped(settings, weights, np.zeros(64))
    assert moved == pytest.approx(weights - np.resize([DECAYS[name], 0], 64), abs=1e-4)


@pytest.mark.parametrize("name", OPTIMIZERS)
def test_what_an_optimizer_keeps_of_an_old_gradient_becomes_zero(name: str) -> None:
    """Without it a run of sparse observations takes four times as long: such numbers never reach 0 alone."""
    run = make_run({"optimizer": name} | ({"betas": (0.9, 0.9)} if name == "adam" else {}))
    widths = np.array([1, COLUMNS])
    weights, gradient = np.zeros(64, np.float32), np.ones(64, np.float32)
    state = optimizers.initial_state(name, 64)
    numbers, factors, panels = run_numbers(run)[0], np.ones(2, np.float32), used_panels(widths, widths)
    for _ in range(2_000):
        optimizers.take_step(weights, gradient, state, numbers, 32, factors, panels)
        size = np.abs(state.kept)
        assert not np.any((size > 0) & (size < np.finfo(np.float32).tiny))
        gradient[:] = 0
    gradient[0] = np.nan
    optimizers.take_step(weights, gradient, state, numbers, 32, factors, panels)
    assert np.isnan(weights[0])


def test_an_optimizers_torch_class_is_one() -> None:
    assert OPTIMIZERS.keys() == optimizers.OPTIMIZERS.keys()
    for optimizer in OPTIMIZERS.values():
        torch_class = getattr(torch.optim, optimizer.torch_class or "Optimizer")
        assert issubclass(torch_class, torch.optim.Optimizer)
