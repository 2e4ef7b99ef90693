"""One update: everything that a run learns from a rollout, in two compiled calls.

The arithmetic is that of Stable-Baselines3's PPO (Schulman et al. 2017; thesis section 4.4): advantages
normalised in each minibatch by the sample deviation, a value loss without one half, one norm limit over actor
and critic or one for each. Hyperparameters that are numbers are passed as data, so that runs which differ
only in them share one compiled program. Another shape, activation or optimizer makes another program.

With small networks most time goes into starting operations, so there are few: each layer is one matrix
(`joined`), and a step's metrics are one array. With large ones most time goes into moving weights. So these
are left in place, and not read for a decay of zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pneuma.algorithms import OPTIMIZERS
from pneuma.config import ANNEALED, Run, stream_seed
from pneuma.engines.batched import optimizers
from pneuma.engines.policy import LEAKY_SLOPE, NUMPY_ACTIVATIONS

Tree = Any
JAX_ACTIVATIONS: dict[str, Callable[[Any], Any]] = {
    "tanh": jnp.tanh,
    "relu": jax.nn.relu,
    "leaky-relu": partial(jax.nn.leaky_relu, negative_slope=LEAKY_SLOPE),
}
JOINED_BELOW = 2**18
"""Layers with so many weights are not joined, because copying them would take longer than it saves."""
METRICS = (
    "policy_loss", "value_loss", "entropy", "clip_fraction", "approx_kl", "grad_norm", "grad_norm_actor",
    "grad_norm_critic",
)  # fmt: skip
"""Metrics of a gradient step, in this order.

An update's are means over all its minibatches; that of `approx_kl` is over the last epoch's.
"""

_LEARNING_NUMBERS = (
    "learning_rate",
    "clip_range",
    "value_coefficient",
    "entropy_coefficient",
    "weight_decay",
)


class Program(NamedTuple):
    """What identifies a compiled program, in addition to shapes."""

    activation: str
    optimizer: str
    minibatch: int
    decays: bool
    """Whether gradients get a weight decay; reading weights for one of zero takes time."""
    normalizes: bool
    """Whether the advantages of each minibatch are normalised."""


def program(run: Run) -> Program:
    decays = bool(run.weight_decay) and not OPTIMIZERS[run.optimizer].decays_weights_itself
    minibatch = min(run.minibatch, run.steps_per_update // run.policies)
    return Program(run.activation, run.optimizer, minibatch, decays, run.normalize_advantage)


def run_numbers(run: Run, player: int = 0, budget_left: float = 1.0) -> dict[str, Any]:
    """Return the run's numeric fields, float32, and the key of its noise, (2,) uint32.

    The optimizer's numbers also have their logarithms. Annealed fields fall with the share of steps that is
    left. An absent limit is infinite.
    """
    numbers = {"joint_limit": math.inf, "separate_limit": math.inf}
    if run.gradient_limit is not None:
        numbers[f"{run.clip}_limit"] = run.gradient_limit
    for field_name in _LEARNING_NUMBERS:
        numbers[field_name] = getattr(run, field_name)
    for field_name in ANNEALED:
        if getattr(run, f"{field_name}_schedule") == "linear":
            numbers[field_name] *= budget_left
    optimizer_numbers = {name: getattr(run, name) for name in OPTIMIZERS[run.optimizer].defaults}
    if "betas" in optimizer_numbers:
        optimizer_numbers["beta_1"], optimizer_numbers["beta_2"] = optimizer_numbers.pop("betas")
    for field_name, number in optimizer_numbers.items():
        numbers[field_name] = number
        numbers[f"log_{field_name}"] = math.log(number) if number else -math.inf
    arrays: dict[str, Any] = {field_name: np.float32(number) for field_name, number in numbers.items()}
    arrays["noise_key"] = np.array([stream_seed(run.seed, "upgd-noise", player)], np.uint64).view(np.uint32)
    return arrays


@partial(jax.jit, static_argnames="activation")
def evaluate_rollout(
    parameters: Tree, observations: Any, actions: Any, activation: str
) -> tuple[Any, Any, Any]:
    """Evaluate a rollout by the networks that played it: observations (N, features), actions (n,), n <= N.

    Return log-probabilities (n,), values (N,), and the share of hidden units that are dead over the n.
    Observations after the first n are only valued.
    """
    sample_count = actions.shape[0]
    networks = joined(parameters)
    hidden_a, logits = _forward(networks["actor"], activation, observations[:sample_count])
    hidden_c, values = _forward(networks["critic"], activation, observations)
    is_dead = NUMPY_ACTIVATIONS[activation].is_dead
    hidden_outputs = hidden_a + [layer[:sample_count] for layer in hidden_c]
    dead_share = jnp.concatenate([is_dead(units).all(axis=0) for units in hidden_outputs]).mean()
    return _at_actions(jax.nn.log_softmax(logits), actions), values[:, 0], dead_share


@partial(jax.jit, static_argnames="program", donate_argnums=(0, 1))
def learn(
    parameters: Tree, state: Tree, batch: Mapping[str, Any], orders: Any, numbers: Mapping[str, Any],
    program: Program,
) -> tuple[Tree, Tree, Any]:  # fmt: skip
    """Take all gradient steps of an update; return parameters, the optimizer's state, and `METRICS`.

    The batch has observations (N, features), actions, log_probabilities, advantages and returns (N,). The
    orders, (epochs, N) permutations, are cut into minibatches, of which the last one may be smaller. The
    numbers are those of `run_numbers`. The memory of parameters and state is reused.
    """
    minibatch = program.minibatch
    batches = orders.shape[1] // minibatch

    def take(carry: Tree, index: Any) -> tuple[Tree, Any]:
        samples = {array_name: array[index] for array_name, array in batch.items()}
        return _step(carry, samples, numbers, program)

    def epoch(carry: Tree, order: Any) -> tuple[Tree, Any]:
        carry, metrics = jax.lax.scan(take, carry, order[: batches * minibatch].reshape(batches, minibatch))
        if batches * minibatch == order.shape[0]:
            return carry, metrics
        carry, last_metrics = take(carry, order[batches * minibatch :])
        return carry, jnp.concatenate([metrics, last_metrics[None]])

    carry, metrics = jax.lax.scan(epoch, (joined(parameters), joined(state)), orders)
    metric_means = metrics.mean(axis=(0, 1))  # (epochs, minibatches, metrics) -> (metrics,)
    kl = METRICS.index("approx_kl")
    return _parted(carry[0]), _parted(carry[1]), metric_means.at[kl].set(metrics[-1, :, kl].mean())


def joined(tree: Tree) -> Tree:
    """Return networks, or a tree of that form, with each small layer as one matrix, (inputs + 1, outputs).

    Its last row is the bias, as the weights of an input that is always one.
    """

    def join(node: Any) -> Any:
        if not _is_layer(node) or node[0].size >= JOINED_BELOW:
            return node
        weight, bias = node
        return jnp.concatenate([weight, bias[None]])

    return jax.tree.map(join, tree, is_leaf=_is_layer)


def _parted(tree: Tree) -> Tree:
    """Undo `joined`."""

    def part(node: Any) -> Any:
        if _is_layer(node) or node.ndim != 2:
            return node
        return node[:-1], node[-1]

    return jax.tree.map(part, tree, is_leaf=_is_layer)


def _is_layer(node: Any) -> bool:
    """Return whether a tree is a layer's weight and bias, and not a network's layers."""
    return isinstance(node, tuple) and getattr(node[-1], "ndim", 0) == 1


def _step(carry: Tree, batch: Mapping[str, Any], numbers: Any, program: Program) -> tuple[Tree, Any]:
    """Take one gradient step on a minibatch; return the carry and `METRICS`."""
    parameters, state = carry
    gradients, metrics = jax.grad(_loss, has_aux=True)(parameters, batch, numbers, program)
    actor_square, critic_square = _square(gradients["actor"]), _square(gradients["critic"])
    norm = jnp.sqrt(actor_square + critic_square)
    norms = {"actor": jnp.sqrt(actor_square), "critic": jnp.sqrt(critic_square)}
    joint_factor = _shrink(norm, numbers["joint_limit"])
    clipped = {}
    for network, gradient in gradients.items():
        factor = joint_factor * _shrink(norms[network], numbers["separate_limit"])
        clipped[network] = jax.tree.map(partial(jnp.multiply, factor), gradient)
    if program.decays:
        clipped = jax.tree.map(lambda g, p: g + numbers["weight_decay"] * p, clipped, parameters)
    take_step, _ = optimizers.OPTIMIZERS[program.optimizer]
    carry = take_step(clipped, parameters, state, numbers)
    return carry, jnp.concatenate([metrics, jnp.stack([norm, norms["actor"], norms["critic"]])])


def _square(gradient: Tree) -> Any:
    """Return the square of a gradient's L2 norm."""
    return sum((leaf**2).sum() for leaf in jax.tree.leaves(gradient))


def _shrink(norm: Any, limit: Any) -> Any:
    """Return the factor by which torch multiplies gradients of a norm to keep it within a limit."""
    return jnp.minimum(limit / (norm + 1e-6), 1.0)


def _loss(parameters: Tree, batch: Mapping[str, Any], numbers: Any, program: Program) -> tuple[Any, Any]:
    """Return the loss of a minibatch and the first five `METRICS`."""
    _, logits = _forward(parameters["actor"], program.activation, batch["observations"])
    _, values = _forward(parameters["critic"], program.activation, batch["observations"])
    advantages = batch["advantages"]
    if program.normalizes and advantages.shape[0] > 1:
        advantages = (advantages - advantages.mean()) / (advantages.std(ddof=1) + 1e-8)
    log_probabilities = jax.nn.log_softmax(logits)
    difference = _at_actions(log_probabilities, batch["actions"]) - batch["log_probabilities"]
    ratio = jnp.exp(difference)
    clip_range = numbers["clip_range"]
    terms = [
        -jnp.minimum(advantages * ratio, advantages * jnp.clip(ratio, 1 - clip_range, 1 + clip_range)),
        (batch["returns"] - values[:, 0]) ** 2,
        -(jnp.exp(log_probabilities) * log_probabilities).sum(axis=1),
        jnp.abs(ratio - 1) > clip_range,
        ratio - 1 - difference,
    ]
    metrics = jnp.stack(terms).mean(axis=1)  # (metrics, minibatch) -> (metrics,)
    policy_loss, value_loss, entropy = metrics[0], metrics[1], metrics[2]
    loss = policy_loss - numbers["entropy_coefficient"] * entropy + numbers["value_coefficient"] * value_loss
    return loss, metrics


def _at_actions(log_probabilities: Any, actions: Any) -> Any:
    """Return the log-probabilities of actions: (N, actions), (N,) -> (N,)."""
    return (log_probabilities * jax.nn.one_hot(actions, log_probabilities.shape[1])).sum(axis=1)


def _forward(layers: Any, activation: str, x: Any) -> tuple[list[Any], Any]:
    """Return the outputs of the hidden layers and of the last layer: (N, units)."""
    hidden_outputs = []
    for layer in layers[:-1]:
        x = JAX_ACTIVATIONS[activation](_linear(layer, x))
        hidden_outputs.append(x)
    return hidden_outputs, _linear(layers[-1], x)


def _linear(layer: Any, x: Any) -> Any:
    """Return a layer's sums: (N, inputs) -> (N, outputs)."""
    if isinstance(layer, tuple):
        weight, bias = layer
        return x @ weight + bias
    return jnp.concatenate([x, jnp.ones((x.shape[0], 1), x.dtype)], axis=1) @ layer
