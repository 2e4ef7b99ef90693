"""The reference engine: learners of Stable-Baselines3 as they are, one run after the other.

A learner collects and trains by its own methods. Pneuma sets it up from the run (`sb3_learners.py`),
listens (`sb3_listening.py`) and evaluates between updates. An update of a learner from rollouts is one
rollout and what is learned from it; of DQN, as many steps with the gradients between them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from typing import Any

import numpy as np
import torch
from stable_baselines3 import DQN
from stable_baselines3.common.callbacks import BaseCallback, CallbackList
from stable_baselines3.common.vec_env import VecEnv

from pneuma.config import Run, env_config, stream_seed
from pneuma.engines.base import OnUpdate, Result
from pneuma.engines.checkpoint import Checkpoint
from pneuma.engines.evaluation import Evaluation
from pneuma.engines.loop import begins_fork, train_run
from pneuma.engines.policy import Policy, overflows
from pneuma.engines.records import Records, Row
from pneuma.engines.sb3_learners import (
    Learner,
    critic_names,
    make_model,
    restore_checkpoint,
    seed_streams,
    take_checkpoint,
)
from pneuma.engines.sb3_listening import (
    LOSSES,
    NAN,
    VISITED_METRICS,
    GradientNorms,
    Visited,
    extract_policy,
    finished_episodes,
    gradient_norms,
    is_finite,
    logged_losses,
    rollout_metrics,
    visited_metrics,
)
from pneuma.env.sb3 import PneumaVecEnv

__all__ = [
    "GradientNorms",
    "begin_fork",
    "extract_policy",
    "gradient_norms",
    "learn_from_rollout",
    "make_env",
    "make_model",
    "train",
    "train_one",
]


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
    """Train one run; see `pneuma.engines.loop`.

    `env` stands in for the run's own environment in benchmarks; then nothing is evaluated.
    """
    model = make_model(run, env or make_env(run))
    with gradient_norms(model, run) as norms:
        return train_run(run, Sb3Trainer(model, run, norms), on_update, checkpoint, evaluated=env is None)


class Sb3Trainer:
    """Trains one run by a learner of Stable-Baselines3; see `pneuma.engines.loop.Trainer`.

    Args:
        model: the learner, set up for the run.
        run: the run.
        norms: takes the norms of its gradients.
    """

    def __init__(self, model: Any, run: Run, norms: GradientNorms) -> None:
        self.run = run
        self._model, self._norms = model, norms
        self._visited = Visited() if isinstance(model, DQN) else None
        _, self._callback = model._setup_learn(run.steps, callback=self._visited or CallbackList([]))
        self._policy = extract_policy(model, run)

    @cached_property
    def _evaluation(self) -> Evaluation:
        return Evaluation(self.run)

    def restore(self, checkpoint: Checkpoint) -> None:
        """Go on from a checkpoint, or begin as the fork of a parent's."""
        if begins_fork(self.run, checkpoint):
            begin_fork(self._model, self.run, checkpoint)
        else:
            restore_checkpoint(self._model, checkpoint)
        self._policy = extract_policy(self._model, self.run)

    def update(self, before: int, after: int, records: Records) -> bool:
        """Let the learner collect and train."""
        model, run = self._model, self.run
        if self._visited:
            told = learn_by_values(model, run, self._visited)
        else:
            told = learn(model, run, self._policy, self._callback)
        records.metrics.append({"step": after, **told, **self._norms.take()})
        records.episodes.extend(finished_episodes(model.env))
        if not is_finite(records.metrics[-1], model):
            return False
        self._policy = extract_policy(model, run)
        return not overflows(self._policy, model._last_obs)

    def evaluate(self, step: int) -> Row:
        """Let the policy play where it was not trained."""
        return self._evaluation.evaluate(self._policy, step)

    def policy(self) -> Policy:
        """Return the policy after the last update."""
        return self._policy

    def checkpoint(self, step: int, records: Records) -> Checkpoint:
        """Copy networks, optimizer, worlds and random generators."""
        return take_checkpoint(self._model, step, records)


def learn(model: Any, run: Run, policy: Policy, callback: BaseCallback) -> dict[str, float]:
    """Let a learner collect a rollout, by `policy`, and train on it; return what it told of both.

    Where weights are huge, logits overflow, and torch refuses to draw: that is no crash but a run that
    diverged.
    """
    try:
        model.collect_rollouts(model.env, callback, model.rollout_buffer, run.horizon)
    except (ValueError, RuntimeError):
        if not overflows(policy, model._last_obs):
            raise
        return dict.fromkeys((*LOSSES, *VISITED_METRICS), NAN)
    rollout = rollout_metrics(model, policy)
    model._update_current_progress_remaining(model.num_timesteps, run.steps)
    return {**learn_from_rollout(model, run), **rollout}


def learn_from_rollout(model: Any, run: Run) -> dict[str, float]:
    """Let the learner train on the rollout it collected; return its log of that.

    Once a weight, the critic's too, or a logit is not a number, torch refuses the next minibatch; that run
    diverged, and its losses are then not numbers either.
    """
    try:
        with np.errstate(over="ignore", invalid="ignore"):  # it measures values that are about to overflow
            model.train()
    except (ValueError, RuntimeError):
        met = model.rollout_buffer.observations
        sound = all(bool(torch.isfinite(parameter).all()) for parameter in model.policy.parameters())
        if sound and not overflows(extract_policy(model, run), met.reshape(-1, met.shape[-1])):
            raise
        return dict.fromkeys(LOSSES, NAN)
    return logged_losses(model, run)


def learn_by_values(model: DQN, run: Run, visited: Visited) -> dict[str, float]:
    """Let DQN take a horizon's steps and gradients, as its `learn` does; return what it told of them."""
    assert model.env is not None and model.replay_buffer is not None and run.train_every
    policy, losses = extract_policy(model, run), []
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
            losses.append(logged_losses(model, run)["value_loss"])
    mean = sum(losses) / len(losses) if losses else NAN
    return {**dict.fromkeys(LOSSES, NAN), "value_loss": mean, **visited_metrics(policy, *visited.take())}


def begin_fork(model: Learner, run: Run, checkpoint: Checkpoint) -> None:
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
    model._last_obs = env.observe().copy()  # as this run sees it: its scale and order may be others
    seed_streams(model, run)


def make_env(run: Run) -> PneumaVecEnv:
    """Return the worlds of a run's slots, each with a random stream of its own."""
    env = PneumaVecEnv(world_seeds(run), env_config(run))
    env.keep_finished = True
    return env


def world_seeds(run: Run) -> list[int]:
    """Return the seeds of the worlds of a run's slots."""
    return [stream_seed(run.stream, "world", slot) for slot in range(run.slots)]
