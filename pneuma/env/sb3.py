"""The vector environment of Stable-Baselines3, over the same worlds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import gymnasium
import numpy as np
from stable_baselines3.common.vec_env.base_vec_env import VecEnv, VecEnvIndices, VecEnvStepReturn

from pneuma.env.fields import ENVIRONMENTS, make_env_config
from pneuma.env.slots import ending_info, make_slots, read_options, read_starts
from pneuma.env.state import LAYOUT_DIGEST, as_bytes
from pneuma.env.watch import Face
from pneuma.errors import UserError


class WholeVecEnv(VecEnv):
    """A vector environment whose attributes and methods apply to all slots at once."""

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        return [getattr(self, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: VecEnvIndices = None, **method_kwargs: Any
    ) -> list[Any]:
        """Call a method for the given slots; `action_masks` returns each slot's own mask."""
        result = getattr(self, method_name)(*method_args, **method_kwargs)
        if method_name == "action_masks":
            return [result[i] for i in self._get_indices(indices)]
        return [result for _ in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: VecEnvIndices = None) -> list[bool]:
        return [False for _ in self._get_indices(indices)]


class PneumaVecEnv(Face, WholeVecEnv):
    """A vector environment of slots that resets ended worlds at once.

    Slot i is player i % players of world i // players. `infos` of a step that ends a slot's episode hold
    `terminal_observation`, `TimeLimit.truncated`, `episode` with the return `r` and length `l`, and how it
    ended. `env_method("action_masks")` serves learners that mask actions.

    Args:
        seeds: one per world; or a number of slots, which is a multiple of the players in a world.
        seed: if `seeds` is a number, world i gets seed + i; default: random.
        env_id: whose presets to start from.
        render_mode: `rgb_array`, one picture of all slots.
        camera: `map`, or `follow` for a view of the player.
        settings: the fields of `pneuma.config.EnvConfig`.

    Raises:
        UserError: for settings that cannot be played.
    """

    def __init__(
        self,
        seeds: int | Sequence[int] = 1,
        *,
        seed: int | None = None,
        env_id: str = ENVIRONMENTS[0],
        render_mode: str | None = None,
        camera: str = "map",
        **settings: object,
    ) -> None:
        config = make_env_config(settings, env_id)
        if isinstance(seeds, int | np.integer):
            self.slots = make_slots(int(seeds), config)
            if seed is not None:
                self.slots.worlds.seed(range(seed, seed + len(self.slots.worlds)))
        elif seed is None:
            self.slots = make_slots(len(seeds) * config.players, config)
            self.slots.worlds.seed(seeds)
        else:
            raise UserError(f"seeds = {seeds}, seed = {seed}: give seeds, or a number of slots and a seed")
        self.state = self.slots.worlds
        self._set_up(self.state, env_id, render_mode, camera)
        self.spec = replace(gymnasium.spec(env_id), kwargs={"env_id": env_id, **settings})
        VecEnv.__init__(self, self.slots.count, self.state.slot_space, self.state.action_space)
        self.metadata = {**Face.metadata, **self.metadata}  # type: ignore[misc]
        self.keep_finished = False
        self.finished: list[dict[str, Any]] = []
        """With `keep_finished`, every episode that has ended since someone last emptied the list."""
        self._steps_taken = np.zeros(1, np.int64)
        self._actions = np.zeros(self.num_envs)

    def reset(self) -> np.ndarray:
        """Start an episode in each world, with the seeds and options set before.

        `set_options({"start": i})` chooses the start place. In a list with one entry per slot, those of the
        first player of each world count.
        """
        by_world = self._options[:: self.slots.players]
        starts = [read_options(options, "start").get("start") for options in by_world]
        first_seed = self._seeds[0]
        if first_seed is not None:
            self.state.seed(range(first_seed, first_seed + len(self.state)))
        self._reset_seeds()
        self._reset_options()
        self.state.reset(starts=read_starts(self.state, starts))
        self.slots.begun = True
        return self.slots.observations

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        slots = self.slots
        dones = slots.step(self._actions)
        rewards = slots.rewards.astype(np.float32)  # a copy: the learner adds to it at time limits
        self._steps_taken += 1
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for slot in np.flatnonzero(dones).tolist():
            infos[slot] = self._final_info(slot)
        ended = slots.world_over
        if ended.any():
            self.state.reset(ended)
        return slots.observations, rewards, dones, infos

    def _final_info(self, slot_index: int) -> dict[str, Any]:
        """Return the info of a slot's last step, and note its episode with `keep_finished`."""
        ending = ending_info(self.state, slot_index)
        book = self.slots.book[slot_index]
        length = int(book["lengths"])
        episode_return = float(book["returns"])
        if self.keep_finished:
            episode = {
                "slot": slot_index,
                "episode": int(book["episodes"]) - 1,
                "step": int(self._steps_taken[0]) * self.num_envs,
                "return": episode_return,
                "length": length,
            }
            self.finished.append(episode | ending)
        world_index, player_index = divmod(slot_index, self.slots.players)
        return {
            **ending,
            "terminal_observation": self.state.observations[world_index, player_index].copy(),
            "TimeLimit.truncated": bool(self.slots.truncated[slot_index]),
            "episode": {"r": episode_return, "l": length},
        }

    def saved_state(self) -> dict[str, np.ndarray]:
        """Copy everything that the next step depends on, including episodes in progress: arrays by name.

        Worlds, players, monsters and events are bytes; `layout` describes them.
        """
        saved = {"layout": np.frombuffer(LAYOUT_DIGEST.encode(), np.uint8)}
        for name, array in self._state_arrays().items():
            saved[name] = array.copy()
        return saved

    def restore_state(self, saved: Mapping[str, np.ndarray]) -> None:
        if saved["layout"].tobytes() != LAYOUT_DIGEST.encode():
            raise ValueError("the state of the worlds was laid out otherwise")
        for name, array in self._state_arrays().items():
            if saved[name].shape != array.shape:
                raise ValueError(f"{name} is of shape {saved[name].shape}, not {array.shape}")
            array[:] = saved[name]
        self.slots.begun = True

    def _state_arrays(self) -> dict[str, np.ndarray]:
        names = ("worlds", "players", "monsters", "events", "observations", "masks")
        arrays = {name: as_bytes(getattr(self.state, name)) for name in names}
        return arrays | self.state.counts() | {"steps_taken": self._steps_taken}

    def action_masks(self) -> np.ndarray:
        """Return which actions would have an effect, (slots, actions) booleans."""
        return self.slots.masks.astype(np.bool_)

    def render(self, mode: str | None = None) -> np.ndarray | None:
        """Return one picture of all slots."""
        return VecEnv.render(self, mode)

    def close(self) -> None:
        """Do nothing: there is nothing to close."""
