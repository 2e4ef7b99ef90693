"""The rules: swinging the sword."""

from __future__ import annotations

import numpy as np
import pytest

from .arena import (
    ATTACK,
    DOWN,
    LEFT,
    RIGHT,
    UP,
    Place,
    monster_at,
    monster_hp,
    move_monster,
    play,
    player_at,
    stage,
)

# The sword box is 51 x 79 px when facing left or right and 79 x 51 when facing up or down. A body of
# 24 x 50 meets it when the centres are less than half of both apart: 25.5 + 12 = 37.5 and
# 39.5 + 25 = 64.5 sideways, 39.5 + 12 = 51.5 and 25.5 + 25 = 50.5 up and down.
CENTRES = {DOWN: (0.0, 52.0), LEFT: (-54.0, 0.0), UP: (0.0, -44.0), RIGHT: (54.0, 0.0)}
REACH = {DOWN: (51.5, 50.5), LEFT: (37.5, 64.5), UP: (51.5, 50.5), RIGHT: (37.5, 64.5)}
SIDES = [(1, 0), (-1, 0), (0, 1), (0, -1)]
CORNERS = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
FACINGS = list(CENTRES)


def hit_at(arena: str, facing: int, place: Place) -> bool:
    """Tell whether a swing hits a monster that stands there."""
    worlds = stage(arena, place, facing=facing, still=True)
    play(worlds, ATTACK)
    return monster_hp(worlds) < 40


def beside(facing: int, side: tuple[int, int], inside: float) -> Place:
    """Return the place at a side of a sword's reach, so many pixels inside it."""
    (x, y), (width, height) = CENTRES[facing], REACH[facing]
    return x + side[0] * (width - inside), y + side[1] * (height - inside)


# --- Time ----------------------------------------------------------------------------------------


def test_an_attack_lasts_three_steps_in_which_walking_does_nothing(arena: str) -> None:
    worlds = stage(arena, facing=UP)
    play(worlds, ATTACK, LEFT, DOWN)  # 0.4 s = 24 ticks = 3 steps
    assert player_at(worlds) == (0.0, 0.0)
    assert worlds.players["facing"][0, 0] == UP
    play(worlds, LEFT)
    assert player_at(worlds) == (-40.0, 0.0)
    assert worlds.players["facing"][0, 0] == LEFT


def test_an_attack_lasts_24_ticks(arena: str) -> None:
    worlds = stage(arena, ticks=1)
    play(worlds, ATTACK, *[RIGHT] * 23)
    assert player_at(worlds) == (0.0, 0.0)
    play(worlds, RIGHT)
    assert player_at(worlds) == (5.0, 0.0)


def test_attacking_during_an_attack_does_not_prolong_it(arena: str) -> None:
    worlds = stage(arena)
    play(worlds, ATTACK, ATTACK, ATTACK, RIGHT)
    assert player_at(worlds) == (40.0, 0.0)


def test_the_sword_strikes_until_the_last_tick_of_a_swing(arena: str) -> None:
    for tick, hp in ((24, 20), (25, 40)):
        worlds = stage(arena, (500.0, 500.0), ticks=1, still=True)
        play(worlds, ATTACK, *[UP] * (tick - 2))
        move_monster(worlds, 0, *CENTRES[RIGHT])  # comes within reach only now
        play(worlds, RIGHT)
        assert monster_hp(worlds) == hp, tick


def test_walking_strikes_nothing(arena: str) -> None:
    worlds = stage(arena, (54.0, 0.0), still=True)
    play(worlds, RIGHT, UP, LEFT)
    assert monster_hp(worlds) == 40


# --- Blows ---------------------------------------------------------------------------------------


def test_a_swing_hits_a_monster_once(arena: str) -> None:
    # Knocked back 2 px a tick from the centre (54, 0), it stays within 37.5 px of it for 18 ticks more.
    worlds = stage(arena, (54.0, 0.0))
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


# --- The sword's box -----------------------------------------------------------------------------


@pytest.mark.parametrize("facing", FACINGS)
def test_the_sword_hits_just_inside_its_box(arena: str, facing: int) -> None:
    for side in SIDES + CORNERS:
        assert hit_at(arena, facing, beside(facing, side, inside=0.001)), side


@pytest.mark.parametrize("facing", FACINGS)
def test_the_sword_does_not_hit_what_it_only_touches(arena: str, facing: int) -> None:
    for side in SIDES + CORNERS:
        assert not hit_at(arena, facing, beside(facing, side, inside=0.0)), side


def test_the_sword_turns_with_the_player_before_it_strikes(arena: str) -> None:
    worlds = stage(arena, (-94.0, 0.0), facing=RIGHT, still=True)
    play(worlds, LEFT, ATTACK)  # now at (-40, 0): the monster is at the sword's centre
    assert monster_hp(worlds) == 20


# --- Knock-back ----------------------------------------------------------------------------------


def test_a_blow_knocks_back_60_px_away_from_the_swords_centre(arena: str) -> None:
    # The sword's centre is (54, 0); the monster at (84, 40) is (30, 40) = 50 x (0.6, 0.8) from it.
    # 2 px a tick for 30 ticks: 60 x (0.6, 0.8) = (36, 48), so it lands at (120, 88).
    worlds = stage(arena, (84.0, 40.0), ticks=1)
    play(worlds, ATTACK)
    assert monster_at(worlds) == pytest.approx((85.2, 41.6))
    play(worlds, *[ATTACK] * 29)
    assert monster_at(worlds) == pytest.approx((120.0, 88.0))
    play(worlds, ATTACK)  # then it comes back, 2.5 px on each axis
    assert monster_at(worlds) == pytest.approx((117.5, 85.5))


@pytest.mark.parametrize("facing", FACINGS)
def test_a_monster_at_the_swords_centre_flies_the_way_faced(arena: str, facing: int) -> None:
    x, y = CENTRES[facing]
    away = np.sign([x, y]) * 60
    worlds = stage(arena, (x, y), facing=facing, ticks=1)
    play(worlds, ATTACK, *[facing] * 29)
    assert monster_at(worlds) == (x + away[0], y + away[1])


def test_a_monster_nearer_than_the_swords_centre_is_pulled_in(arena: str) -> None:
    # Away from the sword is towards the player: from (44, 0) to the left of (54, 0), 8 x 2 px.
    worlds = stage(arena, (44.0, 0.0))
    play(worlds, ATTACK)
    assert monster_at(worlds) == (28.0, 0.0)


def test_a_second_blow_begins_the_knock_back_anew(arena: str) -> None:
    worlds = stage(arena, (54.0, 0.0), ticks=1)
    worlds.monsters["hp"] = 60
    play(worlds, *[ATTACK] * 24)
    assert monster_at(worlds) == (102.0, 0.0)  # 24 x 2 px on, with 6 ticks still to fly
    move_monster(worlds, 0, 54.0, 32.0)  # straight below the centre
    play(worlds, ATTACK, *[RIGHT] * 23)
    assert monster_at(worlds) == (54.0, 80.0)  # 24 x 2 px down, not right
    assert worlds.monsters["knocked"][0, 0] == 6
