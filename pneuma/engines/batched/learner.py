"""The learner of a policy: its networks, its optimizer, and updates from rollouts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import numpy as np

from pneuma.config import Run, stream_seed
from pneuma.engines.batched.optimizers import initial_state
from pneuma.engines.batched.rollout import Rollout, advantages, value_of
from pneuma.engines.batched.update import (
    METRICS,
    evaluate_rollout,
    learn,
    program,
    run_numbers,
)
from pneuma.engines.policy import Layers, Policy
from pneuma.engines.records import action_shares, has_finite_losses
from pneuma.env import rules

Tree = Any
Networks = dict[str, Layers]
"""{"actor": layers giving logits, "critic": layers giving one value}."""

HIDDEN_GAIN, ACTOR_GAIN, CRITIC_GAIN = math.sqrt(2), 0.01, 1.0
"""Gains of the orthogonal initial weights, as in Stable-Baselines3."""


def initial_networks(run: Run, features: int, actions: int, player: int = 0) -> Networks:
    """Return orthogonal weights and zero biases, from the run's random stream for weights."""
    generator = np.random.default_rng(stream_seed(run.seed, "weights", player))
    first_scale = run.first_layer_scale
    return {
        "actor": _layers(generator, (features, *run.actor, actions), first_scale, ACTOR_GAIN),
        "critic": _layers(generator, (features, *run.critic, 1), first_scale, CRITIC_GAIN),
    }


class Learner:
    """The networks, optimizer and minibatch order of one policy, of all players or of one player."""

    def __init__(self, run: Run, features: int, actions: int, player: int = 0) -> None:
        self.run = run
        self.networks: Networks = initial_networks(run, features, actions, player)
        self.optimizer: Tree = to_numpy(initial_state(run.optimizer, self.networks))
        # for the order of minibatches
        self.generator = np.random.default_rng(stream_seed(run.seed, "minibatches", player))
        self._actions = actions
        self._player = player

    def policy(self) -> Policy:
        return Policy(self.run.activation, self.networks["actor"], self.networks["critic"])

    def learn_from(self, rollout: Rollout, budget_left: float = 1.0) -> dict[str, float]:
        """Take an update's gradient steps; return its metrics. A share of the budget is left after them."""
        run = self.run
        batch, values, dead_units = self._compute_advantages(rollout)
        count = len(batch["actions"])
        orders = np.stack([self.generator.permutation(count) for _ in range(run.epochs)]).astype(np.int32)
        numbers = run_numbers(run, self._player, budget_left)
        networks, optimizer, metric_means = learn(
            self.networks, self.optimizer, batch, orders, numbers, program(run)
        )
        self.networks, self.optimizer = to_numpy(networks), to_numpy(optimizer)
        metrics: dict[str, float] = dict(zip(METRICS, np.asarray(metric_means).tolist(), strict=True))
        metrics["explained_variance"] = _explained_variance(values, batch["returns"])
        metrics["dead_units"] = dead_units
        return metrics | action_shares(run, batch["actions"], self._actions)

    def _compute_advantages(self, rollout: Rollout) -> tuple[dict[str, np.ndarray], np.ndarray, float]:
        """Return the batch, slot by slot, the values, and the share of dead units."""
        run = self.run
        slots, steps, features = rollout.observations.shape
        observations = np.concatenate([rollout.observations.reshape(-1, features), rollout.last_observations])
        actions = rollout.actions.reshape(-1)
        log_probabilities, all_values, dead_units = evaluate_rollout(
            self.networks, observations, actions, run.activation
        )
        all_values = np.asarray(all_values)
        values = all_values[: slots * steps].reshape(slots, steps)
        last_values = all_values[slots * steps :]
        all_advantages = advantages(
            self._bootstrapped(rollout), values, rollout.starts, last_values, rollout.last_ends,
            np.float32(run.gamma), np.float32(run.gamma * run.gae_lambda),
        )  # fmt: skip
        batch = {
            "observations": observations[: slots * steps],
            "actions": actions,
            "log_probabilities": np.asarray(log_probabilities),
            "advantages": all_advantages.reshape(-1),
            "returns": (all_advantages + values).reshape(-1),
        }
        return batch, values.reshape(-1), float(dead_units)

    def _bootstrapped(self, rollout: Rollout) -> np.ndarray:
        """Return rewards plus the discounted values of states that a time limit cut off, (S, T)."""
        cut = np.flatnonzero(rollout.ended["ending"] == rules.TIME_LIMIT)
        if not len(cut) or self.run.time_limit == "terminate":
            return rollout.rewards
        values = value_of(self.networks["critic"], self.run.activation, rollout.terminal_observations[cut])
        slots, steps = rollout.ended["slot"][cut], rollout.ended["step"][cut] - 1
        rewards = rollout.rewards.copy()
        rewards[slots, steps] += np.float32(self.run.gamma) * values
        return rewards

    def is_finite(self, metrics: Mapping[str, float]) -> bool:
        weights = jax.tree.leaves(self.networks)
        return has_finite_losses(metrics) and all(bool(np.isfinite(array).all()) for array in weights)


def to_numpy(tree: Tree) -> Tree:
    return jax.tree.map(np.asarray, tree)


def _explained_variance(values: np.ndarray, returns: np.ndarray) -> float:
    """Return 1 - Var(returns - values) / Var(returns); NaN if all returns are equal."""
    variance = np.var(returns)
    if variance == 0:
        return math.nan
    return float(1 - np.var(returns - values) / variance)


def _layers(
    generator: np.random.Generator, widths: Sequence[int], first_scale: float, last_gain: float
) -> Layers:
    gains = [HIDDEN_GAIN] * (len(widths) - 1)
    gains[0] *= first_scale
    gains[-1] = last_gain
    layers = []
    for inputs, outputs, gain in zip(widths[:-1], widths[1:], gains, strict=True):
        weight = _orthogonal(generator, inputs, outputs) * np.float32(gain)
        layers.append((weight, np.zeros(outputs, np.float32)))
    return tuple(layers)


def _orthogonal(generator: np.random.Generator, inputs: int, outputs: int) -> np.ndarray:
    """Return (inputs, outputs) float32 whose shorter side is orthonormal, uniformly drawn.

    Saxe, McClelland and Ganguli (2014); the signs make the draw uniform (Mezzadri 2007).
    """
    normal_matrix = generator.standard_normal((max(inputs, outputs), min(inputs, outputs)))
    q, r = np.linalg.qr(normal_matrix)
    q = q * np.sign(np.diag(r))
    return np.ascontiguousarray(q if inputs >= outputs else q.T, np.float32)
