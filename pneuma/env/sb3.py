"""The vector environment of Stable-Baselines3 over the same worlds."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices, VecEnvStepReturn

from pneuma.config import EnvConfig
from pneuma.env.single import chosen_starts, ending_info
from pneuma.env.slots import Slots
from pneuma.env.worlds import Worlds


class PneumaVecEnv(VecEnv):
    """Slots as Stable-Baselines3 wants them: an ended world resets at once.

    `infos` of a step that ends a slot's episode hold `terminal_observation`, `TimeLimit.truncated`,
    `episode` with the return `r` and length `l`, and how it ended. `env_method("action_masks")` is
    there for learners that mask. Players of a world must observe alike.

    Args:
        seeds: one for each world; it decides how many there are.
        config: the environment's settings.
    """

    def __init__(self, seeds: Sequence[int], config: EnvConfig | None = None) -> None:
        self.state = Worlds(len(seeds), config)
        self.state.seed(seeds)
        self.slots = Slots(self.state)
        self.render_mode = None
        super().__init__(self.slots.count, self.state.slot_space, self.state.action_space)
        self.keep_finished = False
        self.finished: list[dict[str, Any]] = []
        """With `keep_finished`, every episode that has ended since someone last emptied the list."""
        self._steps_taken = 0
        self._returns = np.zeros(self.num_envs)
        self._lengths = np.zeros(self.num_envs, np.int64)
        self._episodes = np.zeros(self.num_envs, np.int64)
        self._actions = np.zeros(self.num_envs, np.int64)
        self._quiet_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        self._no_dones = np.zeros(self.num_envs, np.bool_)

    def reset(self) -> np.ndarray:
        """Begin an episode in every world, with the seeds and options set beforehand."""
        every = slice(None, None, self.slots.players)
        if self._seeds[0] is not None:
            self.state.seed([int(seed) for seed in self._seeds[every] if seed is not None])
        asked = [options.get("start") for options in self._options[every]]
        starts = None if None in asked else chosen_starts(self.state, {"start": asked})
        self._reset_seeds()
        self._reset_options()
        self.state.reset(starts=starts)
        self._returns[:] = 0.0
        self._lengths[:] = 0
        return self.slots.observations

    def step_async(self, actions: np.ndarray) -> None:
        """Take the actions of the next step, shape (slots,)."""
        if np.min(actions) < 0 or np.max(actions) >= self.action_space.n:  # type: ignore[attr-defined]
            raise ValueError(f"actions {actions} are outside {self.action_space}")
        self._actions[:] = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Play them: observations, rewards, dones, infos."""
        slots = self.slots
        ended = slots.step(self._actions)
        rewards = slots.rewards.astype(np.float32)  # a copy: the learner adds to it at time limits
        self._returns += slots.rewards
        self._lengths += 1
        self._steps_taken += 1
        infos, dones = self._quiet_infos, self._no_dones
        if ended:
            dones = slots.terminated | slots.truncated
            infos = [self._end(i) if dones[i] else {} for i in range(self.num_envs)]
        if slots.world_over.any():
            self.state.reset(slots.world_over)
            self._lengths[slots.of_worlds(slots.world_over)] = 0  # idle slots begin again as well
        return slots.observations, rewards, dones.copy(), infos

    def _end(self, slot: int) -> dict[str, Any]:
        """Note an ended episode and return its info."""
        world, player = divmod(slot, self.slots.players)
        info = ending_info(self.state, world, player)
        length, total = int(self._lengths[slot]), float(self._returns[slot])
        if self.keep_finished:
            place = {"slot": slot, "episode": int(self._episodes[slot])}
            step = self._steps_taken * self.num_envs
            self.finished.append({**place, "step": step, "return": total, "length": length, **info})
        info["terminal_observation"] = self.state.observations[world, player].copy()
        info["TimeLimit.truncated"] = bool(self.slots.truncated[slot])
        info["episode"] = {"r": total, "l": length}
        self._returns[slot] = 0.0
        self._lengths[slot] = 0
        self._episodes[slot] += 1
        return info

    def action_masks(self) -> np.ndarray:
        """Return which actions would do anything, (slots, actions) booleans."""
        return self.slots.masks.astype(np.bool_)

    def close(self) -> None:
        """Nothing to close."""

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute, the same for every slot."""
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Set an attribute for all slots."""
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method for every slot asked for; `action_masks` gives each its own mask."""
        result = getattr(self, method_name)(*method_args, **method_kwargs)
        if method_name == "action_masks":
            return [result[i] for i in self._get_indices(indices)]
        return [result for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: VecEnvIndices = None) -> list[bool]:
        """Say that no slot is wrapped."""
        return [False for _ in self._get_indices(indices)]
