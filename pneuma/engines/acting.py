"""Compiled play of one episode in every world: what evaluations spend their time on.

policy and worlds → each world's return

A step costs no Python, and worlds whose episode has ended cost nothing more. A row of observations gives the
same bits whoever else is asked: products are summed input by input, never in blocks of rows.

`activate` and `sample` are compiled into `pneuma.engines.batched.rollout` as well, and the compile cache
watches only the file that a kernel is in: whoever changes them changes that file too.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from pneuma.engines.policy import LEAKY_SLOPE, Policy, flat, sizes
from pneuma.env import rules
from pneuma.env.compiled import cached
from pneuma.env.worlds import Worlds

ACTIVATION_CODES = {"tanh": 0, "relu": 1, "leaky-relu": 2}

MOST_WEIGHTS = 65_536
"""A larger actor is faster in a library's matrix product, with Python in between."""

STEPS_AT_ONCE = 256
"""Steps whose random numbers are drawn together."""

kernel: Any = cached(error_model="numpy")


def play_episodes(
    worlds: Worlds,
    policies: Sequence[Policy],
    sampled: int,
    generator: np.random.Generator,
) -> np.ndarray:
    """Play until every world has ended its episode.

    Args:
        worlds: reset, with rewards of the kernel's own; N of them, of P players.
        policies: giving logits, one for all players or one for each, alike in shape and activation.
        sampled: in how many worlds, the first, actions are drawn; the others take the most probable one.
        generator: for every player of those, a number in [0, 1) is drawn from it at every step.

    Returns:
        (N,) the return of each, the mean over its players.
    """
    weights, widths = np.stack([flat(own.actor) for own in policies]), sizes(policies[0].actor)
    activation = ACTIVATION_CODES[policies[0].activation]
    returns = np.zeros(len(worlds))
    running = len(worlds)
    while running:
        draws = generator.random((STEPS_AT_ONCE, sampled * worlds.players.shape[1]), np.float32)
        running = _play(worlds.handle, weights, widths, activation, draws, returns)
    return returns


@kernel
def _play(handle: Any, weights: Any, widths: Any, activation: int, draws: Any, returns: Any) -> int:
    """Play as many steps as there are draws, or to the end; return how many worlds still run."""
    s = rules.open_state(handle)
    count, players = s.players.shape[0], s.players.shape[1]
    sampled = draws.shape[1] // players
    chosen = np.zeros((count, players), np.int64)
    rows = np.zeros(count * players, np.int64)
    scratch = np.zeros((2, count * players, widths.max()), np.float32)
    running = 0
    for w in range(count):
        running += s.worlds[w].ending == rules.RUNNING
    for step in range(draws.shape[0]):
        if running == 0:
            break
        for own in range(weights.shape[0]):
            asked = 0
            for w in range(count):
                if s.worlds[w].ending != rules.RUNNING:
                    continue
                for p in range(players):
                    if p % weights.shape[0] == own:
                        rows[asked] = w * players + p
                        scratch[0, asked, : widths[0]] = s.observations[w, p]
                        asked += 1
            logits = _forward(weights[own], widths, activation, asked, scratch)
            for k in range(asked):
                w, p = rows[k] // players, rows[k] % players
                place = rows[k] if weights.shape[0] == 1 else p * sampled + w  # as a `Team` draws
                chosen[w, p] = sample(logits[k], draws[step, place]) if w < sampled else _highest(logits[k])
        running -= rules.step_worlds(handle, chosen, False)
        for w in range(count):
            paid = 0.0
            for p in range(players):
                paid += s.events[w, p].reward
            returns[w] += paid / players
    return running


@kernel
def _forward(weights: Any, widths: Any, activation: int, count: int, scratch: Any) -> Any:
    """Return the outputs for `count` rows that lie in `scratch[0]`; they lie in `scratch` too."""
    at = 0
    inputs = scratch[0]
    for layer in range(len(widths) - 1):
        n, m = widths[layer], widths[layer + 1]
        out = scratch[(layer + 1) % 2]
        bias = weights[at + n * m : at + n * m + m]
        for k in range(count):
            for j in range(m):
                out[k, j] = bias[j]
        for i in range(n):
            row = weights[at + i * m : at + (i + 1) * m]
            for k in range(count):
                value = inputs[k, i]
                for j in range(m):
                    out[k, j] += value * row[j]
        at += n * m + m
        if layer < len(widths) - 2:
            for k in range(count):
                activate(activation, out[k, :m])
        inputs = out
    return inputs[:, : widths[-1]]


@kernel
def _highest(logits: Any) -> int:
    best = 0
    for j in range(1, len(logits)):
        if logits[j] > logits[best]:
            best = j
    return best


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
