"""Gymnasium's environments as a vector environment of Stable-Baselines3."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from pneuma.config import Run, slot_seeds
from pneuma.engines.gymnasium_env import GymnasiumSlots, choice_counts
from pneuma.env.sb3 import SlotsVecEnv


class GymnasiumVecEnv(SlotsVecEnv):
    """A run's slots, with flat observations and actions; choices count from 0."""

    slots: GymnasiumSlots
    render_mode = None

    def __init__(self, run: Run) -> None:
        self.slots = GymnasiumSlots(run, slot_seeds(run), training=True)
        features = self.slots.observations.shape[1]
        action_space = _learners_space(self.slots.action_space)
        super().__init__(run.slots, spaces.Box(-np.inf, np.inf, (features,), np.float32), action_space)

    def reset(self) -> np.ndarray:
        return self.slots.observations.copy()

    def step_wait(self) -> VecEnvStepReturn:
        slots = self.slots
        ended = slots.step(self._actions)
        infos: list[dict[str, Any]] = [{} for _ in ended]
        for episode in slots.finished:
            slot_index = episode["slot"]
            infos[slot_index] = {
                "terminal_observation": slots.terminal[slot_index].copy(),
                "TimeLimit.truncated": bool(slots.truncated[slot_index]),
                "episode": {"r": episode["return"], "l": episode["length"]},
            }
        slots.finished.clear()
        return slots.observations.copy(), slots.rewards.astype(np.float32), ended, infos


def _learners_space(space: spaces.Space[Any]) -> spaces.Space[Any]:
    """Return an action space as learners take it: flat, in float32, or with choices from 0 on."""
    if isinstance(space, spaces.Discrete):
        return spaces.Discrete(int(space.n))
    if isinstance(space, spaces.Box):
        low, high = space.low.astype(np.float32), space.high.astype(np.float32)
        return spaces.Box(low.reshape(-1), high.reshape(-1))
    return spaces.MultiDiscrete(choice_counts(space).reshape(-1))
