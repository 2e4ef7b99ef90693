"""The rules: monsters notice, chase and bite."""

from __future__ import annotations

import pytest

from .arena import (
    ATTACK,
    LEFT,
    RIGHT,
    STAND,
    UP,
    monster_at,
    move_monster,
    play,
    player_hp,
    stage,
)

# A player at the origin fills x from -25 to 22 and y from -22 to 26; circles are tested against that box.
# Where the player faces right, monsters on the left are out of the sword's way. How far circles reach along
# an axis is in test_bodies.

# --- Noticing ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("x", "noticed"), [(-205.0, True), (-205.25, False)])
def test_a_monster_notices_a_player_by_the_nearest_corner_of_its_body(
    arena: str, x: float, noticed: bool
) -> None:
    # The circle is centred 7 px below: (180, 240) from the corner (-25, -22) is 300.
    worlds = stage(arena, (x, -269.0))
    play(worlds, STAND)
    assert worlds.events["notices"][0, 0] == noticed
    assert (monster_at(worlds) != (x, -269.0)) == noticed


def test_a_notice_counts_once_until_the_player_has_left(arena: str) -> None:
    worlds = stage(arena, (-325.0, 0.0), ticks=1, still=True)
    counts = []
    for x in (-325.0, -325.0, -325.5, -325.0):
        move_monster(worlds, 0, x, 0.0)
        play(worlds, STAND)
        counts.append(int(worlds.events["notices"][0, 0]))
    assert counts == [1, 0, 0, 1]


def test_a_player_who_walks_into_the_circle_is_noticed_there(arena: str) -> None:
    # 340 px to the left edge of the body: after 8 ticks of 5 px exactly 300, in the last tick.
    worlds = stage(arena, (-365.0, 0.0))
    play(worlds, LEFT)
    assert worlds.events["notices"][0, 0] == 1
    assert monster_at(worlds) == (-362.5, 0.0)


def test_a_monster_that_nobody_is_near_stays_home(arena: str) -> None:
    worlds = stage(arena)
    homes = worlds.monsters["x"].copy(), worlds.monsters["y"].copy()
    play(worlds, *[STAND] * 50)
    assert (worlds.monsters["x"] == homes[0]).all() and (worlds.monsters["y"] == homes[1]).all()


# --- Chasing -------------------------------------------------------------------------------------


def test_a_monster_chases_2_5_px_a_tick_on_each_axis(arena: str) -> None:
    worlds = stage(arena, (-200.0, 100.0))
    play(worlds, STAND)
    assert monster_at(worlds) == (-180.0, 80.0)  # 8 x 2.5 = 20 on both


def test_a_monster_comes_no_nearer_than_30_px_on_either_axis(arena: str) -> None:
    # y: 100 - 28 x 2.5 = 30 after 28 ticks; x: 200 - 68 x 2.5 = 30 after 68.
    worlds = stage(arena, (-200.0, 100.0), ticks=1, settings={"bodies": "pass"})
    play(worlds, *[STAND] * 28)
    assert monster_at(worlds) == (-130.0, 30.0)
    play(worlds, *[STAND] * 40)
    assert monster_at(worlds) == (-30.0, 30.0)
    play(worlds, *[STAND] * 10)
    assert monster_at(worlds) == (-30.0, 30.0)


@pytest.mark.parametrize(("x", "after"), [(-30.0, -30.0), (-30.5, -28.0), (30.5, 28.0), (-12.0, -12.0)])
def test_a_monster_steps_only_from_beyond_30_px(arena: str, x: float, after: float) -> None:
    worlds = stage(arena, (x, 60.0), facing=UP, ticks=1)
    play(worlds, STAND)
    assert monster_at(worlds) == (after, 57.5)


def test_a_monster_follows_as_long_as_it_sees_and_then_stays(arena: str) -> None:
    worlds = stage(arena, (-321.5, 0.0), ticks=1)
    play(worlds, *[RIGHT] * 10)
    # Before the player's tick t the body is 296.5 px away; the player gains 5 px a tick, the monster
    # 2.5: 301.5 at once. So it never notices.
    assert monster_at(worlds) == (-321.5, 0.0)

    worlds = stage(arena, (-311.5, 0.0), ticks=1)
    play(worlds, *[RIGHT] * 10)
    # At t the distance is 286.5 + 5 t - 2.5 (t - 1) = 289 + 2.5 t, within 300 for t up to 4: 4 steps.
    assert monster_at(worlds) == (-301.5, 0.0)


@pytest.mark.parametrize(
    ("settings", "x"),
    [
        ({}, 244.0),  # the obstacle's left edge is at 256: the monster's right edge stops there
        ({"terrain_stops": "players"}, 263.0),  # 243 + 20
        ({"trees": "pass"}, 263.0),
    ],
)
def test_a_wall_holds_up_a_monster_but_not_its_other_axis(
    arena: str, settings: dict[str, object], x: float
) -> None:
    worlds = stage(arena, (243.0, 50.0), players=[(400.0, -100.0)], settings=settings)
    play(worlds, STAND)
    assert monster_at(worlds) == (x, 30.0)  # 50 - 20


def test_a_monster_flying_back_does_not_chase(arena: str) -> None:
    worlds = stage(arena, (-200.0, 0.0), ticks=1)
    worlds.monsters["knocked"][0, 0] = 3
    worlds.monsters["knock_y"][0, 0] = -2.0
    play(worlds, STAND, STAND, STAND)
    assert monster_at(worlds) == (-200.0, -6.0)
    play(worlds, STAND)
    assert monster_at(worlds) == (-197.5, -6.0)


# --- Biting --------------------------------------------------------------------------------------


def test_the_first_bite_comes_at_once_and_the_next_60_ticks_later(arena: str) -> None:
    worlds = stage(arena, (-40.0, 0.0), ticks=1)
    hp = []
    for _ in range(121):
        play(worlds, STAND)
        hp.append(player_hp(worlds))
    assert hp == [93] * 60 + [86] * 60 + [79]


def test_a_contact_counts_once_while_it_lasts(arena: str) -> None:
    worlds = stage(arena, (-40.0, 0.0))
    contacts = 0
    for _ in range(10):
        play(worlds, STAND)
        contacts += int(worlds.events["contacts"][0, 0])
    assert contacts == 1
    assert player_hp(worlds) == 86  # bites in ticks 1 and 61


def test_whoever_leaves_and_comes_back_is_bitten_at_once(arena: str) -> None:
    worlds = stage(arena, (-40.0, 0.0), ticks=1, still=True)
    hp = []
    for x in (-40.0, -65.25, -65.0, -65.0):  # in, just out, in again, still in
        move_monster(worlds, 0, x, 0.0)
        play(worlds, STAND)
        hp.append(player_hp(worlds))
    assert hp == [93, 93, 86, 86]


def test_every_monster_bites_by_its_own_clock(arena: str) -> None:
    worlds = stage(arena, (-40.0, 0.0), (-500.0, 0.0), ticks=1, still=True)
    play(worlds, *[STAND] * 10)
    move_monster(worlds, 1, -40.0, 50.0)
    hp = []
    for _ in range(61):  # ticks 11 to 71
        play(worlds, STAND)
        hp.append(player_hp(worlds))
    # The first bit in tick 1 and does again in tick 61, the other in ticks 11 and 71.
    assert hp == [86] * 50 + [79] * 10 + [72]


def test_the_dead_do_not_bite(arena: str) -> None:
    worlds = stage(arena, (54.0, 0.0))
    worlds.monsters["hp"][0, 0] = 20
    play(worlds, ATTACK)  # the sword strikes before the monster would bite
    assert worlds.events["hp_lost"][0, 0] == 0
    play(worlds, *[STAND] * 10)
    assert player_hp(worlds) == 107  # the kill's
    assert monster_at(worlds) == (54.0, 0.0)
