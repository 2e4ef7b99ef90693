"""Stable-Baselines3 as a script of one's own would use it: any of its learners, policies and arguments.

    run → environments by Gymnasium alone, learner → its own `learn`, an update at a time → records

Nothing is flattened, so that a policy may see pictures. The learner's whole state is not known here: a run is
not resumed, and its policy is not stored.
"""

from __future__ import annotations

import json
from contextlib import closing
from inspect import signature
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv, VecNormalize

from pneuma.algorithms import OPEN_LEARNERS
from pneuma.config import Run, slot_seeds, stream_seed
from pneuma.engines.gymnasium_env import blamed, load_class, make_env, refuse_flat_pictures
from pneuma.engines.gymnasium_evaluation import BEST_EPISODES, Evaluation
from pneuma.engines.loop import Trainer
from pneuma.engines.records import Records, Row, episode_row, evaluation_row, metrics_row
from pneuma.engines.sb3_learners import LEARNERS, has_finite_weights, learner_arguments, logged_losses
from pneuma.errors import UserError

OURS = ("env", "policy", "seed", "device", "learning_rate", "gamma", "tensorboard_log", "_init_setup_model")
"""Arguments that follow from a run's fields, or write files."""


def learner_class(run: Run) -> Any:
    return LEARNERS.get(run.algorithm) or load_class(OPEN_LEARNERS[run.algorithm])


def check_learner(run: Run) -> None:
    """Refuse arguments that the learner does not have, and spaces in which it or its policy cannot learn."""
    known = signature(learner_class(run)).parameters
    given = json.loads(run.algorithm_kwargs or "{}")
    if wrong := [key for key in given if key not in known or key in OURS]:
        allowed = ", ".join(key for key in known if key not in OURS)
        raise UserError(f"algorithm_kwargs: {', '.join(wrong)} not allowed: {run.algorithm} takes {allowed}")
    with closing(make_env(run)) as env:
        refuse_flat_pictures(run, env.observation_space)
    with closing(_environments(run, 1)) as environments:
        _make_learner(run, environments, build=False)


def _environments(run: Run, slots: int, seed: int = 0) -> VecEnv:
    """Return environments in slots, normalised if the run says so."""
    made: VecEnv = DummyVecEnv([lambda: Monitor(make_env(run))] * slots)
    made.seed(seed % 2**31)
    if run.normalize_observations or run.normalize_rewards:
        made = VecNormalize(
            made, norm_obs=run.normalize_observations, norm_reward=run.normalize_rewards, gamma=run.gamma
        )
    return made


def _make_learner(run: Run, env: VecEnv, build: bool = True) -> Any:
    kind = learner_class(run)
    arguments: dict[str, Any] = {"learning_rate": run.learning_rate, "gamma": run.gamma}
    if run.algorithm in LEARNERS:
        arguments |= learner_arguments(run, env.num_envs)
    given = json.loads(run.algorithm_kwargs or "{}")
    for_policy = {**arguments.get("policy_kwargs", {}), **given.pop("policy_kwargs", {})}
    arguments |= {**given, "policy_kwargs": {key: _named(key, each) for key, each in for_policy.items()}}
    arguments["_init_setup_model"] = build
    known = signature(kind).parameters
    with blamed(f"{run.algorithm} in {run.env}"):
        return kind(
            run.policy or "MlpPolicy",
            env,
            seed=stream_seed(run.seed, "weights") % 2**31,
            device="cpu",
            **{key: value for key, value in arguments.items() if key in known},
        )


def _named(key: str, value: Any) -> Any:
    """Return a class of torch by its name, such as nn.ELU, where an argument of a policy takes a class."""
    if not isinstance(value, str):
        return value
    places: dict[str, Any] = {"activation_fn": torch.nn, "optimizer_class": torch.optim}
    found = getattr(places.get(key), value.rpartition(".")[2], None)
    if key in places and not isinstance(found, type):
        raise UserError(f"algorithm_kwargs: {key} = {value!r}: is no class of {places[key].__name__}")
    return found or value


class OpenTrainer(Trainer):
    """Trains a run by its learner's own `learn`, for an update's steps at a time."""

    def __init__(self, run: Run) -> None:
        super().__init__(run)
        torch.set_num_threads(1)
        self._env = _environments(run, run.slots, slot_seeds(run)[0])
        self._model = _make_learner(run, self._env)
        self._model.set_logger(Logger(folder=None, output_formats=[]))
        self._episodes = Episodes(run.slots)
        self._callbacks: list[BaseCallback] = [self._episodes]
        if run.callback:
            with blamed(f"callback = {run.callback}"):
                self._callbacks.append(load_class(run.callback)())
        follow = self._model._update_current_progress_remaining
        # schedules fall over the whole budget, of which `learn` is told a part at a time
        self._model._update_current_progress_remaining = lambda steps, _: follow(steps, run.steps)
        self._random = Evaluation(run).random
        self._seed = stream_seed(run.seed, "evaluation")

    def update(self, before: int, after: int, records: Records) -> bool:
        model = self._model
        with blamed(f"{self.run.algorithm} in {self.run.env}"):
            left = after - model.num_timesteps
            if left > 0:  # learners of replayed steps may have gone further
                model.learn(left, callback=self._callbacks, reset_num_timesteps=False)
        records.metrics.append(metrics_row(after, logged_losses(model)))
        records.episodes.extend(self._episodes.take())
        return has_finite_weights(model)

    def evaluate(self, step: int) -> Row:
        """Return one row of `EVALUATION_COLUMNS`, of the same seeds each time."""
        drawn, lengths = self._play(self.run.evaluation_episodes, deterministic=False)
        best, _ = self._play(BEST_EPISODES, deterministic=True)
        return evaluation_row(step, drawn, lengths, best, self._random)

    def _play(self, episodes: int, deterministic: bool) -> tuple[list[float], list[int]]:
        before = np.random.get_state()
        with (
            torch.random.fork_rng(devices=[]),
            closing(_environments(self.run, 1, self._seed)) as env,
            blamed(f"{self.run.env} in evaluation"),
        ):
            if isinstance(env, VecNormalize) and isinstance(self._env, VecNormalize):
                env.training, env.norm_reward = False, False
                if self.run.normalize_observations:
                    env.obs_rms = self._env.obs_rms
            torch.manual_seed(self._seed % 2**63)
            found: Any = evaluate_policy(
                self._model, env, episodes, deterministic, return_episode_rewards=True
            )
        np.random.set_state(before)
        return found

    def policy(self) -> None:
        return None


class Episodes(BaseCallback):
    """Collects the episodes that end, from what `Monitor` tells."""

    def __init__(self, slots: int) -> None:
        super().__init__()
        self._counts = [0] * slots
        self._ended: list[Row] = []

    def _on_step(self) -> bool:
        for slot, info in enumerate(self.locals["infos"]):
            if episode := info.get("episode"):
                ending = "truncated" if info.get("TimeLimit.truncated") else "terminated"
                told = float(episode["r"]), int(episode["l"]), ending
                self._ended.append(episode_row(slot, self._counts[slot], self.num_timesteps, *told))
                self._counts[slot] += 1
        return True

    def take(self) -> list[Row]:
        taken, self._ended = self._ended, []
        return taken
