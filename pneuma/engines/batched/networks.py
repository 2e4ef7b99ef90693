"""Actor and critic of a run as plain arrays: how they begin, and how they become a stored policy."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pneuma.config import Run, stream_seed
from pneuma.engines.policy import Layers, Policy

Networks = dict[str, Layers]
"""{"actor": layers giving logits, "critic": layers giving one value}."""

HIDDEN_GAIN, ACTOR_GAIN, CRITIC_GAIN = math.sqrt(2), 0.01, 1.0
"""Of the orthogonal initial weights, as Stable-Baselines3 has them."""


def initial_networks(run: Run, features: int, actions: int, player: int = 0) -> Networks:
    """Return orthogonal weights and zero biases, drawn from the run's stream of a player's weights."""
    generator = np.random.default_rng(stream_seed(run.stream, "weights", player))
    return {
        "actor": _layers(generator, (features, *run.actor, actions), ACTOR_GAIN),
        "critic": _layers(generator, (features, *run.critic, 1), CRITIC_GAIN),
    }


def to_policy(run: Run, networks: Networks) -> Policy:
    """Return networks as a stored policy."""
    return Policy(run.activation, networks["actor"], networks["critic"])


def _layers(generator: np.random.Generator, widths: Sequence[int], last_gain: float) -> Layers:
    gains = [HIDDEN_GAIN] * (len(widths) - 2) + [last_gain]
    return tuple(
        (_orthogonal(generator, inputs, outputs) * np.float32(gain), np.zeros(outputs, np.float32))
        for inputs, outputs, gain in zip(widths[:-1], widths[1:], gains, strict=True)
    )


def _orthogonal(generator: np.random.Generator, inputs: int, outputs: int) -> np.ndarray:
    """Return (inputs, outputs) float32 whose shorter side is orthonormal, uniformly drawn.

    Saxe, McClelland and Ganguli (2014); the signs make the draw uniform (Mezzadri 2007).
    """
    normal = generator.standard_normal((max(inputs, outputs), min(inputs, outputs)))
    q, r = np.linalg.qr(normal)
    q = q * np.sign(np.diag(r))
    return np.ascontiguousarray(q if inputs >= outputs else q.T, np.float32)
