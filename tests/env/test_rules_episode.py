"""The rules: what a kill earns, how an episode ends, and what is told of a step."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pneuma.env import state
from pneuma.env.worlds import Worlds

from .arena import (
    ATTACK,
    RIGHT,
    STAND,
    UP,
    monster_hp,
    play,
    player_at,
    player_hp,
    stage,
    state_bits,
)


def told(worlds: Worlds) -> dict[str, float]:
    """Return what was told to have happened in the last step."""
    row = worlds.events[0, 0]
    state_of_things = ("reward", "distance", "present")
    return {name: float(row[name]) for name in row.dtype.names if row[name] and name not in state_of_things}


def reward(worlds: Worlds) -> float:
    return float(worlds.events["reward"][0, 0])


def about_to_kill(arena: str, hp: float = 100.0, settings: Mapping[str, object] | None = None) -> Worlds:
    """Set up a player with so many HP, and a monster that the next blow kills.

    It is within reach of the sword, but 58 px from the player's body: it cannot bite.
    """
    worlds = stage(arena, (80.0, 0.0), still=True, settings=settings)
    worlds.players["hp"], worlds.monsters["hp"][0, 0] = hp, 20
    return worlds


# --- Kills and rewards ---------------------------------------------------------------------------


def test_everything_that_happens_in_a_step_is_told_once(arena: str) -> None:
    worlds = about_to_kill(arena, hp=50)
    for index, (x, y) in enumerate([(40.0, 40.0), (-40.0, 0.0), (-200.0, 0.0)], start=1):
        worlds.monsters["x"][0, index], worlds.monsters["y"][0, index] = x, y
    play(worlds, ATTACK)
    # Monster 0 dies of the sword before it senses anything. Monster 1 is struck, sees and touches, and
    # flies before it can bite; monster 2 sees and bites, monster 3 sees: 50 + 7 - 7 = 50 HP.
    assert told(worlds) == {
        "hits": 2, "kills": 1, "xp_gained": 1, "hp_gained": 7, "notices": 3, "contacts": 2, "hp_lost": 7,
    }  # fmt: skip
    assert reward(worlds) == 1 - 0.5
    play(worlds, ATTACK)
    assert told(worlds) == {}


# --- Death ---------------------------------------------------------------------------------------


def test_an_ended_world_stays_as_it_is_until_it_is_reset(arena: str) -> None:
    worlds = stage(arena, (-40.0, 0.0))
    worlds.players["hp"] = 7
    play(worlds, STAND)
    assert worlds.ending(0) == "killed"
    worlds.events[:] = np.zeros(1, state.EVENTS)  # an ended world tells of nothing more
    worlds.events["distance"] = np.inf
    before = state_bits(worlds)
    play(worlds, RIGHT, ATTACK, UP)
    assert state_bits(worlds) == before
    worlds.reset()
    assert (worlds.ending(0), player_hp(worlds), worlds.worlds["steps"][0]) == ("running", 100, 0)


# --- A new episode -------------------------------------------------------------------------------


def test_a_reset_puts_everything_back(arena: str) -> None:
    fresh, worlds = stage(arena), stage(arena)
    fresh.reset()
    for bodies in (worlds.players, worlds.monsters):
        for name in bodies.dtype.names or ():
            bodies[name][..., :1] = 1  # of eight bite clocks, one player has one
    worlds.worlds["monsters_left"] = worlds.worlds["players_left"] = worlds.worlds["ending"] = 0
    worlds.reset()
    for name in ("players", "monsters"):
        for field in getattr(worlds, name).dtype.names:
            if not field.startswith("knock_"):  # of the last flight; means nothing on the ground
                assert np.array_equal(getattr(worlds, name)[field], getattr(fresh, name)[field]), field
    for field in ("steps", "monsters_left", "players_left", "ending"):
        assert worlds.worlds[field][0] == fresh.worlds[field][0], field
    assert (player_at(worlds), player_hp(worlds), monster_hp(worlds)) == ((0.0, 0.0), 100, 40)
    assert worlds.worlds["monsters_left"][0] == 4
