"""The vector environment of Stable-Baselines3 over the same worlds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices, VecEnvStepReturn

from pneuma.config import EnvConfig
from pneuma.env.single import ending_info
from pneuma.env.worlds import Worlds


class PneumaVecEnv(VecEnv):
    """N worlds, one player each, as Stable-Baselines3 wants them: an ended world resets at once.

    `infos` of a step that ends an episode hold `terminal_observation`, `TimeLimit.truncated`,
    `episode` with the return `r` and length `l`, and how it ended.

    Args:
        seeds: one for each world; it decides how many there are.
        config: the environment's settings.
    """

    def __init__(self, seeds: Sequence[int], config: EnvConfig | None = None) -> None:
        self.state = Worlds(len(seeds), config)
        self.state.seed(seeds)
        self.render_mode = None
        super().__init__(len(seeds), self.state.space, self.state.action_space)
        self.finished: list[dict[str, Any]] = []
        """Every episode that has ended since someone last emptied the list."""
        self._steps_taken = 0
        self._returns = np.zeros(self.num_envs)
        self._episodes = np.zeros(self.num_envs, np.int64)
        self._actions = np.zeros((self.num_envs, 1), np.int64)
        self._quiet_infos: list[dict[str, Any]] = [{} for _ in seeds]
        self._no_dones = np.zeros(self.num_envs, np.bool_)

    def reset(self) -> np.ndarray:
        """Begin an episode in every world, with the seeds and options set beforehand."""
        if self._seeds[0] is not None:
            self.state.seed([int(seed) for seed in self._seeds if seed is not None])
        starts = [options.get("start", -1) for options in self._options]
        self._reset_seeds()
        self._reset_options()
        self.state.reset(starts=np.array(starts, np.int64))
        self._returns[:] = 0.0
        return self.state.observations[:, 0].copy()

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions of the next step, shape (N,)."""
        self._actions[:, 0] = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Play them: observations, rewards, dones, infos."""
        state = self.state
        ended = state.step(self._actions)
        rewards = state.events["reward"][:, 0]
        self._returns += rewards
        self._steps_taken += 1
        infos, dones = self._quiet_infos, self._no_dones
        if ended:
            dones = state.worlds["ending"] != 0
            infos = [self._end(i) if dones[i] else {} for i in range(self.num_envs)]
            state.reset(dones)
        # Copies: the learner keeps the observations, and adds to the rewards at time limits.
        return state.observations[:, 0].copy(), rewards.astype(np.float32), dones.copy(), infos

    def _end(self, world: int) -> dict[str, Any]:
        """Note an ended episode and return its info."""
        info = ending_info(self.state, world)
        length = int(self.state.worlds["steps"][world])
        self.finished.append(
            {
                "slot": world,
                "episode": int(self._episodes[world]),
                "step": self._steps_taken * self.num_envs,
                "return": float(self._returns[world]),
                "length": length,
                **info,
            }
        )
        info["terminal_observation"] = self.state.observations[world, 0].copy()
        info["TimeLimit.truncated"] = info["ending"] == "time-limit"
        info["episode"] = {"r": float(self._returns[world]), "l": length}
        self._returns[world] = 0.0
        self._episodes[world] += 1
        return info

    def close(self) -> None:
        """Nothing to close."""

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute, the same for every world."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute for all worlds."""
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method once and return its result for every world asked for."""
        result = getattr(self, method_name)(*method_args, **method_kwargs)
        return [result for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: VecEnvIndices = None) -> list[bool]:
        """Say that no world is wrapped."""
        return [False for _ in self._get_indices(indices)]
