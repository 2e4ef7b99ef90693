"""The single environment of Gymnasium: one world, one player."""

from __future__ import annotations

import operator
from typing import Any

import gymnasium
import numpy as np

from pneuma.config import ACTION_NAMES, EnvConfig, read_settings
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError


class PneumaEnv(gymnasium.Env[np.ndarray, np.int64]):
    """PneumaRL as the thesis's text describes it: one player against 14 bamboo monsters.

    ## Description
    A top-down island of snow, field and desert. Monsters notice a player within 300 pixels, chase
    and bite; the player kills them with a sword for experience points (XP).

    ## Action space
    `Discrete(5)`: 0 walk down, 1 left, 2 up, 3 right, 4 attack towards the last direction walked.
    An action lasts 8 ticks of 1/60 s; an attack 24, during which further actions do nothing.

    ## Observation space
    `Box` of 4 + 4 x monsters numbers, float32, all of order one; `pneuma.env.observation` lists them.

    ## Reward
    XP so far minus HP over full HP, at every step (thesis section 5.3).

    ## Start
    One of six places, at random; `reset(options={"start": i})` chooses the i-th.

    ## End
    Terminates when the player's HP are gone, and with `end_on_clear` when every monster is dead;
    truncates after `episode_steps` steps. `info` then holds `ending`, `kills`, `xp` and `hp`.

    ## Arguments
    The fields of `pneuma.config.EnvConfig`: `level`, `reward`, `episode_steps`, `end_on_clear`.

    Raises:
        UserError: at construction, for an argument out of range or a level that cannot be played.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 (Gymnasium's own form)

    def __init__(self, render_mode: str | None = None, **settings: object) -> None:
        if render_mode is not None:
            raise UserError(f"render_mode = {render_mode!r} is not allowed: this environment draws nothing")
        self.state = Worlds(1, EnvConfig(**read_settings(EnvConfig, settings)))
        self.observation_space = self.state.space
        self.action_space = self.state.action_space
        self._actions = np.zeros((1, 1), np.int64)
        self._keyed = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode; see `gymnasium.Env.reset`. The same seed begins the same world."""
        super().reset(seed=seed)
        if seed is not None or not self._keyed:
            self.state.seed([seed if seed is not None else _fresh_seed(self.np_random)])
            self._keyed = True
        self.state.reset(starts=chosen_starts(self.state, options))
        return self.state.observations[0, 0].copy(), {}

    def step(self, action: np.int64) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Play one action; see `gymnasium.Env.step`."""
        index = operator.index(action)
        if not 0 <= index < len(ACTION_NAMES):
            raise ValueError(f"action {action!r} is outside {self.action_space}")
        state = self.state
        self._actions[0, 0] = index
        ended = state.step(self._actions)
        reward = state.events["reward"].item()
        observation = state.observations[0, 0].copy()
        if not ended:
            return observation, reward, False, False, {}
        truncated = state.ending(0) == "time-limit"
        return observation, reward, not truncated, truncated, ending_info(state, 0)


def ending_info(state: Worlds, world: int) -> dict[str, Any]:
    """Say how a world's episode ended, for player 0's `info`."""
    player = state.players[world, 0]
    return {
        "ending": state.ending(world),
        "kills": int(player["kills"]),
        "xp": float(player["xp"]),
        "hp": float(player["hp"]),
    }


def chosen_starts(state: Worlds, options: dict[str, Any] | None) -> np.ndarray | None:
    """Return the start places that reset's options ask for, shape (N,), or None for random ones.

    Raises:
        ValueError: for a place that the level does not have.
    """
    if not options or options.get("start") is None:
        return None
    starts = np.broadcast_to(np.asarray(options["start"], np.int64), (len(state),))
    if starts.min() < 0 or starts.max() >= len(state.level.starts):
        raise ValueError(
            f"start {options['start']!r}: the level has places 0 to {len(state.level.starts) - 1}"
        )
    return np.ascontiguousarray(starts)


def _fresh_seed(generator: np.random.Generator) -> int:
    return int(generator.integers(2**63))
