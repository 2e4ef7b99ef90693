"""Hand-written gradients against finite differences in double precision, and against torch's autograd.

Gradient descent without momentum keeps the gradient of its last step as it is: `learn` takes one step with a
minibatch of all.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch

from pneuma.config import ACTIVATIONS, Run, make_run
from pneuma.engines import mlp
from pneuma.engines.batched.optimizers import initial_state
from pneuma.engines.batched.update import METRICS, learn, run_numbers, used_panels
from pneuma.engines.mlp import Layers

from .trained import random_layers

FEATURES, ACTIONS, ROWS = 5, 4, 37
DEPTHS = {"one hidden layer": ((9,), (7,)), "three hidden layers": ((18, 5, 6), (4, 17, 3))}
FUNCTIONS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "tanh": np.tanh,
    "relu": lambda x: np.where(x > 0, x, 0.0),
    "leaky-relu": lambda x: np.where(x > 0, x, 0.01 * x),
}
STEP = 1e-6
"""Of finite differences; the loss is of about 1, so that their error is about 1e-10."""
TOLERANCE = 2e-6
"""Relative to the greatest number of a gradient: that of float32 after a few sums."""


class Batch(NamedTuple):
    """A minibatch: N observations with what is learned from them."""

    observations: np.ndarray  # (N, features) float32
    actions: np.ndarray  # (N,) int64
    old_logs: np.ndarray  # (N,) float32
    advantages: np.ndarray  # (N,) float32
    returns: np.ndarray  # (N,) float32


class Case(NamedTuple):
    run: Run
    actor: Layers
    critic: Layers
    batch: Batch


@pytest.fixture(params=DEPTHS)
def depth(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(params=ACTIVATIONS)
def case(request: pytest.FixtureRequest, depth: str) -> Case:
    """Return networks, and a batch for which some ratios are outside the clip range on either side."""
    actor_widths, critic_widths = DEPTHS[depth]
    run = make_run(
        {
            "actor": actor_widths, "critic": critic_widths, "activation": request.param, "optimizer": "sgd",
            "gradient_limit": "none", "minibatch": ROWS, "steps": 1024, "clip_range": 0.2,
            "value_coefficient": 0.7, "entropy_coefficient": 0.3,
        }
    )  # fmt: skip
    actor = random_layers((FEATURES, *actor_widths, ACTIONS), seed=1)
    critic = random_layers((FEATURES, *critic_widths, 1), seed=2)
    generator = np.random.default_rng(3)
    observations = generator.normal(size=(ROWS, FEATURES)).astype("f4")
    actions = generator.integers(ACTIONS, size=ROWS)
    logs = log_probabilities(outputs(exact(actor), run.activation, observations))[np.arange(ROWS), actions]
    old_logs = (logs + generator.normal(scale=0.3, size=ROWS)).astype("f4")
    advantages, returns = generator.normal(size=(2, ROWS)).astype("f4")
    return Case(run, actor, critic, Batch(observations, actions, old_logs, advantages, returns))


# --- The loss in double precision ------------------------------------------------------------------


def exact(layers: Layers) -> list[tuple[np.ndarray, np.ndarray]]:
    return [(weight.astype("f8"), bias.astype("f8")) for weight, bias in layers]


def outputs(layers: Any, activation: str, observations: np.ndarray) -> np.ndarray:
    """Return a network's outputs: (N, features) -> (N, outputs)."""
    rows = observations.astype("f8")
    for i, (weight, bias) in enumerate(layers):
        rows = rows @ weight + bias
        if i < len(layers) - 1:
            rows = FUNCTIONS[activation](rows)
    return rows


def log_probabilities(logits: np.ndarray) -> np.ndarray:
    return logits - np.log(np.exp(logits).sum(axis=1, keepdims=True))


def policy_loss(run: Run, actor: Any, batch: Batch) -> float:
    """Return the clipped loss (Schulman et al. 2017, Eq. 7) and the entropy's, with Eq. 9's coefficient."""
    logs = log_probabilities(outputs(actor, run.activation, batch.observations))
    ratio = np.exp(logs[np.arange(ROWS), batch.actions] - batch.old_logs)
    advantages = batch.advantages.astype("f8")
    advantages = (advantages - advantages.mean()) / (advantages.std(ddof=1) + 1e-8)
    clipped = np.clip(ratio, 1 - run.clip_range, 1 + run.clip_range)
    gains = np.minimum(advantages * ratio, advantages * clipped)
    entropies = -(np.exp(logs) * logs).sum(axis=1)
    return float(-gains.mean() - run.entropy_coefficient * entropies.mean())


def value_loss(run: Run, critic: Any, batch: Batch) -> float:
    values = outputs(critic, run.activation, batch.observations)[:, 0]
    return float(run.value_coefficient * ((values - batch.returns) ** 2).mean())


def finite_differences(loss: Callable[[Run, Any, Batch], float], case: Case, layers: Layers) -> np.ndarray:
    """Return the gradient of a loss by the weights of a network, in the order of `flat_gradient`."""
    exact_layers = exact(layers)
    gradient = []
    for parameters in parameter_arrays(exact_layers):
        for i in np.ndindex(parameters.shape):
            weight = parameters[i]
            parameters[i] = weight + STEP
            above = loss(case.run, exact_layers, case.batch)
            parameters[i] = weight - STEP
            below = loss(case.run, exact_layers, case.batch)
            parameters[i] = weight
            gradient.append((above - below) / (2 * STEP))
    return np.array(gradient)


def parameter_arrays(layers: Any) -> list[Any]:
    """Return the weight and the bias of each layer, in one list."""
    return [parameters for layer in layers for parameters in layer]


# --- The gradients ---------------------------------------------------------------------------------


def computed(case: Case) -> tuple[np.ndarray, np.ndarray, dict[str, float]]:
    """Return the gradients of actor and critic by the compiled update, and its metrics."""
    batch = case.batch
    flat_layers = [mlp.flat(layers)[0] for layers in (case.actor, case.critic)]
    widths = [mlp.layer_widths(layers) for layers in (case.actor, case.critic)]
    weights = np.concatenate(flat_layers)
    state = initial_state("sgd", len(weights))
    metrics = learn(
        weights, state, *widths, used_panels(*widths), batch.observations, batch.actions, batch.old_logs,
        batch.advantages, batch.returns, np.arange(ROWS)[None], run_numbers(case.run),
    )  # fmt: skip
    actor_gradient, critic_gradient = np.split(state.kept, [len(flat_layers[0])])
    return (
        flat_gradient(mlp.layers_of(actor_gradient, widths[0].tolist())),
        flat_gradient(mlp.layers_of(critic_gradient, widths[1].tolist())),
        dict(zip(METRICS, metrics.tolist(), strict=True)),
    )


def flat_gradient(layers: Layers) -> np.ndarray:
    return np.concatenate([parameters.ravel() for parameters in parameter_arrays(layers)])


def assert_close(gradient: np.ndarray, expected: np.ndarray) -> None:
    assert np.abs(gradient - expected).max() < TOLERANCE * np.abs(expected).max()


def test_gradients_are_those_of_finite_differences(case: Case) -> None:
    actor_gradient, critic_gradient, metrics = computed(case)
    assert 0.2 < metrics["clip_fraction"] < 0.8
    assert_close(actor_gradient, finite_differences(policy_loss, case, case.actor))
    assert_close(critic_gradient, finite_differences(value_loss, case, case.critic))


def test_gradients_are_those_of_torch(case: Case) -> None:
    run = case.run
    observations, actions, old_logs, all_advantages, returns = map(torch.tensor, case.batch)
    actor, critic = (network(layers, run.activation) for layers in (case.actor, case.critic))
    logs = torch.log_softmax(actor(observations), dim=1)
    ratio = torch.exp(logs[torch.arange(ROWS), actions] - old_logs)
    advantages = (all_advantages - all_advantages.mean()) / (all_advantages.std() + 1e-8)
    clipped = torch.clamp(ratio, 1 - run.clip_range, 1 + run.clip_range)
    gains = torch.min(advantages * ratio, advantages * clipped)
    squares = (critic(observations)[:, 0] - returns) ** 2
    entropies = -(logs.exp() * logs).sum(dim=1)
    loss = run.value_coefficient * squares.mean() - gains.mean() - run.entropy_coefficient * entropies.mean()
    loss.backward()

    actor_gradient, critic_gradient, metrics = computed(case)
    assert_close(actor_gradient, torch_gradient(actor))
    assert_close(critic_gradient, torch_gradient(critic))
    assert metrics["policy_loss"] == pytest.approx(-gains.mean().item(), rel=1e-5)
    assert metrics["value_loss"] == pytest.approx(squares.mean().item(), rel=1e-5)
    assert metrics["entropy"] == pytest.approx(entropies.mean().item(), rel=1e-5)


def network(layers: Layers, activation: str) -> torch.nn.Sequential:
    """Return torch's network of the same weights."""
    modules: list[torch.nn.Module] = []
    for weight, bias in layers:
        linear = torch.nn.Linear(*weight.shape)
        linear.weight.data, linear.bias.data = torch.tensor(weight.T.copy()), torch.tensor(bias)
        modules += [linear, getattr(torch.nn, ACTIVATIONS[activation])()]
    return torch.nn.Sequential(*modules[:-1])


def torch_gradient(network: torch.nn.Sequential) -> np.ndarray:
    """Return the gradient in the order of `flat_gradient`; torch keeps weights as (outputs, inputs)."""
    gradients = []
    for parameter in network.parameters():
        assert parameter.grad is not None
        gradients.append(parameter.grad.numpy().T.ravel())
    return np.concatenate(gradients)
