"""The reference engine: Stable-Baselines3's learners, unchanged.

A learner collects and trains by its own methods. Pneuma sets it up from the run (`sb3_learners.py`), reads
its gradients and log without changing its arithmetic, and evaluates between updates. An update is one rollout
and the training on it; for DQN it is as many steps with the gradient steps between them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from sb3_contrib import TRPO
from stable_baselines3 import DQN
from torch import nn

from pneuma.config import Run
from pneuma.engines.environment import make_vec_env
from pneuma.engines.gymnasium_env import choices_of
from pneuma.engines.loop import ResumableTrainer
from pneuma.engines.policy import Layers, Policy, dead_share, overflows
from pneuma.engines.records import Checkpoint, Records, action_shares, metrics_row
from pneuma.engines.sb3_learners import (
    Episodes,
    Learner,
    has_finite_weights,
    learn,
    linear_layers,
    logged_losses,
    make_model,
    prepare,
    restore_checkpoint,
    take_checkpoint,
)


class Sb3Trainer(ResumableTrainer):
    def __init__(self, run: Run) -> None:
        super().__init__(run)
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
        """Let the learner collect and train, by values once every few steps.

        If a weight or logit is not a number, torch refuses to draw actions, or the next minibatch. Such a
        run has diverged, not crashed, and has no losses.
        """
        model, run = self._model, self.run
        self._visited.forget()
        metrics: dict[str, float] = {}
        with GradientNorms(model, run) as gradient_norms:
            try:
                with np.errstate(over="ignore", invalid="ignore"):  # values may overflow here
                    metrics |= self._learn()
            except (ValueError, RuntimeError):
                if not self._has_diverged():
                    raise
        if len(self._visited.actions) == run.horizon:
            metrics |= self._visited_metrics()
        records.metrics.append(metrics_row(after, metrics | gradient_norms.means()))
        records.episodes.extend(self._visited.take_rows())
        if not is_finite(records.metrics[-1], model):
            return False
        self._policy = extract_policy(model, run)
        return not overflows(self._policy, model._last_obs)

    def _learn(self) -> dict[str, float]:
        """Train for an update's steps; return what the learner logged, of several times the mean loss."""
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
        if policy.deviation is None and policy.choices is None:
            metrics |= action_shares(self.run, actions, policy.actions)
        if isinstance(self._model, TRPO):  # which logs no entropy
            metrics["entropy"] = policy.entropy(observations)
        return metrics

    def policy(self) -> Policy:
        return replace(self._policy, scaling=self._model.env.slots.scaling)

    def checkpoint(self, step: int, records: Records) -> Checkpoint:
        return take_checkpoint(self._model, step, records)


class Visited(Episodes):
    """Collects also the observations and actions of each step of an update: (S, features) and (S, …)."""

    def forget(self) -> None:
        self.observations: list[np.ndarray] = []
        self.actions: list[np.ndarray] = []

    def _on_step(self) -> bool:
        self.observations.append(np.asarray(self.model._last_obs))
        self.actions.append(self.locals["actions"])
        return super()._on_step()


# --- Gradients -------------------------------------------------------------------------------------


ACTOR_PARAMETERS = ("policy_net", "action_net", "log_std")
"""What is in the names of an actor's parameters."""


class GradientNorms:
    """Measures the gradient norms of an update's minibatches before clipping; clips parts apart if asked.

    It uses torch's hooks, so that the learner's code and arithmetic are unchanged. TRPO is left out, because
    its actor takes no gradient steps.
    """

    def __init__(self, model: Learner, run: Run) -> None:
        self._parameters = []
        is_actor = []
        for parameter_name, parameter in model.policy.named_parameters():
            if "q_net_target" not in parameter_name:
                self._parameters.append(parameter)
                is_actor.append(any(layer in parameter_name for layer in ACTOR_PARAMETERS))
        self._is_actor = torch.tensor(is_actor)
        self._norms: list[torch.Tensor] = []
        self._limit = run.gradient_limit if run.clip == "separate" else None
        self._optimizer = None if isinstance(model, TRPO) else model.policy.optimizer
        self._hooks: tuple[Any, ...] = ()

    def __enter__(self) -> GradientNorms:
        if self._optimizer is not None:
            self._hooks = (
                self._optimizer.register_step_pre_hook(self._clip_parts),
                torch.autograd.graph.register_multi_grad_hook(self._parameters, self._measure),
            )
        return self

    def __exit__(self, *_: object) -> None:
        """Remove the hooks, which would keep the network in memory."""
        for hook in self._hooks:
            hook.remove()

    def _measure(self, gradients: Sequence[torch.Tensor | None]) -> None:
        present = [gradient for gradient in gradients if gradient is not None]
        self._norms.append(torch.stack(torch._foreach_norm(present)))

    def _clip_parts(self, *_: Any) -> None:
        if self._limit is None:
            return
        actor_parameters: list[nn.Parameter] = []
        critic_parameters: list[nn.Parameter] = []
        for parameter, is_actor in zip(self._parameters, self._is_actor, strict=True):
            (actor_parameters if is_actor else critic_parameters).append(parameter)
        nn.utils.clip_grad_norm_(actor_parameters, self._limit)
        nn.utils.clip_grad_norm_(critic_parameters, self._limit)

    def means(self) -> dict[str, float]:
        """Return the mean norms over the update's minibatches.

        A network of action values has no actor and critic. Before the first gradient there is no norm.
        """
        if not self._norms:
            return {}
        squares = torch.stack(self._norms).double() ** 2  # (minibatches, parameters)
        actor_squares, critic_squares = squares[:, self._is_actor].sum(1), squares[:, ~self._is_actor].sum(1)
        squares_by_norm = {"grad_norm": actor_squares + critic_squares}
        if self._is_actor.any():
            squares_by_norm |= {"grad_norm_actor": actor_squares, "grad_norm_critic": critic_squares}
        return {name: float(square.sqrt().mean()) for name, square in squares_by_norm.items()}


# --- Networks --------------------------------------------------------------------------------------


def extract_policy(model: Any, run: Run) -> Policy:
    """Copy the learner's networks into a `Policy`; a network of action values is its actor."""
    networks: dict[str, Layers] = {"actor": (), "critic": ()}
    for network, modules in linear_layers(model).items():
        for layer in modules:
            weight, bias = layer.weight.detach().numpy(), layer.bias.detach().numpy()
            networks[network] += ((weight.T.copy(), bias.copy()),)  # torch keeps (outputs, inputs)
    of_actions: dict[str, Any] = {}
    if isinstance(model, DQN):
        of_actions = {"exploration": run.exploration}
    elif hasattr(model.policy, "log_std"):
        action_space = model.env.slots.action_space  # not the learner's, which is flat and of float32
        bounds = np.stack([action_space.low, action_space.high])
        of_actions = {"deviation": np.exp(model.policy.log_std.detach().numpy()), "bounds": bounds}
    elif isinstance(model.action_space, spaces.MultiDiscrete):
        of_actions = {"choices": choices_of(model.env.slots.action_space)}
    return Policy(run.activation, networks["actor"], networks["critic"], **of_actions)


def is_finite(metrics: Mapping[str, float], model: Learner) -> bool:
    """Return whether losses, gradient norms and all parameters are finite.

    The explained variance is left out, because it is undefined if all returns are equal, and so are losses
    that the learner does not have, or not before its first gradient.
    """
    watched_metrics = ["policy_loss", "value_loss", "entropy", "grad_norm"]
    if isinstance(model, DQN):
        watched_metrics = ["value_loss", "grad_norm"] if model._n_updates else []
    if isinstance(model, TRPO):
        watched_metrics.remove("grad_norm")
    watched_values = [metrics[metric] for metric in watched_metrics]
    return bool(np.isfinite(watched_values).all()) and has_finite_weights(model)
