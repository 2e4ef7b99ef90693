"""Gymnasium's environments as a vector environment of Stable-Baselines3."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from pneuma.config import Run, slot_seeds
from pneuma.engines.gymnasium_env import GymnasiumSlots, choices_of
from pneuma.engines.normalization import Scaling
from pneuma.env.sb3 import WholeVecEnv


class GymnasiumVecEnv(WholeVecEnv):
    """A run's slots, with flat observations and actions; choices count from 0."""

    def __init__(self, run: Run) -> None:
        self.render_mode = None
        self.slots = GymnasiumSlots(run, slot_seeds(run), training=True)
        self._actions = np.zeros(run.slots)
        features = self.slots.observations.shape[1]
        action_space = _learners_space(self.slots.action_space)
        super().__init__(run.slots, spaces.Box(-np.inf, np.inf, (features,), np.float32), action_space)

    @property
    def finished(self) -> list[dict[str, Any]]:
        return self.slots.finished

    @property
    def scaling(self) -> Scaling | None:
        return self.slots.scaling

    def saved_state(self) -> dict[str, np.ndarray]:
        return self.slots.saved_state()

    def restore_state(self, saved: Mapping[str, np.ndarray]) -> None:
        self.slots.restore_state(saved)

    def reset(self) -> np.ndarray:
        return self.slots.seen.copy()

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        rewards, terminated, truncated = self.slots.step(self._actions)
        dones = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in dones]
        for slot in np.flatnonzero(dones):
            infos[slot] = {
                "terminal_observation": self.slots.terminal[slot].copy(),
                "TimeLimit.truncated": bool(truncated[slot]),
            }
        return self.slots.seen.copy(), rewards.astype(np.float32), dones, infos

    def close(self) -> None:
        self.slots.close()


def _learners_space(space: spaces.Space[Any]) -> spaces.Space[Any]:
    """Return an action space as learners take it: flat, in float32, or with choices from 0 on."""
    if isinstance(space, spaces.Discrete):
        return spaces.Discrete(int(space.n))
    if isinstance(space, spaces.Box):
        low, high = space.low.astype(np.float32), space.high.astype(np.float32)
        return spaces.Box(low.reshape(-1), high.reshape(-1))
    return spaces.MultiDiscrete(choices_of(space).reshape(-1))
