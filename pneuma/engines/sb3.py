"""The reference engine: Stable-Baselines3's learners, unchanged.

A learner collects and trains by its own methods. Pneuma sets it up from the run (`sb3_learners.py`), reads
its gradients and log without changing its arithmetic, and evaluates between updates. An update is one rollout
and the training on it; for DQN it is as many steps with the gradient steps between them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from sb3_contrib import TRPO
from stable_baselines3 import DQN
from torch import nn

from pneuma.config import Run
from pneuma.engines.device import check_device
from pneuma.engines.environment import make_vec_env
from pneuma.engines.gymnasium_env import choice_counts
from pneuma.engines.loop import ResumableTrainer
from pneuma.engines.policy import Policy, dead_share, overflows
from pneuma.engines.records import Checkpoint, Records, action_shares, has_finite_losses, metrics_row
from pneuma.engines.sb3_learners import (
    Episodes,
    Learner,
    copy_array,
    has_finite_weights,
    learn,
    linear_layers,
    logged_losses,
    make_model,
    prepare,
    restore_checkpoint,
    take_checkpoint,
)
from pneuma.engines.stopping import IsStopping, never


class Sb3Trainer(ResumableTrainer):
    def __init__(self, run: Run, is_stopping: IsStopping = never) -> None:
        super().__init__(run, is_stopping)
        check_device(run)
        torch.set_num_threads(1)
        self._model: Any = make_model(run, make_vec_env(run))
        prepare(self._model, run)
        self._visited = Visited(run)
        self._policy = extract_policy(self._model, run)

    def restore(self, checkpoint: Checkpoint) -> None:
        restore_checkpoint(self._model, checkpoint)
        self._visited.counts.update(row["slot"] for row in checkpoint.records.episodes)
        self._policy = extract_policy(self._model, self.run)

    def update(self, before: int, after: int, records: Records) -> bool:
        """Let the learner collect and train; DQN does both once every few steps.

        If a weight or logit is not a number, torch refuses to sample actions, or the next minibatch. Such a
        run has diverged, not crashed, and has no losses.
        """
        model, run = self._model, self.run
        self._visited.forget()
        metrics: dict[str, float] = {}
        has_diverged = False
        with GradientNorms(model, run) as gradient_norms:
            try:
                with np.errstate(over="ignore", invalid="ignore"):  # values may overflow here
                    metrics |= self._learn()
            except (ValueError, RuntimeError):
                has_diverged = self._has_diverged()
                if not has_diverged:
                    raise
        if len(self._visited.actions) == run.horizon:
            metrics |= self._visited_metrics()
        metrics |= gradient_norms.means()
        records.metrics.append(metrics_row(after, metrics))
        records.episodes.extend(self._visited.take_rows())
        if has_diverged or not has_finite_losses(metrics) or not has_finite_weights(model):
            return False
        self._policy = extract_policy(model, run)
        return not overflows(self._policy, model._last_obs)

    def _learn(self) -> dict[str, float]:
        """Train for an update's steps; return what the learner logged, and its mean value loss."""
        run = self.run
        trainings = run.horizon // (run.train_every or run.horizon)
        metrics: dict[str, float] = {}
        value_losses = []
        for _ in range(trainings):
            self._model.logger.name_to_value.clear()
            learn(self._model, run.steps_per_update // trainings, self._visited)
            logged = logged_losses(self._model)
            if logged:  # values are learned from some step on
                metrics = logged
                value_losses.append(logged["value_loss"])
        if len(value_losses) > 1:
            # `sum` rounds differently from Python 3.12 on
            metrics["value_loss"] = float(np.mean(value_losses))
        return metrics

    def _has_diverged(self) -> bool:
        if not has_finite_weights(self._model):
            return True
        observations = np.concatenate([*self._visited.observations, self._model._last_obs])
        return overflows(extract_policy(self._model, self.run), observations)

    def _visited_metrics(self) -> dict[str, float]:
        """Return dead units and shares of actions by the policy that played the update's steps."""
        policy = self._policy
        observations = np.concatenate(self._visited.observations)
        actions = np.concatenate(self._visited.actions)
        metrics = {"dead_units": dead_share(policy, observations)}
        if isinstance(self._model.action_space, spaces.Discrete):
            metrics |= action_shares(self.run, actions, policy.actions)
        if isinstance(self._model, TRPO):  # which logs no entropy
            metrics["entropy"] = policy.entropy(observations)
        return metrics

    def policy(self) -> Policy:
        return replace(self._policy, scaling=self._model.env.slots.scaling)

    def training_xp(self) -> np.ndarray:
        xp: np.ndarray = self._model.env.slots.worlds.players["xp"]
        return xp

    def checkpoint(self, step: int, records: Records) -> Checkpoint:
        return take_checkpoint(self._model, step, records)


class Visited(Episodes):
    """Also collects the observations, (S, features), and actions, (S, …), of each step of an update."""

    def forget(self) -> None:
        self.observations: list[np.ndarray] = []
        self.actions: list[np.ndarray] = []

    def _on_step(self) -> bool:
        self.observations.append(np.asarray(self.model._last_obs))
        self.actions.append(self.locals["actions"])
        return super()._on_step()


# --- Gradients -------------------------------------------------------------------------------------


ACTOR_PARAMETERS = ("policy_net", "action_net", "log_std")
"""Parts of the names of an actor's parameters."""


class GradientNorms:
    """Measures the gradient norms of an update's minibatches before clipping, and clips separately if asked.

    It uses torch's hooks, so that the learner's code and arithmetic are unchanged. TRPO is left out, because
    its actor takes no gradient steps.
    """

    def __init__(self, model: Learner, run: Run) -> None:
        self._actor: list[nn.Parameter] = []
        self._critic: list[nn.Parameter] = []
        for parameter_name, parameter in model.policy.named_parameters():
            if "q_net_target" not in parameter_name:
                is_actor = any(part in parameter_name for part in ACTOR_PARAMETERS)
                (self._actor if is_actor else self._critic).append(parameter)
        self._norms: list[torch.Tensor] = []
        self._limit = run.gradient_limit if run.clip == "separate" else None
        self._optimizer = None if isinstance(model, TRPO) else model.policy.optimizer
        self._hooks: tuple[Any, ...] = ()

    def __enter__(self) -> GradientNorms:
        if self._optimizer is not None:
            self._hooks = (
                self._optimizer.register_step_pre_hook(self._clip_separately),
                torch.autograd.graph.register_multi_grad_hook(self._actor + self._critic, self._measure),
            )
        return self

    def __exit__(self, *_: object) -> None:
        """Remove the hooks, which would keep the network in memory."""
        for hook in self._hooks:
            hook.remove()

    def _measure(self, gradients: Any) -> None:
        self._norms.append(torch.stack(torch._foreach_norm(gradients)))

    def _clip_separately(self, *_: Any) -> None:
        if self._limit is not None:
            nn.utils.clip_grad_norm_(self._actor, self._limit)
            nn.utils.clip_grad_norm_(self._critic, self._limit)

    def means(self) -> dict[str, float]:
        """Return the mean norms over the update's minibatches.

        A network of action values has no actor and critic. Before the first gradient there is no norm.
        """
        if not self._norms:
            return {}
        squares = torch.stack(self._norms).double() ** 2  # (minibatches, parameters)
        actor_squares = squares[:, : len(self._actor)].sum(1)
        critic_squares = squares[:, len(self._actor) :].sum(1)
        squares_by_norm = {"grad_norm": actor_squares + critic_squares}
        if self._actor:
            squares_by_norm |= {"grad_norm_actor": actor_squares, "grad_norm_critic": critic_squares}
        return {name: float(square.sqrt().mean()) for name, square in squares_by_norm.items()}


# --- Networks --------------------------------------------------------------------------------------


def extract_policy(model: Any, run: Run) -> Policy:
    """Copy the learner's networks into a `Policy`; a network of action values is its actor."""
    parts: dict[str, Any] = {"actor": (), "critic": ()}
    for network, modules in linear_layers(model).items():
        for layer in modules:
            # torch keeps (outputs, inputs)
            parts[network] += ((copy_array(layer.weight.T), copy_array(layer.bias)),)
    if isinstance(model, DQN):
        parts["exploration"] = run.exploration
    elif hasattr(model.policy, "log_std"):
        action_space = model.env.slots.action_space  # not the learner's, which is flat and of float32
        parts["deviation"] = np.exp(copy_array(model.policy.log_std))
        parts["bounds"] = np.stack([action_space.low, action_space.high])
    elif isinstance(model.action_space, spaces.MultiDiscrete):
        parts["choices"] = choice_counts(model.env.slots.action_space)
    return Policy(run.activation, **parts)
