"""The learner of a policy: its networks, its optimizer, and updates from rollouts."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pneuma.config import Run, stream_seed
from pneuma.engines.batched.initial_weights import initial_networks
from pneuma.engines.batched.optimizers import OptimizerState, initial_state
from pneuma.engines.batched.rollout import Rollout, advantages
from pneuma.engines.batched.update import (
    METRICS,
    evaluate_rollout,
    explained_variance,
    learn,
    run_numbers,
    used_panels,
)
from pneuma.engines.mlp import ACTIVATION_CODES, Network, flat, layer_widths, layers_of, values_of
from pneuma.engines.policy import Policy
from pneuma.engines.records import action_shares, has_finite_losses
from pneuma.env import rules


class Learner:
    """The networks, optimizer and minibatch order of one policy, of all players or of one player.

    Attributes:
        weights: (weights,) float32, the actor's `flat` ones, then the critic's.
        optimizer: what the optimizer keeps.
        generator: for the order of minibatches.
        actor, critic: the networks, whose weights are views.
    """

    def __init__(self, run: Run, features: int, actions: int, player: int = 0) -> None:
        self.run = run
        self._actions = actions
        self._player = player
        networks = initial_networks(run, features, actions, player)
        actor_weights, critic_weights = flat(networks["actor"]), flat(networks["critic"])
        self.weights = np.concatenate([actor_weights[0], critic_weights[0]])
        self.optimizer: OptimizerState = initial_state(run.optimizer, len(self.weights))
        self.generator = np.random.default_rng(stream_seed(run.seed, "minibatches", player))
        code, actor_size = ACTIVATION_CODES[run.activation], actor_weights.size
        self.actor = Network(self.weights[None, :actor_size], layer_widths(networks["actor"]), code)
        self.critic = Network(self.weights[None, actor_size:], layer_widths(networks["critic"]), code)
        self._panels = used_panels(self.actor.widths, self.critic.widths)

    def policy(self) -> Policy:
        """Return a copy of the networks."""
        actor, critic = self.actor, self.critic
        return Policy(
            self.run.activation,
            layers_of(actor.weights[0], actor.widths.tolist()),
            layers_of(critic.weights[0], critic.widths.tolist()),
        )

    def learn_from(self, rollout: Rollout, budget_left: float = 1.0) -> dict[str, float]:
        """Take an update's gradient steps; return its metrics. A share of the budget is left after them."""
        run = self.run
        numbers = run_numbers(run, self._player, budget_left)
        slots, steps, features = rollout.observations.shape
        count = slots * steps
        observations = np.concatenate([rollout.observations.reshape(-1, features), rollout.last_observations])
        actions = rollout.actions.reshape(-1)
        old_logs, all_values, dead_units = evaluate_rollout(
            self.weights, self.actor.widths, self.critic.widths, observations, actions, numbers
        )
        values = all_values[:count].reshape(slots, steps)
        all_advantages = advantages(
            self._bootstrapped(rollout), values, rollout.starts, all_values[count:], rollout.last_ends,
            np.float32(run.gamma), np.float32(run.gamma * run.gae_lambda),
        )  # fmt: skip
        returns = (all_advantages + values).reshape(-1)
        orders = np.stack([self.generator.permutation(count) for _ in range(run.epochs)])
        metric_means = learn(
            self.weights, self.optimizer, self.actor.widths, self.critic.widths, self._panels,
            observations, actions, old_logs, all_advantages.reshape(-1), returns, orders, numbers,
        )  # fmt: skip
        metrics: dict[str, float] = dict(zip(METRICS, metric_means.tolist(), strict=True))
        metrics["explained_variance"] = explained_variance(values.reshape(-1), returns)
        metrics["dead_units"] = dead_units
        return metrics | action_shares(run, actions, self._actions)

    def _bootstrapped(self, rollout: Rollout) -> np.ndarray:
        """Return rewards plus the discounted values of states that a time limit cut off, (S, T)."""
        cut = np.flatnonzero(rollout.ended["ending"] == rules.TIME_LIMIT)
        if not len(cut) or self.run.time_limit == "terminate":
            return rollout.rewards
        values = values_of(self.critic, rollout.terminal_observations[cut])
        slots, steps = rollout.ended["slot"][cut], rollout.ended["step"][cut] - 1
        rewards = rollout.rewards.copy()
        rewards[slots, steps] += np.float32(self.run.gamma) * values
        return rewards

    def is_finite(self, metrics: Mapping[str, float]) -> bool:
        return has_finite_losses(metrics) and bool(np.isfinite(self.weights).all())

    def saved_state(self) -> dict[str, np.ndarray]:
        """Copy the weights and what the optimizer keeps: arrays by name."""
        arrays = {"weights": self.weights.copy()}
        for name, array in self.optimizer._asdict().items():
            arrays[f"optimizer.{name}"] = array.copy()
        return arrays

    def restore_state(self, saved: Mapping[str, np.ndarray]) -> None:
        """Return to a saved state; ValueError or KeyError for one of another learner."""
        self.weights[:] = saved["weights"]
        for name, array in self.optimizer._asdict().items():
            array[:] = saved[f"optimizer.{name}"]
