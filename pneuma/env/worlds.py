"""N worlds in parallel: their state, the calls to the rules, and their players as slots.

Every interface (Gymnasium's, PettingZoo's, Stable-Baselines3's) is a thin layer over `Worlds`, so all of them
give the same bits for the same seeds and actions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils import seeding

from pneuma.env import characters, fields, kernel, rules, state
from pneuma.env.fields import EnvConfig, make_env_config
from pneuma.env.layouts import fill_scales, observation_space
from pneuma.env.level import Level, refuse_bad_places
from pneuma.env.load_level import load_levels
from pneuma.env.reward import custom_rewards, load_reward, present
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
        masks: (N, P, actions) int8, 0 if an action would do nothing in the next step; the dead count as
            alive.
        slots, tallies, taken: the book of the episodes in progress: (N, P) `state.SLOT`, (N,) `TALLY`, and
            how often each action was taken, (N, actions).
        levels: the levels played; one, unless random ones are drawn.
        usual_starts: (N,) the default start places; negative ones are drawn at random.
        player_stats, monster_stats: (P,) and (L, M), the numbers that the rules read.
        handle: the argument of the compiled rules; see `state.make_handle`.
    """

    def __init__(self, count: int, config: EnvConfig | None = None) -> None:
        config = self.config = make_env_config(vars(config or EnvConfig()))  # checked, however it was made
        cast = characters.load_characters(config.characters)
        self.player_stats = characters.player_stats(cast, _one_each(config.classes, config))
        if config.attack_ticks:
            self.player_stats["swing"] = config.attack_ticks
        self.action_names = fields.action_names(config)
        self.levels = load_levels(config, characters.monster_codes(cast))
        rewards = _one_each(config.reward, config)
        codes = {name: code for code, name in enumerate(fields.REWARDS)}
        self.player_stats["reward"] = [codes.get(name, -1) for name in rewards]
        self._custom = [
            (name, load_reward(name), [p for p, reward in enumerate(rewards) if reward == name])
            for name in dict.fromkeys(fields.own_rewards(rewards))
        ]
        self.monster_stats = characters.monster_stats(cast, self.levels, self.player_stats, config.magic)
        for level, kinds in zip(self.levels, self.monster_stats, strict=True):
            refuse_bad_places(level, self.player_stats, kinds, config)
        self.settings = self._settings(config)
        fill_scales(self.settings[0], self.player_stats, self.monster_stats, config, self.levels)
        self.spaces = [
            observation_space(self.settings[0], player, self.monster_stats, config, self.levels)
            for player in self.player_stats
        ]
        self._actions = len(self.action_names)
        self.action_space = spaces.Discrete(self._actions)
        self._allocate(count, self._actions)
        self._try_rewards()

    def _allocate(self, count: int, actions: int) -> None:
        (players,), (levels, monsters) = self.player_stats.shape, self.monster_stats.shape
        first_players = np.zeros(players, state.PLAYER)
        for name in ("hp", "energy"):
            first_players[name] = self.player_stats[name]
        first_monsters = np.zeros((levels, monsters), state.MONSTER)
        first_monsters["hp"] = self.monster_stats["hp"]
        homes = np.array([[place for _, *place in level.monsters] for level in self.levels], np.float64)
        first_monsters["x"], first_monsters["y"] = np.moveaxis(homes.reshape(levels, monsters, 2), 2, 0)
        no_events = np.zeros(1, state.EVENTS)
        no_events["distance"] = np.inf
        given = {
            "player_stats": self.player_stats,
            "monster_stats": self.monster_stats,
            "settings": self.settings,
            "terrain": np.array([level.terrain for level in self.levels]),
            "starts": np.array([level.starts for level in self.levels]),
            "first_players": first_players,
            "first_monsters": first_monsters,
            "no_events": no_events,
        }
        arrays = self._arrays = state.allocate(
            given, N=count, P=players, M=monsters, B=players + monsters, A=actions, F=self.space.shape[0]
        )
        self.worlds, self.players, self.monsters, *_ = arrays
        self.events, self.observations, self.masks = arrays.events, arrays.observations, arrays.masks
        self.slots, self.tallies, self.taken = arrays.slots, arrays.tallies, arrays.taken
        fresh = np.random.SeedSequence()
        self.worlds["key"] = fresh.generate_state(count, np.uint64)  # until they are seeded
        self.players["x"], self.players["y"] = self.level.starts[0]  # on the grid, also before a reset
        self.events[:] = no_events
        self.slots["begins"] = 1.0
        self._none = np.zeros((count, players), np.int64)  # actions that a reset does not read
        self._take_addresses()
        self._every = np.ones(count, np.bool_)
        start = -1 if self.config.start == "random" else 0
        self.usual_starts = np.full(count, start, np.int64)

    def __getstate__(self) -> dict[str, Any]:
        """Leave out the addresses, as the arrays of a copy lie elsewhere."""
        return {name: value for name, value in vars(self).items() if name not in _ADDRESSES}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        vars(self).update(kept)
        self._take_addresses()

    def _take_addresses(self) -> None:
        self.handle = state.make_handle(self._arrays)
        self._address = self.handle.ctypes.data
        kernel.load_rules()
        self._shown = tuple(state.read_only(each) for each in (self.events, self.players, self.player_stats))

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
        return spaces.Box(low, np.max([space.high for space in self.spaces], axis=0), dtype=np.float32)

    def _settings(self, config: EnvConfig) -> np.ndarray:
        settings = np.zeros(1, state.SETTINGS)
        row = settings[0]
        row["left"], row["top"], row["tile"] = self.level.left, self.level.top, self.level.tile
        for name, value in vars(config).items():
            if name in (state.SETTINGS.names or ()) and not isinstance(value, str):
                row[name] = value
        row["ticks"] = characters.TICKS_PER_STEP
        stops = 1 << rules.COAST
        if config.trees == "wall":
            stops |= 1 << rules.SOLID
        row["player_stops"] = stops
        if config.terrain_stops == "all":
            row["monster_stops"] = stops
        row["shared_reward"] = config.shared_reward and not self._custom
        row["blow_on_entry"] = config.blow == "entry"
        row["credit_near"] = config.kill_credit == "near"
        row["keep_xp"] = config.xp_scope == "forever"
        fastest = characters.fastest(self.player_stats, self.monster_stats.ravel())
        row["body_reach"] = 2 * (self._largest_body() + fastest * characters.TICKS_PER_STEP) + 1.0
        if fastest > self.level.tile:
            raise UserError(f"a speed of {fastest * 60:g} px/s jumps over tiles of {self.level.tile:g} px")
        return settings

    def _largest_body(self) -> float:
        """Return how far a body reaches from its position, on x or y, in pixels."""
        return max(
            float((abs(stats[middle]) + stats[half]).max(initial=0.0))
            for stats in (self.player_stats, self.monster_stats)
            for middle, half in (("body_x", "half_width"), ("body_y", "half_height"))
        )

    def seed(self, seeds: Sequence[int], mask: np.ndarray | None = None) -> None:
        """Seed the random stream of all worlds, or of those in `mask`.

        Equal seeds make equal worlds; XP that outlives episodes starts again from 0.
        """
        chosen = self._every if mask is None else mask
        for world in np.flatnonzero(chosen):
            generator, _ = seeding.np_random(int(seeds[int(world)]))
            self.worlds["key"][world] = generator.integers(2**64, dtype=np.uint64)
            self.worlds["draws"][world] = 0
        self.players["xp"][chosen] = 0.0

    def reset(self, mask: np.ndarray | None = None, starts: np.ndarray | None = None) -> None:
        """Start an episode in all worlds, or in those of `mask`, and observe all.

        Args:
            mask: (N,) booleans.
            starts: (N,) indices of start places; below zero, drawn at random.

        Raises:
            ValueError: for a mask or starts of a wrong shape or type, or an unknown start place.
        """
        which = self._every if mask is None else _checked(mask, (len(self),), "b", "mask")
        usual = self.usual_starts if starts is None else _checked(starts, (len(self),), "iu", "starts")
        if usual.max(initial=0) >= (count := len(self.level.starts)):
            raise ValueError(f"start {usual.max()} is none of the level's {count}")
        self._begin(np.where(which, usual, kernel.GO_ON))

    def step(self, actions: np.ndarray) -> int:
        """Advance all running worlds; return how many episodes ended.

        Args:
            actions: (N, P) whole numbers of the action space, or as many in another shape.

        Raises:
            ValueError: for anything else.
        """
        given = np.asarray(actions)
        if given.dtype.kind in "iu" and given.size == self.players.size:
            whole = np.ascontiguousarray(given, np.int64).reshape(self.players.shape)
            if whole.view(np.uint64).max() < self._actions:  # negative numbers are huge as unsigned ones
                return self.advance(whole)
        raise ValueError(f"actions {given} are outside {self.players.size} of {self.action_space}")

    def advance(self, actions: np.ndarray) -> int:
        """Do the same as `step` for actions that are known to be valid, (N, P) int64."""
        if not self._custom:
            return int(kernel.call_rules(self._address, actions, kernel.STEP | kernel.RECORD))
        ended = int(kernel.call_rules(self._address, actions, kernel.STEP))
        for name, function, players in self._custom:
            rewards = custom_rewards(function, name, *self._shown)
            self.events["reward"][:, players] = rewards[:, players]
        if self.config.shared_reward:
            mean = self.events["reward"].sum(axis=1) / self.players.shape[1]
            self.events["reward"] = np.where(self.present, mean[:, None], 0.0)
        kernel.call_rules(self._address, actions, kernel.RECORD)
        return ended

    def counts(self) -> dict[str, np.ndarray]:
        """Return what `slots` has of episodes in progress, to save and restore: (N * P,) arrays by name."""
        book = self.slots.reshape(-1)
        names = ("returns", "lengths", "episodes", "idle")[: 3 + (self.players.shape[1] > 1)]
        return {name: book[name] for name in names}

    def _begin(self, places: Any) -> None:
        """Reset worlds at these start places, those with `kernel.GO_ON` excepted, and observe all."""
        self._arrays.begins[:] = places
        kernel.call_rules(self._address, self._none, kernel.RESET)

    def _try_rewards(self) -> None:
        """Call each user's reward once, as after a reset, with no events."""
        events, players = self.events.copy(), np.tile(self._arrays.first_players, (len(self), 1))
        events["present"] = self.settings["ticks"][0]
        places = np.arange(players.shape[1]) % len(self.level.starts)
        players["x"], players["y"] = self.level.starts[places].T
        for name, function, _ in self._custom:
            custom_rewards(function, name, *map(state.read_only, (events, players, self.player_stats)))

    @property
    def present(self) -> np.ndarray:
        """Which players were alive before the last step, (N, P)."""
        return present(self.events)

    @property
    def truncated(self) -> np.ndarray:
        """Which worlds ended by a time limit that truncates, (N,)."""
        limit = self.worlds["ending"] == rules.TIME_LIMIT
        return limit if self.config.time_limit == "truncate" else np.zeros_like(limit)

    def ending(self, world: int) -> str:
        """Return how a world's episode ended, or 'running'."""
        return ENDINGS[self.worlds["ending"][world]]

    def observe(self) -> None:
        """Write all observations and masks from the current state, which may have been changed by hand.

        Counts of players and monsters that are alive are updated.

        Raises:
            ValueError: for bodies outside the grid, or with an invalid facing.
        """
        self._refuse_nowhere()
        self.worlds["monsters_left"] = (self.monsters["hp"] > 0).sum(axis=1)
        self.worlds["players_left"] = (self.players["hp"] > 0).sum(axis=1)
        self._begin(kernel.GO_ON)

    def _refuse_nowhere(self) -> None:
        """Refuse positions that are none. Dead monsters may be anywhere."""
        left, top, right, bottom = self.level.grid
        for name, bodies in (("players", self.players), ("monsters", self.monsters[self.monsters["hp"] > 0])):
            x, y = bodies["x"], bodies["y"]
            if not ((left <= x) & (x < right) & (top <= y) & (y < bottom)).all():  # nor NaN
                grid = f"{left:g} to {right:g}, {top:g} to {bottom:g}"
                raise ValueError(f"{name}: x or y lies off the grid, {grid}")
        if not np.isin(self.players["facing"], range(4)).all():
            raise ValueError("players: facing is none of 0 to 3")


def _checked(given: np.ndarray, shape: tuple[int, ...], kinds: str, what: str) -> np.ndarray:
    """Return actions or masks in the compiled rules' type, after checking their shape and type."""
    array = np.asarray(given)
    if array.shape != shape or array.dtype.kind not in kinds:
        of = "booleans" if kinds == "b" else "whole numbers"
        raise ValueError(f"{what}: must be {of} of shape {shape}, not {array.dtype} of {array.shape}")
    return np.ascontiguousarray(array, np.bool_ if kinds == "b" else np.int64)


def _one_each(names: tuple[str, ...], config: EnvConfig) -> tuple[str, ...]:
    return names * config.players if len(names) == 1 else names


_ADDRESSES = ("handle", "_address", "_shown")
"""Attributes of `Worlds` that are valid in one process only."""
