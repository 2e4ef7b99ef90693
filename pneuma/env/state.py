"""The world's state as plain structured arrays, and a handle by which compiled functions take them.

Lengths are pixels, times ticks of 1/60 s, speeds pixels a tick; y points down. N worlds, P players
and M monsters in each, L levels, K monsters perceived.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Annotated, Any, NamedTuple, get_type_hints

import numpy as np
from llvmlite import ir
from numba import from_dtype, types
from numpy import bool_, float32, float64, int16, int32, int64, uint8, uint32, uint64

from pneuma.env.compiling import (
    array_from,
    inlined_early,
    typed_arrays,
    typed_codegen,
    typed_intrinsic,
    typed_tuple,
)

MAX_PLAYERS = 8
MAX_RAYS = 64

Array = Any
"""A NumPy array, or a row of one, inside a kernel."""


def _record(fields: type) -> np.dtype[np.void]:
    """Return the dtype of the fields that a class annotates: numbers, or arrays of a length."""
    columns: list[tuple[Any, ...]] = []
    for field_name, hint in get_type_hints(fields, include_extras=True).items():
        length = getattr(hint, "__metadata__", ())
        columns.append((field_name, getattr(hint, "__origin__", hint), *length))
    return np.dtype(columns, align=True)


# --- The whole state of the worlds ----------------------------------------------------------------


class _World:
    """A world."""

    key: uint64  # of the world's random stream
    draws: uint64  # numbers taken from it so far
    steps: int64  # agent steps of this episode
    level: uint32  # index of its level
    start: int32  # index of player 0's start place
    monsters_left: int32
    players_left: int32
    ending: int32  # RUNNING, or how the episode ended


WORLD = _record(_World)


class _Player:
    """A player."""

    x: float64
    y: float64
    hp: float64
    xp: float64
    energy: float64
    facing: int32
    busy: int32  # ticks that the current attack or spell still lasts
    action_kind: int32  # of the latest one: BLADE, BURNING or HEALING; 0 before the first
    attack: int32  # number of the latest attack of this episode
    safe: int32  # ticks in which bites do nothing
    kills: int32


PLAYER = _record(_Player)


class _Monster:
    """A monster; what every step looks at comes first, as it shares a line of cache."""

    x: float64
    y: float64
    hp: float64
    knocked: int32  # ticks that the knock-back still lasts
    safe: int32  # ticks in which strikes do nothing
    noticed: uint8  # bit p: player p is inside the notice circle
    bite: Annotated[int16, MAX_PLAYERS]  # ticks to the next bite of player p; 0: out of reach
    inside: uint8  # bit p: player p struck where it stood in the last tick
    knock_x: float64  # pixels a tick
    knock_y: float64
    struck_by: Annotated[int32, MAX_PLAYERS]  # the last attack of player p that hit it


MONSTER = _record(_Monster)


# --- What the rules read --------------------------------------------------------------------------


class _Body:
    """A body's box."""

    half_width: float64
    half_height: float64
    body_x: float64  # centre of the body box from the position
    body_y: float64


class _Strike:
    """What a sword or a flame does; lists go by the player's facing."""

    x: Annotated[float64, 4]  # centre of the box that it strikes
    y: Annotated[float64, 4]
    half_width: Annotated[float64, 4]
    half_height: Annotated[float64, 4]
    hilt_x: Annotated[float64, 4]  # knock-back points away from it
    hilt_y: Annotated[float64, 4]
    damage: float64
    knock_speed: float64
    knock_ticks: int32  # below 0: it knocks nobody back


STRIKE: Any = _record(_Strike)


class _PlayerStats(_Body):
    """A player's numbers that do not change."""

    hp: float64
    energy: float64
    energy_gain: float64  # a tick
    speed: float64
    safe: int32  # ticks after a bite in which further ones do nothing
    swing: int32  # ticks that an attack lasts, and a flame, and the spell that heals
    flame_ticks: int32
    heal_ticks: int32
    sword: STRIKE
    flame: STRIKE
    flame_cost: float64
    heal: float64
    heal_cost: float64
    heal_reach: float64  # other players within it are healed too; 0: none
    reward: int32  # which formula
    hp_scale: float64  # of an observation
    energy_scale: float64


PLAYER_STATS = _record(_PlayerStats)


class _MonsterStats(_Body):
    """A monster's numbers that do not change."""

    hp: float64
    speed: float64
    notice_squared: float64
    notice_x: float64  # centre of the notice circle from the position
    notice_y: float64
    attack_squared: float64
    attack_x: float64  # and of the attack circle
    attack_y: float64
    stand_off: float64  # no approach on an axis nearer than this
    damage: float64
    bite_ticks: int32
    safe: int32  # ticks after a strike in which further ones do nothing
    knock_ticks: int32  # below 0: as the striker's
    knock_speed: float64
    xp: float64  # for the kill
    heal: float64
    reach_squared: float64  # beyond this distance nothing can happen to it within one step
    species: int32  # number of its species, among those that rays distinguish
    hp_scale: float64  # of an observation
    distance_scale: float64
    xp_scale: float64


MONSTER_STATS = _record(_MonsterStats)


class _Settings:
    """Settings of all worlds."""

    corner: Annotated[float64, 2]  # left and top of the tile grid
    tile: float64
    ticks: int32  # of one agent step
    episode_steps: int64
    end_on_clear: int32
    player_stops: int64  # bit 1 << code: tiles of this code stop players
    monster_stops: int64
    body_reach: float64  # a body further off on x or y cannot stop another within a step
    magic: int32  # whether there are spells
    shared_reward: int32  # whether players get the mean of all their rewards
    hit_on_entry: int32  # whether a monster is hit when it enters the sword's box, not once per attack
    credit_near: int32  # a kill pays those within the attack circle, not the striker
    ending_cost: float64  # XP lost by every ending
    keep_xp: int32  # from episode to episode
    layout: int32  # of observations
    observe_facing: int32
    fixed_order: int32
    perceived: int32  # most monsters in an observation
    middle_x: float64  # positions are observed as (x - middle) * scale
    middle_y: float64
    scale_x: float64
    scale_y: float64
    xp_scale: float64
    rays: int32  # that a player sees by
    species_count: int32  # that they distinguish
    ray_scale: float64  # of distances along them
    ray_x: Annotated[float64, MAX_RAYS]  # their directions, of length 1
    ray_y: Annotated[float64, MAX_RAYS]


SETTINGS = _record(_Settings)


# --- What the rules write -------------------------------------------------------------------------


class _Events:
    """What happened to a player in one step, for rewards computed outside."""

    reward: float64
    xp_gained: float64  # by kills, minus what an ending cost
    hp_lost: float64
    hp_gained: float64
    hits: int32  # strikes that hit monsters
    kills: int32  # hits that killed
    notices: int32  # notice circles entered
    contacts: int32  # attack circles entered
    distance: float64  # to the nearest living monster, infinite without one
    died: int32
    present: int32  # ticks of the step in which the player was alive


EVENTS = _record(_Events)


class _Slot:
    """The episode in progress, or just ended, of one player."""

    returns: float64
    lengths: int64  # steps that the player lived to begin
    episodes: int64  # how many ended before or now
    ending: int32  # how the last step ended it; RUNNING if it did not
    begins: float32  # 1 if the last step ended an episode, or there was none
    idle: bool_  # whether the player was dead before the last step of an episode that still runs


SLOT = _record(_Slot)


class _Tally:
    """The same of a world: means over its players."""

    returns: float64
    hp_lost: float64
    cleared: int64  # the step that left no monster; 0 so far


TALLY = _record(_Tally)


class _Tick:
    """What a player does in one tick, and its results."""

    is_present: int32  # whether the player is alive when the tick begins
    strikes: int32  # BLADE, BURNING, or 0
    xp: float64
    healed: float64
    bitten: float64
    notices: int32
    contacts: int32
    paid: int32  # whether a kill was credited


TICK = _record(_Tick)


class _Box:
    """A body where moving bodies and rays look for it; the lists hold x and y."""

    place: Annotated[float64, 2]
    offset: Annotated[float64, 2]  # of the box's centre from there
    half: Annotated[float64, 2]  # sides
    alive: int32  # the dead stop nobody


BOX = _record(_Box)


class _Scratch:
    """A monster of a list, by its index."""

    order: uint64
    distance: float64


SCRATCH = _record(_Scratch)


class State(NamedTuple):
    """Every array that the kernels share, with its dtype and axes.

    N worlds of P players, M monsters and B = P + M bodies; L levels of R x C tiles and S start places; A
    actions, F features. The first three are the whole state of the worlds. Every step writes `events`,
    `observations`, `masks`, `slots`, `tallies` and `action_counts`. `tick`, `scratch`, `neighbours` and
    `boxes` are for the rules alone.
    """

    worlds: Annotated[Array, WORLD, "N"]
    players: Annotated[Array, PLAYER, "N P"]
    monsters: Annotated[Array, MONSTER, "N M"]
    player_stats: Annotated[Array, PLAYER_STATS, "P"]
    monster_stats: Annotated[Array, MONSTER_STATS, "L M"]
    settings: Annotated[Array, SETTINGS, "1"]
    terrain: Annotated[Array, np.uint8, "L R C"]  # OPEN, SOLID or COAST
    starts: Annotated[Array, np.float64, "L S 2"]
    events: Annotated[Array, EVENTS, "N P"]
    observations: Annotated[Array, np.float32, "N P F"]
    masks: Annotated[Array, np.int8, "N P A"]  # 0 where an action would do nothing
    tick: Annotated[Array, TICK, "P"]
    scratch: Annotated[Array, SCRATCH, "M"]
    neighbours: Annotated[Array, np.int32, "B B"]  # how many bodies a body may meet in this step, and which
    boxes: Annotated[Array, BOX, "B"]
    reset_starts: Annotated[Array, np.int64, "N"]  # start places of the worlds that `run_worlds` resets
    first_players: Annotated[Array, PLAYER, "P"]  # copied when an episode begins, except place and kept XP
    first_monsters: Annotated[Array, MONSTER, "L M"]  # copied when an episode begins
    slots: Annotated[Array, SLOT, "N P"]
    tallies: Annotated[Array, TALLY, "N"]
    action_counts: Annotated[Array, np.int64, "N A"]  # how often players who lived took each action
    no_events: Annotated[Array, EVENTS, "1"]  # of a step in which nothing happens
    no_tally: Annotated[Array, TALLY, "1"]  # of an episode that begins


def _read_annotations() -> dict[str, tuple[np.dtype[Any], list[str]]]:
    layouts = {}
    for array_name, hint in get_type_hints(State, include_extras=True).items():
        dtype, axes = hint.__metadata__
        layouts[array_name] = (np.dtype(dtype), axes.split())
    return layouts


ARRAYS = _read_annotations()
"""Dtype and axes of each array."""
_SAVED = repr([dtype.descr for dtype in (WORLD, PLAYER, MONSTER, SLOT)])
LAYOUT_DIGEST = hashlib.sha256(_SAVED.encode()).hexdigest()[:16]
"""Identifies the layout of the parts of a `State` that are saved."""
HANDLE = np.dtype([("array", "i8", (4,))])
"""Address and shape of an array of a `State`."""


def allocate(constants: Mapping[str, np.ndarray], sizes: Mapping[str, int]) -> State:
    """Return a state of constant arrays, and of zeros for the others, by the sizes of their axes."""
    arrays = {}
    for array_name, (dtype, axes) in ARRAYS.items():
        if array_name in constants:
            arrays[array_name] = np.ascontiguousarray(constants[array_name], dtype)
        else:
            arrays[array_name] = np.zeros([sizes[axis] for axis in axes], dtype)
    return State(**arrays)


def make_handle(state: State) -> np.ndarray:
    """Return addresses and shapes of all arrays, (arrays,) HANDLE, with which the kernels are called.

    Passing one small array to a compiled function instead of all arrays saves most of the time of a call. The
    arrays must outlive the handle.
    """
    handle = np.zeros(len(state), HANDLE)
    for numbers, array in zip(handle["array"], state, strict=True):
        numbers[0] = array.ctypes.data
        numbers[1 : 1 + array.ndim] = array.shape
    return handle


def read_only(array: np.ndarray) -> np.ndarray:
    view = array.view()
    view.flags.writeable = False
    return view


def as_bytes(array: np.ndarray) -> np.ndarray:
    """Return an array's memory, (bytes,) uint8.

    What lies between the fields is of no meaning, and may differ where all fields are equal.
    """
    return array.reshape(-1).view(np.uint8)


def saved_bytes(array: np.ndarray) -> np.ndarray:
    """Return a copy of a structured array's memory, (bytes,) uint8, with zeros between its fields."""
    saved = np.zeros(array.shape, array.dtype)
    for field_name in array.dtype.names or ():
        saved[field_name] = array[field_name]
    return as_bytes(saved)


class World(NamedTuple):
    """The part of a `State` that belongs to one world and its level: without the axes N and L."""

    episode: Array  # its row of `worlds`
    settings: Array
    players: Array
    monsters: Array
    player_stats: Array
    monster_stats: Array
    terrain: Array
    events: Array
    observations: Array
    masks: Array
    slots: Array
    tally: Array
    action_counts: Array
    tick: Array
    scratch: Array
    neighbours: Array
    boxes: Array


# --- In compiled functions --------------------------------------------------------------------------


@typed_intrinsic
def open_state(context: Any, handle: Any) -> Any:
    """Return the `State` of a handle, or of a pointer to one; the reverse of `make_handle`."""
    array_types = [types.Array(from_dtype(dtype), len(axes), "C") for dtype, axes in ARRAYS.values()]
    state_type = typed_tuple(array_types, State)

    def generate(codegen: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        address = arguments[0]
        if isinstance(handle, types.Array):
            address = typed_arrays.make_array(handle)(codegen, builder, address).data
        numbers = builder.bitcast(address, ir.IntType(64).as_pointer())

        def number_at(index: int) -> Any:
            return builder.load(builder.gep(numbers, [ir.IntType(64)(index)]))

        arrays = []
        for index, array_type in enumerate(array_types):
            first_number = 4 * index
            lengths = [number_at(first_number + 1 + axis) for axis in range(array_type.ndim)]
            arrays.append(array_from(codegen, builder, array_type, number_at(first_number), lengths))
        return codegen.make_tuple(builder, state_type, arrays)

    return state_type(handle), generate


@inlined_early
def world_of(state: State, world_index: int) -> World:
    """Return the part of a state that belongs to one world."""
    episode = state.worlds[world_index]
    return World(
        episode,
        state.settings[0],
        state.players[world_index],
        state.monsters[world_index],
        state.player_stats,
        state.monster_stats[episode.level],
        state.terrain[episode.level],
        state.events[world_index],
        state.observations[world_index],
        state.masks[world_index],
        state.slots[world_index],
        state.tallies[world_index],
        state.action_counts[world_index],
        state.tick,
        state.scratch,
        state.neighbours,
        state.boxes,
    )


@typed_intrinsic
def array_at(context: Any, pointer: Any, shape: Any) -> Any:
    """Return the array of a shape at a pointer.

    `numba.carray` does the same, but compiles slowly, and with reference counts.
    """
    array_type = types.Array(pointer.dtype, len(shape), "C")

    def generate(codegen: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        lengths = typed_codegen.unpack_tuple(builder, arguments[1], len(shape))
        return array_from(codegen, builder, array_type, arguments[0], lengths)

    return array_type(pointer, shape), generate
