"""The compiled forward pass of a policy, and the choice of actions by its logits.

weights, observations → outputs, actions

A row of observations gives the same bits however many other rows there are, because products are summed input
by input and not in blocks of rows.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pneuma.env.state import cached

ACTIVATION_CODES = {"tanh": 0, "relu": 1, "leaky-relu": 2}

LEAKY_SLOPE = 0.01
"""Slope of LeakyReLU below zero (thesis section 6.2)."""

kernel: Any = cached(error_model="numpy")


@kernel
def forward(weights: Any, widths: Any, activation: int, count: int, scratch: Any) -> Any:
    """Return a network's outputs for `count` rows of `scratch[0]`, (count at least, outputs).

    Weights and widths of all layers are laid out as by `pneuma.engines.policy.flat` and `sizes`. `scratch`,
    (2, rows, greatest width) float32, is overwritten and contains the outputs. `activation` is the code of
    the hidden layers' one.
    """
    at = 0
    inputs = scratch[0]
    for layer in range(len(widths) - 1):
        n, m = widths[layer], widths[layer + 1]
        out = scratch[(layer + 1) % 2]
        matrix = weights[at : at + n * m].reshape(n, m)
        bias = weights[at + n * m : at + n * m + m]
        for k in range(count):
            for j in range(m):
                out[k, j] = bias[j]
        several = n - n % 4
        for i in range(0, several, 4):  # four inputs at a time, as loading and storing sums costs most
            w0, w1, w2, w3 = matrix[i], matrix[i + 1], matrix[i + 2], matrix[i + 3]
            for k in range(count):
                x0, x1, x2, x3 = inputs[k, i], inputs[k, i + 1], inputs[k, i + 2], inputs[k, i + 3]
                for j in range(m):
                    out[k, j] = out[k, j] + x0 * w0[j] + x1 * w1[j] + x2 * w2[j] + x3 * w3[j]
        for i in range(several, n):
            for k in range(count):
                for j in range(m):
                    out[k, j] += inputs[k, i] * matrix[i, j]
        at += n * m + m
        if layer < len(widths) - 2:
            for k in range(count):
                activate(activation, out[k, :m])
        inputs = out
    return inputs[:, : widths[-1]]


@kernel
def activate(activation: int, x: Any) -> None:
    """Apply the activation function of a code to a row, in place."""
    if activation == 0:
        for j in range(len(x)):
            x[j] = math.tanh(x[j])
    elif activation == 1:
        for j in range(len(x)):
            x[j] = max(x[j], np.float32(0))
    else:
        for j in range(len(x)):
            x[j] = x[j] if x[j] > 0 else x[j] * np.float32(LEAKY_SLOPE)


@kernel
def sample(logits: Any, draw: Any) -> int:
    """Draw from a softmax by a number in [0, 1); the logits are overwritten."""
    highest = logits[0]
    for value in logits:
        highest = max(highest, value)
    total = np.float32(0)
    for j in range(len(logits)):
        logits[j] = math.exp(logits[j] - highest)
        total += logits[j]
    left = draw * total
    for j in range(len(logits) - 1):
        left -= logits[j]
        if left < 0:
            return j
    return len(logits) - 1


@kernel
def choose(
    weights: Any, widths: Any, activation: int, observations: Any, draws: Any, plays: Any, chosen: Any
) -> None:
    """Choose an action in every row that plays: a drawn one in the first rows, else the most probable.

    Row i of the observations, (rows, features), is of policy i % policies of the actors' weights, (policies,
    numbers). `draws` has a number in [0, 1) for each of the first rows. Rows that do not play cost nothing.
    The actions are written into `chosen`, (rows,) int64.
    """
    policies = len(weights)
    for own in range(policies):
        rows = own + policies * np.flatnonzero(plays[own::policies])
        scratch = np.empty((2, len(rows), widths.max()), np.float32)
        for k in range(len(rows)):
            scratch[0, k, : widths[0]] = observations[rows[k]]
        logits = forward(weights[own], widths, activation, len(rows), scratch)
        for k in range(len(rows)):
            row = rows[k]
            chosen[row] = sample(logits[k], draws[row]) if row < len(draws) else np.argmax(logits[k])
