"""What Pneuma hears of a learner of Stable-Baselines3's without touching its arithmetic.

Gradients before clipping, the learner's own log, the rollouts it collected, its networks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from sb3_contrib import TRPO
from stable_baselines3 import DQN
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from pneuma.algorithms import VALUE_BASED
from pneuma.config import ACTION_NAMES, Run
from pneuma.engines.policy import Policy, dead_share
from pneuma.engines.records import EPISODE_COLUMNS
from pneuma.engines.sb3_learners import Learner

NAN = float("nan")

LOGGED: dict[str, dict[str, tuple[int, str]]] = {
    "ppo": {
        "policy_loss": (1, "policy_gradient_loss"),
        "value_loss": (1, "value_loss"),
        "entropy": (-1, "entropy_loss"),
        "approx_kl": (1, "approx_kl"),
        "clip_fraction": (1, "clip_fraction"),
        "explained_variance": (1, "explained_variance"),
    },
    "a2c": {
        "policy_loss": (1, "policy_loss"),
        "value_loss": (1, "value_loss"),
        "entropy": (-1, "entropy_loss"),
        "explained_variance": (1, "explained_variance"),
    },
    "trpo": {
        "policy_loss": (-1, "policy_objective"),
        "value_loss": (1, "value_loss"),
        "approx_kl": (1, "kl_divergence_loss"),
        "explained_variance": (1, "explained_variance"),
    },
    "dqn": {"value_loss": (1, "loss")},
    "double-dqn": {"value_loss": (1, "loss")},
}
"""Columns of the metrics that each learner logs, with sign and name there; it has no others of `LOSSES`."""

LOSSES = tuple(LOGGED["ppo"])
NORMS = ("grad_norm", "grad_norm_actor", "grad_norm_critic")
VISITED_METRICS = ("dead_units", *(f"action_{i}" for i in range(len(ACTION_NAMES))))
"""Columns of the metrics that tell what a policy met and did."""


# --- Gradients -------------------------------------------------------------------------------------


class GradientNorms:
    """Measures every minibatch's gradient norms before clipping, and clips parts separately if asked.

    Listens by torch's own hooks; the learner's code and arithmetic stay as they are.
    """

    def __init__(self, model: Learner, run: Run) -> None:
        named = [(name, own) for name, own in model.policy.named_parameters() if "q_net_target" not in name]
        self._parameters = [parameter for _, parameter in named]
        self._is_actor = torch.tensor(["policy_net" in name or "action_net" in name for name, _ in named])
        self._in_parts = run.algorithm not in VALUE_BASED
        self._norms: list[torch.Tensor] = []
        self._limit = run.gradient_limit if run.clip == "separate" else None
        self._hooks = self._listen(model)

    def _listen(self, model: Learner) -> tuple[Any, ...]:
        return (
            model.policy.optimizer.register_step_pre_hook(self._clip_parts),
            torch.autograd.graph.register_multi_grad_hook(self._parameters, self._measure),
        )

    def __enter__(self) -> GradientNorms:
        """Listen until the end of a `with` block."""
        return self

    def __exit__(self, *_: object) -> None:
        """Stop listening: a hook keeps its network in memory."""
        for hook in self._hooks:
            hook.remove()

    def _measure(self, gradients: Sequence[torch.Tensor | None]) -> None:
        present = [g for g in gradients if g is not None]
        self._norms.append(torch.stack(torch._foreach_norm(present)))

    def _clip_parts(self, *_: Any) -> None:
        if self._limit is None:
            return
        for actor in (True, False):
            part = [p for p, own in zip(self._parameters, self._is_actor, strict=True) if own == actor]
            nn.utils.clip_grad_norm_(part, self._limit)

    def take(self) -> dict[str, float]:
        """Return the mean norms over the minibatches since the last call, and forget them.

        A network of action values has neither actor nor critic; before its first gradient there is no norm.
        """
        if not self._norms:
            return dict.fromkeys(NORMS, NAN)
        squares = torch.stack(self._norms).double() ** 2  # (minibatches, parameters)
        self._norms.clear()
        actor, critic = squares[:, self._is_actor].sum(1), squares[:, ~self._is_actor].sum(1)
        parts = {"grad_norm": actor + critic, "grad_norm_actor": actor, "grad_norm_critic": critic}
        told = {name: float(square.sqrt().mean()) for name, square in parts.items()}
        return told if self._in_parts else {**dict.fromkeys(NORMS, NAN), "grad_norm": told["grad_norm"]}


class TrustRegionNorms(GradientNorms):
    """Measures TRPO's: of its objective's gradient for the actor, of every minibatch's for the critic.

    There is no joint gradient; `grad_norm` is the norm of the two side by side. Nothing is clipped.
    """

    def _listen(self, model: Learner) -> tuple[Any, ...]:
        assert isinstance(model, TRPO)
        self._objective = NAN
        compute = model._compute_actor_grad

        def heard(*arguments: Any) -> Any:
            parameters, gradient, *rest = compute(*arguments)
            self._objective = float(gradient.detach().norm())
            return parameters, gradient, *rest

        model._compute_actor_grad = heard  # type: ignore[method-assign, assignment]
        return (model.policy.optimizer.register_step_pre_hook(self._measure_critic),)

    def _measure_critic(self, *_: Any) -> None:
        critic = [p for p, actor in zip(self._parameters, self._is_actor, strict=True) if not actor]
        self._norms.append(torch.stack([p.grad.norm() for p in critic if p.grad is not None]).norm())

    def take(self) -> dict[str, float]:
        """Return the norms since the last call, and forget them."""
        critic = float(torch.stack(self._norms).double().mean()) if self._norms else NAN
        self._norms.clear()
        actor, self._objective = self._objective, NAN
        return {
            "grad_norm": float(np.hypot(actor, critic)),
            "grad_norm_actor": actor,
            "grad_norm_critic": critic,
        }


def gradient_norms(model: Learner, run: Run) -> GradientNorms:
    """Return what listens to the gradients of a run's learner."""
    return TrustRegionNorms(model, run) if isinstance(model, TRPO) else GradientNorms(model, run)


# --- Rollouts --------------------------------------------------------------------------------------


class Visited(BaseCallback):
    """Keeps what a learner without rollouts saw and did since someone last took it."""

    def __init__(self) -> None:
        super().__init__()
        self._seen: list[tuple[np.ndarray, np.ndarray]] = []

    def _on_step(self) -> bool:
        self._seen.append((np.array(self.model._last_obs), np.array(self.locals["actions"])))
        return True

    def take(self) -> tuple[np.ndarray, np.ndarray]:
        """Return observations (N, features) and actions (N,), and forget them."""
        observations, actions = zip(*self._seen, strict=True)
        self._seen.clear()
        return np.concatenate(observations), np.concatenate(actions)


def logged_losses(model: Learner, run: Run) -> dict[str, float]:
    """Return what a learner logged of its last training, NaN for what it has none of."""
    log = model.logger.name_to_value
    told = LOGGED[run.algorithm].items()
    return {
        **dict.fromkeys(LOSSES, NAN),
        **{name: sign * float(log[f"train/{theirs}"]) for name, (sign, theirs) in told},
    }


def visited_metrics(policy: Policy, observations: np.ndarray, actions: np.ndarray) -> dict[str, float]:
    """Measure what a policy met and did: dead units over (N, features), shares of the actions (N,)."""
    shares = np.bincount(actions.astype(np.int64).ravel(), minlength=len(ACTION_NAMES)) / actions.size
    return {
        "dead_units": dead_share(policy, observations),
        **{f"action_{i}": float(share) for i, share in enumerate(shares)},
    }


def rollout_metrics(model: Any, policy: Policy) -> dict[str, float]:
    """Measure the rollout just collected: dead units of the policy that collected it, action shares.

    TRPO logs no entropy; it is that of the policy that collected.
    """
    buffer = model.rollout_buffer
    observations = buffer.observations.reshape(-1, buffer.observations.shape[-1])
    told = visited_metrics(policy, observations, buffer.actions)
    return {**told, "entropy": policy.entropy(observations)} if isinstance(model, TRPO) else told


def finished_episodes(env: VecEnv | None) -> list[dict[str, Any]]:
    """Take the episodes that ended since the last call."""
    finished: list[dict[str, Any]] = getattr(env, "finished", [])
    rows = [{name: episode[name] for name in EPISODE_COLUMNS} for episode in finished]
    finished.clear()
    return rows


# --- Networks --------------------------------------------------------------------------------------


def extract_policy(model: Any, run: Run) -> Policy:
    """Copy the learner's networks into a `Policy`; a network of action values is its actor."""
    policy = model.policy
    if isinstance(model, DQN):
        return Policy(run.activation, _layers(policy.q_net.q_net), (), run.exploration)
    nets = policy.mlp_extractor
    return Policy(
        run.activation,
        _layers(nets.policy_net, policy.action_net),
        _layers(nets.value_net, policy.value_net),
    )


def _layers(hidden: nn.Module, *head: nn.Module) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    linear = [layer for layer in (*hidden.children(), *head) if isinstance(layer, nn.Linear)]
    # torch keeps (outputs, inputs)
    return tuple((a.weight.detach().numpy().T.copy(), a.bias.detach().numpy().copy()) for a in linear)


def is_finite(metrics: Mapping[str, float], model: Learner) -> bool:
    """Tell whether losses, gradient norms and every parameter are finite.

    The explained variance is left out: it is undefined where all returns are equal. So are losses that
    a learner has none of, or none before its first gradient.
    """
    watched = ["policy_loss", "value_loss", "entropy", "grad_norm"]
    if isinstance(model, DQN):
        watched = ["value_loss", "grad_norm"] if model._n_updates else []
    with torch.no_grad():
        total = sum(float(parameter.abs().sum()) for parameter in model.policy.parameters())
    return bool(np.isfinite([*(metrics[name] for name in watched), total]).all())
