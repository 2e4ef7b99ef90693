"""The calls from outside to the compiled rules: reset, step and observe N worlds at once."""

from __future__ import annotations

import math

from pneuma.env.observe import observe_player
from pneuma.env.reward import write_reward
from pneuma.env.rules import RUNNING, begin_episode, step_world
from pneuma.env.state import Array, entry, open_state, part


@entry
def reset_worlds(handle: Array, chosen: Array, mask: Array) -> None:
    """Start an episode in every world whose `mask` is set.

    Takes the handle of a `State`, `chosen` (N,) and `mask` (N,). Player p of a world takes start place
    `chosen + p`, wrapping around; `chosen` below zero asks for one at random. Where there are several
    levels, one is drawn first.
    """
    s = open_state(handle)
    for w in range(s.worlds.shape[0]):
        if mask[w]:
            begin_episode(s, w, chosen[w])


@entry
def step_worlds(handle: Array, actions: Array) -> int:
    """Advance every running world by one agent step, observe it, and return how many ended.

    Takes the handle of a `State` and actions (N, P), whole numbers. A world whose episode has ended stays as
    it is, with empty events, until it is reset.
    """
    s = open_state(handle)
    ended = 0
    for w in range(s.worlds.shape[0]):
        for p in range(s.players.shape[1]):
            _clear(s.events[w, p])
        if s.worlds[w].ending != RUNNING:
            continue
        ended += step_world(s, w, actions)
        for p in range(s.players.shape[1]):
            observe_player(s, w, p, True)
        for p in range(s.players.shape[1]):
            if s.events[w, p].present or s.events[w, p].died:
                write_reward(s.players[w, p], s.player_stats[p], s.events[w, p])
    return ended


@entry
def observe_worlds(handle: Array) -> None:
    """Write the observations of every world as it stands."""
    s = open_state(handle)
    for w in range(s.worlds.shape[0]):
        for p in range(s.players.shape[1]):
            observe_player(s, w, p, s.worlds[w].ending == RUNNING)


@part
def _clear(event: Array) -> None:
    """Empty a player's events before a step."""
    event.reward = 0.0
    event.xp_gained = 0.0
    event.hp_lost = 0.0
    event.hp_gained = 0.0
    event.hits = 0
    event.kills = 0
    event.notices = 0
    event.contacts = 0
    event.died = 0
    event.present = 0
    event.distance = math.inf
