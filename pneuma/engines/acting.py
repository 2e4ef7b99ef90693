"""Compiled play of one episode in every world, for evaluations.

policy and worlds → each world's return

Steps run without Python, and worlds whose episode has ended cost nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pneuma.engines.mlp import ACTIVATION_CODES, forward, sample
from pneuma.engines.policy import Policy, flat, sizes
from pneuma.env import rules
from pneuma.env.compiled import cached
from pneuma.env.worlds import Worlds

MOST_WEIGHTS = 65_536
"""Largest actor that is faster compiled than by a library's matrix product."""

STEPS_AT_ONCE = 256
"""Steps for which random numbers are drawn at once."""

kernel: Any = cached(error_model="numpy")


def play_episodes(
    worlds: Worlds,
    policy: Policy,
    sampled: int,
    generator: np.random.Generator,
) -> np.ndarray:
    """Play until every world has ended its episode.

    Args:
        worlds: N worlds of P players, just reset, with built-in rewards.
        policy: a policy of logits, which plays all players.
        sampled: the number of worlds, counted from the first, in which actions are drawn; the others take the
            most probable ones.
        generator: gives a number in [0, 1) for each player of these worlds at every step.

    Returns:
        (N,) the return of each, the mean over its players.
    """
    weights, widths = flat(policy.actor), sizes(policy.actor)
    activation = ACTIVATION_CODES[policy.activation]
    returns = np.zeros(len(worlds))
    running = len(worlds)
    while running:
        draws = generator.random((STEPS_AT_ONCE, sampled * worlds.players.shape[1]), np.float32)
        running = _play(worlds.handle, weights, widths, activation, draws, returns)
    return returns


@kernel
def _play(handle: Any, weights: Any, widths: Any, activation: int, draws: Any, returns: Any) -> int:
    """Play until the draws are used up or all worlds have ended; return how many still run."""
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
        asked = 0
        for w in range(count):
            if s.worlds[w].ending != rules.RUNNING:
                continue
            for p in range(players):
                rows[asked] = w * players + p
                scratch[0, asked, : widths[0]] = s.observations[w, p]
                asked += 1
        logits = forward(weights, widths, activation, asked, scratch)
        for k in range(asked):
            w, p = rows[k] // players, rows[k] % players
            chosen[w, p] = sample(logits[k], draws[step, rows[k]]) if w < sampled else np.argmax(logits[k])
        running -= rules.step_worlds(handle, chosen)
        for w in range(count):
            paid = 0.0
            for p in range(players):
                paid += s.events[w, p].reward
            returns[w] += paid / players
    return running
