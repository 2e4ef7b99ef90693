"""Evaluation in any Gymnasium environment: always the same episodes, on seeds of their own."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import closing

import numpy as np

from pneuma.config import Run, stream_seed
from pneuma.engines.gymnasium_env import GymnasiumSlots, actions_in_space, errors_from
from pneuma.engines.policy import Policy
from pneuma.engines.records import NAN, Row, evaluation_row
from pneuma.engines.stopping import IsStopping, check_length, check_stop, never

BEST_EPISODES = 5
"""Greedy episodes of an evaluation, in addition to those with sampled actions."""


class Evaluation:
    """Evaluates the policies of one run: always the same episodes, on seeds of their own.

    Each evaluation makes new environments, because wrappers may keep what they learned, such as means.
    """

    def __init__(self, run: Run, most_steps: float = math.inf, is_stopping: IsStopping = never) -> None:
        """Play at random, with fewer episodes than the run's if these would take more than `most_steps`."""
        self.run, self._is_stopping = run, is_stopping
        self.episodes, self.best_episodes = run.evaluation_episodes, BEST_EPISODES
        if most_steps < math.inf:
            _, lengths = self._play_at_random(1)
            affordable = int(most_steps / 2 / lengths[0])
            self.episodes = min(max(affordable, 1), self.episodes)
            self.best_episodes = min(self.episodes, BEST_EPISODES)
        returns, _ = self._play_at_random(self.episodes + self.best_episodes)
        sampled = returns[: self.episodes]
        self.random: Row = {"random_return": float(sampled.mean()), "random_spread": float(sampled.std())}

    def _make_slots(self, count: int) -> GymnasiumSlots:
        return GymnasiumSlots(self.run, [stream_seed(self.run.seed, "evaluation", i) for i in range(count)])

    def _play_at_random(self, slot_count: int) -> tuple[np.ndarray, np.ndarray]:
        slots = self._make_slots(slot_count)
        slots.action_space.seed(stream_seed(self.run.seed, "random-player") % 2**31)
        returns, lengths, _ = self._play(
            slots, lambda rows, _: np.array([slots.random_action(row) for row in rows])
        )
        return returns, lengths

    def evaluate(self, policy: Policy, step: int) -> Row:
        """Return one row of `records.EVALUATION_COLUMNS`, with some of `VALUE_COLUMNS`."""
        generator = np.random.default_rng(stream_seed(self.run.seed, "evaluation-actions", step))
        episodes = self.episodes

        def act(playing: np.ndarray, observations: np.ndarray) -> np.ndarray:
            sampled_count = int((playing < episodes).sum())
            actions = []
            if sampled_count:
                actions.append(policy.sample(observations[:sampled_count], generator))
            if sampled_count < len(playing):
                actions.append(policy.best(observations[sampled_count:]))
            return np.concatenate(actions)

        returns, lengths, successes = self._play(self._make_slots(episodes + self.best_episodes), act)
        success = float(successes[:episodes].mean())  # NaN where the environment does not report it
        return evaluation_row(
            step=step,
            returns=returns[:episodes],
            lengths=lengths[:episodes],
            best_returns=returns[episodes:],
            extra_columns={"success": success, **self.random},
        )

    def _play(
        self, slots: GymnasiumSlots, choose_actions: Callable[[np.ndarray, np.ndarray], np.ndarray]
    ) -> tuple[np.ndarray, ...]:
        """Play one episode in each slot; return returns, lengths and, if reported, successes: (N,) each."""
        returns, successes = np.zeros((2, len(slots.envs)))
        playing = np.arange(len(slots.envs))
        with closing(slots):
            while len(playing):
                running = []
                chosen_actions = choose_actions(playing, slots.observations[playing])
                actions = actions_in_space(slots.action_space, chosen_actions)
                for slot, action in zip(playing.tolist(), actions, strict=True):
                    check_stop(self._is_stopping)
                    reward, terminated, truncated, info = slots.step_one(slot, action)
                    returns[slot] += reward
                    if terminated or truncated:
                        with errors_from(f"{slots.run.env}: info['is_success']"):
                            success = info.get("is_success")
                            successes[slot] = NAN if success is None else float(success)
                    else:
                        running.append(slot)
                check_length(self.run, slots.lengths[running].max(initial=0))
                playing = np.array(running, np.int64)
        return returns, slots.lengths, successes
