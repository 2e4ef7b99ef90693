"""Optimizers with the arithmetic of torch's, as pure functions over trees of arrays.

Each takes gradients, parameters, its own state and the run's numbers, and returns new parameters and
state. Bias corrections are computed by expm1 of t log(beta), because 1 - beta**t in float32 loses
most of its digits at first.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp

Tree = Any
State = dict[str, Any]
Numbers = Mapping[str, Any]
Step = Callable[[Tree, Tree, State, Numbers], tuple[Tree, State]]


def initial_state(optimizer: str, parameters: Tree) -> State:
    """Return an optimizer's state before its first step."""
    zeros = jax.tree.map(jnp.zeros_like, parameters)
    moments = {"adam": ("mean", "square"), "sgd": ("momentum",), "rmsprop": ("square", "momentum")}
    return {"steps": jnp.zeros((), jnp.float32)} | dict.fromkeys(moments[optimizer], zeros)


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
    """Gradient descent with momentum; the first step takes the whole gradient, as torch has it."""
    first = state["steps"] == 0
    kept = numbers["momentum"]
    fresh = jnp.where(first, 1.0, 1.0 - numbers["dampening"])
    momentum = jax.tree.map(
        lambda m, g: jnp.where(kept > 0, kept * m + fresh * g, g), state["momentum"], gradients
    )
    moved = jax.tree.map(lambda p, m: p - numbers["learning_rate"] * m, parameters, momentum)
    return moved, {"steps": state["steps"] + 1, "momentum": momentum}


def rmsprop(gradients: Tree, parameters: Tree, state: State, numbers: Numbers) -> tuple[Tree, State]:
    """RMSProp with momentum; epsilon is outside the root, as torch has it."""
    smoothing, kept = numbers["smoothing"], numbers["momentum"]
    square = jax.tree.map(lambda v, g: smoothing * v + (1 - smoothing) * g * g, state["square"], gradients)
    scaled = jax.tree.map(lambda g, v: g / (jnp.sqrt(v) + numbers["epsilon"]), gradients, square)
    momentum = jax.tree.map(lambda m, g: kept * m + g, state["momentum"], scaled)
    moved = jax.tree.map(lambda p, m: p - numbers["learning_rate"] * m, parameters, momentum)
    return moved, {"steps": state["steps"] + 1, "square": square, "momentum": momentum}


STEPS: dict[str, Step] = {"adam": adam, "sgd": sgd, "rmsprop": rmsprop}
