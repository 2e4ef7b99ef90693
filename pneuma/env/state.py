"""The world's state as plain structured arrays, and how functions that take them are compiled.

Lengths are pixels, times ticks of 1/60 s, speeds pixels a tick; y points down. N worlds, P players
and M monsters in each, L levels, K monsters perceived.
"""

from __future__ import annotations

import hashlib
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba import njit, types
from numba.core import cgutils
from numba.core.caching import FunctionCache
from numba.extending import intrinsic
from numba.np import arrayobj

PACKAGE = Path(__file__).parents[1]
KERNEL_SOURCES = (
    "env/kernel.py", "env/layouts.py", "env/observe.py", "env/reward.py", "env/rules.py", "env/state.py",
    "engines/batched/rollout.py", "engines/mlp.py",
)  # fmt: skip
"""Files whose code, or whose constants, are compiled into kernels."""
DIGEST = hashlib.sha256(b"".join((PACKAGE / name).read_bytes() for name in KERNEL_SOURCES)).hexdigest()[:16]

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
    ("busy", "i4"),  # ticks that the current attack, dash or spell still lasts
    ("action_kind", "i4"),  # what that is: BLADE, DASHING, BURNING or HEALING; 0: there was none yet
    ("attack", "i4"),  # number of the latest attack of this episode
    ("safe", "i4"),  # ticks in which bites do nothing
    ("kills", "i4"),
    ("dash_cooldown", "i4"),  # ticks until the player can dash again
    ("second", "i2"),  # whether it holds its second weapon
    ("token", "i2"),  # said in this step, from 1; 0: none
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
    ("first_by", "u1"),  # who struck first a monster that falls to two
    ("opened", "i2"),  # ticks in which another player can wound it
    ("first_facing", "u1"),  # of who struck first
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
    ("dash_speed", "f8"),  # 0 where nobody dashes
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
    ("pair_ticks", "i4"),  # within which two players must strike it from two sides; 0: one is enough
    ("xp", "f8"),  # for the kill
    ("heal", "f8"),
    ("reach_squared", "f8"),  # beyond this distance nothing can happen to it within one step
    ("perceived", "i4"),  # whether it is part of observations
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
    ("step_limit", "i8"),
    ("end_on_clear", "i4"),
    ("deadly_coast", "i4"),
    ("player_stops", "i8"),  # bit 1 << code: tiles of this code stop players, or bodies do
    ("monster_stops", "i8"),
    ("body_reach", "f8"),  # a body further off on x or y cannot stop another within a step
    ("slow_factor", "f8"),  # of speeds on slow tiles; 1 where there are none
    ("dash", "i4"),  # number of this action; -1: there is none
    ("dash_ticks", "i4"),  # that it lasts
    ("dash_cooldown", "i4"),  # ticks from its end until the next one may begin
    ("magic", "i4"),  # whether there are spells
    ("hold", "i4"),  # number of the action that takes up the first weapon, before the second; -1: none
    ("tokens", "i4"),  # that players can say, by the last actions
    ("shared_reward", "i4"),  # whether players get the mean of all their rewards
    ("blow_on_entry", "i4"),  # whether a monster is hit when it enters the sword's box, not once an attack
    ("bite_while_knocked", "i4"),
    ("healing_cap", "i4"),  # whether the HP of a kill stop at full HP
    ("credit_near", "i4"),  # a kill pays those within the attack circle, not the striker
    ("ending_cost", "f8"),  # XP lost by an ending other than the coast's
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
    ("strikes", "i4"),  # whether a sword or a flame strikes the box below
    ("box_x", "f8"),
    ("box_y", "f8"),
    ("half_width", "f8"),
    ("half_height", "f8"),
    ("damage", "f8"),
    ("hilt_x", "f8"),
    ("hilt_y", "f8"),
    ("knock_speed", "f8"),
    ("knock_ticks", "i4"),  # below 0: it knocks nobody back
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
    """Every array that the kernels share.

    The first three are the whole state of the worlds. `events`, `observations`, `masks`, `slots`, `tallies`
    and `taken` are written by every step. `tick`, `scratch`, `near` and `boxes` are scratch space.
    """

    worlds: Array  # (N,) WORLD
    players: Array  # (N, P) PLAYER
    monsters: Array  # (N, M) MONSTER
    player_stats: Array  # (2 P,) PLAYER_STATS: of players, then with their second weapon
    monster_stats: Array  # (L, M) MONSTER_STATS
    settings: Array  # (1,) SETTINGS
    terrain: Array  # (L, rows, columns) uint8: OPEN, SOLID, COAST or SLOW
    starts: Array  # (L, S, 2) start places
    events: Array  # (N, P) EVENTS
    observations: Array  # (N, P, features) float32
    masks: Array  # (N, P, actions) int8: 0 where an action would do nothing
    tick: Array  # (P,) TICK
    scratch: Array  # (M,) SCRATCH
    near: Array  # (M + P, M + P) int32: how many bodies a body may meet in this step, and which
    boxes: Array  # (M + P, 4): centre and half sides of each body now; those of the dead are -inf
    begins: Array  # (N,) int64: start places of the worlds that the next call of `run_worlds` resets
    first_players: Array  # (P,) PLAYER: of which an episode's are copies, but for place and kept XP
    first_monsters: Array  # (L, M) MONSTER: of which an episode's are copies
    slots: Array  # (N, P) SLOT
    tallies: Array  # (N,) TALLY
    taken: Array  # (N, actions) int64: how often players who lived took each action in this episode


DTYPES = State(
    WORLD, PLAYER, MONSTER, PLAYER_STATS, MONSTER_STATS, SETTINGS, np.dtype(np.uint8), np.dtype(np.float64),
    EVENTS, np.dtype(np.float32), np.dtype(np.int8), TICK, SCRATCH, np.dtype(np.int32),
    np.dtype(np.float64), np.dtype(np.int64), PLAYER, MONSTER, SLOT, TALLY, np.dtype(np.int64),
)  # fmt: skip
DIMENSIONS = State(1, 2, 2, 1, 2, 1, 3, 3, 2, 3, 3, 1, 1, 2, 2, 1, 1, 2, 2, 1, 2)

LAYOUT_DIGEST = hashlib.sha256(repr([dtype.descr for dtype in DTYPES[:3]]).encode()).hexdigest()[:16]
"""Identifies the layout of the parts of a `State` that are saved."""
HANDLE = _record(("address", "i8"), ("shape", "i8", (3,)), (f"code_{DIGEST}", "i8"))
"""A row for each array of a `State`; the last one's name is the sources' digest: an edit recompiles."""


def make_handle(state: State) -> np.ndarray:
    """Return addresses and shapes of all arrays, (21,) HANDLE, with which the kernels are called.

    Passing one small array to a compiled function instead of all arrays saves most of the time of a call. The
    arrays must outlive the handle, and be laid out as declared here.
    """
    handle = np.zeros(len(state), HANDLE)
    for row, array, dtype, dimensions in zip(handle, state, DTYPES, DIMENSIONS, strict=True):
        if array.dtype != dtype or array.ndim != dimensions or not array.flags.c_contiguous:
            raise ValueError(f"an array of the state is {array.dtype} with shape {array.shape}")
        row["address"] = array.ctypes.data
        row["shape"][:dimensions] = array.shape
    return handle


def read_only(array: np.ndarray) -> np.ndarray:
    view = array.view()
    view.flags.writeable = False
    return view


def as_bytes(array: np.ndarray) -> np.ndarray:
    """Return an array's memory, (bytes,) uint8."""
    return array.reshape(-1).view(np.uint8)


# --- Compiling ------------------------------------------------------------------------------------
# Numba's cache on disk checks the types of arguments and the file of the kernel itself, but no other file. So
# the handle of a world's state has an unused field whose name is a digest of all files with kernels. If one
# of them changes, every kernel that takes a handle is compiled again. A kernel that takes no handle must not
# use code from other files.


def cached(*signature: Any, using: Any = njit, **options: Any) -> Callable[[Any], Any]:
    """Return `njit`, or `cfunc`, with its cache; where no folder can be written, each process compiles anew.

    Numba writes beside the code, in the user's cache, or in NUMBA_CACHE_DIR; in some containers it can write
    to none of them.
    """

    def compiled(function: Any) -> Any:
        try:
            cache = typed_cache(function)
        except RuntimeError:  # no such folder
            return using(*signature, **options)(function)
        try:
            cache._cache_file._load_index()
        except Exception:  # it names a class that is gone, and is read whole before its age is seen
            cache.flush()
        return using(*signature, cache=True, **options)(function)

    return compiled


# Only the call from outside can be called from outside: the code that takes Python's arguments
# apart would take longer to compile than the rules. Nothing allocates, so all do without
# numba's reference counts, which took half the time of a step.
_INNER: Any = {"error_model": "numpy", "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
_UNCOUNTED: Any = {**_INNER, "_nrt": False}
entry: Any = cached(error_model="numpy", nogil=True)
inlined_counted: Any = njit(**_INNER, forceinline=True)
kernel: Any = njit(**_UNCOUNTED)
inlined: Any = njit(**_UNCOUNTED, forceinline=True)
inlined_early: Any = njit(**_UNCOUNTED, inline="always")  # by numba before compiling: for the few large ones
typed_intrinsic: Any = intrinsic
typed_arrays: Any = arrayobj
typed_codegen: Any = cgutils
typed_void: Any = types.void
typed_pointer: Any = types.CPointer
typed_cache: Any = FunctionCache


@entry
def seed_compiled(seed: int) -> None:
    """Seed numba's own generators, from which a user's compiled code may draw."""
    random.seed(seed)
    np.random.seed(seed)


@inlined_counted
def open_state(h: Array) -> State:
    """Turn addresses and shapes back into arrays; the reverse of `make_handle`."""
    return State(
        array_at(h[0].address, (h[0].shape[0],), WORLD),
        array_at(h[1].address, (h[1].shape[0], h[1].shape[1]), PLAYER),
        array_at(h[2].address, (h[2].shape[0], h[2].shape[1]), MONSTER),
        array_at(h[3].address, (h[3].shape[0],), PLAYER_STATS),
        array_at(h[4].address, (h[4].shape[0], h[4].shape[1]), MONSTER_STATS),
        array_at(h[5].address, (h[5].shape[0],), SETTINGS),
        array_at(h[6].address, (h[6].shape[0], h[6].shape[1], h[6].shape[2]), np.uint8),
        array_at(h[7].address, (h[7].shape[0], h[7].shape[1], h[7].shape[2]), np.float64),
        array_at(h[8].address, (h[8].shape[0], h[8].shape[1]), EVENTS),
        array_at(h[9].address, (h[9].shape[0], h[9].shape[1], h[9].shape[2]), np.float32),
        array_at(h[10].address, (h[10].shape[0], h[10].shape[1], h[10].shape[2]), np.int8),
        array_at(h[11].address, (h[11].shape[0],), TICK),
        array_at(h[12].address, (h[12].shape[0],), SCRATCH),
        array_at(h[13].address, (h[13].shape[0], h[13].shape[1]), np.int32),
        array_at(h[14].address, (h[14].shape[0], h[14].shape[1]), np.float64),
        array_at(h[15].address, (h[15].shape[0],), np.int64),
        array_at(h[16].address, (h[16].shape[0],), PLAYER),
        array_at(h[17].address, (h[17].shape[0], h[17].shape[1]), MONSTER),
        array_at(h[18].address, (h[18].shape[0], h[18].shape[1]), SLOT),
        array_at(h[19].address, (h[19].shape[0],), TALLY),
        array_at(h[20].address, (h[20].shape[0], h[20].shape[1]), np.int64),
    )


@typed_intrinsic
def array_at(context: Any, address: Any, shape: Any, dtype: Any) -> Any:
    """Return the array of a shape and dtype at an address or pointer.

    `numba.carray` does the same, but compiles slowly, and with reference counts.
    """
    kind = types.Array(dtype.dtype, len(shape), "C")

    def generate(codegen: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = typed_arrays.make_array(kind)(codegen, builder)
        item = codegen.get_constant(types.intp, codegen.get_abi_sizeof(codegen.get_data_type(kind.dtype)))
        lengths = typed_codegen.unpack_tuple(builder, arguments[1], len(shape))
        strides = [item]
        for length in reversed(lengths[1:]):
            strides.insert(0, builder.mul(strides[0], length))
        from_there = builder.inttoptr if isinstance(address, types.Integer) else builder.bitcast
        data = from_there(arguments[0], array.data.type)
        typed_arrays.populate_array(array, data, lengths, strides, item, None)
        return array._getvalue()

    return kind(address, shape, dtype), generate
