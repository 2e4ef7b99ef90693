"""N worlds in parallel: their state, the calls to the rules, and their players as slots.

Every interface (Gymnasium's, PettingZoo's, Stable-Baselines3's) is a thin layer over `Worlds`, so all of them
give the same bits for the same seeds and actions.
"""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding

from pneuma.env import fields, kernel, rules, state
from pneuma.env.characters import (
    TICKS_PER_SECOND,
    TICKS_PER_STEP,
    greatest_speed,
    load_characters,
    make_monster_stats,
    make_player_stats,
    monster_codes,
)
from pneuma.env.fields import EnvConfig, make_env_config
from pneuma.env.layouts import fill_scales, observation_space
from pneuma.env.level import Level, refuse_stuck_bodies
from pneuma.env.load_level import load_levels
from pneuma.env.reward import OwnReward
from pneuma.errors import UserError

ENDINGS = ("running", "killed", "cleared", "time-limit")
"""Names of `rules.RUNNING`, `KILLED`, `CLEARED` and `TIME_LIMIT`."""


class Worlds:
    """The state of `count` independent worlds, each with the configuration's players.

    Attributes:
        worlds, players, monsters: the whole state, shapes (N,), (N, P) and (N, M), with the dtypes
            `state.WORLD`, `PLAYER` and `MONSTER`.
        events: (N, P) `state.EVENTS`, the events of the last step, with the reward.
        observations: (N, P, features) float32, overwritten by every step.
        masks: (N, P, actions) int8, 0 if an action would do nothing in the next step, also of the dead.
        slots, tallies, action_counts: statistics of the episodes in progress: (N, P) `state.SLOT`, (N,)
            `TALLY`, and how often each action was chosen, (N, actions).
        levels: the levels played; one, unless random ones are drawn.
        truncates: whether the time limit truncates episodes, or terminates them.
        default_starts: (N,) the default start places; negative ones are drawn at random.
        player_stats, monster_stats: (P,) and (L, M), the numbers that the rules read.
        handle: the argument of the compiled rules; see `state.make_handle`.
    """

    def __init__(self, count: int, config: EnvConfig | None = None) -> None:
        config = self.config = config or make_env_config({})
        characters = load_characters(config.characters)
        classes = np.broadcast_to(config.classes, config.players).tolist()
        self.player_stats = make_player_stats(characters, classes)
        if config.attack_ticks:
            self.player_stats["swing"] = config.attack_ticks
        self.action_names: tuple[str, ...] = fields.ACTION_NAMES
        if config.magic:
            self.action_names += fields.SPELL_NAMES
        self.levels = load_levels(config, monster_codes(characters))
        self.monster_stats = make_monster_stats(characters, self.levels, self.player_stats, config.magic)
        for level, level_stats in zip(self.levels, self.monster_stats, strict=True):
            refuse_stuck_bodies(level, self.player_stats, level_stats, config)
        self._reward_names = np.broadcast_to(config.reward, config.players)
        self.player_stats["reward"] = -1
        for formula, reward_name in enumerate(fields.REWARDS):
            self.player_stats["reward"][self._reward_names == reward_name] = formula
        own_names = dict.fromkeys(filter(fields.is_own_reward, config.reward))
        self._own_rewards = [OwnReward(reward_name) for reward_name in own_names]
        self.settings = self._settings(config)
        settings = self.settings[0]
        fill_scales(config, self.levels, settings, self.player_stats, self.monster_stats)
        self.spaces = [
            observation_space(config, self.level, settings, player_stats, self.monster_stats)
            for player_stats in self.player_stats
        ]
        self._actions = len(self.action_names)
        self.action_space = spaces.Discrete(self._actions)
        self._allocate(count)
        self._try_rewards()

    def _allocate(self, count: int) -> None:
        """Make the arrays of all worlds, in which no episode has begun."""
        (players,) = self.player_stats.shape
        levels, monsters = self.monster_stats.shape
        first_players = np.zeros(players, state.PLAYER)
        first_players["hp"] = self.player_stats["hp"]
        first_players["energy"] = self.player_stats["energy"]
        first_monsters = np.zeros((levels, monsters), state.MONSTER)
        first_monsters["hp"] = self.monster_stats["hp"]
        for level_row, level in zip(first_monsters, self.levels, strict=True):
            level_row["x"] = [monster.x for monster in level.monsters]
            level_row["y"] = [monster.y for monster in level.monsters]
        no_events = np.zeros(1, state.EVENTS)
        no_events["distance"] = np.inf
        constants = {
            "player_stats": self.player_stats,
            "monster_stats": self.monster_stats,
            "settings": self.settings,
            "terrain": np.array([level.terrain for level in self.levels]),
            "starts": np.array([level.starts for level in self.levels]),
            "first_players": first_players,
            "first_monsters": first_monsters,
            "no_events": no_events,
        }
        sizes = {
            "N": count,
            "P": players,
            "M": monsters,
            "B": players + monsters,
            "A": self._actions,
            "F": self.space.shape[0],
            "1": 1,
        }
        arrays = self._arrays = state.allocate(constants, sizes)
        self.worlds, self.players, self.monsters = arrays.worlds, arrays.players, arrays.monsters
        self.events, self.observations, self.masks = arrays.events, arrays.observations, arrays.masks
        self.slots, self.tallies, self.action_counts = arrays.slots, arrays.tallies, arrays.action_counts
        entropy = np.random.SeedSequence()
        self.worlds["key"] = entropy.generate_state(count, np.uint64)  # until they are seeded
        self.players[:] = first_players
        self.players["x"], self.players["y"] = self.level.starts[0]  # on the grid, also before a reset
        self.events[:] = no_events
        self.slots["begins"] = 1.0
        self.truncates = self.config.time_limit == "truncate"
        self._no_actions = np.zeros((count, players), np.int64)  # which a reset does not read
        self._take_addresses()
        self.default_starts = np.zeros(count, np.int64)
        if self.config.start == "random":
            self.default_starts[:] = -1

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the addresses, as the arrays of a copy lie elsewhere."""
        return {attribute: value for attribute, value in vars(self).items() if attribute not in _ADDRESSES}

    def __setstate__(self, attributes: dict[str, Any]) -> None:
        vars(self).update(attributes)
        self._take_addresses()

    def _take_addresses(self) -> None:
        self.handle = state.make_handle(self._arrays)
        self._address = self.handle.ctypes.data
        kernel.load_rules()
        self._read_only = (
            state.read_only(self.events),
            state.read_only(self.players),
            state.read_only(self.player_stats),
        )

    def __len__(self) -> int:
        return len(self.worlds)

    @property
    def level(self) -> Level:
        """The first level, or the only one."""
        return self.levels[0]

    @property
    def space(self) -> spaces.Box:
        """The observation space of player 0."""
        return self.spaces[0]

    @property
    def slot_space(self) -> spaces.Box:
        """A space for the observations of any player."""
        low = np.min([space.low for space in self.spaces], axis=0)
        high = np.max([space.high for space in self.spaces], axis=0)
        return spaces.Box(low, high, dtype=np.float32)

    def _settings(self, config: EnvConfig) -> np.ndarray:
        settings = np.zeros(1, state.SETTINGS)
        settings_row = settings[0]
        settings_row["corner"] = self.level.left, self.level.top
        settings_row["tile"] = self.level.tile
        settings_row["ticks"] = TICKS_PER_STEP
        settings_row["episode_steps"] = config.episode_steps
        settings_row["end_on_clear"] = config.end_on_clear
        settings_row["ending_cost"] = config.ending_cost
        settings_row["magic"] = config.magic
        settings_row["observe_facing"] = config.observe_facing
        settings_row["hit_on_entry"] = config.blow == "entry"
        settings_row["credit_near"] = config.kill_credit == "near"
        settings_row["keep_xp"] = config.xp_scope == "forever"
        settings_row["shared_reward"] = config.shared_reward
        stops = 1 << rules.COAST
        if config.trees == "wall":
            stops |= 1 << rules.SOLID
        settings_row["player_stops"] = stops
        if config.terrain_stops == "all":
            settings_row["monster_stops"] = stops
        fastest = greatest_speed(self.player_stats, self.monster_stats)
        settings_row["body_reach"] = 2 * (self._largest_body() + fastest * TICKS_PER_STEP) + 1.0
        if fastest > self.level.tile:
            speed = fastest * TICKS_PER_SECOND
            raise UserError(f"a speed of {speed:g} px/s jumps over tiles of {self.level.tile:g} px")
        return settings

    def _largest_body(self) -> float:
        """Return how far a body reaches from its position, on x or y, in pixels."""
        largest = 0.0
        for body_stats in (self.player_stats, self.monster_stats):
            for middle, half in (("body_x", "half_width"), ("body_y", "half_height")):
                reach = abs(body_stats[middle]) + body_stats[half]
                largest = max(largest, float(reach.max(initial=0.0)))
        return largest

    def seed(self, seeds: Sequence[int | None]) -> None:
        """Seed the random stream of each world; with None it goes on.

        Equal seeds make equal worlds; XP that outlives episodes starts again from 0.
        """
        for world, world_seed in enumerate(seeds):
            if world_seed is not None:
                generator, _ = seeding.np_random(operator.index(world_seed))
                self.worlds["key"][world] = generator.integers(2**64, dtype=np.uint64)
                self.worlds["draws"][world] = 0
                self.players["xp"][world] = 0.0

    def reset(self, mask: np.ndarray | bool = True, starts: np.ndarray | None = None) -> None:
        """Start an episode in all worlds, or in those of `mask`, and observe all.

        Args:
            mask: (N,) booleans; True for all.
            starts: (N,) indices of start places; below zero, drawn at random.

        Raises:
            ValueError: for arrays of a wrong shape, or an unknown start place.
        """
        if starts is None:
            starts = self.default_starts
        start_count = len(self.level.starts)
        if starts.max() >= start_count:
            raise ValueError(f"start {starts.max()} is not one of the level's {start_count}")
        self._begin(np.where(mask, np.maximum(starts, -1), kernel.GO_ON))

    def step(self, actions: np.ndarray) -> int:
        """Advance all running worlds; return how many episodes ended.

        Args:
            actions: (N, P) whole numbers of the action space, or as many in another shape.

        Raises:
            ValueError: for anything else.
        """
        action_array = np.asarray(actions)
        if action_array.dtype.kind in "iu" and action_array.size == self.players.size:
            by_player = np.ascontiguousarray(action_array, np.int64).reshape(self.players.shape)
            if by_player.view(np.uint64).max() < self._actions:  # negative numbers are huge as unsigned ones
                return self.advance(by_player)
        raise ValueError(f"actions {action_array} are outside {self.players.size} of {self.action_space}")

    def advance(self, actions: np.ndarray) -> int:
        """Do the same as `step` for actions that are known to be valid, (N, P) int64."""
        if not self._own_rewards:
            return int(kernel.call_rules(self._address, actions, kernel.STEP | kernel.RECORD))
        ended = int(kernel.call_rules(self._address, actions, kernel.STEP))
        for own_reward in self._own_rewards:
            is_paid = self._reward_names == own_reward.name
            self.events["reward"][:, is_paid] = own_reward.pay(*self._read_only)[:, is_paid]
        kernel.call_rules(self._address, actions, kernel.RECORD)
        return ended

    def _begin(self, starts: Any) -> None:
        """Reset worlds at these start places, those with `kernel.GO_ON` excepted, and observe all."""
        self._arrays.reset_starts[:] = starts
        kernel.call_rules(self._address, self._no_actions, kernel.RESET)

    def _try_rewards(self) -> None:
        """Call each user's reward once, as after a step in which nothing happened."""
        quiet_events = self.events.copy()
        quiet_events["present"] = self.settings["ticks"][0]
        for own_reward in self._own_rewards:
            own_reward.pay(state.read_only(quiet_events), *self._read_only[1:])

    @property
    def present(self) -> np.ndarray:
        """Which players were alive before the last step, (N, P)."""
        return np.asarray(self.events["present"] > 0)

    @property
    def truncated(self) -> np.ndarray:
        """Which worlds ended by a time limit that truncates, (N,)."""
        return np.asarray((self.worlds["ending"] == rules.TIME_LIMIT) & self.truncates)

    def ending(self, world: int) -> str:
        """Return how a world's episode ended, or 'running'."""
        return ENDINGS[self.worlds["ending"][world]]

    def observe(self) -> None:
        """Write all observations and masks from the current state, which may have been changed by hand.

        Counts of players and monsters that are alive are updated.
        """
        self.worlds["monsters_left"] = (self.monsters["hp"] > 0).sum(axis=1)
        self.worlds["players_left"] = (self.players["hp"] > 0).sum(axis=1)
        self._begin(kernel.GO_ON)


_ADDRESSES = ("handle", "_address", "_read_only")
"""Attributes of `Worlds` that are valid in one process only."""
