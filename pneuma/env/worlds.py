"""N worlds side by side: owns their state and drives the rules.

Every face (single, vector, Stable-Baselines3) is a thin layer over `Worlds`, so all of them give
the same bits for the same seeds and actions.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding

from pneuma.config import ACTION_NAMES, EnvConfig
from pneuma.env import characters, rules, state
from pneuma.env.level import load_level, room_for_bodies
from pneuma.env.observation import fill_scales, observation_space
from pneuma.errors import UserError

ENDINGS = ("running", "killed", "cleared", "time-limit")
"""Names of `rules.RUNNING`, `KILLED`, `CLEARED` and `TIME_LIMIT`."""


class Worlds:
    """The state of `count` independent worlds with `players` players each.

    Attributes:
        worlds, players, monsters: the whole state, shapes (N,), (N, P) and (N, M), with the dtypes
            `state.WORLD`, `PLAYER` and `MONSTER`; copy them, put them back, and the worlds go on
            as they would have.
        events: (N, P) `state.EVENTS`, what the last step did, the reward among it.
        observations: (N, P, features) float32, overwritten by every step.
    """

    def __init__(self, count: int, config: EnvConfig | None = None, players: int = 1) -> None:
        if not 1 <= players <= state.MAX_PLAYERS:
            raise UserError(f"players = {players} is not allowed: 1 to {state.MAX_PLAYERS} to a world")
        config = config or EnvConfig()
        self.config = config
        self.level = load_level(config.level, characters.monster_codes())
        self.player_stats = characters.player_stats(("base",) * players)
        self.monster_stats = characters.monster_stats(self.level, self.player_stats)
        self.space = observation_space(self.level, self.monster_stats)
        self.action_space = spaces.Discrete(len(ACTION_NAMES))
        self.settings = self._settings(config)
        self.worlds = np.zeros(count, state.WORLD)
        self.players = np.zeros((count, players), state.PLAYER)
        self.monsters = np.zeros((count, len(self.monster_stats)), state.MONSTER)
        self.events = np.zeros((count, players), state.EVENTS)
        self.observations = np.zeros((count, players, *self.space.shape), np.float32)
        margin = characters.margin(self.player_stats, self.monster_stats)
        self._arrays = state.State(
            self.worlds,
            self.players,
            self.monsters,
            self.player_stats,
            self.monster_stats,
            self.settings,
            self.level.terrain,
            room_for_bodies(self.level, margin),
            self.events,
            self.observations,
            np.zeros(len(self.monster_stats), state.SCRATCH),
        )
        self._every = np.ones(count, np.bool_)
        self._anywhere = np.full(count, -1, np.int64)

    def __len__(self) -> int:
        """Return the number of worlds."""
        return len(self.worlds)

    def _settings(self, config: EnvConfig) -> np.ndarray:
        settings = np.zeros(1, state.SETTINGS)
        row = settings[0]
        row["left"], row["top"], row["tile"] = self.level.left, self.level.top, self.level.tile
        row["cells_per_pixel"] = 2 / self.level.tile
        row["ticks"] = characters.TICKS_PER_STEP
        row["step_limit"] = config.episode_steps
        row["end_on_clear"] = config.end_on_clear
        fill_scales(row, self.level, self.monster_stats)
        return settings

    def seed(self, seeds: Sequence[int], mask: np.ndarray | None = None) -> None:
        """Key the random stream of every world, or of those of `mask`, by its own seed.

        Equal seeds make equal worlds.
        """
        for world in np.flatnonzero(self._every if mask is None else mask):
            self.worlds["key"][world] = world_key(seeds[int(world)])
            self.worlds["draws"][world] = 0

    def reset(self, mask: np.ndarray | None = None, starts: np.ndarray | None = None) -> None:
        """Begin an episode in all worlds, or in those of `mask`, and observe all.

        Args:
            mask: (N,) booleans.
            starts: (N,) indices of start places; below zero, or left out, drawn at random.
        """
        rules.reset_worlds(
            *self._arrays[:5],
            self.level.starts,
            self._anywhere if starts is None else starts,
            self._every if mask is None else mask,
        )
        rules.observe_worlds(*self._arrays)

    def step(self, actions: np.ndarray) -> int:
        """Advance every running world; return how many episodes ended with this step.

        Args:
            actions: (N, P) whole numbers below 5, trusted.
        """
        return int(rules.step_worlds(*self._arrays, actions))

    def ending(self, world: int) -> str:
        """Name how a world's episode ended, or 'running'."""
        return ENDINGS[self.worlds["ending"][world]]


def world_key(seed: int) -> int:
    """Return the key of the random stream of the world seeded `seed`."""
    return int(seeding.np_random(seed)[0].integers(2**64, dtype=np.uint64))
