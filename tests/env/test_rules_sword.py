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

# --- Time ----------------------------------------------------------------------------------------


def test_an_attack_lasts_three_steps_in_which_walking_does_nothing(arena: str) -> None:
    worlds = stage(arena, facing=UP)
    play(worlds, ATTACK, LEFT, DOWN)  # 0.4 s = 24 ticks = 3 steps
    assert player_at(worlds) == (0.0, 0.0)
    assert worlds.players["facing"][0, 0] == UP
    play(worlds, LEFT)
    assert player_at(worlds) == (-40.0, 0.0)
    assert worlds.players["facing"][0, 0] == LEFT


def test_the_sword_strikes_until_the_last_tick_of_a_swing(arena: str) -> None:
    for tick, hp in ((24, 20), (25, 40)):
        worlds = stage(arena, (500.0, 500.0), ticks=1, still=True)
        play(worlds, ATTACK, *[UP] * (tick - 2))
        move_monster(worlds, 0, 60.0, 0.0)  # comes within reach only now
        play(worlds, RIGHT)
        assert monster_hp(worlds) == hp, tick


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
