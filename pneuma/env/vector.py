"""The native vector environment of Gymnasium: N slots, one kernel call a step."""

from __future__ import annotations

import numbers
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from pneuma.config import ENVIRONMENTS, make_env_config
from pneuma.env.showing import ShowsWorld
from pneuma.env.single import chosen_starts, ending_info
from pneuma.env.slots import Slots
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError


class PneumaVectorEnv(ShowsWorld, VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """N worlds as one environment; `PneumaEnv` says what each is.

    World i of a batch reset with seed s is the single world reset with seed s + i, bit for bit. With
    several players to a world, each is a slot: slot i is player i % players of world i // players. A
    slot whose player dies before its world ends idles until then (`pneuma.env.slots`).

    Args:
        num_envs: number of slots, a multiple of the players in a world.
        autoreset_mode: Gymnasium's three. `NEXT_STEP`, its default: the step after an ending
            resets and ignores the action. `SAME_STEP`: the step that ends resets too, and `info`
            holds `final_obs` and `final_info`. `DISABLED`: reset by hand with
            `reset(options={"reset_mask": booleans})`.
        settings: the fields of `pneuma.config.EnvConfig`.
    """

    def __init__(
        self,
        num_envs: int = 1,
        env_id: str = ENVIRONMENTS[0],
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **settings: object,
    ) -> None:
        config = make_env_config(settings, env_id)
        if num_envs < 1 or num_envs % config.players:
            raise UserError(
                f"num_envs = {num_envs} is not allowed: a multiple of the {config.players} players in a world"
            )
        self.num_envs = num_envs
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}  # type: ignore[misc]
        self.state = Worlds(num_envs // config.players, config)
        self.slots = Slots(self.state)
        self._set_up_rendering(render_mode)
        self.single_observation_space = self.state.slot_space
        self.single_action_space = self.state.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.state.action_space, num_envs)
        self._keyed = False
        self._every = np.ones(num_envs, np.bool_)
        self._action_count = int(self.state.action_space.n)
        self._over = np.zeros(len(self.state), np.bool_)
        self._waiting = False

    def reset(
        self,
        *,
        seed: int | Sequence[int] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode in every world, or in those of `options["reset_mask"]`.

        A seed, or one for each world, keys the random streams of the worlds that are reset.
        """
        seeds = self._seeds(seed)
        super().reset(seed=None if seeds is None else seeds[0])
        mask = self._reset_mask(options)
        if seeds is None and not self._keyed:
            seeds = self._seeds(int(self.np_random.integers(2**62)))
        if seeds is not None:
            self.state.seed(seeds, mask)
            self._keyed = True
        self.state.reset(mask, chosen_starts(self.state, options))
        self._over &= ~mask
        self._waiting = bool(self._over.any())
        self._show()
        return self.slots.observations, self._infos()

    def _seeds(self, seed: int | Sequence[int] | None) -> list[int] | None:
        """Return a seed for each world."""
        if seed is None:
            return None
        if isinstance(seed, numbers.Integral):
            return [int(seed) + i for i in range(len(self.state))]
        seeds = [int(own) for own in seed]  # type: ignore[union-attr]
        if len(seeds) != len(self.state):
            raise ValueError(f"{len(seeds)} seeds for {len(self.state)} worlds")
        return seeds

    def _reset_mask(self, options: dict[str, Any] | None) -> np.ndarray:
        """Return which worlds to reset, (N,)."""
        mask = (options or {}).get("reset_mask")
        if mask is None:
            return np.ones(len(self.state), np.bool_)
        if not (isinstance(mask, np.ndarray) and mask.dtype == np.bool_ and mask.shape == (self.num_envs,)):
            raise TypeError(f"reset_mask must be an array of {self.num_envs} booleans, not {mask!r}")
        return np.asarray(mask.reshape(len(self.state), -1).any(axis=1))

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Play one action in every slot; see `gymnasium.vector.VectorEnv.step`."""
        actions = self._checked(actions)
        if self.autoreset_mode == AutoresetMode.DISABLED and self._waiting:
            raise ValueError("some worlds have ended: reset them with options={'reset_mask': …} first")
        slots = self.slots
        ended = slots.step(actions)
        if self._waiting:  # NEXT_STEP: this step resets what the last one ended
            self.state.reset(self._over)
        rewards = slots.rewards.copy()
        terminated, truncated = slots.terminated.copy(), slots.truncated.copy()
        infos = self._final(terminated | truncated) if ended else {}
        self._waiting = ended and bool(slots.world_over.any())
        if self.autoreset_mode != AutoresetMode.SAME_STEP:
            self._over = slots.world_over.copy()
        elif self._waiting:
            self.state.reset(slots.world_over)
            self._waiting = False
        self._show()
        return slots.observations, rewards, terminated, truncated, self._infos(infos)

    def _checked(self, actions: np.ndarray) -> np.ndarray:
        """Return actions as the rules take them, (slots,) int64.

        Raises:
            ValueError: for what is no action.
        """
        given = np.asarray(actions)
        if given.dtype.kind not in "iu":
            raise ValueError(f"actions {given} are outside {self.action_space}: not whole numbers")
        whole = np.ascontiguousarray(given, np.int64).reshape(self.num_envs)
        if whole.view(np.uint64).max() >= self._action_count:  # what is below zero is huge without its sign
            raise ValueError(f"actions {given} are outside {self.action_space}")
        return whole

    def _infos(self, infos: dict[str, Any] | None = None) -> dict[str, Any]:
        """Add every slot's action mask to the infos."""
        return {
            "action_mask": self.slots.masks,
            "_action_mask": self._every.copy(),
            **(infos or {}),
        }

    def _final(self, over: np.ndarray) -> dict[str, Any]:
        """Return the infos of the slots that ended, in Gymnasium's form for this autoreset mode."""
        infos: dict[str, Any] = {}
        for slot in np.flatnonzero(over):
            world, player = divmod(int(slot), self.slots.players)
            info = ending_info(self.state, world, player)
            if self.autoreset_mode == AutoresetMode.SAME_STEP:
                final = self.state.observations[world, player].copy()
                mask = self.state.masks[world, player].copy()
                info = {"final_obs": final, "final_info": {"action_mask": mask, **info}}
            infos = self._add_info(infos, info, int(slot))
        return infos
