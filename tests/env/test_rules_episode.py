"""The rules: what a kill earns, how an episode ends, and what is told of a step."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from pneuma.config import make_env_config
from pneuma.env import state
from pneuma.env.worlds import Worlds

from .arena import (
    ATTACK,
    RIGHT,
    STAND,
    UP,
    monster_at,
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


def test_a_blow_that_does_not_kill_earns_nothing(arena: str) -> None:
    worlds = stage(arena, (80.0, 0.0), still=True)
    play(worlds, ATTACK)
    assert told(worlds) == {"hits": 1, "notices": 1}
    assert (worlds.players["xp"][0, 0], worlds.players["kills"][0, 0]) == (0, 0)
    assert reward(worlds) == -1.0  # 0 - 100 / 100


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


def test_a_player_without_hp_ends_the_episode(arena: str) -> None:
    worlds = stage(arena, (-40.0, 0.0))
    worlds.players["hp"] = 14
    play(worlds, *[STAND] * 7)
    assert (worlds.ending(0), player_hp(worlds)) == ("running", 7)
    play(worlds, STAND)  # tick 61 is in the 8th step
    assert (worlds.ending(0), player_hp(worlds)) == ("killed", 0)
    assert reward(worlds) == 0  # 0 XP - 0 / 100
    assert worlds.worlds["steps"][0] == 8


def test_no_more_hp_are_lost_than_there_are(arena: str) -> None:
    worlds = stage(arena, (-40.0, 0.0))
    worlds.players["hp"] = 5
    play(worlds, STAND)
    assert player_hp(worlds) == 0
    assert worlds.events["hp_lost"][0, 0] == 5


def test_the_tick_of_death_is_the_last_one(arena: str) -> None:
    worlds = stage(arena, (-40.0, 0.0))
    worlds.players["hp"] = 7
    play(worlds, RIGHT)
    assert player_at(worlds) == (5.0, 0.0)  # one tick's walk, bitten at 45 - 25 = 20 px


def test_the_step_goes_on_to_its_end_without_the_last_player(arena: str) -> None:
    worlds = stage(arena, (-40.0, 0.0), (-200.0, 0.0), (-300.0, 0.0))
    worlds.players["hp"] = 7  # gone in the first of 8 ticks
    worlds.monsters["knocked"][0, 1], worlds.monsters["knock_y"][0, 1] = 30, 2.0
    play(worlds, STAND)
    assert worlds.ending(0) == "killed"
    assert monster_at(worlds, 1) == (-200.0, 16.0)  # flies on for 8 ticks
    assert monster_at(worlds, 2) == (-297.5, 0.0)  # chased him for the one tick that he lived


def test_healing_comes_before_the_bites_of_the_same_tick(arena: str) -> None:
    worlds = about_to_kill(arena, hp=7)
    worlds.monsters["x"][0, 1], worlds.monsters["y"][0, 1] = -40.0, 0.0
    play(worlds, ATTACK)  # 7 + 7 - 7
    assert (worlds.ending(0), player_hp(worlds)) == ("running", 7)


def test_all_bites_of_a_tick_are_settled_together(arena: str) -> None:
    worlds = stage(arena, (-40.0, 0.0), (-40.0, 50.0), (-40.0, -50.0))
    worlds.players["hp"] = 10
    play(worlds, STAND)  # 3 x 7
    assert (worlds.ending(0), player_hp(worlds)) == ("killed", 0)
    assert worlds.events["hp_lost"][0, 0] == 10
    assert worlds.events["contacts"][0, 0] == 3


def test_a_kill_in_the_tick_of_death_counts(arena: str) -> None:
    worlds = about_to_kill(arena, hp=7)
    for index, y in enumerate((0.0, 50.0), start=1):
        worlds.monsters["x"][0, index], worlds.monsters["y"][0, index] = -40.0, y
    play(worlds, ATTACK)  # 7 + 7 - 2 x 7
    assert worlds.ending(0) == "killed"
    assert (worlds.players["xp"][0, 0], worlds.players["kills"][0, 0]) == (1, 1)
    assert (worlds.events["hp_gained"][0, 0], worlds.events["hp_lost"][0, 0]) == (7, 14)
    assert reward(worlds) == 1.0  # 1 XP - 0 / 100


@pytest.mark.parametrize(("tick", "hit"), [(1, True), (2, False)])
def test_the_sword_of_the_dead_strikes_no_more(arena: str, tick: int, hit: bool) -> None:
    # The bite kills in the first tick. Another monster flies into the sword's reach, which ends at 90.
    worlds = stage(arena, (-40.0, 0.0), still=True)
    worlds.players["hp"] = 7
    flier = worlds.monsters[0, 1]
    flier["x"], flier["y"], flier["hp"] = 89.0 + 2 * (tick - 1), 0.0, 20
    flier["knocked"], flier["knock_x"], flier["knock_y"] = 30, -2.0, 0.0
    play(worlds, ATTACK)
    assert (monster_hp(worlds, 1) == 0) is hit
    assert worlds.ending(0) == ("running" if hit else "killed")  # a kill heals 7 HP in time


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


def test_the_time_limit_ends_an_episode_after_so_many_steps(arena: str) -> None:
    worlds = stage(arena, settings={"episode_steps": 5})
    play(worlds, *[STAND] * 4)
    assert worlds.ending(0) == "running"
    assert worlds.step(np.full((1, 1), STAND)) == 1  # it counts those that ended
    assert worlds.ending(0) == "time-limit"
    assert worlds.step(np.full((1, 1), STAND)) == 0


def test_the_time_limit_is_1000_steps_unless_set() -> None:
    assert make_env_config({}).episode_steps == 1000
    assert Worlds(1).settings["step_limit"][0] == 1000


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


def test_a_cleared_level_runs_on_to_the_time_limit(arena: str) -> None:
    worlds = about_to_kill(arena, settings={"episode_steps": 4})
    worlds.monsters["hp"][0, 1:] = 0
    worlds.worlds["monsters_left"] = 1
    play(worlds, *[ATTACK] * 4)
    assert worlds.ending(0) == "time-limit"


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
