"""Every activation and optimizer in every backend."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch

from pneuma.algorithms import OPTIMIZERS
from pneuma.config import ACTIVATIONS, make_run
from pneuma.engines import mlp, policy
from pneuma.engines.batched import optimizers, update
from pneuma.engines.batched.update import run_numbers

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


def by_numpy(activation: str, inputs: np.ndarray) -> np.ndarray:
    return policy.NUMPY_ACTIVATIONS[activation].apply(inputs)


def by_jax(activation: str, inputs: np.ndarray) -> np.ndarray:
    return np.asarray(update.JAX_ACTIVATIONS[activation](inputs))


def by_torch(activation: str, inputs: np.ndarray) -> np.ndarray:
    outputs: np.ndarray = getattr(torch.nn, ACTIVATIONS[activation])()(torch.from_numpy(inputs)).numpy()
    return outputs


BACKENDS = (by_numba, by_numpy, by_jax, by_torch)


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_an_activation_is_what_its_name_says(
    activation: str, backend: Callable[[str, np.ndarray], np.ndarray]
) -> None:
    expected = [DEFINITIONS[activation](x) for x in INPUTS.tolist()]
    assert backend(activation, INPUTS) == pytest.approx(expected, rel=1e-6, abs=1e-7)  # float32 may cancel


@pytest.mark.parametrize("backend", [by_numpy, by_jax])
@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_a_unit_is_dead_at_the_outputs_that_its_activation_has(
    activation: str, backend: Callable[[str, np.ndarray], np.ndarray]
) -> None:
    is_dead = policy.NUMPY_ACTIVATIONS[activation].is_dead(backend(activation, INPUTS))
    assert tuple(INPUTS[is_dead].tolist()) == DEAD[activation]


FIRST_STEPS = {"adam": 0.1, "sgd": 0.3, "rmsprop": 1.0, "upgd": 0.1}
"""How far a weight of 0 moves for a gradient of 3 at a rate of 0.1. Adam divides the gradient by its size,
RMSProp by a tenth of it; UPGD's weights are equally useful, and its noise is small."""


@pytest.mark.parametrize("name", OPTIMIZERS)
def test_an_optimizer_takes_the_first_step_that_it_should(name: str) -> None:
    numbers = run_numbers(make_run({"optimizer": name, "learning_rate": 0.1}))
    weights = (np.zeros(2, np.float32),)
    take_step, _ = optimizers.OPTIMIZERS[name]
    (moved,), _ = take_step(
        (np.array([3, -3], np.float32),), weights, optimizers.initial_state(name, weights), numbers
    )
    assert np.asarray(moved) == pytest.approx([-FIRST_STEPS[name], FIRST_STEPS[name]], abs=1e-3)


DECAYS = {"adam": 0.1, "sgd": 0.1, "rmsprop": 1.0, "upgd": 0.1}
"""How far a weight of 2 moves for no gradient but a decay of 0.5, at a rate of 0.1. Torch's take it as a
gradient of 1, UPGD as a share of the weight."""


@pytest.mark.parametrize("name", OPTIMIZERS)
def test_an_optimizer_decays_weights_once(name: str) -> None:
    """No advantage and no weight of the values and the entropy: no gradient."""
    fields = {"optimizer": name, "learning_rate": 0.1, "weight_decay": 0.5, "minibatch": 4}
    fields |= {"value_coefficient": 0.0, "entropy_coefficient": 0.0}
    if "noise" in OPTIMIZERS[name].defaults:
        fields["noise"] = 0.0
    run = make_run(fields)
    layers = {
        part: ((np.full((3, 2), 2, np.float32), np.zeros(2, np.float32)),) for part in ("actor", "critic")
    }
    batch = {column: np.zeros(4, np.float32) for column in ("log_probabilities", "advantages", "returns")}
    batch |= {"observations": np.ones((4, 3), np.float32), "actions": np.zeros(4, np.int32)}
    state = optimizers.initial_state(name, layers)
    orders = np.arange(4)[None]
    moved, _, _ = update.learn(layers, state, batch, orders, run_numbers(run), update.program(run))
    for ((weight, bias),) in moved.values():
        assert np.asarray(weight) == pytest.approx(np.full((3, 2), 2 - DECAYS[name]), abs=1e-4)
        assert not np.asarray(bias).any()


def test_an_optimizers_torch_class_is_one() -> None:
    assert OPTIMIZERS.keys() == optimizers.OPTIMIZERS.keys()
    for optimizer in OPTIMIZERS.values():
        torch_class = getattr(torch.optim, optimizer.torch_class or "Optimizer")
        assert issubclass(torch_class, torch.optim.Optimizer)
