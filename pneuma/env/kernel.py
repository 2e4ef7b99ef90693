"""The calls from outside to the compiled rules: reset, step and observe N worlds at once."""

from __future__ import annotations

import math
import sys
from functools import cache
from typing import Any

from numba.core import event

from pneuma.env.observe import observe_player
from pneuma.env.reward import share_reward, write_reward
from pneuma.env.rules import RUNNING, begin_episode, step_world
from pneuma.env.state import Array, entry, inlined, open_state

GO_ON = -2
"""In place of a start place in `begins`: this world is not reset."""


@entry
def run_worlds(handle: Array, actions: Array, steps: bool) -> int:
    """Advance every running world by one agent step, or reset worlds; observe; return how many ended.

    This is the only function that is compiled to be called, as each would compile the observations anew.

    Args:
        handle: of a `State`. With `steps` False, its `begins` say which worlds start an episode, and where:
            player p of a world takes start place `begins + p`, wrapping around; -1 draws one at random.
            Where there are several levels, one is drawn first. All worlds are observed.
        actions: (N, P), whole numbers, read by a step alone. A world whose episode has ended stays as it is,
            with empty events, until it is reset.
        steps: whether worlds advance.
    """
    s = open_state(handle)
    ended = 0
    for w in range(s.worlds.shape[0]):
        if steps:
            for p in range(s.players.shape[1]):
                _clear(s.events[w, p])
            if s.worlds[w].ending != RUNNING:
                continue
            ended += step_world(s, w, actions)
        elif s.begins[w] != GO_ON:
            begin_episode(s, w, s.begins[w])
        tell = steps or s.worlds[w].ending == RUNNING
        for p in range(s.players.shape[1]):
            observe_player(s, w, p, tell)
        if steps:
            for p in range(s.players.shape[1]):
                if s.events[w, p].present or s.events[w, p].died:
                    write_reward(s.players[w, p], s.player_stats[p], s.events[w, p])
            if s.settings[0].shared_reward:
                share_reward(s.events[w])
    return ended


@cache
def announce_compiling() -> None:
    """From now on tell a person at a terminal when the rules are compiled, as nothing else happens then."""
    event.register("numba:compile", _Announcer())  # type: ignore[no-untyped-call]


class _Announcer(event.Listener):
    def on_start(self, event: Any) -> None:
        if event.data["dispatcher"] is run_worlds and sys.stderr.isatty():
            print("Compiling the rules of the world: some ten seconds, once a version.", file=sys.stderr)

    def on_end(self, event: Any) -> None:
        pass


@inlined
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
