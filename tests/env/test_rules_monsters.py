"""The rules: monsters notice, chase and bite."""

from __future__ import annotations

import pytest

from .arena import (
    STAND,
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


# --- Chasing -------------------------------------------------------------------------------------


def test_a_monster_comes_no_nearer_than_30_px_on_either_axis(arena: str) -> None:
    # y: 100 - 28 x 2.5 = 30 after 28 ticks; x: 200 - 68 x 2.5 = 30 after 68.
    worlds = stage(arena, (-200.0, 100.0), ticks=1, settings={"bodies": "pass"})
    play(worlds, *[STAND] * 28)
    assert monster_at(worlds) == (-130.0, 30.0)
    play(worlds, *[STAND] * 40)
    assert monster_at(worlds) == (-30.0, 30.0)
    play(worlds, *[STAND] * 10)
    assert monster_at(worlds) == (-30.0, 30.0)


# --- Biting --------------------------------------------------------------------------------------


def test_the_first_bite_comes_at_once_and_the_next_60_ticks_later(arena: str) -> None:
    worlds = stage(arena, (-40.0, 0.0), ticks=1)
    hp = []
    for _ in range(121):
        play(worlds, STAND)
        hp.append(player_hp(worlds))
    assert hp == [93] * 60 + [86] * 60 + [79]


def test_whoever_leaves_and_comes_back_is_bitten_at_once(arena: str) -> None:
    worlds = stage(arena, (-40.0, 0.0), ticks=1, still=True)
    hp = []
    for x in (-40.0, -65.25, -65.0, -65.0):  # in, just out, in again, still in
        move_monster(worlds, 0, x, 0.0)
        play(worlds, STAND)
        hp.append(player_hp(worlds))
    assert hp == [93, 93, 86, 86]
