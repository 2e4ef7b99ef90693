"""Optimizers with the arithmetic of torch's, as pure functions over trees of arrays.

Each takes gradients, parameters, its own state and the run's numbers, and returns new parameters and state.
Bias corrections use expm1 of t log(beta), because 1 - beta**t in float32 loses most of its digits in the
first steps.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

Tree = Any
State = dict[str, Any]
Numbers = Mapping[str, Any]
Step = Callable[[Tree, Tree, State, Numbers], tuple[Tree, State]]


def adam(gradients: Tree, parameters: Tree, state: State, numbers: Numbers) -> tuple[Tree, State]:
    """Adam (Kingma and Ba 2015); thesis section 6.1."""
    b1, b2 = numbers["beta_1"], numbers["beta_2"]
    steps = state["steps"] + 1
    mean = jax.tree.map(lambda m, g: m + (g - m) * (1 - b1), state["mean"], gradients)
    square = jax.tree.map(lambda v, g: b2 * v + (1 - b2) * g * g, state["square"], gradients)
    correction_1 = -jnp.expm1(steps * numbers["log_beta_1"])
    scale = 1 / jnp.sqrt(-jnp.expm1(steps * numbers["log_beta_2"]))
    rate = numbers["learning_rate"] / correction_1

    def move(p: Any, m: Any, v: Any) -> Any:
        return p - rate * m / (jnp.sqrt(v) * scale + numbers["epsilon"])

    moved = jax.tree.map(move, parameters, mean, square)
    return moved, {"steps": steps, "mean": mean, "square": square}


def sgd(gradients: Tree, parameters: Tree, state: State, numbers: Numbers) -> tuple[Tree, State]:
    """Gradient descent with momentum; as in torch, the first step does not dampen the gradient."""
    first = state["steps"] == 0
    factor = numbers["momentum"]
    fresh = jnp.where(first, 1.0, 1.0 - numbers["dampening"])
    momentum = jax.tree.map(
        lambda m, g: jnp.where(factor > 0, factor * m + fresh * g, g), state["momentum"], gradients
    )
    moved = jax.tree.map(lambda p, m: p - numbers["learning_rate"] * m, parameters, momentum)
    return moved, {"steps": state["steps"] + 1, "momentum": momentum}


def rmsprop(gradients: Tree, parameters: Tree, state: State, numbers: Numbers) -> tuple[Tree, State]:
    """RMSProp with momentum; as in torch, epsilon is outside the root."""
    smoothing, factor = numbers["smoothing"], numbers["momentum"]
    square = jax.tree.map(lambda v, g: smoothing * v + (1 - smoothing) * g * g, state["square"], gradients)
    scaled = jax.tree.map(lambda g, v: g / (jnp.sqrt(v) + numbers["epsilon"]), gradients, square)
    momentum = jax.tree.map(lambda m, g: factor * m + g, state["momentum"], scaled)
    moved = jax.tree.map(lambda p, m: p - numbers["learning_rate"] * m, parameters, momentum)
    return moved, {"steps": state["steps"] + 1, "square": square, "momentum": momentum}


def upgd(gradients: Tree, parameters: Tree, state: State, numbers: Numbers) -> tuple[Tree, State]:
    """Adaptive UPGD, which protects useful weights and perturbs the others.

    Elsayed and Mahmood, "Addressing Loss of Plasticity and Catastrophic Forgetting in Continual Learning",
    ICLR 2024: reference [23] of the thesis, whose section 6.1 names it as a remedy for policy collapse. This
    is the form with which its authors train PPO. For a weight w with gradient g, its moments m and v as
    Adam's, corrected, and noise ξ ~ N(0, 1):

        u ← β u - (1 - β) g w                    the first-order utility: what the loss would gain without w
        s = sigmoid(u / (1 - βᵗ) / max u)        the greatest utility of all weights scales it
        w ← (1 - α λ) w - 2 α (1 - s) (m / (√v + ε) + σ ξ)

    As in the authors' published PPO, the greatest utility is not corrected, so that at first s is nearly 0
    or 1; the factor 2 makes up for s = 1/2 where u = 0; and weight decay λ shrinks w by itself instead of
    being added to the gradient. Here α is the learning rate, β `utility_decay` and σ `noise`. The noise is
    keyed by the run and the number of the step.
    """
    b1, b2, decay = numbers["beta_1"], numbers["beta_2"], numbers["utility_decay"]
    steps = state["steps"] + 1
    mean = jax.tree.map(lambda m, g: b1 * m + (1 - b1) * g, state["mean"], gradients)
    square = jax.tree.map(lambda v, g: b2 * v + (1 - b2) * g * g, state["square"], gradients)
    utility = jax.tree.map(
        lambda u, g, p: decay * u - (1 - decay) * g * p, state["utility"], gradients, parameters
    )
    correction_1 = -jnp.expm1(steps * numbers["log_beta_1"])
    correction_2 = -jnp.expm1(steps * numbers["log_beta_2"])
    correction_u = -jnp.expm1(steps * numbers["log_utility_decay"])
    highest = jnp.stack([u.max() for u in jax.tree.leaves(utility)]).max()
    scale = correction_u * jnp.where(highest == 0, 1.0, highest)
    rate = 2 * numbers["learning_rate"]
    shrunk = 1 - numbers["learning_rate"] * numbers["weight_decay"]

    def move(p: Any, m: Any, v: Any, u: Any, xi: Any) -> Any:
        free = 1 - jax.nn.sigmoid(u / scale)
        adapted = m / correction_1 / (jnp.sqrt(v / correction_2) + numbers["epsilon"])
        return p * shrunk - rate * free * (adapted + numbers["noise"] * xi)

    moved = jax.tree.map(move, parameters, mean, square, utility, upgd_noise(parameters, steps, numbers))
    return moved, {"steps": steps, "mean": mean, "square": square, "utility": utility}


def upgd_noise(parameters: Tree, steps: Any, numbers: Numbers) -> Tree:
    """Return standard normal noise shaped like the parameters, keyed by the run and the step, from 1."""
    leaves, structure = jax.tree.flatten(parameters)
    noise_key = jax.random.wrap_key_data(numbers["noise_key"], impl="threefry2x32")
    stream_keys = jax.random.split(jax.random.fold_in(noise_key, steps), len(leaves))
    noise_leaves = []
    for stream_key, leaf in zip(stream_keys, leaves, strict=True):
        noise_leaves.append(jax.random.normal(stream_key, leaf.shape, leaf.dtype))
    return jax.tree.unflatten(structure, noise_leaves)


OPTIMIZERS: dict[str, tuple[Step, tuple[str, ...]]] = {
    "adam": (adam, ("mean", "square")),
    "sgd": (sgd, ("momentum",)),
    "rmsprop": (rmsprop, ("square", "momentum")),
    "upgd": (upgd, ("mean", "square", "utility")),
}
"""The function that takes a step, and the arrays that it keeps for every parameter."""


def initial_state(optimizer: str, parameters: Tree) -> State:
    _, kept_arrays = OPTIMIZERS[optimizer]
    zeros = jax.tree.map(np.zeros_like, parameters)  # NumPy's: JAX would compile a program for each shape
    return {"steps": np.zeros((), np.int32)} | dict.fromkeys(kept_arrays, zeros)
