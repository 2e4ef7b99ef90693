"""Overestimation: estimated values of actions against the returns of their policy (thesis section 3.3).

As in van Hasselt, Guez and Silver (2015): the greatest estimated value, and the actual discounted return,
averaged over the states that the greedy policy visits.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from pneuma.config import Run, evaluation_config, stream_seed
from pneuma.engines.policy import Policy
from pneuma.env.worlds import Worlds
from pneuma.env_fields import MOST_STEPS

WEIGHT_LEFT_OUT = 0.01
"""Rewards after a truncated episode count until their discount is below this."""


class ActionValues:
    """Plays the greedy policy once from every start place, to measure the true value of its states.

    Learners bootstrap at a time limit that truncates. So episodes continue past it until the last state that
    counts is followed by enough steps. A time limit that terminates ends them.
    """

    def __init__(self, run: Run, starts: int) -> None:
        self.run = run
        beyond = _steps_beyond(run)
        steps = run.episode_steps + (beyond or 0)
        self.worlds = Worlds(starts, replace(evaluation_config(run), episode_steps=steps))
        self._known = beyond is not None

    def measure(self, policy: Policy) -> dict[str, float]:
        """Return `q_estimate` and `q_true`, means over all visited states.

        Both are NaN if an endless future is not discounted, or hardly at all.
        """
        estimates, rewards, counted = self._play(policy)
        if self.worlds.truncated.any() and not self._known:
            return {"q_estimate": math.nan, "q_true": math.nan}
        true = discounted(rewards, self.run.gamma)
        counted[self.run.episode_steps :] = False
        return {"q_estimate": float(estimates[counted].mean()), "q_true": float(true[counted].mean())}

    def _play(self, policy: Policy) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return estimates, rewards and whether the player was alive, each (steps, worlds, players)."""
        worlds = self.worlds
        worlds.seed([stream_seed(self.run.stream, "action-values", i) for i in range(len(worlds))])
        worlds.reset(starts=np.arange(len(worlds)))
        steps: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        running = len(worlds)
        while running:
            values = policy.logits(worlds.observations.reshape(-1, worlds.observations.shape[2]))
            best = values.argmax(axis=1).reshape(worlds.players.shape)
            running -= worlds.step(best)
            estimate = values.max(axis=1).reshape(worlds.players.shape)
            steps.append((estimate, worlds.events["reward"].copy(), worlds.present.copy()))
        estimates, rewards, present = (np.stack(each) for each in zip(*steps, strict=True))
        return estimates, rewards, present.astype(np.bool_)


def discounted(rewards: np.ndarray, gamma: float) -> np.ndarray:
    """Return the discounted sum of rewards from each step on, (steps, …), with nothing after the last."""
    sums = np.zeros((len(rewards) + 1, *rewards.shape[1:]))
    for step in reversed(range(len(rewards))):
        sums[step] = rewards[step] + gamma * sums[step + 1]
    return sums[:-1]


def _steps_beyond(run: Run) -> int | None:
    """Return how many steps past the time limit must be played; None if no number is enough."""
    if run.time_limit == "terminate" or run.gamma == 0:
        return 0
    if run.gamma == 1:
        return None
    beyond = math.ceil(math.log(WEIGHT_LEFT_OUT) / math.log(run.gamma))
    return beyond if run.episode_steps + beyond <= MOST_STEPS else None
