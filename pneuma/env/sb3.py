"""The vector environment of Stable-Baselines3, over the same worlds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np

from pneuma.env.fields import ENVIRONMENTS
from pneuma.env.interface import Interface, read_options, world_seeds
from pneuma.env.slots import LearnerSlots, Slots
from pneuma.errors import require

try:
    from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices, VecEnvStepReturn
except ModuleNotFoundError:
    require("stable_baselines3", command="pip install stable-baselines3")
    raise


class SlotsVecEnv(VecEnv):
    """A vector environment over `slots`, whose attributes and methods apply to all of them at once."""

    slots: LearnerSlots

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method for the given slots; `action_masks` returns each slot's own mask."""
        method_result = getattr(self, method_name)(*method_args, **method_kwargs)
        if method_name == "action_masks":
            return [method_result[i] for i in self._get_indices(indices)]
        return [method_result for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: VecEnvIndices = None) -> list[bool]:
        return [False for _ in self._get_indices(indices)]

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def close(self) -> None:
        """Do nothing: there is nothing to close."""


class PneumaVecEnv(Interface, SlotsVecEnv):
    """A vector environment of slots that resets ended worlds at once.

    Slot i is player i % players of world i // players. `infos` of a step that ends a slot's episode hold
    `terminal_observation`, `TimeLimit.truncated`, `episode` with the return `r` and length `l`, and how it
    ended. `env_method("action_masks")` serves learners that mask actions.

    Args:
        num_envs: number of slots, a multiple of the players in a world.
        seed: world i gets seed + i; or a list with one per world; default: random.
        env_id: whose presets to start from.
        render_mode: `rgb_array`, one picture of all slots.
        camera: `map`, or `follow` for a view of the player.
        settings: the fields of `pneuma.config.EnvConfig`.

    Raises:
        UserError: for settings that cannot be played.
    """

    slots: Slots

    def __init__(
        self,
        num_envs: int = 1,
        seed: int | Sequence[int | None] | None = None,
        env_id: str = ENVIRONMENTS[0],
        render_mode: str | None = None,
        camera: str = "map",
        **settings: object,
    ) -> None:
        self._set_up(num_envs, env_id, render_mode, camera, settings)
        self.worlds.seed(world_seeds(seed, len(self.worlds)))
        self.spec = replace(gymnasium.spec(env_id), kwargs={"env_id": env_id, **settings})
        VecEnv.__init__(self, num_envs, self.worlds.slot_space, self.worlds.action_space)
        self.metadata = {**Interface.metadata, **self.metadata}  # type: ignore[misc]

    def reset(self) -> np.ndarray:
        """Start an episode in each world, with the seeds and options set before.

        `set_options({"start": i})` chooses the start place. In a list with one entry per slot, those of the
        first player of each world count.
        """
        by_world = self._options[:: self.slots.players]
        starts = [read_options(options, "start").get("start") for options in by_world]
        self._begin(world_seeds(self._seeds[0], len(self.worlds)), starts)
        self._reset_seeds()
        self._reset_options()
        return self.slots.observations

    def step_wait(self) -> VecEnvStepReturn:
        slots = self.slots
        dones = slots.step(self._actions)
        observations = self.worlds.observations.reshape(self.num_envs, -1)
        rewards = slots.rewards.astype(np.float32)  # a copy: the learner adds to it at time limits
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for slot_index in np.flatnonzero(dones).tolist():
            episode = slots.episode_stats[slot_index]
            infos[slot_index] = {
                **slots.ending_info(slot_index),
                "terminal_observation": observations[slot_index].copy(),
                "TimeLimit.truncated": bool(slots.truncated[slot_index]),
                "episode": {"r": float(episode["returns"]), "l": int(episode["lengths"])},
            }
        is_over = slots.world_over
        if is_over.any():
            self.worlds.reset(is_over)
        return slots.observations, rewards, dones, infos

    def action_masks(self) -> np.ndarray:
        """Return which actions would have an effect, (slots, actions) booleans."""
        return self.slots.masks.astype(np.bool_)

    def render(self, mode: str | None = None) -> np.ndarray | None:
        """Return one picture of all slots."""
        return VecEnv.render(self, mode)
