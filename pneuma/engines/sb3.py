"""The reference engine: Stable-Baselines3's PPO as it is, one run after the other.

The learner collects and trains by its own methods. Pneuma sets it up from the run, listens (to
gradients before clipping, to rollouts, to the learner's own log) and evaluates between updates.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import CallbackList
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from pneuma.config import ACTION_NAMES, OPTIMIZER_SETTINGS, Run, env_config, stream_seed
from pneuma.engines.base import OnUpdate, Progress, Result, evaluation_updates
from pneuma.engines.checkpoint import Checkpoint
from pneuma.engines.evaluation import Evaluation
from pneuma.engines.policy import LEAKY_SLOPE, Policy, dead_share
from pneuma.engines.records import EPISODE_COLUMNS, Records
from pneuma.engines.sb3_state import critic_names, restore_checkpoint, take_checkpoint
from pneuma.env.sb3 import PneumaVecEnv

ACTIVATIONS: dict[str, Callable[[], nn.Module]] = {
    "tanh": nn.Tanh,
    "relu": nn.ReLU,
    "leaky-relu": lambda: nn.LeakyReLU(LEAKY_SLOPE),
}
OPTIMIZERS: dict[str, type[torch.optim.Optimizer]] = {
    "adam": torch.optim.Adam,
    "sgd": torch.optim.SGD,
    "rmsprop": torch.optim.RMSprop,
}
_LOGGED = {
    "policy_loss": (1, "policy_gradient_loss"),
    "value_loss": (1, "value_loss"),
    "entropy": (-1, "entropy_loss"),
    "approx_kl": (1, "approx_kl"),
    "clip_fraction": (1, "clip_fraction"),
    "explained_variance": (1, "explained_variance"),
}
"""Columns of the metrics, with sign and name in the learner's own log."""

_TORCH_NAMES = {"epsilon": "eps", "smoothing": "alpha"}


def train(
    runs: Sequence[Run], checkpoints: Mapping[int, Checkpoint], on_update: OnUpdate
) -> Iterator[Result]:
    """Train every run, one after the other; see `pneuma.engines.base`."""
    torch.set_num_threads(1)
    for index, run in enumerate(runs):
        yield train_one(run, on_update, checkpoints.get(index))


def train_one(
    run: Run, on_update: OnUpdate, checkpoint: Checkpoint | None = None, env: VecEnv | None = None
) -> Result:
    """Train one run, from its start or from a checkpoint.

    `env` stands in for the run's own environment in benchmarks; then nothing is evaluated.
    """
    model = make_model(run, env or make_env(run))
    with GradientNorms(model, run) as norms:
        evaluation = Evaluation(run) if env is None else None
        return _train_model(model, run, norms, on_update, checkpoint, evaluation)


def _train_model(
    model: PPO,
    run: Run,
    norms: GradientNorms,
    on_update: OnUpdate,
    checkpoint: Checkpoint | None,
    evaluation: Evaluation | None,
) -> Result:
    """Collect, learn, record and evaluate, update by update."""
    evaluated = evaluation_updates(run) if evaluation else set()
    records, step = Records(), 0
    _, callback = model._setup_learn(run.steps, callback=CallbackList([]))
    if checkpoint and run.parent and checkpoint.step == run.fork_step:
        begin_fork(model, run, checkpoint)
        step = checkpoint.step
    elif checkpoint:
        restore_checkpoint(model, checkpoint)
        records, step = checkpoint.records.copy(), checkpoint.step
    status, policy = "done", extract_policy(model, run)
    for update in range(step // run.steps_per_update + 1, run.updates + 1):
        step = update * run.steps_per_update
        model.collect_rollouts(model.env, callback, model.rollout_buffer, run.horizon)  # type: ignore[arg-type]
        rollout = rollout_metrics(model, policy)
        model._update_current_progress_remaining(model.num_timesteps, run.steps)
        losses = learn_from_rollout(model)
        records.metrics.append({"step": step, **losses, **norms.take(), **rollout})
        records.episodes.extend(finished_episodes(model.env))
        if not is_finite(records.metrics[-1], model):
            return Result(run, "diverged", step, records, None)
        policy = extract_policy(model, run)
        if evaluation and update in evaluated:
            records.evaluations.append(evaluation.evaluate(policy, step))
        if not on_update(Progress(run, step, records, partial(take_checkpoint, model, step, records))):
            status = "done" if update == run.updates else "stopped"
            break
    return Result(run, status, step, records, policy)


def learn_from_rollout(model: PPO) -> dict[str, float]:
    """Let the learner train on the rollout it collected; return its log of that.

    Once a weight is not a number, torch refuses the next minibatch; that is no crash but a run that
    diverged, whose losses are then not numbers either.
    """
    try:
        model.train()
    except (ValueError, RuntimeError):
        if all(bool(torch.isfinite(parameter).all()) for parameter in model.policy.parameters()):
            raise
        return dict.fromkeys(_LOGGED, float("nan"))
    log = model.logger.name_to_value
    return {name: sign * float(log[f"train/{theirs}"]) for name, (sign, theirs) in _LOGGED.items()}


def begin_fork(model: PPO, run: Run, checkpoint: Checkpoint) -> None:
    """Put a learner where its parent's checkpoint was taken, with random streams of its own from there on.

    What the run asks to reset is as it is at a run's start instead.

    Raises:
        CheckpointError: for settings that the checkpoint does not fit.
    """
    left_out = {"optimizer": ("optimizer/",), "critic": critic_names(model)}.get(run.fork_reset, ())
    restore_checkpoint(model, checkpoint, left_out)
    env = model.env
    assert isinstance(env, PneumaVecEnv)
    env.state.rekey(world_seeds(run))
    if run.fork_reset == "xp":
        env.state.players["xp"] = 0.0
    seed_streams(run)


def make_env(run: Run) -> PneumaVecEnv:
    """Return the worlds of a run's slots, each with a random stream of its own."""
    env = PneumaVecEnv(world_seeds(run), env_config(run))
    env.keep_finished = True
    return env


def world_seeds(run: Run) -> list[int]:
    """Return the seeds of the worlds of a run's slots."""
    return [stream_seed(run.stream, "world", slot) for slot in range(run.slots)]


def make_model(run: Run, env: VecEnv) -> PPO:
    """Set Stable-Baselines3's PPO up from a run's configuration.

    Each of torch's and NumPy's global generators serves one purpose from its own stream: torch the
    initial weights, then the actions; NumPy the order of minibatches.
    """
    torch.manual_seed(stream_seed(run.stream, "weights"))
    model = PPO(
        "MlpPolicy",
        env,
        learning_rate=run.learning_rate,
        n_steps=run.horizon,
        batch_size=run.minibatch,
        n_epochs=run.epochs,
        gamma=run.gamma,
        gae_lambda=run.gae_lambda,
        clip_range=run.clip_range,
        ent_coef=run.entropy_coefficient,
        vf_coef=run.value_coefficient,
        max_grad_norm=joint_limit(run),
        policy_kwargs={
            "net_arch": {"pi": list(run.actor), "vf": list(run.critic)},
            "activation_fn": ACTIVATIONS[run.activation],
            "optimizer_class": OPTIMIZERS[run.optimizer],
            "optimizer_kwargs": optimizer_arguments(run),
        },
        device="cpu",
    )
    model.set_logger(Logger(folder=None, output_formats=[]))
    seed_streams(run)
    return model


def seed_streams(run: Run) -> None:
    """Begin the streams of a run's actions and minibatches."""
    torch.manual_seed(stream_seed(run.stream, "actions"))
    np.random.seed(stream_seed(run.stream, "minibatches") % 2**32)


def joint_limit(run: Run) -> float:
    """Return the limit that Stable-Baselines3 itself applies, to one norm over all parameters."""
    return run.gradient_limit if run.gradient_limit is not None and run.clip == "joint" else float("inf")


def optimizer_arguments(run: Run) -> dict[str, Any]:
    """Return the keyword arguments of the run's torch optimizer, all stated.

    Stable-Baselines3 uses epsilon 1e-5 only when given none, torch's own 1e-8 otherwise.
    """
    names = OPTIMIZER_SETTINGS[run.optimizer]
    own = {_TORCH_NAMES.get(name, name): getattr(run, name) for name in names}
    return {**own, "weight_decay": run.weight_decay}


class GradientNorms:
    """Measures every minibatch's gradient norms before clipping, and clips parts separately if asked.

    Listens by torch's own hooks; the learner's code and arithmetic stay as they are.
    """

    def __init__(self, model: PPO, run: Run) -> None:
        named = list(model.policy.named_parameters())
        self._parameters = [parameter for _, parameter in named]
        self._is_actor = torch.tensor(["policy_net" in name or "action_net" in name for name, _ in named])
        self._norms: list[torch.Tensor] = []
        self._limit = run.gradient_limit if run.clip == "separate" else None
        self._hooks = (
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
        """Return the mean norms over the minibatches since the last call, and forget them."""
        squares = torch.stack(self._norms).double() ** 2  # (minibatches, parameters)
        self._norms.clear()
        actor, critic = squares[:, self._is_actor].sum(1), squares[:, ~self._is_actor].sum(1)
        parts = {"grad_norm": actor + critic, "grad_norm_actor": actor, "grad_norm_critic": critic}
        return {name: float(square.sqrt().mean()) for name, square in parts.items()}


def extract_policy(model: PPO, run: Run) -> Policy:
    """Copy the learner's actor and critic into a `Policy`."""

    def layers(hidden: nn.Module, head: nn.Module) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        linear = [layer for layer in (*hidden.children(), head) if isinstance(layer, nn.Linear)]
        # torch keeps (outputs, inputs)
        return tuple((a.weight.detach().numpy().T.copy(), a.bias.detach().numpy().copy()) for a in linear)

    policy = model.policy
    return Policy(
        run.activation,
        layers(policy.mlp_extractor.policy_net, policy.action_net),
        layers(policy.mlp_extractor.value_net, policy.value_net),
    )


def rollout_metrics(model: PPO, policy: Policy) -> dict[str, float]:
    """Measure the rollout just collected: dead units of the policy that collected it, action shares."""
    buffer = model.rollout_buffer
    taken = buffer.actions.astype(np.int64).ravel()
    shares = np.bincount(taken, minlength=len(ACTION_NAMES)) / taken.size
    observations = buffer.observations.reshape(-1, buffer.observations.shape[-1])
    return {
        "dead_units": dead_share(policy, observations),
        **{f"action_{i}": float(share) for i, share in enumerate(shares)},
    }


def finished_episodes(env: VecEnv | None) -> list[dict[str, Any]]:
    """Take the episodes that ended since the last call."""
    finished: list[dict[str, Any]] = getattr(env, "finished", [])
    rows = [{name: episode[name] for name in EPISODE_COLUMNS} for episode in finished]
    finished.clear()
    return rows


def is_finite(metrics: Mapping[str, float], model: PPO) -> bool:
    """Tell whether losses, gradient norms and every parameter are finite.

    The explained variance is left out: it is undefined where all returns are equal.
    """
    watched = ("policy_loss", "value_loss", "entropy", "grad_norm")
    with torch.no_grad():
        total = sum(float(parameter.abs().sum()) for parameter in model.policy.parameters())
    return bool(np.isfinite([*(metrics[name] for name in watched), total]).all())
