"""The rules: what a kill earns, how an episode ends, and what is told of a step."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

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


def test_a_kill_earns_1_xp_and_7_hp(arena: str) -> None:
    worlds = about_to_kill(arena, hp=50)
    play(worlds, ATTACK)
    assert told(worlds) == {"hits": 1, "kills": 1, "xp_gained": 1, "hp_gained": 7}
    assert (worlds.players["xp"][0, 0], player_hp(worlds), worlds.players["kills"][0, 0]) == (1, 57, 1)


def test_the_reward_is_xp_less_the_share_of_hp_at_every_step(arena: str) -> None:
    worlds = about_to_kill(arena, hp=50)
    play(worlds, UP)
    assert reward(worlds) == -0.5  # 0 - 50 / 100
    worlds.players["y"], worlds.players["facing"] = 0.0, RIGHT
    play(worlds, ATTACK)
    assert reward(worlds) == 1 - 0.57  # 50 + 7 HP
    play(worlds, ATTACK)
    assert reward(worlds) == 1 - 0.57  # again: it is a level, not a gain


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


def test_healing_comes_before_the_bites_of_the_same_tick(arena: str) -> None:
    worlds = about_to_kill(arena, hp=7)
    worlds.monsters["x"][0, 1], worlds.monsters["y"][0, 1] = -40.0, 0.0
    play(worlds, ATTACK)  # 7 + 7 - 7
    assert (worlds.ending(0), player_hp(worlds)) == ("running", 7)


def test_a_kill_in_the_tick_of_death_counts(arena: str) -> None:
    worlds = about_to_kill(arena, hp=7)
    for index, y in enumerate((0.0, 50.0), start=1):
        worlds.monsters["x"][0, index], worlds.monsters["y"][0, index] = -40.0, y
    play(worlds, ATTACK)  # 7 + 7 - 2 x 7
    assert worlds.ending(0) == "killed"
    assert (worlds.players["xp"][0, 0], worlds.players["kills"][0, 0]) == (1, 1)
    assert (worlds.events["hp_gained"][0, 0], worlds.events["hp_lost"][0, 0]) == (7, 14)
    assert reward(worlds) == 1.0  # 1 XP - 0 / 100


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


# --- Time ----------------------------------------------------------------------------------------


def test_whoever_dies_in_the_last_step_was_killed(arena: str) -> None:
    worlds = stage(arena, (-40.0, 0.0), settings={"episode_steps": 1})
    worlds.players["hp"] = 7
    play(worlds, STAND)
    assert worlds.ending(0) == "killed"


# --- Clearing the level --------------------------------------------------------------------------


@pytest.mark.parametrize(("end_on_clear", "ending"), [(False, "running"), (True, "cleared")])
def test_the_last_kill_ends_an_episode_only_if_asked(arena: str, end_on_clear: bool, ending: str) -> None:
    worlds = about_to_kill(arena, settings={"end_on_clear": end_on_clear})
    worlds.monsters["hp"][0, 1:] = 0
    worlds.worlds["monsters_left"] = 1
    play(worlds, ATTACK)
    assert worlds.worlds["monsters_left"][0] == 0
    assert worlds.ending(0) == ending
    assert reward(worlds) == pytest.approx(-0.07)  # 1 XP - 107 / 100


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
