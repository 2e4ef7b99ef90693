"""Any learner of Stable-Baselines3's kind, trained as a user's own script would train it.

    run → Gymnasium's environments, learner → its own `learn`, an update at a time → records

Observations are not flattened, so that a policy may see pictures. Neither the replay buffer nor the state of
environments is stored, so that a run cannot be resumed. The policy is stored as the library saves it, in a
.zip, and read without unpickling: a learner is made from the run's fields and loads the parameters.
"""

from __future__ import annotations

import io
import json
import math
import re
import warnings
from inspect import signature
from typing import Any
from zipfile import ZipFile

import numpy as np
import torch
from safetensors.numpy import load, save
from sb3_contrib import MaskablePPO
from sb3_contrib.common.maskable.evaluation import evaluate_policy as masked_evaluation
from sb3_contrib.common.maskable.utils import get_action_masks, is_masking_supported
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.on_policy_algorithm import OnPolicyAlgorithm
from stable_baselines3.common.running_mean_std import RunningMeanStd
from stable_baselines3.common.type_aliases import TrainFrequencyUnit
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecNormalize

from pneuma.algorithms import find_algorithm, has_rollouts, is_masked
from pneuma.config import CPU, LIBRARY, Run, slot_seeds, stream_seed
from pneuma.engines.device import check_device
from pneuma.engines.gymnasium_env import (
    check_observations,
    check_others,
    closed_after,
    errors_from,
    load_class,
    make_env,
)
from pneuma.engines.loop import Trainer
from pneuma.engines.policy import LEARNER_FILE
from pneuma.engines.records import Records, Row, evaluation_row, metrics_row
from pneuma.engines.sb3_arguments import find_class, read_arguments
from pneuma.engines.sb3_learners import (
    LEARNERS,
    Episodes,
    PartwiseCallbacks,
    field_arguments,
    has_finite_weights,
    learn,
    learner_arguments,
    logged_losses,
    prepare,
)
from pneuma.engines.stopping import IsStopping, check_length, check_stop, never
from pneuma.errors import UserError
from pneuma.sb3_names import CALLBACK

IN_POLICY_KWARGS = {
    "net_arch": "actor and critic",
    "optimizer_class": "optimizer",
    "optimizer_kwargs": "betas",
}
"""Parts of `policy_kwargs` that are set by fields of PPO."""
RESERVED = {
    "policy": "the field policy is for that",
    "env": "the field env is for that",
    "seed": "it follows from the run's seed",
    "device": "runs are trained on the CPU",
    "tensorboard_log": "an option of the command that trains is for that",
    "_init_setup_model": "learners are always set up",
}
"""Arguments of all learners that no run may set, and why."""
STATISTICS = "observations.safetensors"
"""File in a learner's .zip: mean and variance of observations, by key. Stable-Baselines3 ignores it."""

HOOKS = ("_setup_learn", "_update_current_progress_remaining")
"""Attributes that `prepare` sets. They hold the learner with its replay buffer."""


# --- Making a learner ------------------------------------------------------------------------------


def check_learner(run: Run) -> None:
    """Make a run's environments and learner once, take a step, and refuse what cannot be trained."""
    for argument, reason in RESERVED.items():
        if argument in _algorithm_kwargs(run):
            raise UserError(f"algorithm_kwargs: {argument} is not allowed: {reason}")
    if run.algorithm == "ppo":
        _check_arguments(run)
    with closed_after(run, make_env(run)) as env:
        check_observations(run, env.observation_space)
        check_others(run)
    with (
        warnings.catch_warnings(action="ignore"),  # the run itself warns
        closed_after(run, _environments(run, run.slots)) as environments,
    ):
        first_action = getattr(environments.action_space, "start", 0)
        if np.any(first_action):  # these learners act from 0 on in any space
            problem = f"its actions count from {first_action}, which {run.algorithm} cannot handle"
            raise UserError(f"{run.env}: {problem}: wrap it to count from 0")
        learner = _make_learner(run, environments)
        own_callbacks(run)
        with errors_from(f"{run.env} in its first step"):
            observations = environments.reset()
            actions = np.array([environments.action_space.sample() for _ in range(run.slots)])
            if is_masked(run.algorithm):
                actions, _ = learner.predict(observations, action_masks=get_action_masks(environments))
            environments.step(actions)
    pace = _pace(learner)
    if isinstance(learner, OnPolicyAlgorithm) and run.horizon != pace:
        remedy = f"set horizon = {pace}, or n_steps = {run.horizon} in algorithm_kwargs"
        raise UserError(
            f"horizon = {run.horizon} is not allowed: {run.algorithm} has n_steps = {pace}; {remedy}"
        )
    if run.horizon % pace:
        remedy = f"set horizon = {math.ceil(run.horizon / pace) * pace}, or another multiple"
        raise UserError(
            f"horizon = {run.horizon} is not allowed: {run.algorithm} learns every {pace} steps; {remedy}"
        )


def learner_class(run: Run) -> Any:
    if run.algorithm in LEARNERS:
        return LEARNERS[run.algorithm]
    with errors_from(f"algorithm = {run.algorithm}"):
        learner_type = load_class(find_algorithm(run.algorithm).learner)
    if not isinstance(learner_type, type) or not issubclass(
        learner_type, OnPolicyAlgorithm | OffPolicyAlgorithm
    ):
        raise UserError(f"algorithm = {run.algorithm}: must be an OnPolicyAlgorithm or an OffPolicyAlgorithm")
    if issubclass(learner_type, MaskablePPO) and not is_masked(run.algorithm):
        raise UserError(
            f"algorithm = {run.algorithm}: evaluations know the action masks of maskable-ppo alone"
        )
    return learner_type


def _check_arguments(run: Run) -> None:
    """Refuse arguments of PPO that it has as fields."""
    arguments = _algorithm_kwargs(run)
    policy_kwargs = str(arguments.get("policy_kwargs"))  # a table, its text, or anything
    for argument, field_name in (*IN_POLICY_KWARGS.items(), *field_arguments(run)):
        if argument in arguments or (argument in IN_POLICY_KWARGS and argument in policy_kwargs):
            raise UserError(f"algorithm_kwargs: {argument} is not allowed: ppo has the field {field_name}")


def _algorithm_kwargs(run: Run) -> dict[str, Any]:
    """Return the learner's arguments as a table, without callbacks."""
    argument_table: dict[str, Any] = json.loads(run.algorithm_kwargs or "{}")
    argument_table.pop(CALLBACK, None)
    return argument_table


def own_callbacks(run: Run) -> list[BaseCallback]:
    """Make a user's own callbacks, which `algorithm_kwargs` names, without arguments."""
    named = json.loads(run.algorithm_kwargs or "{}").get(CALLBACK, [])
    callbacks = []
    for class_name in [named] if isinstance(named, str) else named:
        if not isinstance(class_name, str):
            raise UserError(
                f"algorithm_kwargs: {CALLBACK} = {named!r} is not allowed: module:Class, or a list"
            )
        with errors_from(f"algorithm_kwargs: {CALLBACK} = {class_name!r}"):
            callbacks.append(find_class(CALLBACK, class_name)())
    return callbacks


def _environments(run: Run, slots: int, seed: int = 0) -> VecEnv:
    """Return environments in slots, normalised if the run asks for it."""
    with errors_from(run.env):
        environments: VecEnv = DummyVecEnv([lambda: Monitor(make_env(run))] * slots)
    environments.seed(seed % 2**31)
    if run.normalize_observations or run.normalize_rewards:
        environments = VecNormalize(
            environments,
            norm_obs=run.normalize_observations,
            norm_reward=run.normalize_rewards,
        )
    return environments


def _make_learner(run: Run, env: VecEnv, to_play: bool = False) -> Any:
    """Return the learner of a run. One `to_play` has an empty replay buffer, and seeds no generators."""
    learner_type = learner_class(run)
    policy_name = run.policy or "MlpPolicy"
    if issubclass(learner_type, MaskablePPO) and not is_masking_supported(env):
        raise UserError(f"{run.algorithm} needs action masks, but {run.env} has no method action_masks()")
    if policy_name not in learner_type.policy_aliases:
        raise UserError(
            f'policy = "{policy_name}": {run.algorithm} has {", ".join(learner_type.policy_aliases)}'
        )
    with errors_from(f"{run.algorithm} in {run.env}"):
        arguments = read_arguments(_algorithm_kwargs(run), env.action_space)
        if run.algorithm == "ppo":
            from_fields = learner_arguments(run, env.num_envs)
            policy_kwargs = {**from_fields["policy_kwargs"], **arguments.get("policy_kwargs", {})}
            arguments = {**from_fields, **arguments, "policy_kwargs": policy_kwargs}
        elif has_rollouts(run.algorithm):
            arguments.setdefault("n_steps", run.horizon)
        if to_play and "buffer_size" in signature(learner_type).parameters:
            arguments["buffer_size"] = 1
        seed = run.seed if run.seed_as == LIBRARY else stream_seed(run.seed, "weights") % 2**31
        device = CPU if to_play else run.device
        try:
            learner = learner_type(
                policy_name, env, seed=None if to_play else seed, device=device, **arguments
            )
        except AssertionError as error:
            _refuse_actions(run, env, str(error))
            raise
    if isinstance(env, VecNormalize):
        env.gamma = learner.gamma
    return learner


def _refuse_actions(run: Run, env: VecEnv, library_message: str) -> None:
    """Refuse an environment whose actions a learner lacks, as the library's message says."""
    supported, text, _ = library_message.partition(" as action spaces but ")
    if text:
        spaces_needed = " or ".join(re.findall(r"(\w+)'>", supported))
        raise UserError(
            f"{run.algorithm} needs {spaces_needed} actions, but {run.env} has {env.action_space}"
        )


def _pace(learner: OnPolicyAlgorithm | OffPolicyAlgorithm) -> int:
    """Return the steps per slot after which a learner may learn; 1 where it counts episodes."""
    if isinstance(learner, OnPolicyAlgorithm):
        return learner.n_steps
    frequency: Any = learner.train_freq
    if frequency.frequency < 1:  # it would wait forever
        raise UserError(f"algorithm_kwargs: train_freq = {frequency.frequency} is not allowed: at least 1")
    return int(frequency.frequency) if frequency.unit is TrainFrequencyUnit.STEP else 1


# --- Training --------------------------------------------------------------------------------------


class OpenTrainer(Trainer):
    """Trains a run by its learner's own `learn`, for an update's steps at a time."""

    def __init__(self, run: Run, is_stopping: IsStopping = never) -> None:
        super().__init__(run, is_stopping)
        check_device(run)
        torch.set_num_threads(1)
        self._env = _environments(run, run.slots, slot_seeds(run)[0])
        self._model = _make_learner(run, self._env)
        prepare(self._model, run)
        self._episodes = Episodes(run, is_stopping)
        self._callbacks = PartwiseCallbacks([self._episodes, *own_callbacks(run)])
        self._seed = stream_seed(run.seed, "evaluation")

    def update(self, before: int, after: int, records: Records) -> bool:
        model = self._model
        with errors_from(f"{self.run.algorithm} in {self.run.env}"):
            steps_left = after - model.num_timesteps
            if steps_left > 0:  # a learner that counts episodes may have gone further
                learn(model, steps_left, self._callbacks)
                if model.num_timesteps < after:
                    step_text = f"at step {model.num_timesteps:,}"
                    raise UserError(f"a callback ended training {step_text}, but a run trains all its steps")
            if after >= self.run.steps:
                self._callbacks.end()
        records.metrics.append(metrics_row(after, logged_losses(model)))
        records.episodes.extend(self._episodes.take_rows())
        return has_finite_weights(model)

    def evaluate(self, step: int) -> Row:
        """Return one row of `EVALUATION_COLUMNS`, always of episodes of the same seeds."""
        returns, lengths = self._play(self._evaluation.episodes, deterministic=False)
        best_returns, _ = self._play(self._evaluation.best_episodes, deterministic=True)
        return evaluation_row(step, returns, lengths, best_returns, self._evaluation.random)

    def _play(self, episodes: int, deterministic: bool) -> tuple[list[float], list[int]]:
        steps = 0  # of the episode, which may have several lives

        def check(playing: dict[str, Any], _: dict[str, Any]) -> None:
            nonlocal steps
            steps = 0 if "episode" in playing["info"] else steps + 1
            check_stop(self.is_stopping)
            check_length(self.run, steps)

        action_space = self._model.action_space  # some learners draw from it when they are evaluated
        generator_state = action_space.np_random.bit_generator.state
        action_space.seed(self._seed % 2**31)
        torch.manual_seed(self._seed % 2**63)
        try:
            with (
                closed_after(self.run, _environments(self.run, 1, self._seed)) as env,
                errors_from(f"{self.run.env} in evaluation"),
            ):
                if isinstance(env, VecNormalize) and isinstance(self._env, VecNormalize):
                    env.training, env.norm_reward = False, False
                    if self.run.normalize_observations:
                        env.obs_rms = self._env.obs_rms
                evaluate: Any = masked_evaluation if is_masked(self.run.algorithm) else evaluate_policy
                returns_and_lengths: Any = evaluate(
                    self._model, env, episodes, deterministic, callback=check, return_episode_rewards=True
                )
        finally:
            action_space.np_random.bit_generator.state = generator_state
        return returns_and_lengths

    def policy(self) -> LearnedPolicy:
        return LearnedPolicy(self._model)


# --- Policies ------------------------------------------------------------------------------


class LearnedPolicy:
    """A learner, and the statistics by which its observations are normalised.

    Attributes:
        learner: the learner itself, of Stable-Baselines3's kind.
    """

    file = LEARNER_FILE

    def __init__(self, learner: BaseAlgorithm) -> None:
        self.learner = learner

    def predict(
        self,
        observation: Any,
        state: tuple[np.ndarray, ...] | None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = False,
        action_masks: np.ndarray | None = None,
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...] | None]:
        """Return actions and the next state for observations as the environment gives them.

        It is a `PolicyPredictor` of Stable-Baselines3, for its `evaluate_policy`. Only a learner with action
        masks takes them.
        """
        normalizing = self.learner.get_vec_normalize_env()
        if normalizing is not None:
            observation = normalizing.normalize_obs(observation)
        masks: dict[str, Any] = {} if action_masks is None else {"action_masks": action_masks}
        return self.learner.predict(observation, state, episode_start, deterministic, **masks)

    def to_bytes(self) -> bytes:
        """Return the .zip that the learner's `save` writes, with the statistics in it."""
        zip_buffer = io.BytesIO()
        self.learner.save(zip_buffer, exclude=HOOKS)
        with ZipFile(zip_buffer, "a") as archive:
            archive.writestr(STATISTICS, save(_statistics(self.learner)))
        return zip_buffer.getvalue()


def load_learner(run: Run, zip_bytes: bytes) -> LearnedPolicy:
    """Read a policy from the bytes of `LearnedPolicy.to_bytes`, which may be untrusted.

    The learner and its environment are made from the run's fields. Nothing is unpickled.
    """
    with closed_after(run, _environments(run, 1)) as environments:
        learner = _make_learner(run, environments, to_play=True)
    try:
        learner.set_parameters(io.BytesIO(zip_bytes), device=CPU)
        with ZipFile(io.BytesIO(zip_bytes)) as archive:
            _restore_statistics(learner, load(archive.read(STATISTICS)))
    except Exception:  # zipfile, torch and safetensors raise different errors
        raise UserError(
            f"{LEARNER_FILE}: is not a policy of {run.algorithm}, or does not match its run"
        ) from None
    if getattr(learner, "use_sde", False):
        learner.policy.reset_noise()
    return LearnedPolicy(learner)


def _means_by_key(learner: BaseAlgorithm) -> dict[str, RunningMeanStd]:
    """Return the running means of observations: of each part of a dictionary, else of "all"."""
    normalizing = learner.get_vec_normalize_env()
    if normalizing is None or not normalizing.norm_obs:
        return {}
    means = normalizing.obs_rms
    return means if isinstance(means, dict) else {"all": means}


def _statistics(learner: BaseAlgorithm) -> dict[str, np.ndarray]:
    statistics: dict[str, np.ndarray] = {}
    for observation_key, means in _means_by_key(learner).items():
        statistics |= {f"mean/{observation_key}": means.mean, f"variance/{observation_key}": means.var}
    return statistics


def _restore_statistics(learner: BaseAlgorithm, statistics: dict[str, np.ndarray]) -> None:
    for observation_key, means in _means_by_key(learner).items():
        mean, variance = statistics[f"mean/{observation_key}"], statistics[f"variance/{observation_key}"]
        if mean.shape != means.mean.shape or variance.shape != means.var.shape:
            raise ValueError(f"the statistics of {observation_key} are of another shape")
        means.mean, means.var = mean, variance
