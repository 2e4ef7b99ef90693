"""Gymnasium's interface to N worlds as one environment.

It gives the same bits as `gym.py` for the same seeds and actions. A slot of several players' worlds is as in
`Slots`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from pneuma.env.fields import ENVIRONMENTS
from pneuma.env.interface import Interface, read_options, world_seeds


class PneumaVectorEnv(Interface, VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """N worlds as one environment; see `pneuma.env.gym.PneumaEnv` for each.

    World i of a batch reset with seed s is the single world reset with seed s + i, bit for bit. With several
    players to a world, each is a slot: slot i is player i % players of world i // players. A slot whose
    player dies before its world ends idles until then (`pneuma.env.slots.Slots`).

    Args:
        num_envs: number of slots, a multiple of the players in a world.
        autoreset_mode: Gymnasium's three. `NEXT_STEP`, its default: the step after an ending
            resets and ignores the action. `SAME_STEP`: the step that ends resets too, and `info`
            holds `final_obs` and `final_info`. `DISABLED`: reset by hand with
            `reset(options={"reset_mask": booleans})`, one a slot.
        max_episode_steps: Gymnasium's name of `episode_steps`, which counts if both are given.
        settings: the fields of `pneuma.config.EnvConfig`.
    """

    def __init__(
        self,
        num_envs: int = 1,
        env_id: str = ENVIRONMENTS[0],
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        camera: str = "map",
        max_episode_steps: int | None = None,
        **settings: object,
    ) -> None:
        if max_episode_steps is not None:
            settings = {"episode_steps": max_episode_steps, **settings}
        self._set_up(num_envs, env_id, render_mode, camera, settings)
        self.num_envs = num_envs
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}  # type: ignore[misc]
        self.single_observation_space = self.worlds.slot_space
        self.single_action_space = self.worlds.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.worlds.action_space, num_envs)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | np.ndarray | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode in every world, or in those of `options["reset_mask"]`.

        `seed` is one seed, or a list with one per world, for the random streams of the worlds that are reset;
        those with None go on. `options["start"]` is the index of a start place, or one for each world.

        Raises:
            ResetNeeded: when the first reset leaves out some worlds.
            TypeError: for a mask that is not an array of one boolean for each slot.
        """
        own_options = read_options(options, "start", "reset_mask")
        mask = np.ones(len(self.worlds), np.bool_)
        if "reset_mask" in own_options:
            mask = self._world_mask(own_options["reset_mask"])
        if not self.slots.has_begun and not mask.all():
            raise ResetNeeded("no episode has begun in the other worlds: reset all of them first")
        seeds = world_seeds(seed, len(self.worlds))
        super().reset(seed=seeds[0])
        for world in np.flatnonzero(~mask):
            seeds[world] = None
        self._begin(seeds, own_options.get("start"), mask)
        return self.slots.observations, self._infos()

    def _world_mask(self, slot_mask: Any) -> np.ndarray:
        """Return which worlds are reset: those of the slots in a mask, which must be as Gymnasium has it."""
        is_mask = isinstance(slot_mask, np.ndarray) and slot_mask.dtype == np.bool_
        if not (is_mask and slot_mask.shape == (self.num_envs,)):
            raise TypeError(f"reset_mask must be an array of {self.num_envs} booleans, not {slot_mask!r}")
        return np.asarray(slot_mask.reshape(len(self.worlds), -1).any(axis=1))

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Play one action in every slot; see `gymnasium.vector.VectorEnv.step`."""
        slots = self.slots
        waiting = slots.world_over
        if self.autoreset_mode == AutoresetMode.DISABLED and waiting.any():
            raise ValueError("some worlds have ended: reset them with options={'reset_mask': …} first")
        infos = self._final_infos(slots.step(actions))
        if self.autoreset_mode == AutoresetMode.SAME_STEP:
            waiting = slots.world_over
        rewards = slots.rewards.copy()
        if waiting.any():  # in NEXT_STEP this step resets what the last one ended
            self.worlds.reset(waiting)
        infos = self._infos() | infos
        return slots.observations, rewards, slots.terminated, slots.truncated, infos

    def render(self) -> Any:
        """Return a frame for each slot, if there is a render mode."""
        if self.render_mode is None:
            return None
        return self.get_images()

    def _infos(self) -> dict[str, Any]:
        return {"action_mask": self.slots.masks, "_action_mask": np.ones(self.num_envs, np.bool_)}

    def _final_infos(self, ended: np.ndarray) -> dict[str, Any]:
        """Return the infos of the slots that ended, in Gymnasium's form for this autoreset mode."""
        observations = self.worlds.observations.reshape(self.num_envs, -1)
        masks = self.worlds.masks.reshape(self.num_envs, -1)
        infos: dict[str, Any] = {}
        for slot_index in np.flatnonzero(ended).tolist():
            slot_info = self.slots.ending_info(slot_index)
            if self.autoreset_mode == AutoresetMode.SAME_STEP:
                slot_info["action_mask"] = masks[slot_index].copy()
                slot_info = {"final_obs": observations[slot_index].copy(), "final_info": slot_info}
            infos = self._add_info(infos, slot_info, slot_index)
        return infos
