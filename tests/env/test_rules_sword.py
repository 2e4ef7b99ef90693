"""The rules: swinging the sword."""

from __future__ import annotations

import pytest

from .arena import (
    ATTACK,
    DOWN,
    LEFT,
    RIGHT,
    UP,
    monster_at,
    monster_hp,
    move_monster,
    play,
    player_at,
    stage,
)

WAYS = {DOWN: (0, 1), LEFT: (-1, 0), UP: (0, -1), RIGHT: (1, 0)}
HILTS = {DOWN: (-12.0, 52.0), LEFT: (-54.0, 14.0), UP: (8.0, -44.0), RIGHT: (54.0, 14.0)}
"""From the player; where the sword's box ends is in test_bodies."""

# --- Time ----------------------------------------------------------------------------------------


def test_an_attack_lasts_three_steps_in_which_walking_does_nothing(arena: str) -> None:
    worlds = stage(arena, facing=UP)
    play(worlds, ATTACK, LEFT, DOWN)  # 0.4 s = 24 ticks = 3 steps
    assert player_at(worlds) == (0.0, 0.0)
    assert worlds.players["facing"][0, 0] == UP
    play(worlds, LEFT)
    assert player_at(worlds) == (-40.0, 0.0)
    assert worlds.players["facing"][0, 0] == LEFT


def test_attacking_during_an_attack_does_not_prolong_it(arena: str) -> None:
    worlds = stage(arena)
    play(worlds, ATTACK, ATTACK, ATTACK, RIGHT)
    assert player_at(worlds) == (40.0, 0.0)


def test_the_sword_strikes_until_the_last_tick_of_a_swing(arena: str) -> None:
    for tick, hp in ((24, 20), (25, 40)):
        worlds = stage(arena, (500.0, 500.0), ticks=1, still=True)
        play(worlds, ATTACK, *[UP] * (tick - 2))
        move_monster(worlds, 0, 60.0, 0.0)  # comes within reach only now
        play(worlds, RIGHT)
        assert monster_hp(worlds) == hp, tick


def test_walking_strikes_nothing(arena: str) -> None:
    worlds = stage(arena, (54.0, 0.0), still=True)
    play(worlds, RIGHT, UP, LEFT)
    assert monster_hp(worlds) == 40


# --- Blows ---------------------------------------------------------------------------------------


def test_a_swing_hits_a_monster_once(arena: str) -> None:
    # Knocked back 2 px a tick from the hilt (54, 14), it stays within 90 px for 15 ticks more.
    worlds = stage(arena, (60.0, 14.0))
    play(worlds, ATTACK)
    assert (monster_hp(worlds), worlds.events["hits"][0, 0]) == (20, 1)
    play(worlds, ATTACK, ATTACK)
    assert (monster_hp(worlds), worlds.events["hits"][0, 0]) == (20, 0)


def test_two_swings_kill_a_bamboo(arena: str) -> None:
    worlds = stage(arena, (54.0, 0.0))
    play(worlds, ATTACK, ATTACK, ATTACK)
    move_monster(worlds, 0, 54.0, 0.0)
    play(worlds, ATTACK)  # 40 - 2 x 20 = 0
    assert monster_hp(worlds) == 0
    assert worlds.players["kills"][0, 0] == 1
    assert worlds.worlds["monsters_left"][0] == 3  # of the four


def test_a_swing_hits_every_monster_that_it_meets(arena: str) -> None:
    worlds = stage(arena, (54.0, 0.0), (40.0, 50.0), (-54.0, 0.0), still=True)
    play(worlds, ATTACK)
    assert [monster_hp(worlds, m) for m in range(4)] == [20, 20, 40, 40]
    assert worlds.events["hits"][0, 0] == 2


def test_the_dead_are_not_struck(arena: str) -> None:
    worlds = stage(arena, (54.0, 0.0), still=True)
    worlds.monsters["hp"][0, 0] = 0
    play(worlds, ATTACK)
    assert worlds.events["hits"][0, 0] == 0
    assert worlds.players["kills"][0, 0] == 0


def test_the_sword_turns_with_the_player_before_it_strikes(arena: str) -> None:
    worlds = stage(arena, (-94.0, 0.0), facing=RIGHT, still=True)
    play(worlds, LEFT, ATTACK)  # now at (-40, 0): the monster is at the sword's centre
    assert monster_hp(worlds) == 20


# --- Knock-back ----------------------------------------------------------------------------------


def test_a_blow_knocks_back_60_px_away_from_the_hilt(arena: str) -> None:
    # The monster at (84, -26) is (30, -40) = 50 x (0.6, -0.8) from the hilt. 2 px a tick for 30 ticks:
    # 60 x (0.6, -0.8) = (36, -48), so it lands at (120, -74).
    worlds = stage(arena, (84.0, -26.0), ticks=1)
    play(worlds, ATTACK)
    assert monster_at(worlds) == pytest.approx((85.2, -27.6))
    play(worlds, *[ATTACK] * 29)
    assert monster_at(worlds) == pytest.approx((120.0, -74.0))
    play(worlds, ATTACK)  # then it comes back, 2.5 px on each axis
    assert monster_at(worlds) == pytest.approx((117.5, -71.5))


@pytest.mark.parametrize("facing", HILTS)
def test_a_monster_beyond_the_hilt_flies_the_way_faced(arena: str, facing: int) -> None:
    x, y = HILTS[facing]
    dx, dy = WAYS[facing]
    worlds = stage(arena, (x + 16 * dx, y + 16 * dy), facing=facing, ticks=1)
    play(worlds, *[ATTACK] * 24)
    assert monster_at(worlds) == (x + 64 * dx, y + 64 * dy)  # 24 ticks of 2 px


def test_a_monster_at_the_hilt_is_stunned_where_it_stands(arena: str) -> None:
    """For 30 ticks; the second swing's blow in tick 25 does not make them more."""
    worlds = stage(arena, (54.0, 14.0), ticks=1)
    worlds.monsters["hp"] = 60
    play(worlds, *[ATTACK] * 30)
    assert monster_at(worlds) == (54.0, 14.0)
    play(worlds, ATTACK)
    assert monster_at(worlds) == (51.5, 14.0)
