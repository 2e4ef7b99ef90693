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
from stable_baselines3.common.callbacks import BaseCallback, CallbackList
from torch import nn

from pneuma.config import Run
from pneuma.engines.environment import make_vec_env
from pneuma.engines.gymnasium_env import choices_of
from pneuma.engines.loop import ResumableTrainer
from pneuma.engines.policy import Layers, Policy, dead_share, overflows
from pneuma.engines.records import EPISODE_COLUMNS, NAN, Checkpoint, Records, action_shares, metrics_row
from pneuma.engines.sb3_learners import (
    Learner,
    has_finite_weights,
    linear_layers,
    logged_losses,
    make_model,
    restore_checkpoint,
    take_checkpoint,
)


class Sb3Trainer(ResumableTrainer):
    def __init__(self, run: Run) -> None:
        super().__init__(run)
        torch.set_num_threads(1)
        self._model: Any = make_model(run, make_vec_env(run))
        self._visited = Visited() if isinstance(self._model, DQN) else None
        callback = self._visited or CallbackList([])
        _, self._callback = self._model._setup_learn(run.steps, callback=callback)
        self._policy = extract_policy(self._model, run)

    def restore(self, checkpoint: Checkpoint) -> None:
        restore_checkpoint(self._model, checkpoint)
        self._policy = extract_policy(self._model, self.run)

    def update(self, before: int, after: int, records: Records) -> bool:
        model, run = self._model, self.run
        with GradientNorms(model, run) as norms:
            if self._visited:
                metrics = learn_by_values(model, run, self._visited)
            else:
                metrics = learn(model, run, self._policy, self._callback)
        records.metrics.append(metrics_row(after, {**metrics, **norms.means()}))
        for episode in model.env.finished:
            records.episodes.append({name: episode[name] for name in EPISODE_COLUMNS})
        model.env.finished.clear()
        if not is_finite(records.metrics[-1], model):
            return False
        self._policy = extract_policy(model, run)
        return not overflows(self._policy, model._last_obs)

    def policy(self) -> Policy:
        return replace(self._policy, scaling=getattr(self._model.env, "scaling", None))

    def checkpoint(self, step: int, records: Records) -> Checkpoint:
        return take_checkpoint(self._model, step, records)


def learn(model: Any, run: Run, policy: Policy, callback: BaseCallback) -> dict[str, float]:
    """Let a learner collect a rollout and train on it; return the metrics of both.

    If weights are huge, logits overflow, and torch refuses to draw actions. Such a run has diverged, not
    crashed, and has no metrics.
    """
    try:
        model.collect_rollouts(model.env, callback, model.rollout_buffer, run.horizon)
    except (ValueError, RuntimeError):
        if not overflows(policy, model._last_obs):
            raise
        return {}
    observations = rollout_observations(model)
    metrics = visited_metrics(run, policy, observations, model.rollout_buffer.actions)
    if isinstance(model, TRPO):  # which logs no entropy
        metrics["entropy"] = policy.entropy(observations)
    model._update_current_progress_remaining(model.num_timesteps, run.steps)
    return {**learn_from_rollout(model, run), **metrics}


def rollout_observations(model: Any) -> np.ndarray:
    """Return the observations of a learner's rollout, (N, features)."""
    observations: np.ndarray = model.rollout_buffer.observations
    return observations.reshape(-1, observations.shape[-1])


def learn_from_rollout(model: Any, run: Run) -> dict[str, float]:
    """Let the learner train on its rollout; return what it logged.

    If a weight or logit is not a number, torch refuses the next minibatch. Such a run has diverged, and has
    no losses.
    """
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # values may overflow here
            model.train()
    except (ValueError, RuntimeError):
        has_diverged = not has_finite_weights(model)
        if not has_diverged and not overflows(extract_policy(model, run), rollout_observations(model)):
            raise
        return {}
    return logged_losses(model)


def learn_by_values(model: DQN, run: Run, visited: Visited) -> dict[str, float]:
    """Let DQN take one horizon of steps and gradients, as its `learn` does; return its metrics."""
    assert model.env is not None and model.replay_buffer is not None and run.train_every
    policy = extract_policy(model, run)
    losses = []
    for _ in range(run.horizon // run.train_every):
        model.collect_rollouts(
            model.env,
            visited,
            model.train_freq,  # type: ignore[arg-type]
            model.replay_buffer,
            learning_starts=model.learning_starts,
        )
        if model.num_timesteps > model.learning_starts:
            model.train(batch_size=model.batch_size, gradient_steps=model.gradient_steps)
            losses.append(logged_losses(model)["value_loss"])
    mean_loss = NAN
    if losses:
        mean_loss = float(np.mean(losses))  # `sum` rounds differently from Python 3.12 on
    observations, actions = visited.take()
    return {"value_loss": mean_loss, **visited_metrics(run, policy, observations, actions)}


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
        for name, parameter in model.policy.named_parameters():
            if "q_net_target" not in name:
                self._parameters.append(parameter)
                is_actor.append(any(layer in name for layer in ACTOR_PARAMETERS))
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
        actor: list[nn.Parameter] = []
        critic: list[nn.Parameter] = []
        for parameter, is_actor in zip(self._parameters, self._is_actor, strict=True):
            (actor if is_actor else critic).append(parameter)
        nn.utils.clip_grad_norm_(actor, self._limit)
        nn.utils.clip_grad_norm_(critic, self._limit)

    def means(self) -> dict[str, float]:
        """Return the mean norms over the update's minibatches.

        A network of action values has no actor and critic. Before the first gradient there is no norm.
        """
        if not self._norms:
            return {}
        squares = torch.stack(self._norms).double() ** 2  # (minibatches, parameters)
        actor, critic = squares[:, self._is_actor].sum(1), squares[:, ~self._is_actor].sum(1)
        norms = {"grad_norm": actor + critic}
        if self._is_actor.any():
            norms |= {"grad_norm_actor": actor, "grad_norm_critic": critic}
        return {name: float(square.sqrt().mean()) for name, square in norms.items()}


# --- Rollouts --------------------------------------------------------------------------------------


class Visited(BaseCallback):
    """Records the observations and actions of a learner without rollouts."""

    def __init__(self) -> None:
        super().__init__()
        self._observations: list[np.ndarray] = []
        self._actions: list[np.ndarray] = []

    def _on_step(self) -> bool:
        self._observations.append(np.array(self.model._last_obs))
        self._actions.append(np.array(self.locals["actions"]))
        return True

    def take(self) -> tuple[np.ndarray, np.ndarray]:
        """Return and forget observations (N, features) and actions (N,)."""
        observations, actions = np.concatenate(self._observations), np.concatenate(self._actions)
        self._observations.clear()
        self._actions.clear()
        return observations, actions


def visited_metrics(
    run: Run, policy: Policy, observations: np.ndarray, actions: np.ndarray
) -> dict[str, float]:
    """Return dead units over (N, features) observations and the shares of (N,) actions."""
    is_one_choice = policy.deviation is None and policy.choices is None
    actions = actions.astype(np.int64 if is_one_choice else np.float32)
    return {"dead_units": dead_share(policy, observations), **action_shares(run, actions, policy.actions)}


# --- Networks --------------------------------------------------------------------------------------


def extract_policy(model: Any, run: Run) -> Policy:
    """Copy the learner's networks into a `Policy`; a network of action values is its actor."""
    networks: dict[str, Layers] = {"actor": (), "critic": ()}
    for name, modules in linear_layers(model).items():
        for layer in modules:
            weight, bias = layer.weight.detach().numpy(), layer.bias.detach().numpy()
            networks[name] += ((weight.T.copy(), bias.copy()),)  # torch keeps (outputs, inputs)
    of_actions: dict[str, Any] = {}
    if isinstance(model, DQN):
        of_actions = {"exploration": run.exploration}
    elif hasattr(model.policy, "log_std"):
        space = model.env.slots.action_space  # not the learner's, which is flat and of float32
        bounds = np.stack([space.low, space.high])
        of_actions = {"deviation": np.exp(model.policy.log_std.detach().numpy()), "bounds": bounds}
    elif isinstance(model.action_space, spaces.MultiDiscrete):
        of_actions = {"choices": choices_of(model.env.slots.action_space)}
    return Policy(run.activation, networks["actor"], networks["critic"], **of_actions)


def is_finite(metrics: Mapping[str, float], model: Learner) -> bool:
    """Return whether losses, gradient norms and all parameters are finite.

    The explained variance is left out, because it is undefined if all returns are equal, and so are losses
    that the learner does not have, or not before its first gradient.
    """
    watched = ["policy_loss", "value_loss", "entropy", "grad_norm"]
    if isinstance(model, DQN):
        watched = ["value_loss", "grad_norm"] if model._n_updates else []
    if isinstance(model, TRPO):
        watched.remove("grad_norm")
    values = [metrics[name] for name in watched]
    return bool(np.isfinite(values).all()) and has_finite_weights(model)
