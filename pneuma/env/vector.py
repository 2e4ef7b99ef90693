"""The native vector environment of Gymnasium: N worlds, one player each, one kernel call a step."""

from __future__ import annotations

import numbers
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from pneuma.config import EnvConfig, read_settings
from pneuma.env.single import chosen_starts, ending_info
from pneuma.env.worlds import Worlds


class PneumaVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """N worlds of `pneuma/Pneuma-v0` as one environment; `PneumaEnv` says what each is.

    World i of a batch reset with seed s is the single world reset with seed s + i, bit for bit.

    Args:
        num_envs: number of worlds.
        autoreset_mode: Gymnasium's three. `NEXT_STEP`, its default: the step after an ending
            resets and ignores the action. `SAME_STEP`: the step that ends resets too, and `info`
            holds `final_obs` and `final_info`. `DISABLED`: reset by hand with
            `reset(options={"reset_mask": booleans})`.
        settings: the fields of `pneuma.config.EnvConfig`.
    """

    def __init__(
        self,
        num_envs: int = 1,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **settings: object,
    ) -> None:
        self.num_envs = num_envs
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {"autoreset_mode": self.autoreset_mode, "render_modes": []}
        self.render_mode = render_mode
        self.state = Worlds(num_envs, EnvConfig(**read_settings(EnvConfig, settings)))
        self.single_observation_space = self.state.space
        self.single_action_space = self.state.action_space
        self.observation_space = batch_space(self.state.space, num_envs)
        self.action_space = batch_space(self.state.action_space, num_envs)
        self._keyed = False
        self._over = np.zeros(num_envs, np.bool_)

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
        return self.state.observations[:, 0].copy(), {}

    def _seeds(self, seed: int | Sequence[int] | None) -> list[int] | None:
        """Return a seed for each world."""
        if seed is None:
            return None
        if isinstance(seed, numbers.Integral):
            return [int(seed) + i for i in range(self.num_envs)]
        seeds = [int(own) for own in seed]  # type: ignore[union-attr]
        if len(seeds) != self.num_envs:
            raise ValueError(f"{len(seeds)} seeds for {self.num_envs} worlds")
        return seeds

    def _reset_mask(self, options: dict[str, Any] | None) -> np.ndarray:
        """Return which worlds to reset, (N,)."""
        mask = (options or {}).get("reset_mask")
        if mask is None:
            return np.ones(self.num_envs, np.bool_)
        if not (isinstance(mask, np.ndarray) and mask.dtype == np.bool_ and mask.shape == (self.num_envs,)):
            raise TypeError(f"reset_mask must be an array of {self.num_envs} booleans, not {mask!r}")
        return mask

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Play one action in every world; see `gymnasium.vector.VectorEnv.step`."""
        actions = np.asarray(actions, np.int64).reshape(self.num_envs, 1)
        if actions.min() < 0 or actions.max() > 4:
            raise ValueError(f"actions {actions.ravel()} are outside {self.action_space}")
        state = self.state
        waiting = self._over.copy()
        if self.autoreset_mode == AutoresetMode.DISABLED and waiting.any():
            raise ValueError("some worlds have ended: reset them with options={'reset_mask': …} first")
        ended = state.step(actions)
        if waiting.any():  # NEXT_STEP: this step resets what the last one ended
            state.reset(waiting)
        rewards = state.events["reward"][:, 0].copy()
        over = (state.worlds["ending"] != 0) if ended else np.zeros(self.num_envs, np.bool_)
        truncated = over & (state.worlds["ending"] == 3)
        infos = self._final(over) if ended else {}
        if ended and self.autoreset_mode == AutoresetMode.SAME_STEP:
            state.reset(over)
        else:
            self._over = over
        return state.observations[:, 0].copy(), rewards, over & ~truncated, truncated, infos

    def _final(self, over: np.ndarray) -> dict[str, Any]:
        """Return the infos of the worlds that ended, in Gymnasium's form for this autoreset mode."""
        infos: dict[str, Any] = {}
        for world in np.flatnonzero(over):
            info = ending_info(self.state, int(world))
            if self.autoreset_mode == AutoresetMode.SAME_STEP:
                final = self.state.observations[world, 0].copy()
                info = {"final_obs": final, "final_info": info}
            infos = self._add_info(infos, info, int(world))
        return infos
