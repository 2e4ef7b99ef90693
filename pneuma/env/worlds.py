"""N worlds side by side: owns their state and drives the rules.

Every face (single, vector, parallel, Stable-Baselines3) is a thin layer over `Worlds`, so all of them
give the same bits for the same seeds and actions.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding

from pneuma.config import ACTION_NAMES, SPELL_NAMES, EnvConfig, make_env_config
from pneuma.env import characters, rules, state
from pneuma.env.level import Level, load_level, room_for_bodies
from pneuma.env.observation import fill_scales, observation_space
from pneuma.env.reward import custom_rewards, load_reward, reward_code
from pneuma.errors import UserError

ENDINGS = ("running", "killed", "cleared", "time-limit")
"""Names of `rules.RUNNING`, `KILLED`, `CLEARED` and `TIME_LIMIT`."""


@dataclass(frozen=True)
class Snapshot:
    """The whole state of some worlds: what they need to go on as they would have.

    Attributes:
        worlds, players, monsters: (N,), (N, P) and (N, M), as in `Worlds`.
    """

    worlds: np.ndarray
    players: np.ndarray
    monsters: np.ndarray


class Worlds:
    """The state of `count` independent worlds, each with the configuration's players.

    Attributes:
        worlds, players, monsters: the whole state, shapes (N,), (N, P) and (N, M), with the dtypes
            `state.WORLD`, `PLAYER` and `MONSTER`.
        events: (N, P) `state.EVENTS`, what the last step did, the reward among it.
        observations: (N, P, features) float32, overwritten by every step.
        masks: (N, P, actions) int8, 0 where an action would do nothing in the next step.
        levels: the levels played; one, unless random ones are drawn.
        player_stats, monster_stats: (P,) and (L, M), what the rules read.

    Raises:
        UserError: for a configuration that cannot be played.
    """

    def __init__(self, count: int, config: EnvConfig | None = None) -> None:
        config = config or make_env_config({})
        self.config = config
        cast = characters.load_characters(config.characters)
        self.levels = _load_levels(config, characters.monster_codes(cast))
        self.player_stats = characters.player_stats(
            cast, _one_each(config.classes, config), _one_each(config.weapons, config)
        )
        rewards = _one_each(config.reward, config)
        self.player_stats["reward"] = [reward_code(name) for name in rewards]
        self._custom = [(p, name, load_reward(name)) for p, name in enumerate(rewards) if ":" in name]
        self.monster_stats = np.stack(
            [characters.monster_stats(cast, level, self.player_stats, config.magic) for level in self.levels]
        )
        for level, kinds in zip(self.levels, self.monster_stats, strict=True):
            _refuse_bodies_off_the_grid(level, self.player_stats, kinds)
        self.settings = self._settings(config)
        fill_scales(self.settings[0], self.player_stats, self.monster_stats, config, self.levels)
        self.spaces = [
            observation_space(self.settings[0], player, self.monster_stats, config, self.levels)
            for player in self.player_stats
        ]
        names = ACTION_NAMES + (SPELL_NAMES if config.magic else ())
        self.action_space = spaces.Discrete(len(names))
        self._allocate(count, len(names))

    def _allocate(self, count: int, actions: int) -> None:
        players, monsters = len(self.player_stats), self.monster_stats.shape[1]
        margin = characters.margin(self.player_stats, self.monster_stats.ravel())
        ticks = int(self.settings["ticks"][0])
        self.worlds = np.zeros(count, state.WORLD)
        self.players = np.zeros((count, players), state.PLAYER)
        self.monsters = np.zeros((count, monsters), state.MONSTER)
        self.events = np.zeros((count, players), state.EVENTS)
        self.events["distance"] = np.inf
        self.observations = np.zeros((count, players, *self.space.shape), np.float32)
        self.masks = np.zeros((count, players, actions), np.int8)
        self._arrays = state.State(
            self.worlds,
            self.players,
            self.monsters,
            self.player_stats,
            self.monster_stats,
            self.settings,
            np.ascontiguousarray([level.terrain for level in self.levels]),
            np.ascontiguousarray([room_for_bodies(level, margin) for level in self.levels]),
            np.ascontiguousarray([level.starts for level in self.levels]),
            self.events,
            self.observations,
            self.masks,
            np.zeros((ticks, players), state.PATH),
            np.zeros((ticks, players), state.LEDGER),
            np.zeros(monsters, state.MONSTER),
            np.zeros(monsters, state.SCRATCH),
            np.zeros(1, state.CHASE),
        )
        self._handle = state.make_handle(self._arrays)
        self._every = np.ones(count, np.bool_)
        self._no_actions = np.zeros((count, players), np.int64)
        start = -1 if self.config.start == "random" else 0
        self._usual_starts = np.full(count, start, np.int64)

    def __getstate__(self) -> dict[str, Any]:
        """Leave the addresses behind: a copy's arrays lie elsewhere."""
        return {
            name: value for name, value in self.__dict__.items() if name not in ("_handle", "_arrays")
        } | {"_rest": tuple(self._arrays[3:])}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        """Take the copied arrays and note their addresses."""
        rest = kept.pop("_rest")
        self.__dict__.update(kept)
        self._arrays = state.State(self.worlds, self.players, self.monsters, *rest)
        self.player_stats, self.monster_stats, self.settings = rest[:3]
        self.events, self.observations, self.masks = rest[6:9]
        self._handle = state.make_handle(self._arrays)

    def __len__(self) -> int:
        """Return the number of worlds."""
        return len(self.worlds)

    @property
    def level(self) -> Level:
        """The first level, or the only one."""
        return self.levels[0]

    @property
    def space(self) -> spaces.Box:
        """What player 0 observes."""
        return self.spaces[0]

    @property
    def slot_space(self) -> spaces.Box:
        """What any of the players may observe."""
        low = np.min([space.low for space in self.spaces], axis=0)
        return spaces.Box(low, np.max([space.high for space in self.spaces], axis=0), dtype=np.float32)

    def _settings(self, config: EnvConfig) -> np.ndarray:
        settings = np.zeros(1, state.SETTINGS)
        row = settings[0]
        row["left"], row["top"], row["tile"] = self.level.left, self.level.top, self.level.tile
        row["cells_per_pixel"] = 2 / self.level.tile
        row["ticks"] = characters.TICKS_PER_STEP
        row["step_limit"] = config.episode_steps
        row["end_on_clear"] = config.end_on_clear
        row["deadly_coast"] = config.coast == "deadly"
        row["credit_near"] = config.kill_credit == "near"
        row["ending_cost"] = config.ending_cost
        row["keep_xp"] = config.xp_scope == "forever"
        row["magic"] = config.magic
        fastest = max(self.player_stats["speed"].max(), self.player_stats["knock_speed"].max())
        for name in ("speed", "knock_speed"):
            fastest = max(fastest, self.monster_stats[name].max(initial=0.0))
        if fastest > self.level.tile:
            raise UserError(f"a speed of {fastest * 60:g} px/s jumps over tiles of {self.level.tile:g} px")
        return settings

    def seed(self, seeds: Sequence[int], mask: np.ndarray | None = None) -> None:
        """Key the random stream of every world, or of those of `mask`, by its own seed.

        Equal seeds make equal worlds; XP that outlives episodes starts again from 0.
        """
        for world in np.flatnonzero(self._every if mask is None else mask):
            self.worlds["key"][world] = world_key(int(seeds[int(world)]))
            self.worlds["draws"][world] = 0
            self.players["xp"][world] = 0.0

    def reset(self, mask: np.ndarray | None = None, starts: np.ndarray | None = None) -> None:
        """Begin an episode in all worlds, or in those of `mask`, and observe all.

        Args:
            mask: (N,) booleans.
            starts: (N,) indices of start places; below zero, drawn at random.
        """
        usual = self._usual_starts if starts is None else starts
        rules.reset_worlds(self._handle, usual, self._every if mask is None else mask)
        self.observe()

    def step(self, actions: np.ndarray) -> int:
        """Advance every running world; return how many episodes ended with this step.

        Args:
            actions: (N, P) whole numbers of the action space, trusted.
        """
        ended = int(rules.step_worlds(self._handle, actions, False))
        for player, name, function in self._custom:
            rewards = custom_rewards(function, name, self.events, self.players, self.player_stats)
            self.events["reward"][:, player] = rewards[:, player]
        return ended

    @property
    def present(self) -> np.ndarray:
        """Which players were alive when the last step began, (N, P)."""
        return (self.events["present"] > 0) | (self.events["died"] > 0)

    @property
    def truncated(self) -> np.ndarray:
        """Which worlds a time limit that truncates has ended, (N,)."""
        limit = self.worlds["ending"] == rules.TIME_LIMIT
        return limit if self.config.time_limit == "truncate" else np.zeros_like(limit)

    def ending(self, world: int) -> str:
        """Name how a world's episode ended, or 'running'."""
        return ENDINGS[self.worlds["ending"][world]]

    # --- Saving and restoring ---------------------------------------------------------------------

    def save(self, world: int) -> Snapshot:
        """Return a copy of one world's state; it can be pickled, sent and restored elsewhere."""
        one = slice(world, world + 1)
        return Snapshot(self.worlds[one].copy(), self.players[one].copy(), self.monsters[one].copy())

    def restore(self, world: int, snapshot: Snapshot) -> None:
        """Put a saved state into one world, of this or of another `Worlds` of equal configuration.

        The world goes on as the saved one would have. Its observation is that of the next step;
        `observe` writes it at once.

        Raises:
            ValueError: for a state of other numbers of players or monsters.
        """
        for name in ("players", "monsters"):
            own, other = getattr(self, name).shape[1], getattr(snapshot, name).shape[1]
            if own != other:
                raise ValueError(f"a state of {other} {name} does not fit a world of {own}")
        self.worlds[world] = snapshot.worlds[0]
        self.players[world] = snapshot.players[0]
        self.monsters[world] = snapshot.monsters[0]

    def observe(self) -> None:
        """Write all observations and masks from the state as it is."""
        rules.step_worlds(self._handle, self._no_actions, True)


def world_key(seed: int) -> int:
    """Return the key of the random stream of the world seeded `seed`."""
    return int(seeding.np_random(seed)[0].integers(2**64, dtype=np.uint64))


def _one_each(names: tuple[str, ...], config: EnvConfig) -> tuple[str, ...]:
    return names * config.players if len(names) == 1 else names


def _refuse_bodies_off_the_grid(level: Level, players: np.ndarray, monsters: np.ndarray) -> None:
    """Refuse a level in which a body would begin beyond the grid: the rules look up tiles unchecked.

    Raises:
        UserError: naming the start place or the monster.
    """
    rows, columns = level.terrain.shape
    edges = (level.left, level.top, level.left + columns * level.tile, level.top + rows * level.tile)
    bodies = [
        (f"start place {i}", x, y, players["half_width"].max(), players["half_height"].max())
        for i, (x, y) in enumerate(level.starts)
    ]
    bodies += [
        (f"monster {i} ({name})", x, y, kind["half_width"], kind["half_height"])
        for i, ((name, x, y), kind) in enumerate(zip(level.monsters, monsters, strict=True))
    ]
    for who, x, y, half_width, half_height in bodies:
        inside = edges[0] <= x - half_width and x + half_width <= edges[2]
        if not inside or y - half_height < edges[1] or y + half_height > edges[3]:
            raise UserError(
                f"level {level.name}: {who} at ({x:g}, {y:g}) has a body of {2 * half_width:g} x "
                f"{2 * half_height:g} px, which reaches beyond the grid"
            )


def _load_levels(config: EnvConfig, codes: dict[int, str]) -> list[Level]:
    """Load the level, or as many random ones as asked for, numbered from the first on."""
    if config.random_levels == 1:
        return [load_level(config.level, codes)]
    first, _, number = config.level.rpartition(":")
    if not number.isdigit():
        return [load_level(config.level, codes)]  # says what is wrong with the name
    return [load_level(f"{first}:{int(number) + i}", codes) for i in range(config.random_levels)]
