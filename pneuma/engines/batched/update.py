"""One update: everything that a run learns from a rollout, in two compiled calls.

The arithmetic is that of Stable-Baselines3's PPO (Schulman et al. 2017; thesis section 4.3): advantages
normalised in each minibatch by the sample deviation, a value loss without one half, one norm limit
over actor and critic or one for each. What is only a number is data, so that runs that differ in
numbers alone share one compiled program; shapes, activation and optimizer make another.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pneuma.config import Run
from pneuma.engines.batched.optimizers import STEPS
from pneuma.engines.policy import LEAKY_SLOPE

Tree = Any
METRICS = (
    "policy_loss",
    "value_loss",
    "entropy",
    "clip_fraction",
    "grad_norm",
    "grad_norm_actor",
    "grad_norm_critic",
)
"""Means over all minibatches; `approx_kl` is one over the last epoch's."""


def run_numbers(run: Run) -> dict[str, np.float32]:
    """Return what of a run is only a number, float32; an absent limit is infinite."""
    b1, b2 = run.betas or (0.0, 0.0)
    limit = math.inf if run.gradient_limit is None else run.gradient_limit
    numbers = {
        "learning_rate": run.learning_rate,
        "clip_range": run.clip_range,
        "value_coefficient": run.value_coefficient,
        "entropy_coefficient": run.entropy_coefficient,
        "joint_limit": limit if run.clip == "joint" else math.inf,
        "part_limit": limit if run.clip == "separate" else math.inf,
        "beta_1": b1,
        "beta_2": b2,
        "log_beta_1": math.log(b1) if b1 else -math.inf,
        "log_beta_2": math.log(b2) if b2 else -math.inf,
        "epsilon": run.epsilon or 0.0,
        "momentum": run.momentum or 0.0,
        "dampening": run.dampening or 0.0,
        "smoothing": run.smoothing or 0.0,
        "weight_decay": run.weight_decay,
    }
    return {name: np.float32(value) for name, value in numbers.items()}


@partial(jax.jit, static_argnames="activation")
def look_back(parameters: Tree, observations: Any, actions: Any, activation: str) -> tuple[Any, Any, Any]:
    """Judge a rollout by the networks that played it.

    Args:
        parameters: of actor and critic.
        observations: (N, features); beyond the N actions, observations of which only the value counts.
        actions: (n,), n <= N.
        activation: of the hidden layers.

    Returns:
        Log-probabilities (n,), values (N,), and the share of hidden units that are dead over the n.
    """
    count = actions.shape[0]
    hidden_a, logits = _forward(parameters["actor"], activation, observations[:count])
    hidden_c, values = _forward(parameters["critic"], activation, observations)
    flags = [_dead(units, activation) for units in [*hidden_a, *(layer[:count] for layer in hidden_c)]]
    dead = jnp.concatenate(flags).mean()
    return _log_probabilities(logits, actions), values[:, 0], dead


@partial(jax.jit, static_argnames=("activation", "optimizer"), donate_argnums=(0, 1))
def learn(
    parameters: Tree, state: Tree, batch: Mapping[str, Any], orders: Any, numbers: Any,
    activation: str, optimizer: str, minibatch: Any,
) -> tuple[Tree, Tree, dict[str, Any]]:  # fmt: skip
    """Take all gradient steps of an update.

    Args:
        parameters: of actor and critic; their memory is used again.
        state: of the optimizer; likewise.
        batch: observations (N, features), actions, log_probabilities, advantages and returns (N,).
        orders: (epochs, N) permutations, cut into minibatches in order; the last one may be smaller.
        numbers: `run_numbers`.
        activation: of the hidden layers.
        optimizer: its name.
        minibatch: (minibatch,) of anything: its length is the size.

    Returns:
        Parameters, state, and `METRICS` with `approx_kl`.
    """
    size = minibatch.shape[0]
    whole = orders.shape[1] // size

    def take(carry: Tree, index: Any) -> tuple[Tree, dict[str, Any]]:
        return _step(
            carry, {name: array[index] for name, array in batch.items()}, numbers, activation, optimizer
        )

    def epoch(carry: Tree, order: Any) -> tuple[Tree, dict[str, Any]]:
        carry, told = jax.lax.scan(take, carry, order[: whole * size].reshape(whole, size))
        if whole * size == order.shape[0]:
            return carry, told
        carry, rest = take(carry, order[whole * size :])
        return carry, {name: jnp.append(told[name], rest[name]) for name in told}

    (parameters, state), told = jax.lax.scan(epoch, (parameters, state), orders)  # (epochs, minibatches)
    metrics = {name: told[name].mean() for name in METRICS}
    return parameters, state, {**metrics, "approx_kl": told["approx_kl"][-1].mean()}


def _step(
    carry: Tree, batch: Mapping[str, Any], numbers: Any, activation: str, optimizer: str
) -> tuple[Tree, dict[str, Any]]:
    """Take one gradient step on a minibatch."""
    parameters, state = carry
    gradients, told = jax.grad(_loss, has_aux=True)(parameters, batch, numbers, activation)
    squares = {part: sum((g**2).sum() for g in jax.tree.leaves(gradients[part])) for part in gradients}
    norm = jnp.sqrt(squares["actor"] + squares["critic"])
    norms = {part: jnp.sqrt(square) for part, square in squares.items()}
    joint = _shrink(norm, numbers["joint_limit"])
    clipped = {
        part: jax.tree.map(
            partial(jnp.multiply, joint * _shrink(norms[part], numbers["part_limit"])), gradients[part]
        )
        for part in gradients
    }
    decayed = jax.tree.map(lambda g, p: g + numbers["weight_decay"] * p, clipped, parameters)
    carry = STEPS[optimizer](decayed, parameters, state, numbers)
    return carry, {
        **told, "grad_norm": norm, "grad_norm_actor": norms["actor"], "grad_norm_critic": norms["critic"],
    }  # fmt: skip


def _shrink(norm: Any, limit: Any) -> Any:
    """Return by what torch multiplies gradients of a norm to keep it within a limit."""
    return jnp.minimum(limit / (norm + 1e-6), 1.0)


def _loss(
    parameters: Tree, batch: Mapping[str, Any], numbers: Any, activation: str
) -> tuple[Any, dict[str, Any]]:
    _, logits = _forward(parameters["actor"], activation, batch["observations"])
    _, values = _forward(parameters["critic"], activation, batch["observations"])
    advantages = batch["advantages"]
    if advantages.shape[0] > 1:
        advantages = (advantages - advantages.mean()) / (advantages.std(ddof=1) + 1e-8)
    difference = _log_probabilities(logits, batch["actions"]) - batch["log_probabilities"]
    ratio = jnp.exp(difference)
    clip = numbers["clip_range"]
    policy_loss = -jnp.minimum(advantages * ratio, advantages * jnp.clip(ratio, 1 - clip, 1 + clip)).mean()
    value_loss = ((batch["returns"] - values[:, 0]) ** 2).mean()
    logs = jax.nn.log_softmax(logits)
    entropy = -(jnp.exp(logs) * logs).sum(axis=1).mean()
    loss = policy_loss - numbers["entropy_coefficient"] * entropy + numbers["value_coefficient"] * value_loss
    return loss, {
        "policy_loss": policy_loss,
        "value_loss": value_loss,
        "entropy": entropy,
        "approx_kl": (ratio - 1 - difference).mean(),
        "clip_fraction": (jnp.abs(ratio - 1) > clip).mean(),
    }


def _log_probabilities(logits: Any, actions: Any) -> Any:
    return jnp.take_along_axis(jax.nn.log_softmax(logits), actions[:, None], axis=1)[:, 0]


def _forward(layers: Any, activation: str, x: Any) -> tuple[list[Any], Any]:
    """Return the outputs of the hidden layers, and those of the last: (N, units)."""
    hidden = []
    for weight, bias in layers[:-1]:
        x = _activate(activation, x @ weight + bias)
        hidden.append(x)
    weight, bias = layers[-1]
    return hidden, x @ weight + bias


def _activate(activation: str, x: Any) -> Any:
    if activation == "tanh":
        return jnp.tanh(x)
    return jax.nn.relu(x) if activation == "relu" else jax.nn.leaky_relu(x, LEAKY_SLOPE)


def _dead(units: Any, activation: str) -> Any:
    """Tell which units are constant over a rollout; see `pneuma.engines.policy.dead_share`."""
    return (jnp.abs(units) > 0.99 if activation == "tanh" else units <= 0).all(axis=0)
