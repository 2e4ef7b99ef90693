"""The calls from outside to the compiled rules: reset, step and observe N worlds at once."""

from __future__ import annotations

from functools import cache
from typing import Any

import numba
from llvmlite import binding
from numba.core import types

from pneuma.env.compiling import cached, entry, typed_pointer
from pneuma.env.observe import observe_player
from pneuma.env.reward import share_reward, write_reward
from pneuma.env.rules import RUNNING, begin_episode, record_step, step_world
from pneuma.env.state import HANDLE, Array, array_at, open_state, world_of

GO_ON = -2
"""Instead of a start place in `reset_starts`: this world is not reset."""
RESET, STEP, RECORD = 0, 1, 2
"""What `run_worlds` does; `STEP | RECORD` at once unless rewards are computed outside."""
SYMBOL = "pneuma_run_worlds"
NOTICE = "Compiling the rules of the world: some ten seconds, once a version."
_STATE, _ACTIONS = typed_pointer(numba.from_dtype(HANDLE)), typed_pointer(types.int64)
run_worlds: Any = types.ExternalFunction(SYMBOL, types.int64(types.uintp, _ACTIONS, types.int64))
"""`_run_worlds` for compiled functions, by its name: `run_worlds(handle.ctypes.data, actions.ctypes, RESET)`.

Inlined it would be compiled again with each of them, 12 s a time. `load_rules` comes first.
"""


@cache
def load_rules() -> None:
    """Compile `_run_worlds`, or load it."""
    signature = types.int64(_STATE, _ACTIONS, types.int64)
    compile_rules = cached(signature, notice=NOTICE, error_model="numpy", _nrt=False)
    binding.add_symbol(SYMBOL, compile_rules(_run_worlds).address)


@entry
def call_rules(handle: int, actions: Array, work: int) -> int:
    """Call `_run_worlds` from Python, which is faster by an address than by an array."""
    return run_worlds(handle, actions.ctypes, work)


def _run_worlds(handle: Any, actions: Any, work: int) -> int:
    """Reset worlds, or advance every running world by one agent step; observe; return how many ended.

    Args:
        handle: of a `State`. A reset starts an episode in the worlds whose entry in `reset_starts` is not
            `GO_ON`: player p of a world takes start place `reset_starts + p`, wrapping around; -1 draws one
            at random. Of several levels one is drawn first. All worlds are observed.
        actions: (N, P) int64, not read by a reset. A world whose episode has ended stays as it is, with empty
            events, until it is reset.
        work: `RESET`; or `STEP`, `RECORD` the step's rewards, or both.
    """
    state = open_state(handle)
    players = state.players.shape[1]
    step_actions = array_at(actions, (state.players.shape[0], players))
    ended_count = 0
    for world_index in range(state.worlds.shape[0]):
        if work == RESET and state.reset_starts[world_index] != GO_ON:
            begin_episode(state, world_index, state.reset_starts[world_index])
        world = world_of(state, world_index)
        world_actions = step_actions[world_index]
        if work & STEP:
            for player_index in range(players):
                world.events[player_index] = state.no_events[0]
                world.slots[player_index].ending = RUNNING
            if world.episode.ending != RUNNING:
                continue
            ended_count += step_world(world, world_actions)
        if work != RECORD:
            notes_distance = work & STEP or world.episode.ending == RUNNING
            for player_index in range(players):
                observe_player(world, player_index, notes_distance)
        if work & STEP:
            for player_index in range(players):
                event = world.events[player_index]
                if event.present > 0:
                    write_reward(world.players[player_index], world.player_stats[player_index], event)
        if work & RECORD:
            if world.settings.shared_reward:
                share_reward(world.events)
            record_step(world, world_actions)
    return ended_count
