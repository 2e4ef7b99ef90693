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

from pneuma.env.compiling import (
    DIGEST,
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


def _record(*fields: tuple[Any, ...]) -> np.dtype[np.void]:
    return np.dtype(list(fields), align=True)


# --- The whole state of the worlds ----------------------------------------------------------------

WORLD = _record(
    ("key", "u8"),  # of the world's random stream
    ("draws", "u8"),  # numbers taken from it so far
    ("steps", "i8"),  # agent steps of this episode
    ("level", "u4"),  # index of the level played
    ("start", "i4"),  # index of player 0's start place
    ("monsters_left", "i4"),
    ("players_left", "i4"),
    ("ending", "i4"),  # RUNNING, or how the episode ended
)
PLAYER = _record(
    ("x", "f8"),
    ("y", "f8"),
    ("hp", "f8"),
    ("xp", "f8"),
    ("energy", "f8"),
    ("facing", "i4"),
    ("busy", "i4"),  # ticks that the current attack or spell still lasts
    ("action_kind", "i4"),  # what that is: BLADE, BURNING or HEALING; 0: there was none yet
    ("attack", "i4"),  # number of the latest attack of this episode
    ("safe", "i4"),  # ticks in which bites do nothing
    ("kills", "i4"),
)
MONSTER = _record(  # what every step looks at comes first: it shares a line of cache
    ("x", "f8"),
    ("y", "f8"),
    ("hp", "f8"),
    ("knocked", "i4"),  # ticks that the knock-back still lasts
    ("safe", "i4"),  # ticks in which blows do nothing
    ("noticed", "u1"),  # bit p: player p is inside the notice circle
    ("bite", "i2", (MAX_PLAYERS,)),  # ticks to the next bite of player p; 0: out of reach
    ("inside", "u1"),  # bit p: player p struck where it stood in the last tick
    ("knock_x", "f8"),  # pixels a tick
    ("knock_y", "f8"),
    ("struck_by", "i4", (MAX_PLAYERS,)),  # the last attack of player p that hit it
)

# --- What the rules read --------------------------------------------------------------------------

_BODY = (
    ("half_width", "f8"),
    ("half_height", "f8"),
    ("body_x", "f8"),  # centre of the body box from the position
    ("body_y", "f8"),
)

STRIKE = _record(  # of a sword or a flame, from the player, by facing
    ("x", "f8", (4,)),  # centre of the box that it strikes
    ("y", "f8", (4,)),
    ("half_width", "f8", (4,)),
    ("half_height", "f8", (4,)),
    ("hilt_x", "f8", (4,)),  # knock-back points away from it
    ("hilt_y", "f8", (4,)),
    ("damage", "f8"),
    ("knock_speed", "f8"),
    ("knock_ticks", "i4"),  # below 0: it knocks nobody back
)
PLAYER_STATS = _record(
    ("hp", "f8"),
    ("energy", "f8"),
    ("energy_gain", "f8"),  # a tick
    ("speed", "f8"),
    *_BODY,
    ("safe", "i4"),  # ticks after a bite in which further ones do nothing
    ("swing", "i4"),  # ticks that an attack lasts, and a flame, and the spell that heals
    ("flame_ticks", "i4"),
    ("heal_ticks", "i4"),
    ("sword", STRIKE),
    ("flame", STRIKE),
    ("flame_cost", "f8"),
    ("heal", "f8"),
    ("heal_cost", "f8"),
    ("heal_reach", "f8"),  # other players within it are healed too; 0: none
    ("reward", "i4"),  # which formula
    ("hp_scale", "f8"),  # of an observation
    ("energy_scale", "f8"),
)
MONSTER_STATS = _record(
    ("hp", "f8"),
    ("speed", "f8"),
    *_BODY,
    ("notice_squared", "f8"),
    ("notice_x", "f8"),  # centre of the notice circle from the position
    ("notice_y", "f8"),
    ("attack_squared", "f8"),
    ("attack_x", "f8"),  # and of the attack circle
    ("attack_y", "f8"),
    ("stand_off", "f8"),  # no approach on an axis nearer than this
    ("damage", "f8"),
    ("bite_ticks", "i4"),
    ("safe", "i4"),  # ticks after a blow in which further ones do nothing
    ("knock_ticks", "i4"),  # below 0: as the striker's
    ("knock_speed", "f8"),
    ("xp", "f8"),  # for the kill
    ("heal", "f8"),
    ("reach_squared", "f8"),  # beyond this distance nothing can happen to it within one step
    ("sight", "i4"),  # number of its kind, among those that rays tell apart
    ("hp_scale", "f8"),  # of an observation
    ("distance_scale", "f8"),
    ("xp_scale", "f8"),
)
SETTINGS = _record(
    ("left", "f8"),  # of the tile grid
    ("top", "f8"),
    ("tile", "f8"),
    ("ticks", "i4"),  # of one agent step
    ("episode_steps", "i8"),
    ("end_on_clear", "i4"),
    ("player_stops", "i8"),  # bit 1 << code: tiles of this code stop players
    ("monster_stops", "i8"),
    ("body_reach", "f8"),  # a body further off on x or y cannot stop another within a step
    ("magic", "i4"),  # whether there are spells
    ("shared_reward", "i4"),  # whether players get the mean of all their rewards
    ("blow_on_entry", "i4"),  # whether a monster is hit when it enters the sword's box, not once an attack
    ("credit_near", "i4"),  # a kill pays those within the attack circle, not the striker
    ("ending_cost", "f8"),  # XP lost by every ending
    ("keep_xp", "i4"),  # from episode to episode
    ("layout", "i4"),  # of observations
    ("observe_facing", "i4"),
    ("fixed_order", "i4"),
    ("perceived", "i4"),  # most monsters in an observation
    ("middle_x", "f8"),  # positions are observed as (x - middle) * scale
    ("middle_y", "f8"),
    ("scale_x", "f8"),
    ("scale_y", "f8"),
    ("xp_scale", "f8"),
    ("rays", "i4"),  # that a player sees by
    ("sights", "i4"),  # kinds of monsters that they tell apart
    ("ray_scale", "f8"),  # of distances along them
    ("ray_x", "f8", (MAX_RAYS,)),  # their directions, of length 1
    ("ray_y", "f8", (MAX_RAYS,)),
)

# --- What the rules write -------------------------------------------------------------------------

EVENTS = _record(
    ("reward", "f8"),
    ("xp_gained", "f8"),  # by kills, less what an ending cost
    ("hp_lost", "f8"),
    ("hp_gained", "f8"),
    ("hits", "i4"),  # blows landed on monsters
    ("kills", "i4"),  # last blows among them
    ("notices", "i4"),  # notice circles entered
    ("contacts", "i4"),  # attack circles entered
    ("distance", "f8"),  # to the nearest living monster, infinite without one
    ("died", "i4"),
    ("present", "i4"),  # ticks of the step that the player lived through
)
"""What happened to a player in one step, for rewards computed outside."""

SLOT = _record(  # the episode in progress, or just ended, of one player
    ("returns", "f8"),
    ("lengths", "i8"),  # steps that the player lived to begin
    ("episodes", "i8"),  # how many ended before or now
    ("ending", "i4"),  # how the last step ended it; RUNNING if it did not
    ("begins", "f4"),  # 1 if the last step ended an episode, or there was none
    ("idle", "?"),  # whether the player was dead before the last step of an episode that still runs
)
TALLY = _record(  # the same of a world: means over its players
    ("returns", "f8"),
    ("hp_lost", "f8"),
    ("cleared", "i8"),  # the step that left no monster; 0 so far
)

TICK = _record(
    ("there", "i4"),  # whether the player lives through this tick
    ("strikes", "i4"),  # BLADE, BURNING, or 0
    ("xp", "f8"),
    ("healed", "f8"),
    ("bitten", "f8"),
    ("notices", "i4"),
    ("contacts", "i4"),
    ("paid", "i4"),  # whether anybody killed
)
"""What a player does in one tick, and its results."""

SCRATCH = _record(("order", "u8"), ("distance", "f8"))


class State(NamedTuple):
    """Every array that the kernels share, with its dtype and axes.

    N worlds of P players, M monsters and B = P + M bodies; L levels of R x C tiles and S start places; A
    actions, F features. The first three are the whole state of the worlds. `events`, `observations`, `masks`,
    `slots`, `tallies` and `taken` are written by every step. `tick`, `scratch`, `near` and `boxes` are for
    the rules alone.
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
    near: Annotated[Array, np.int32, "B B"]  # how many bodies a body may meet in this step, and which
    boxes: Annotated[Array, np.float64, "B 4"]  # centre and half sides of bodies; those of the dead are -inf
    begins: Annotated[Array, np.int64, "N"]  # start places of the worlds that `run_worlds` resets
    first_players: Annotated[Array, PLAYER, "P"]  # an episode's are copies, but for place and kept XP
    first_monsters: Annotated[Array, MONSTER, "L M"]  # an episode's are copies
    slots: Annotated[Array, SLOT, "N P"]
    tallies: Annotated[Array, TALLY, "N"]
    taken: Annotated[Array, np.int64, "N A"]  # how often players who lived took each action
    no_events: Annotated[Array, EVENTS, "1"]  # of a step in which nothing happens


def _read_annotations() -> dict[str, tuple[np.dtype[Any], list[str]]]:
    layouts = {}
    for name, hint in get_type_hints(State, include_extras=True).items():
        dtype, axes = hint.__metadata__
        layouts[name] = (np.dtype(dtype), axes.split())
    return layouts


ARRAYS = _read_annotations()
"""Dtype and axes of each array."""
_SAVED = repr([dtype.descr for dtype in (WORLD, PLAYER, MONSTER)])
LAYOUT_DIGEST = hashlib.sha256(_SAVED.encode()).hexdigest()[:16]
"""Identifies the layout of the parts of a `State` that are saved."""
_CODE = f"code_{DIGEST}"
HANDLE = np.dtype([(_CODE, "i8", (4,))])
"""Address and shape of an array of a `State`; the name is the sources' digest: an edit recompiles."""


def allocate(constants: Mapping[str, np.ndarray], **sizes: int) -> State:
    """Return a state of constant arrays, and of zeros for the others, by the sizes of their axes."""
    arrays = {}
    for name, (dtype, axes) in ARRAYS.items():
        if name in constants:
            arrays[name] = np.ascontiguousarray(constants[name], dtype)
        else:
            arrays[name] = np.zeros([_length(axis, sizes) for axis in axes], dtype)
    return State(**arrays)


def _length(axis: str, sizes: Mapping[str, int]) -> int:
    """Return the length of an axis, which is a letter or a number."""
    if axis in sizes:
        return sizes[axis]
    return int(axis)


def make_handle(state: State) -> np.ndarray:
    """Return addresses and shapes of all arrays, (arrays,) HANDLE, with which the kernels are called.

    Passing one small array to a compiled function instead of all arrays saves most of the time of a call. The
    arrays must outlive the handle.
    """
    handle = np.zeros(len(state), HANDLE)
    for numbers, array in zip(handle[_CODE], state, strict=True):
        numbers[0] = array.ctypes.data
        numbers[1 : 1 + array.ndim] = array.shape
    return handle


def read_only(array: np.ndarray) -> np.ndarray:
    view = array.view()
    view.flags.writeable = False
    return view


def as_bytes(array: np.ndarray) -> np.ndarray:
    """Return an array's memory, (bytes,) uint8."""
    return array.reshape(-1).view(np.uint8)


class World(NamedTuple):
    """What of a `State` concerns one world, at the level that it plays: without the axes N and L."""

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
    taken: Array
    tick: Array
    scratch: Array
    near: Array
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
            first = 4 * index
            lengths = [number_at(first + 1 + axis) for axis in range(array_type.ndim)]
            arrays.append(array_from(codegen, builder, array_type, number_at(first), lengths))
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
        state.taken[world_index],
        state.tick,
        state.scratch,
        state.near,
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
