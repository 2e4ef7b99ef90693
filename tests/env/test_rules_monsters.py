"""The rules: monsters notice, chase and bite."""

from __future__ import annotations

import pytest

from .arena import (
    ATTACK,
    LEFT,
    RIGHT,
    STAND,
    UP,
    Place,
    monster_at,
    move_monster,
    play,
    player_hp,
    stage,
)

# A player at the origin fills x from -23.5 to 23.5 and y from -24 to 24; circles are tested against
# that box. Where the player faces right, monsters on the left are out of the sword's way.

# --- Noticing ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("place", "noticed"),
    [
        ((-323.5, 0.0), True),  # 23.5 + 300
        ((-323.75, 0.0), False),
        ((0.0, 324.0), True),  # 24 + 300
        ((0.0, 324.25), False),
        ((-203.5, -264.0), True),  # (180, 240) from the corner (-23.5, -24): 300
        ((-203.75, -264.0), False),
        ((-323.5, -24.0), True),  # beside the box, not its centre
        ((-323.5, -24.5), False),
    ],
)
def test_a_monster_notices_a_player_whose_body_is_within_300_px(
    arena: str, place: Place, noticed: bool
) -> None:
    worlds = stage(arena, place)
    play(worlds, STAND)
    assert worlds.events["notices"][0, 0] == noticed
    assert (monster_at(worlds) != place) == noticed


def test_a_notice_counts_once_until_the_player_has_left(arena: str) -> None:
    worlds = stage(arena, (-323.5, 0.0), ticks=1, still=True)
    counts = []
    for x in (-323.5, -323.5, -324.0, -323.5):
        move_monster(worlds, 0, x, 0.0)
        play(worlds, STAND)
        counts.append(int(worlds.events["notices"][0, 0]))
    assert counts == [1, 0, 0, 1]


def test_a_player_who_walks_into_the_circle_is_noticed_there(arena: str) -> None:
    # 340 px to the left edge of the body: after 8 ticks of 5 px exactly 300, in the last tick.
    worlds = stage(arena, (-363.5, 0.0))
    play(worlds, LEFT)
    assert worlds.events["notices"][0, 0] == 1
    assert monster_at(worlds) == (-361.0, 0.0)


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
    worlds = stage(arena, (-200.0, 100.0), ticks=1)
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
    worlds = stage(arena, (-320.0, 0.0), ticks=1)
    play(worlds, *[RIGHT] * 10)
    # Before the player's tick t the body is 296.5 px away; the player gains 5 px a tick, the monster
    # 2.5: 301.5 at once. So it never notices.
    assert monster_at(worlds) == (-320.0, 0.0)

    worlds = stage(arena, (-310.0, 0.0), ticks=1)
    play(worlds, *[RIGHT] * 10)
    # At t the distance is 286.5 + 5 t - 2.5 (t - 1) = 289 + 2.5 t, within 300 for t up to 4: 4 steps.
    assert monster_at(worlds) == (-300.0, 0.0)


def test_a_wall_holds_up_a_monster_but_not_its_other_axis(arena: str) -> None:
    # The obstacle's left edge is at 256: the monster's right edge stops there, x = 244.
    worlds = stage(arena, (243.0, 50.0), players=[(400.0, -100.0)])
    play(worlds, STAND)
    assert monster_at(worlds) == (244.0, 30.0)  # 50 - 20


def test_a_monster_flying_back_does_not_chase(arena: str) -> None:
    worlds = stage(arena, (-200.0, 0.0), ticks=1)
    worlds.monsters["knocked"][0, 0] = 3
    worlds.monsters["knock_y"][0, 0] = -2.0
    play(worlds, STAND, STAND, STAND)
    assert monster_at(worlds) == (-200.0, -6.0)
    play(worlds, STAND)
    assert monster_at(worlds) == (-197.5, -6.0)


# --- Biting --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("place", "bitten"),
    [
        ((-63.5, 0.0), True),  # 23.5 + 40
        ((-63.75, 0.0), False),
        ((0.0, -64.0), True),
        ((0.0, -64.25), False),
        ((-47.5, -56.0), True),  # (24, 32) from the corner: 40
        ((-47.75, -56.0), False),
        ((-10.0, 10.0), True),  # inside the body
    ],
)
def test_a_bite_reaches_40_px_to_the_body(arena: str, place: Place, bitten: bool) -> None:
    worlds = stage(arena, place, ticks=1)
    play(worlds, STAND)
    assert player_hp(worlds) == (93 if bitten else 100)  # 7 HP
    assert worlds.events["hp_lost"][0, 0] == (7 if bitten else 0)
    assert worlds.events["contacts"][0, 0] == bitten


def test_the_first_bite_comes_at_once_and_the_next_60_ticks_later(arena: str) -> None:
    worlds = stage(arena, (-30.0, 0.0), ticks=1)
    hp = []
    for _ in range(121):
        play(worlds, STAND)
        hp.append(player_hp(worlds))
    assert hp == [93] * 60 + [86] * 60 + [79]


def test_a_contact_counts_once_while_it_lasts(arena: str) -> None:
    worlds = stage(arena, (-30.0, 0.0))
    contacts = 0
    for _ in range(10):
        play(worlds, STAND)
        contacts += int(worlds.events["contacts"][0, 0])
    assert contacts == 1
    assert player_hp(worlds) == 86  # bites in ticks 1 and 61


def test_whoever_leaves_and_comes_back_is_bitten_at_once(arena: str) -> None:
    worlds = stage(arena, (-30.0, 0.0), ticks=1, still=True)
    hp = []
    for x in (-30.0, -63.75, -63.5, -63.5):  # in, just out, in again, still in
        move_monster(worlds, 0, x, 0.0)
        play(worlds, STAND)
        hp.append(player_hp(worlds))
    assert hp == [93, 93, 86, 86]


def test_every_monster_bites_by_its_own_clock(arena: str) -> None:
    worlds = stage(arena, (-30.0, 0.0), (-500.0, 0.0), ticks=1, still=True)
    play(worlds, *[STAND] * 10)
    move_monster(worlds, 1, -30.0, 10.0)
    hp = []
    for _ in range(61):  # ticks 11 to 71
        play(worlds, STAND)
        hp.append(player_hp(worlds))
    # The first bit in tick 1 and does again in tick 61, the other in ticks 11 and 71.
    assert hp == [86] * 50 + [79] * 10 + [72]


def test_a_monster_bites_while_it_flies_back(arena: str) -> None:
    worlds = stage(arena, (54.0, 0.0), ticks=1)  # struck in tick 1; the body is 30.5 px away
    play(worlds, ATTACK)
    assert worlds.monsters["knocked"][0, 0] == 29
    assert player_hp(worlds) == 93


def test_the_dead_do_not_bite(arena: str) -> None:
    worlds = stage(arena, (54.0, 0.0))
    worlds.monsters["hp"][0, 0] = 20
    play(worlds, ATTACK)  # the sword strikes before the monster would bite
    assert worlds.events["hp_lost"][0, 0] == 0
    play(worlds, *[STAND] * 10)
    assert worlds.players["hp"][0, 0] == 100
    assert monster_at(worlds) == (54.0, 0.0)
