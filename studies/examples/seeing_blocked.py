"""The arena for agents that can see whether they are stuck: stacked observations, or the last displacement.

An agent of the arena does not observe terrain. In one observation standing at a wall looks like standing
anywhere else; in two of them, or with the displacement of the last step, it can be told.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.wrappers import FlattenObservation, FrameStackObservation

import pneuma  # noqa: F401  (registers its environments)

POSITION = slice(0, 2)
"""Where an observation has the agent's own position (`docs/environment.md`)."""


class LastDisplacement(gymnasium.Wrapper[Any, Any, Any, Any]):
    """Append how far the last step moved the agent, in x and y, in hundredths of the position's unit."""

    def __init__(self, env: gymnasium.Env[Any, Any]) -> None:
        super().__init__(env)
        size = env.observation_space.shape[0]
        self.observation_space = spaces.Box(-np.inf, np.inf, (size + 2,), np.float32)

    def reset(self, **options: Any) -> tuple[np.ndarray, dict[str, Any]]:
        seen, info = self.env.reset(**options)
        self._position = seen[POSITION].copy()
        return self._append(seen), info

    def step(self, action: Any) -> Any:
        seen, *rest = self.env.step(action)
        return self._append(seen), *rest

    def _append(self, seen: np.ndarray) -> np.ndarray:
        moved = (seen[POSITION] - self._position) * 100
        self._position = seen[POSITION].copy()
        return np.concatenate([seen, moved], dtype=np.float32)


def make(stack: int = 1, displacement: bool = False) -> gymnasium.Env[Any, Any]:
    env = gymnasium.make("pneuma/PneumaArena-v0", disable_env_checker=True)
    if displacement:
        env = LastDisplacement(env)
    return FlattenObservation(FrameStackObservation(env, stack)) if stack > 1 else env


gymnasium.register("SeeingBlocked-v0", make)
