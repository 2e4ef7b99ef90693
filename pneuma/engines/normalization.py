"""Observations and rewards normalised by running statistics, as Stable-Baselines3's VecNormalize does it.

    training: slots → Normalization, which learns → observations and rewards for the learner
    afterwards: observations → the policy's Scaling → its networks

Statistics are float64. They follow from a run's seeds and actions, as its slots do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pneuma.config import Run

CLIP = 10.0
EPSILON = 1e-8


@dataclass(frozen=True)
class Scaling:
    """How observations are normalised: by mean and variance, (features,) float64."""

    mean: np.ndarray
    variance: np.ndarray

    def __call__(self, observations: np.ndarray) -> np.ndarray:
        """Normalise observations: (N, features) -> (N, features) float32."""
        scaled_observations = (observations - self.mean) / np.sqrt(self.variance + EPSILON)
        return np.clip(scaled_observations, -CLIP, CLIP).astype(np.float32)


class Normalization:
    """The statistics that a run's slots learn in training, from their first observations, (S, features), on.

    `seen` are the current ones as the learner sees them.
    """

    def __init__(self, run: Run, observations: np.ndarray) -> None:
        from gymnasium.wrappers.utils import RunningMeanStd  # which reading policies does not need

        self._run = run
        moments: Any = RunningMeanStd
        self._observed = moments(shape=observations.shape[1:])
        self._returned = moments()
        self._returns = np.zeros(len(observations))
        self._see(observations)

    @property
    def scaling(self) -> Scaling | None:
        """How a policy normalises from now on; None if observations are left as they are."""
        if not self._run.normalize_observations:
            return None
        return Scaling(self._observed.mean, self._observed.var)

    def step(
        self, observations: np.ndarray, rewards: np.ndarray, ended: np.ndarray, terminal: np.ndarray
    ) -> np.ndarray:
        """Learn from a step of all slots; return normalised rewards, (S,), for the learner.

        Observations are those after the step. Where an episode has ended, the rows of `terminal` are
        normalised in place.
        """
        self._see(observations)
        scaling = self.scaling
        if scaling:
            terminal[ended] = scaling(terminal[ended])
        if not self._run.normalize_rewards:
            return rewards
        self._returns = self._returns * self._run.gamma + rewards
        self._returned.update(self._returns)
        self._returns[ended] = 0.0
        return np.clip(rewards / np.sqrt(self._returned.var + EPSILON), -CLIP, CLIP)

    def _see(self, observations: np.ndarray) -> None:
        if self._run.normalize_observations:
            self._observed.update(observations)
        scaling = self.scaling
        self.seen = scaling(observations) if scaling else observations

    def saved_state(self) -> dict[str, np.ndarray]:
        """Return the statistics: arrays by name."""
        state_arrays = {"discounted": self._returns.copy()}
        for quantity, moments in (("observed", self._observed), ("returned", self._returned)):
            for statistic in ("mean", "var", "count"):
                state_arrays[f"{quantity}_{statistic}"] = np.array(getattr(moments, statistic))
        return state_arrays
